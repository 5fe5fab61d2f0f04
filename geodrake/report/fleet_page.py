"""What was found in a fleet as a page: all robots at a glance, then each that changed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.fleet.fleet_result import (
    CHANGED,
    STEADY,
    FleetFinding,
    FleetResult,
    ParameterHistory,
    RobotResult,
)
from geodrake.fleet.history import DAY
from geodrake.fleet.type_columns import STEP
from geodrake.report.charts import Chart, Panel, Plot, Shade, Stage
from geodrake.report.fleet_tables import (
    change_label,
    findings_table,
    fleet_verdict,
    parameter_label,
    robots_table,
    since_words,
    size_words,
    unused_list,
)
from geodrake.report.numbers import number, percent
from geodrake.report.page import Page, Section, Tile, render, without_empty
from geodrake.report.tables import Cell, Table
from geodrake.report.words import effect_label

Array = NDArray[np.float64]

VALUE = Stage("value", "value of each log", "after")
INTERVAL = Stage("interval", "95 % interval", "measured")
LEVEL = Stage("level", "mean before and after a change", "before", wide=True)

_MOST_PAGES = 12  # robots that are shown by themselves
_MOST_PLACES = 12  # joints of the table of robots and joints
_WITHIN = 1.96  # deviations of an interval of 95 %
_FAR = 5.0  # spreads at which a bar is full

_GLANCE = (
    "Robots, worst first, and how far each is from others of its type, in spreads by which these "
    "differ: at each joint the parameter that is farthest, without changes."
)
_CHANGES = (
    "A change is named if logs say so much for it hardly by chance: in robots in which nothing "
    "changed, of at most {} a robot-month."
)
_ROBOT = (
    "Each log by itself, with what logs of this robot scatter in its interval. Shaded: when a "
    "change began, with a probability of 95 %."
)


def render_fleet(result: FleetResult, *, title: str) -> str:
    """Return the report of a fleet.

    Returns:
        One HTML page that loads nothing from elsewhere.
    """
    changed = [robot for robot in result.robots if robot.findings]
    steady = [robot for robot in result.robots if robot.logs and not robot.findings]
    shown = (changed or steady[:1])[:_MOST_PAGES]
    more = f"The worst {len(shown)} of {len(changed)} that changed are shown by themselves."
    sections = (
        Section("The fleet at a glance", (_GLANCE,), _glance_tables(result.robots)),
        Section(
            "What changed",
            (_CHANGES.format(percent(result.false_alarms)),),
            (findings_table(result.findings),),
        )
        if changed
        else Section(""),
        *(_robot_section(robot, at) for at, robot in enumerate(shown)),
        Section(
            "Robots",
            (more,) if len(changed) > len(shown) else (),
            (robots_table(result.robots),),
        ),
        Section("Logs that are not used", items=tuple(unused_list(result))),
        Section("Notes", items=result.repairs),
    )
    page = Page(
        title,
        f"{len(result.robots)} robots, {sum(robot.logs for robot in result.robots)} logs",
        "unexplained" if changed else "adequate",
        CHANGED if changed else STEADY,
        fleet_verdict(result),
        tuple(_lead(finding) for finding in result.findings[:1]),
        _tiles(result),
        without_empty(sections),
        "Made by geodrake: which robot changed, at which joint, by what, since when.",
    )
    return render(page)


def _lead(finding: FleetFinding) -> str:
    return (
        f"The surest: {change_label(finding)} of {finding.where} in {finding.robot}, since "
        f"{since_words(finding)}: {size_words(finding)}."
    )


def _tiles(result: FleetResult) -> tuple[Tile, ...]:
    findings = result.findings
    last = max(findings, key=lambda each: each.date, default=None)
    latest = () if last is None else (Tile("latest", since_words(last), last.robot, words=True),)
    return (
        Tile("changed", str(result.count(CHANGED)), f"of {len(result.robots)} robots"),
        Tile("steady", str(result.count(STEADY)), "nothing found in them"),
        Tile("logs not used", str(len(result.unused)), "each with its reason below"),
        *latest,
    )


def _glance_tables(robots: Sequence[RobotResult]) -> tuple[Table, ...]:
    """Robots × joints for each type: what changed there, or how far it is from others."""
    tables = []
    for kind in dict.fromkeys(robot.type for robot in robots):
        own = [robot for robot in robots if robot.type == kind]
        places = list(
            dict.fromkeys(each.parameter.where for robot in own for each in robot.histories)
        )[:_MOST_PLACES]
        rows = tuple(
            (
                Cell(robot.robot),
                Cell(robot.state),
                _body_cell(robot, places),
                *(_place_cell(robot, place) for place in places),
            )
            for robot in own
        )
        tables.append(Table(("robot", "state", "bodies", *places), rows, words=3, title=kind))
    return tuple(tables)


def _place_cell(robot: RobotResult, place: str) -> Cell:
    """Return how far a robot is from others at a joint, and what changed there."""
    apart = max(
        (abs(each.apart) for each in robot.own if each.parameter.where == place), default=0.0
    )
    changes = [effect_label(f.effect.replace("+", " + ")) for f in robot.findings]
    own = [label for label, f in zip(changes, robot.findings, strict=True) if f.where == place]
    return Cell(number(apart, 2), note=", ".join(own), bar=min(1.0, apart / _FAR))


def _body_cell(robot: RobotResult, places: Sequence[str]) -> Cell:
    """Return what changed at bodies."""
    found = [f"{change_label(f)} of {f.where}" for f in robot.findings if f.where not in places]
    return Cell(", ".join(found))


def _robot_section(robot: RobotResult, at: int) -> Section:
    """One robot: its findings, its joints over time, and what it has beside others."""
    tables = [findings_table(robot.findings)] if robot.findings else []
    farthest = sorted(robot.own, key=lambda each: -abs(each.apart))[:_MOST_PLACES]
    rows = tuple(
        (
            Cell(parameter_label(each.parameter)),
            Cell(each.parameter.unit),
            Cell(number(each.value)),
            Cell(number(each.deviation, 2)),
            Cell(number(each.common)),
            Cell(number(each.spread, 2)),
            Cell(number(each.of_model)),
            Cell(number(each.apart, 2), bar=min(1.0, abs(each.apart) / _FAR)),
        )
        for each in farthest
    )
    head = ("parameter", "unit", "value", "±", "others", "spread", "model", "spreads apart")
    tables.append(Table(head, rows, words=2, title="Farthest from others, without changes"))
    return Section(robot.robot, (_ROBOT,), tuple(tables), charts=(_chart(robot, at),))


def _chart(robot: RobotResult, at: int) -> Chart:
    """Return the joints of a robot over time."""
    days = (robot.dates - robot.dates[0]) / DAY
    places = list(dict.fromkeys(each.parameter.where for each in robot.histories))
    changed = {finding.where for finding in robot.findings}
    first = [place for place in places if place in changed]
    others = [place for place in places if place not in changed]
    panels = tuple(_panel(robot, place, days) for place in (*first, *others))
    return Chart(
        f"robot-{at}",
        "Parameters of each joint over time, log by log.",
        (VALUE, INTERVAL, LEVEL),
        panels,
        (("", 0.0, float(max(days[-1], 1e-3)), 0.0),),
        axis=f"days since {np.datetime64(round(robot.dates[0]), 's').astype('datetime64[D]')}",
        unit="days",
    )


def _panel(robot: RobotResult, place: str, days: Array) -> Panel:
    """One joint: its parameters above each other, and when changes began."""
    histories = [each for each in robot.histories if each.parameter.where == place]
    places = {each.parameter.where for each in robot.histories}
    # Changes of bodies are seen by all joints.
    seen = [each for each in robot.findings if each.where == place or each.where not in places]
    shades = tuple(
        Shade(
            LEVEL.key,
            *_begins(finding, robot.dates),
            f"{change_label(finding)} of {finding.where} since {since_words(finding)}",
        )
        for finding in seen
    )
    own = [finding for finding in robot.findings if finding.where == place]
    return Panel(
        place,
        "; ".join(map(size_words, own)),
        np.repeat(days, 3),
        tuple(_plot(each, own, robot.dates) for each in histories),
        shades,
        "changed" if own else "",
    )


def _begins(finding: FleetFinding, dates: Array) -> tuple[float, float]:
    """Days between which a change began: a step after the log before the first that shows it."""
    low, high = finding.interval
    if finding.kind == STEP:
        low = max(dates[dates < low], default=low)
    return float((low - dates[0]) / DAY), float((high - dates[0]) / DAY)


def _plot(history: ParameterHistory, changes: Sequence[FleetFinding], dates: Array) -> Plot:
    """A parameter, log by log: each log has three points, the last of which ends its interval."""
    parameter, values = history.parameter, history.values
    half = _WITHIN * history.deviations
    interval = np.stack([values - half, values + half, np.full(len(values), np.nan)], -1)
    unit = f", {parameter.unit}" if parameter.unit else ", share"
    of_it = [each for each in changes if parameter.effect in each.effect.split("+")]
    return Plot(
        f"{effect_label(parameter.effect)}: {parameter.name}{unit}",
        {
            LEVEL.key: np.repeat(_levels(history, of_it, dates), 3),
            INTERVAL.key: interval.ravel(),
            VALUE.key: np.repeat(values, 3),
        },
        tall=len(of_it) > 0,
    )


def _levels(history: ParameterHistory, changes: Sequence[FleetFinding], dates: Array) -> Array:
    """(T,) weighted mean of a parameter between its changes."""
    stretch = np.sum([dates >= each.date for each in changes], axis=0) if changes else 0
    number_of = np.broadcast_to(stretch, dates.shape)
    weights = 1.0 / np.maximum(history.deviations, 1e-300) ** 2
    found = np.empty(len(dates))
    for each in np.unique(number_of):
        own = number_of == each
        found[own] = np.average(history.values[own], weights=weights[own])
    return found
