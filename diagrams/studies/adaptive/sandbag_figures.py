"""Figure of the arm with sandbags, like 5.8 and 5.9 of the source."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from diagrams.studies.adaptive.laws import COLORS
from diagrams.studies.adaptive.wam_figures import SPREAD, legend, speed_note
from geodrake.report import style


def write_sandbag_figure(folder: Path, rows: Sequence[dict[str, Any]], period: float) -> None:
    """Write the figure into a folder as PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    sandbag_figure(rows, period).savefig(folder / "ambidex_sandbags.png")


def sandbag_figure(rows: Sequence[dict[str, Any]], period: float) -> Figure:
    """Errors of every case, and over time in the first one."""
    cases = list(dict.fromkeys(row["case"] for row in rows))
    laws = list(dict.fromkeys(row["law"] for row in rows))
    figure = style.new_figure(3.8)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.5))
    for k, law in enumerate(laws):
        found = [row for row in rows if row["law"] == law]
        height = [np.nan if row["lost"] else row["rms"] for row in found]
        at = np.arange(len(cases)) + SPREAD * (k - 0.5 * (len(laws) - 1))
        left.bar(at, height, 0.9 * SPREAD, color=COLORS[law])
        series = next(row["series"] for row in found if row["case"] == cases[0])
        time = period * np.arange(len(series))
        right.plot(time, np.maximum(series, 1e-2), color=COLORS[law], linewidth=1.1)
    style.log_scale(left, "y")
    left.set_xticks(range(len(cases)), cases)
    title = "Tracking error of the turns: RMS, degrees"
    style.polish(left, grid="y").set_title(title, loc="left", **style.plain(fontweight="bold"))
    title = f"Its course with sandbags at {cases[0]}, degrees"
    style.polish(right).set_title(title, loc="left", **style.plain(fontweight="bold"))
    right.set_xlabel("time, s", **style.plain(style.SMALL, style.QUIET))
    style.log_scale(right, "y")
    right.set_ylim(bottom=0.02)
    style.legend_above(figure, legend(laws))
    lost = sum(row["lost"] for row in rows)
    style.note_below(figure, speed_note(rows) + (f" {lost} loops were lost." if lost else ""))
    return figure
