"""What the commands say of mistakes in the columns of logs, and what they do about them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from geodrake.diagnosis.columns import MOST_JOINTS, ColumnFinding, check_columns
from geodrake.errors import GeodrakeError
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel

_UNCORRECTED = (
    "The rest goes on with the columns as they are; --correct-columns corrects them first."
)
_CORRECTED = "The rest goes on with these columns corrected."


def found_columns(
    model: RobotModel, logs: Sequence[JointLog], settings: Mapping[str, Any]
) -> tuple[ColumnFinding, ...]:
    """Return mistakes in columns; none of logs of which the command itself says what is wrong."""
    if model.base_joints:
        return ()
    try:
        return check_columns(model, logs, **settings)
    except GeodrakeError:
        return ()


def column_words(columns: Sequence[ColumnFinding], *, corrected: bool) -> list[str]:
    """Return findings, and what is done about them, in sentences."""
    if not columns:
        return []
    able = any(finding.is_correctable for finding in columns)
    last = [_CORRECTED if corrected else _UNCORRECTED] if able else []
    return [*map(str, columns), *last]


def unchecked_words(model: RobotModel) -> list[str]:
    """Return that the columns of a robot were not checked, as it floats or has many joints."""
    count = len(model.joints)
    if model.base_joints:
        return ["Columns are not checked: forces at the feet change the efforts of all joints."]
    if count <= MOST_JOINTS:
        return []
    return [
        f"Columns are not checked, which would take minutes for {count} joints (the limit is "
        f"{MOST_JOINTS}); hold joints with --lock to check those of the others."
    ]


def columns_list(columns: Sequence[ColumnFinding]) -> list[dict[str, Any]]:
    """Return findings as plain data, for JSON."""
    return [
        {
            **asdict(finding),
            "rivals": [{"words": words, "probability": chance} for words, chance in finding.rivals],
        }
        for finding in columns
    ]
