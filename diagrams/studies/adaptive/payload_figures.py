"""Figure of the adaptation to unknown loads, like 5.6 of the source."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from diagrams.studies.adaptive.laws import COLORS
from diagrams.studies.adaptive.wam_figures import SPREAD, legend, speed_note
from geodrake.report import style


def write_payload_figure(folder: Path, rows: Sequence[dict[str, Any]], period: float) -> None:
    """Write the figure into a folder as PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    load_figure(rows, period).savefig(folder / "wam_payload.png")


def load_figure(rows: Sequence[dict[str, Any]], period: float) -> Figure:
    """Errors of every round above, and over time below, one column a load."""
    loads = list(dict.fromkeys(row["load"] for row in rows))
    laws = list(dict.fromkeys(row["law"] for row in rows))
    figure = style.new_figure(5.2)
    axes = figure.subplots(2, len(loads), sharey="row", squeeze=False)
    for (above, below), load in zip(axes.T, loads, strict=True):
        for k, law in enumerate(laws):
            row = next(row for row in rows if (row["load"], row["law"]) == (load, law))
            done = [np.nan if x is None else x for x in row["rounds"]]
            at = 1 + np.arange(len(done)) + SPREAD * (k - 0.5 * (len(laws) - 1))
            above.bar(at, done, 0.9 * SPREAD, color=COLORS[law])
            time = period * np.arange(len(row["series"]))
            below.plot(time, np.maximum(row["series"], 1e-3), color=COLORS[law], linewidth=1.1)
        style.polish(above).set_title(load, loc="left", **style.plain(fontweight="bold"))
        above.set_xlabel("round", **style.plain(style.SMALL, style.QUIET))
        above.set_xticks(1 + np.arange(max(len(row["rounds"]) for row in rows)))
        style.polish(below).set_xlabel("time, s", **style.plain(style.SMALL, style.QUIET))
    for ax, name in zip(axes[:, 0], ("of each round", "of all joints"), strict=True):
        style.log_scale(ax, "y")
        ax.set_ylabel(f"RMS {name}, degrees", **style.plain())
    style.legend_above(figure, legend(laws))
    style.note_below(figure, speed_note(rows))
    return figure
