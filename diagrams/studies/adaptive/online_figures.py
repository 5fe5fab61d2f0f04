"""Figure of a payload found online."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from geodrake.report import style

COLORS = {"ur10e_free_b": "#6b7683", "ur10e_free_c": "#a9b4c0", "ur10e_changed": "#1b6ca8"}
TITLES = {"offline": "Arm identified offline", "online": "Arm learned online"}


def write_online_figure(folder: Path, rows: Sequence[dict[str, Any]], mass: float) -> None:
    """Write the figure into a folder as PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    mass_figure(rows, mass).savefig(folder / "online_payload.png")


def mass_figure(rows: Sequence[dict[str, Any]], mass: float) -> Figure:
    """Estimated mass over time, one panel a way to learn the arm."""
    figure = style.new_figure(3.6)
    ways = list(dict.fromkeys(row["way"] for row in rows))
    axes = figure.subplots(1, len(ways), sharey=True, squeeze=False)[0]
    for ax, way in zip(axes, ways, strict=True):
        for row in (row for row in rows if row["way"] == way):
            look = {"color": COLORS[row["log"]], "linewidth": 1.4, "label": row["log"]}
            ax.plot(row["time"], row["mass_over_time"], **look)
        ax.axhline(mass, color=style.FLOOR, linestyle="--", linewidth=1.2, label="by explain")
        style.polish(ax).set_title(TITLES[way], loc="left", **style.plain(fontweight="bold"))
        ax.set_xlabel("time, s", **style.plain(style.SMALL, style.QUIET))
    top = max(np.quantile(row["mass_over_time"], 0.98) for row in rows)
    axes[0].set_ylim(0.0, max(1.2 * top, 1.5 * mass))
    axes[0].set_ylabel("estimated mass of the payload, kg", **style.plain())
    style.legend_above(figure, axes[0].get_legend_handles_labels()[0])
    return figure
