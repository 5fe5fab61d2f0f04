"""What was found in a fleet as plain numbers, for JSON, for Parquet, and a line at a time.

Numbers have six significant digits, of themselves or of their deviation: more would be rounding,
which differs from one machine to another, and files of one result are to be the same.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from geodrake.boundary.escaping import json_text
from geodrake.boundary.optional_packages import optional_package
from geodrake.boundary.whole_files import Content
from geodrake.errors import FleetError
from geodrake.fleet.fleet_result import (
    CHANGED,
    STEADY,
    UNKNOWN,
    FleetFinding,
    FleetResult,
    OwnParameter,
    ParameterHistory,
    RobotResult,
)
from geodrake.fleet.log_places import date_text
from geodrake.report.json_output import number_or, picked

_DIGITS = 6
_LEAST_CHANCE = 1e-12  # what is less likely is told as this
_NO_SHARE = "it is no share of anything"
_NOT_SAID = "the model does not say it"


def rounded(value: float, deviation: float = 0.0) -> float:
    """Return a value to six digits of itself or of its deviation, whichever is larger."""
    largest = max(abs(value), abs(deviation) if math.isfinite(deviation) else 0.0)
    if not math.isfinite(value) or largest == 0.0:
        return value
    decimals = _DIGITS - 1 - math.floor(math.log10(largest))
    # Of numbers with few digits before the point, rounding by decimals is that of their text.
    return round(value, decimals) + 0.0


def fleet_dict(result: FleetResult) -> dict[str, Any]:
    """Return a result: robots worst first, with findings and parameters; logs left out."""
    return {
        "false_alarms": result.false_alarms,
        "counts": {state: result.count(state) for state in (CHANGED, STEADY, UNKNOWN)},
        "findings": [finding_dict(finding) for finding in result.findings],
        "robots": [_robot(robot) for robot in result.robots],
        "unused": [vars(log) for log in result.unused],
        "settings": dict(result.settings),
        "notes": list(result.repairs),
    }


def finding_dict(finding: FleetFinding) -> dict[str, Any]:
    """Return a finding."""
    chance = max(finding.false_alarm_probability, _LEAST_CHANCE)
    return {
        **picked(finding, "robot", "effect", "where", "kind"),
        "since": date_text(finding.date),
        "interval": [date_text(end) for end in finding.interval],
        "parameters": {
            each.name: {
                "change": rounded(each.size, each.deviation),
                "deviation": rounded(each.deviation),
                "unit": each.unit,
                "share": number_or(rounded(each.share), _NO_SHARE),
            }
            for each in finding.parameters
        },
        "probability": rounded(finding.probability, 1.0),
        "rivals": [
            {**vars(rival), "probability": rounded(rival.probability, 1.0)}
            for rival in finding.rivals
        ],
        "false_alarm_probability": rounded(chance),
    }


def finding_line(finding: FleetFinding) -> str:
    """Return a finding as one line of JSON."""
    said = {"finding": _without_reasons(finding)}
    return json_text(json.dumps(said, ensure_ascii=False, allow_nan=False))


def _without_reasons(finding: FleetFinding) -> dict[str, Any]:
    """Return a finding with nothing, and no reason, where a change is no share of anything."""
    said = finding_dict(finding)
    for own in said["parameters"].values():
        own["share"] = own["share"] if isinstance(own["share"], float) else None
    return said


def _robot(robot: RobotResult) -> dict[str, Any]:
    return {
        **picked(robot, "robot", "type", "state", "logs"),
        "dates": [date_text(date) for date in robot.dates.tolist()],
        "findings": [finding_dict(finding) for finding in robot.findings],
        "parameters": [_history(history) for history in robot.histories],
        "beside_others": [_own(own) for own in robot.own],
    }


def _history(history: ParameterHistory) -> dict[str, Any]:
    pairs = list(zip(history.values.tolist(), history.deviations.tolist(), strict=True))
    return {
        **vars(history.parameter),
        "values": [rounded(value, deviation) for value, deviation in pairs],
        "deviations": [rounded(deviation) for _, deviation in pairs],
        "shown": history.shown.tolist(),
    }


def _own(own: OwnParameter) -> dict[str, Any]:
    return {
        **vars(own.parameter),
        "value": rounded(own.value, own.deviation),
        "deviation": rounded(own.deviation),
        "common": rounded(own.common, own.spread),
        "spread": rounded(own.spread),
        "apart": rounded(own.apart, 1.0),
        "of_model": number_or(rounded(own.of_model, own.spread), _NOT_SAID),
    }


def parquet_contents(result: FleetResult, folder: Path) -> Mapping[Path, Content]:
    """File -> content of three tables: `findings`, `parameters` over time, and `unused_logs`."""
    arrow = optional_package("pyarrow", "fleet", "tables in Parquet", FleetError)
    parquet = optional_package("pyarrow.parquet", "fleet", "tables in Parquet", FleetError)
    text, real, flag = arrow.string(), arrow.float64(), arrow.bool_()
    instant = arrow.timestamp("s", tz="UTC")
    kinds = {
        **dict.fromkeys(("since", "earliest", "latest", "date"), instant),
        **dict.fromkeys(
            ("change", "deviation", "share", "probability", "false_alarm_probability", "value"),
            real,
        ),
        "shown": flag,
    }
    tables = {
        "findings": (_FINDINGS, _finding_rows(result)),
        "parameters": (_PARAMETERS, _parameter_rows(result)),
        "unused_logs": (_UNUSED, [vars(log) for log in result.unused]),
    }
    return {
        folder / f"{name}.parquet": partial(
            parquet.write_table,
            arrow.Table.from_pylist(
                rows, schema=arrow.schema([(c, kinds.get(c, text)) for c in columns])
            ),
        )
        for name, (columns, rows) in tables.items()
    }


_FINDINGS = (
    *("robot", "type", "effect", "where", "kind", "since", "earliest", "latest", "parameter"),
    *("unit", "change", "deviation", "share", "probability", "false_alarm_probability"),
)
_PARAMETERS = (
    *("robot", "type", "effect", "where", "parameter", "unit", "date", "value", "deviation"),
    "shown",
)
_UNUSED = ("robot", "log", "reason")


def _finding_rows(result: FleetResult) -> list[dict[str, Any]]:
    """Return a row for each parameter of each finding."""
    return [
        {
            "type": robot.type,
            **said,
            "since": round(finding.date),
            "earliest": round(finding.interval[0]),
            "latest": round(finding.interval[1]),
            "parameter": name,
            **change,
        }
        for robot in result.robots
        for finding in robot.findings
        for said in (_without_reasons(finding),)
        for name, change in said["parameters"].items()
    ]


def _parameter_rows(result: FleetResult) -> list[dict[str, Any]]:
    """Return a row for each parameter of effects and each time of each robot."""
    return [
        {
            "robot": robot.robot,
            "type": robot.type,
            **vars(history.parameter),
            "parameter": history.parameter.name,
            "date": round(date),
            "value": rounded(value, deviation),
            "deviation": rounded(deviation),
            "shown": shown,
        }
        for robot in result.robots
        for history in robot.histories
        for date, value, deviation, shown in zip(
            robot.dates.tolist(),
            history.values.tolist(),
            history.deviations.tolist(),
            history.shown.tolist(),
            strict=True,
        )
    ]
