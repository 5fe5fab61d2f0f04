"""Pictures of a fleet: days of changes, and one joint over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fleets.scoring import FAMILIES
from geodrake.fleet.levels import ParameterLevels
from geodrake.report import style


def save_days(rows: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Days that were found over those that were hidden, with their intervals.

    Args:
        rows: Rows of the table.
        folder: Where `fleet_days.png` goes.
    """
    figure = Figure(figsize=(9.0, 3.0), layout="constrained")
    for axes, what in zip(figure.subplots(1, len(FAMILIES), sharey=True), FAMILIES, strict=True):
        for row in rows:
            if row["hidden"] == what:
                for named in row["named"]:
                    low, high = named["interval"]
                    axes.vlines(row["hidden day"], low, high, color=style.BEFORE, linewidth=1.0)
                    axes.plot(row["hidden day"], named["day"], "o", markersize=3, color=style.AFTER)
        axes.plot([0, 30], [0, 30], color="0.3", linewidth=0.6)
        axes.set(title=what, xlabel="day of the change")
    figure.axes[0].set_ylabel("day that was found")
    _save(figure, folder, "fleet_days.png")


def save_levels(levels: ParameterLevels, name: str, day: float, folder: Path) -> None:
    """One parameter of one robot over time.

    Args:
        levels: Its levels, the first of which is shown.
        name: What it is.
        day: On which it changed.
        folder: Where `fleet_levels.png` goes.
    """
    figure = Figure(figsize=(6.0, 3.0), layout="constrained")
    axes, value = figure.subplots(), levels.values[:, 0]
    spread = 1.96 * np.stack([levels.deviation, levels.with_scatter])[:, :, 0]
    axes.errorbar(levels.days, value, spread[1], fmt="none", color=style.BEFORE, linewidth=0.8)
    axes.errorbar(levels.days, value, spread[0], fmt="o", markersize=3, color=style.AFTER)
    axes.axvline(day, color="0.3", linewidth=0.6)
    axes.set(title=name, xlabel="day")
    _save(figure, folder, "fleet_levels.png")


def _save(figure: Figure, folder: Path, name: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / name, dpi=110)
