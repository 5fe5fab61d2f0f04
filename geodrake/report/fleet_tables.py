"""What was found in a fleet in words and tables, for a terminal and a page alike."""

from __future__ import annotations

from collections.abc import Sequence

from geodrake.fleet.fleet_result import (
    CHANGED,
    UNKNOWN,
    ChangedParameter,
    FleetFinding,
    FleetResult,
    RobotResult,
)
from geodrake.fleet.log_places import date_text
from geodrake.fleet.type_columns import RAMP
from geodrake.fleet.type_layout import BODIES, FleetParameter
from geodrake.report.numbers import chance, number, percent, with_deviation
from geodrake.report.tables import Cell, Table, cells
from geodrake.report.words import effect_label

MOST_ROBOTS = 20
"""Robots without findings that a terminal shows, the farthest from others first."""

_CERTAIN = 3.0  # deviations from 0 from which on a part of a change is told in a line


def day_text(seconds: float) -> str:
    """A date to the minute, or to the day where it is at midnight: `2026-05-04 12:30`."""
    text = date_text(seconds)[:16].replace("T", " ")
    return text.removesuffix(" 00:00")


def since_words(finding: FleetFinding) -> str:
    """Since when, with the interval where that is more than the day itself."""
    low, high = map(day_text, finding.interval)
    when = day_text(finding.date)
    return when if low == high else f"{when} ({low} to {high})"


def changed_words(parameter: ChangedParameter) -> str:
    """`mass + 0.60 ± 0.01 kg`, with the share where there is one."""
    size = with_deviation(parameter.size, parameter.deviation)
    sign = "" if size.startswith(("−", "(")) else "+"
    share = f", {percent(parameter.share)}" if parameter.share == parameter.share else ""
    return f"{parameter.name} {sign}{size} {parameter.unit}".rstrip() + share


def size_words(finding: FleetFinding) -> str:
    """What changed by how much: the parts that are not nothing, at least the first."""
    first, *others = finding.parameters
    told = [each for each in others if abs(each.size) > _CERTAIN * each.deviation]
    return "; ".join(map(changed_words, (first, *told)))


def findings_table(findings: Sequence[FleetFinding]) -> Table:
    """A row for each finding."""
    rows = tuple(
        cells(
            finding.robot,
            Cell(change_label(finding), typed=finding.effect),
            finding.where,
            since_words(finding),
            size_words(finding),
            rivals_words(finding),
            chance(finding.probability),
            chance(finding.false_alarm_probability),
        )
        for finding in findings
    )
    head = ("robot", "effect", "where", "since", "change", "or", "probability", "by chance")
    return Table(head, rows, words=6)


def change_label(finding: FleetFinding) -> str:
    """What changed, in words: `Coulomb friction, going on`."""
    label = effect_label(finding.effect.replace("+", " + "))
    return f"{label}, going on" if finding.kind == RAMP else label


def rivals_words(finding: FleetFinding) -> str:
    """What else it may be."""
    return "; ".join(
        f"{effect_label(rival.effect.replace('+', ' + '))} of {rival.where}, "
        f"{percent(rival.probability)}"
        for rival in finding.rivals
    )


def robots_table(robots: Sequence[RobotResult]) -> Table:
    """A row for each robot: what is known of it, and what is farthest from others.

    Args:
        robots: The robots, in their order.
    """
    return Table(
        ("robot", "type", "state", "from", "to", "farthest from others", "logs", "spreads"),
        tuple(map(_robot_cells, robots)),
        words=6,
    )


def _robot_cells(robot: RobotResult) -> tuple[Cell, ...]:
    ends = robot.dates[[0, -1]].tolist() if len(robot.dates) else []
    first, last = map(day_text, ends) if ends else ("", "")
    farthest = robot.farthest
    return cells(
        robot.robot,
        robot.type,
        state_words(robot),
        first,
        last,
        "" if farthest is None else parameter_label(farthest.parameter),
        str(robot.logs),
        "" if farthest is None else number(farthest.apart, 2),
    )


def state_words(robot: RobotResult) -> str:
    """What is the matter with a robot, in a few words."""
    if not robot.findings:
        return robot.state
    first, *others = robot.findings
    more = f" and {len(others)} more" if others else ""
    return f"{change_label(first)} of {first.where}{more}"


def parameter_label(parameter: FleetParameter) -> str:
    """Such as `Coulomb friction of elbow, coulomb`; of bodies the combination itself."""
    if parameter.effect == BODIES:
        return parameter.name
    return f"{effect_label(parameter.effect)} of {parameter.where}, {parameter.name}"


def fleet_verdict(result: FleetResult) -> str:
    """How many robots changed, in a sentence."""
    total, changed, unknown = len(result.robots), result.count(CHANGED), result.count(UNKNOWN)
    words = f"{changed} of {_counted(total, 'robot')} changed"
    if unknown:
        words += f"; {_counted(unknown, 'robot')} without a log that could be used"
    if result.unused:
        words += f"; {_counted(len(result.unused), 'log')} not used"
    return f"{words}."


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def unused_list(result: FleetResult) -> list[str]:
    """Logs that are not used, each with its reason."""
    return [f"{each.robot}: {each.log}: {each.reason}" for each in result.unused]
