"""Figure of adaptive loops with faults."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from diagrams.studies.adaptive.laws import COLORS, EUCLIDEAN, NATURAL, PULLBACK
from geodrake.report import style

SHADES = {"passivity": NATURAL, "computed torque": PULLBACK, "unguarded": EUCLIDEAN}


def write_soak_figure(folder: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write the figure into a folder as PNG: distances and errors over time, faults as ticks."""
    folder.mkdir(parents=True, exist_ok=True)
    figure = style.new_figure(5.0)
    top, bottom = figure.subplots(2, 1, sharex=True)
    for row in rows:
        minutes = [t / 60.0 for t in row["time"]]
        color = COLORS[SHADES[row["controller"]]]
        top.plot(minutes, row["distance"], color=color, linewidth=1.2, label=row["controller"])
        bottom.plot(minutes, row["error"], color=color, linewidth=0.6)
    for ax, name in ((top, "distance from the truth"), (bottom, "tracking error, degrees")):
        style.polish(ax, grid="y")
        style.log_scale(ax, "y")
        ax.set_ylabel(name, **style.plain())
        for start in rows[0]["starts"]:
            ax.axvline(start / 60.0, color="#d5dae0", linewidth=0.5, zorder=0)
    bottom.set_xlabel("minutes", **style.plain())
    style.legend_above(figure, top.get_legend_handles_labels()[0])
    figure.savefig(folder / "adaptive_soak.png")
