"""Results of a fleet: the page of `fleet`, JSON, lines of findings, and tables in Parquet.

Numbers are rounded to six significant digits of themselves or of their deviation. Further digits
differ between machines, and files of the same result must not.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from geodrake.boundary.escaping import json_text, printable
from geodrake.boundary.optional_packages import optional_package
from geodrake.boundary.whole_files import Content
from geodrake.errors import FleetError
from geodrake.fleet.fleet_result import (
    CHANGED,
    STEADY,
    UNKNOWN,
    ChangedParameter,
    FleetFinding,
    FleetResult,
    ParameterHistory,
    RobotResult,
)
from geodrake.fleet.history import DAY
from geodrake.fleet.log_places import date_text
from geodrake.fleet.type_columns import RAMP, STEP
from geodrake.fleet.type_layout import BODIES, FleetParameter
from geodrake.inertia import Array
from geodrake.report.charts import Chart, Panel, Plot, Shade, Stage
from geodrake.report.explaining import notes_section
from geodrake.report.json_output import plain_of, record
from geodrake.report.numbers import chance, number, percent, with_deviation
from geodrake.report.page import About, Cell, Page, Section, Table, Tile, View, cells
from geodrake.report.words import effect_label

_VALUE = Stage("value of each log", "after")
_INTERVAL = Stage("95 % interval", "measured")
_LEVEL = Stage("mean before and after a change", "before", look="wide")

_DIGITS = 6
_LEAST_CHANCE = 1e-12  # smallest reported probability
_MOST_SECTIONS = 12  # robots with a section of their own
_MOST_PLACES = 12  # joints in the overview
_MOST_ROBOTS, _MOST_UNUSED = 20, 20  # listed robots and logs
_HALF_INTERVAL = 1.96  # standard deviations, half a 95 % interval
_FULL_BAR = 5.0  # spreads
_SIGNIFICANT = 3.0  # standard deviations from 0 of the parts of a change that are listed


def fleet_page(result: FleetResult, about: About) -> Page:
    """Return the page of a fleet."""
    changed = [robot for robot in result.robots if robot.findings]
    steady = [robot for robot in result.robots if not robot.findings]
    shown = (changed or [robot for robot in steady if robot.logs][:1])[:_MOST_SECTIONS]
    logs = sum(robot.logs for robot in result.robots)
    count = f"{_counted(len(result.robots), 'robot')}, {_counted(logs, 'log')}"
    facts = {"All results": f"in {result.folder}"} if result.folder else {}
    if result.findings:
        finding, *_ = result.findings
        change = f"{_change_label(finding)} of {finding.where} in {finding.robot}"
        certain = f"{change}, since {_since(finding)}: {_size(finding)}"
        facts = {"Most certain": certain, **facts}
    last = max(result.findings, key=lambda finding: finding.date, default=None)
    latest = [] if last is None else [Tile("latest", _since(last), last.robot, words=True)]
    unused = [f"{log.robot}: {log.address}: {log.reason}" for log in result.unused]
    more = [
        f"and {len(unused) - _MOST_UNUSED} more"
        + (f", in {result.folder}" if result.folder else "")
    ]
    return Page(
        about,
        fleet_verdict(result),
        (
            Section(
                "What changed",
                "Robots with changes, worst first.",
                "The rate of false alarms is at most "
                f"{percent(result.false_alarms)} per robot and month.",
                tables=(_findings_table(result.findings),),
            ),
            Section(
                "Overview",
                "Deviation of each robot from others of its type, in standard deviations "
                "between robots.",
                "At each joint the parameter with the largest deviation, without changes.",
                tables=_overview_tables(result.robots),
                detailed=True,
            ),
            *(_robot_section(robot, index) for index, robot in enumerate(shown)),
            Section(
                "Robots without changes",
                f"The largest deviation from others first, {_MOST_ROBOTS} at most.",
                tables=(_robots_table(steady[:_MOST_ROBOTS]),),
            ),
            notes_section(result.repairs),
            Section(
                "Logs that were not used",
                items=(*unused[:_MOST_UNUSED], *(more if len(unused) > _MOST_UNUSED else [])),
            ),
        ),
        of=f"{about.model}: {count}, {result.made} digested now",
        verdict=CHANGED if changed else STEADY,
        facts=facts,
        tiles=(
            Tile("changed", str(result.count(CHANGED)), f"of {len(result.robots)} robots"),
            Tile("steady", str(result.count(STEADY)), "without changes"),
            Tile("logs not used", str(len(result.unused)), "reasons below"),
            *latest,
        ),
        footer="Made by geodrake: which robots changed, at which joint, by which effect, since "
        "when.",
    )


def fleet_verdict(result: FleetResult) -> str:
    """Return how many robots changed, in a sentence."""
    total, changed, unknown = len(result.robots), result.count(CHANGED), result.count(UNKNOWN)
    words = f"{changed} of {_counted(total, 'robot')} changed"
    if unknown:
        words += f"; {_counted(unknown, 'robot')} without a usable log"
    if result.unused:
        words += f"; {_counted(len(result.unused), 'log')} not used"
    return f"{words}."


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _day(seconds: float) -> str:
    """Return a date to the minute, or to the day if it is at midnight: `2026-05-04 12:30`."""
    return date_text(seconds)[:16].replace("T", " ").removesuffix(" 00:00")


def _since(finding: FleetFinding) -> str:
    """Return the date of a change, with its interval unless that is a single date."""
    low, high = map(_day, finding.interval)
    when = _day(finding.date)
    return when if low == high else f"{when} ({low} to {high})"


def _parameter_change(parameter: ChangedParameter) -> str:
    """Return a change in words, such as `mass +0.60 ± 0.01 kg, 12 %`."""
    size = with_deviation(parameter.size, parameter.deviation)
    sign = "" if size.startswith(("−", "(")) else "+"
    share = f", {percent(parameter.share)}" if parameter.share == parameter.share else ""
    return f"{parameter.name} {sign}{size} {parameter.unit}".rstrip() + share


def _size(finding: FleetFinding) -> str:
    """Return the size of a change: its first part, and others that are significant."""
    first, *others = finding.parameters
    significant = [part for part in others if abs(part.size) > _SIGNIFICANT * part.deviation]
    return "; ".join(map(_parameter_change, (first, *significant)))


def _label(effect: str) -> str:
    return effect_label(effect.replace("+", " + "))


def _change_label(finding: FleetFinding) -> str:
    """Return a change in words: `Coulomb friction, continuing`."""
    return _label(finding.effect) + (", continuing" if finding.kind == RAMP else "")


def _findings_table(findings: Sequence[FleetFinding]) -> Table:
    rows = []
    for finding in findings:
        others = (
            f"{_label(r.effect)} of {r.where}, {percent(r.probability)}" for r in finding.rivals
        )
        effect = Cell(_change_label(finding), typed=finding.effect)
        chances = map(chance, (finding.probability, finding.false_alarm_probability))
        change = _since(finding), _size(finding), "; ".join(others)
        rows.append(cells(finding.robot, effect, finding.where, *change, *chances))
    head = ("robot", "effect", "where", "since", "change", "or", "probability", "by chance")
    return Table(head, rows, words=6)


def _robots_table(robots: Sequence[RobotResult]) -> Table:
    """Return the robots, and their largest deviation from others."""
    rows = []
    for robot in robots:
        dates = map(_day, robot.dates[[0, -1]].tolist()) if len(robot.dates) else ("", "")
        name, spreads = "", ""
        if robot.farthest is not None:
            name = _parameter(robot.farthest.parameter)
            spreads = number(robot.farthest.apart, 2)
        rows.append(cells(robot.robot, robot.type, robot.state, *dates, name, robot.logs, spreads))
    head = ("robot", "type", "state", "from", "to", "largest deviation", "logs", "spreads")
    return Table(head, rows, words=6)


def _parameter(parameter: FleetParameter) -> str:
    """Return a parameter in words, such as `Coulomb friction of elbow, coulomb`."""
    if parameter.effect == BODIES:
        return parameter.name
    return f"{effect_label(parameter.effect)} of {parameter.where}, {parameter.name}"


def _overview_tables(robots: Sequence[RobotResult]) -> tuple[Table, ...]:
    """Return changes and deviations from others by robot and joint, a table for each type."""
    tables = []
    for kind in dict.fromkeys(robot.type for robot in robots):
        members = [robot for robot in robots if robot.type == kind]
        places = list(
            dict.fromkeys(each.parameter.where for robot in members for each in robot.histories)
        )[:_MOST_PLACES]
        rows = []
        for robot in members:
            others = [f for f in robot.findings if f.where not in places]
            bodies = ", ".join(f"{_change_label(f)} of {f.where}" for f in others)
            entries = []
            for place in places:
                spreads = [abs(e.apart) for e in robot.own if e.parameter.where == place]
                largest = max(spreads, default=0.0)
                changes = ", ".join(_label(f.effect) for f in robot.findings if f.where == place)
                bar = min(1.0, largest / _FULL_BAR)
                entries.append(Cell(number(largest, 2), note=changes, bar=bar))
            rows.append(cells(robot.robot, robot.state, bodies, *entries))
        head = ("robot", "state", "bodies", *places)
        tables.append(Table(head, rows, words=3, title=kind))
    return tuple(tables)


def _robot_section(robot: RobotResult, index: int) -> Section:
    """Return the section of a robot: its joints over time, and its deviations from others."""
    farthest = sorted(robot.own, key=lambda each: -abs(each.apart))[:_MOST_PLACES]
    rows = [
        cells(
            *(_parameter(each.parameter), each.parameter.unit),
            *(each.value, number(each.deviation, 2), each.common, number(each.spread, 2)),
            each.of_model,
            Cell(number(each.apart, 2), bar=min(1.0, abs(each.apart) / _FULL_BAR)),
        )
        for each in farthest
    ]
    head = ("parameter", "unit", "value", "±", "others", "spread", "model", "spreads apart")
    others = Table(head, rows, words=2, title="Largest deviation, without changes")
    return Section(
        robot.robot,
        "Values of each log; shaded: 95 % interval of the time of a change.",
        "Intervals include the scatter between logs of this robot.",
        tables=(_findings_table(robot.findings), others),
        charts=(_chart(robot, index),),
        detailed=True,
    )


def _chart(robot: RobotResult, index: int) -> Chart:
    """Return the joints of a robot over time, those with changes first."""
    days = (robot.dates - robot.dates[0]) / DAY
    places = list(dict.fromkeys(each.parameter.where for each in robot.histories))
    changed = {finding.where for finding in robot.findings}
    return Chart(
        f"robot-{index}",
        "Parameters of each joint over time, log by log.",
        tuple(
            _panel(robot, place, days)
            for place in sorted(places, key=lambda place: place not in changed)
        ),
        axis=f"days since {np.datetime64(round(robot.dates[0]), 's').astype('datetime64[D]')}",
        unit="days",
    )


def _panel(robot: RobotResult, place: str, days: Array) -> Panel:
    """Return the panel of a joint: its parameters, and the times of changes."""
    histories = [each for each in robot.histories if each.parameter.where == place]
    places = {each.parameter.where for each in robot.histories}
    # All joints feel changes of bodies.
    felt = [each for each in robot.findings if each.where == place or each.where not in places]
    shades = tuple(
        Shade(
            _LEVEL,
            *_onset(finding, robot.dates),
            f"{_change_label(finding)} of {finding.where} since {_since(finding)}",
        )
        for finding in felt
    )
    changes = [finding for finding in robot.findings if finding.where == place]
    return Panel(
        place,
        "; ".join(map(_size, changes)),
        np.repeat(days, 3),
        tuple(_plot(each, changes, robot.dates) for each in histories),
        shades,
        "changed" if changes else "",
    )


def _onset(finding: FleetFinding, dates: Array) -> tuple[float, float]:
    """Return the interval (days) in which a change began; that of a step starts one log earlier."""
    low, high = finding.interval
    if finding.kind == STEP:
        low = max(dates[dates < low], default=low)
    return float((low - dates[0]) / DAY), float((high - dates[0]) / DAY)


def _plot(history: ParameterHistory, changes: Sequence[FleetFinding], dates: Array) -> Plot:
    """Return a parameter's plot: each log has three points, the last of which breaks the line."""
    parameter, values = history.parameter, history.values
    half = _HALF_INTERVAL * history.deviations
    interval = np.stack([values - half, values + half, np.full(len(values), np.nan)], -1)
    unit = f", {parameter.unit}" if parameter.unit else ", share"
    related = [each for each in changes if parameter.effect in each.effect.split("+")]
    return Plot(
        f"{effect_label(parameter.effect)}: {parameter.name}{unit}",
        {
            _LEVEL: np.repeat(_levels(history, related, dates), 3),
            _INTERVAL: interval.ravel(),
            _VALUE: np.repeat(values, 3),
        },
        tall=len(related) > 0,
    )


def _levels(history: ParameterHistory, changes: Sequence[FleetFinding], dates: Array) -> Array:
    """Return the weighted means (T,) of a parameter between its changes."""
    count = np.sum([dates >= change.date for change in changes], axis=0) if changes else 0
    segments = np.broadcast_to(count, dates.shape)
    weights = 1.0 / np.maximum(history.deviations, 1e-300) ** 2
    means = np.empty(len(dates))
    for segment in np.unique(segments):
        rows = segments == segment
        means[rows] = np.average(history.values[rows], weights=weights[rows])
    return means


def rounded(value: float, deviation: float = 0.0) -> float:
    """Round a value to six digits of itself or of its deviation, whichever is larger."""
    largest = max(abs(value), abs(deviation) if math.isfinite(deviation) else 0.0)
    if not math.isfinite(value) or largest == 0.0:
        return value
    decimals = _DIGITS - 1 - math.floor(math.log10(largest))
    return round(value, decimals) + 0.0  # −0 becomes 0


def _fleet_values(result: FleetResult) -> dict[str, Any]:
    """Return the robots, worst first, with findings and parameters."""
    return {
        "counts": {state: result.count(state) for state in (CHANGED, STEADY, UNKNOWN)},
        "findings": map(finding_dict, result.findings),
        "robots": map(_robot, result.robots),
    }


def finding_dict(finding: FleetFinding) -> dict[str, Any]:
    """Return a finding for JSON."""
    return record(
        "Finding",
        finding,
        since=date_text(finding.date),
        interval=map(date_text, finding.interval),
        parameters={
            parameter.name: {
                "change": rounded(parameter.size, parameter.deviation),
                "deviation": rounded(parameter.deviation),
                "unit": parameter.unit,
                "share": rounded(parameter.share),
            }
            for parameter in finding.parameters
        },
        probability=rounded(finding.probability, 1.0),
        rivals=[
            record("ChangeRival", rival, probability=rounded(rival.probability, 1.0))
            for rival in finding.rivals
        ],
        false_alarm_probability=rounded(max(finding.false_alarm_probability, _LEAST_CHANCE)),
    )


def finding_line(finding: FleetFinding) -> str:
    """Return a finding as one line of JSON."""
    line = {"finding": plain_of(finding_dict(finding), "", {})}
    return json_text(json.dumps(line, ensure_ascii=False, allow_nan=False))


def _robot(robot: RobotResult) -> dict[str, Any]:
    return record(
        "Robot",
        robot,
        dates=map(date_text, robot.dates.tolist()),
        findings=map(finding_dict, robot.findings),
        parameters=map(_history, robot.histories),
        beside_others=[
            record(
                "BesideOthers",
                own.parameter,
                value=rounded(own.value, own.deviation),
                deviation=rounded(own.deviation),
                common=rounded(own.common, own.spread),
                spread=rounded(own.spread),
                apart=rounded(own.apart, 1.0),
                of_model=rounded(own.of_model, own.spread),
            )
            for own in robot.own
        ],
    )


def _history(history: ParameterHistory) -> dict[str, Any]:
    values, deviations = history.values.tolist(), history.deviations.tolist()
    return record(
        "ParameterHistory",
        history.parameter,
        values=[*map(rounded, values, deviations)],
        deviations=[*map(rounded, deviations)],
        shown=history.shown.tolist(),
    )


def parquet_contents(result: FleetResult, folder: Path) -> Mapping[Path, Content]:
    """Return the tables `findings`, `parameters` over time, and `unused_logs`, by their files."""
    arrow = optional_package("pyarrow", "fleet", "tables in Parquet", FleetError)
    parquet = optional_package("pyarrow.parquet", "fleet", "tables in Parquet", FleetError)
    instants = dict.fromkeys(
        ("since", "earliest", "latest", "date"), arrow.timestamp("s", tz="UTC")
    )
    kinds = {**instants, **dict.fromkeys(_REAL, arrow.float64()), "shown": arrow.bool_()}
    findings, parameters = list[dict[str, Any]](), list[dict[str, Any]]()
    for robot in result.robots:
        for finding in robot.findings:
            row = plain_of(finding_dict(finding), "", {}) | {
                "type": robot.type,
                "since": round(finding.date),
                "earliest": round(finding.interval[0]),
                "latest": round(finding.interval[1]),
            }
            changes = row["parameters"].items()
            findings += [{**row, "parameter": name, **change} for name, change in changes]
        for each in map(_history, robot.histories):
            numbers = zip(
                robot.dates, each["values"], each["deviations"], each["shown"], strict=True
            )
            parameters += [
                {
                    **each,
                    "robot": robot.robot,
                    "type": robot.type,
                    "parameter": each["name"],
                    "date": round(date),
                    "value": value,
                    "deviation": deviation,
                    "shown": shown,
                }
                for date, value, deviation, shown in numbers
            ]
    unused = [vars(each) | {"log": printable(each.address)} for each in result.unused]
    tables = {
        "findings": (_FINDINGS, findings),
        "parameters": (_PARAMETERS, parameters),
        "unused_logs": (("robot", "log", "reason"), unused),
    }
    return {
        folder / f"{name}.parquet": partial(
            parquet.write_table,
            arrow.Table.from_pylist(
                rows, schema=arrow.schema([(c, kinds.get(c, arrow.string())) for c in columns])
            ),
        )
        for name, (columns, rows) in tables.items()
    }


_REAL = ("change", "deviation", "share", "probability", "false_alarm_probability", "value")
_FINDINGS = (
    *("robot", "type", "effect", "where", "kind", "since", "earliest", "latest", "parameter"),
    *("unit", "change", "deviation", "share", "probability", "false_alarm_probability"),
)
_PARAMETERS = (
    *("robot", "type", "effect", "where", "parameter", "unit", "date", "value", "deviation"),
    "shown",
)


VIEWS = {
    FleetResult: View(fleet_page, "Fleet", _fleet_values),
}
"""Type of result -> its view."""
