"""Pictures of a fleet: days of changes, and one joint over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from diagrams.benchmarks.fleets.files import day_of
from diagrams.benchmarks.fleets.scoring import FAMILIES
from geodrake.fleet import FleetFinding, FleetResult, ParameterHistory, RobotResult
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


def save_history(result: FleetResult, folder: Path) -> None:
    """A parameter that changed, over time: of the first robot in which one alone did.

    Args:
        result: What was found; if there is no such robot, nothing is written.
        folder: Where `fleet_levels.png` goes.
    """
    for robot in result.robots:
        for finding in robot.findings:
            for history in robot.histories:
                parameter = history.parameter
                if (parameter.effect, parameter.where) == (finding.effect, finding.where):
                    _save(_history_figure(robot, finding, history), folder, "fleet_levels.png")
                    return


def _history_figure(robot: RobotResult, finding: FleetFinding, history: ParameterHistory) -> Figure:
    figure = Figure(figsize=(6.0, 3.0), layout="constrained")
    axes, spread = figure.subplots(), 1.96 * history.deviations
    axes.errorbar(
        day_of(robot.dates),
        history.values,
        spread,
        fmt="o",
        markersize=3,
        color=style.AFTER,
        ecolor=style.BEFORE,
    )
    axes.axvline(day_of(finding.date), color="0.3", linewidth=0.6)
    name, unit = history.parameter.name, history.parameter.unit
    title = f"{finding.effect} of {finding.where}, {robot.robot}"
    axes.set(title=title, xlabel="day", ylabel=f"{name}, {unit}" if unit else name)
    return figure


def _save(figure: Figure, folder: Path, name: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / name, dpi=110)
