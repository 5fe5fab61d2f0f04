"""Correction of mistakes in the columns of logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import instance, instances
from geodrake.diagnosis.columns.finding import ColumnFinding
from geodrake.diagnosis.columns.kinds import KINDS
from geodrake.errors import ArgumentError
from geodrake.logs.inspection import UnderstoodColumn
from geodrake.logs.motion import EFFORT_KINDS, JointLog
from geodrake.model.effort_signal import COMMAND, EFFORT, EffortSignal, MotorLimit
from geodrake.model.robot_model import RobotModel
from geodrake.model.signal_efforts import kind_of, limited_effort

Array = NDArray[np.float64]


def corrected(log: JointLog, findings: Sequence[ColumnFinding]) -> JointLog:
    """Return a log with its columns corrected by each finding in turn.

    Terms that were subtracted from efforts cannot be restored. Motor limits apply to efforts only;
    currents, voltages and commands are unchanged.

    Raises:
        ArgumentError: A finding is about a joint that the log does not have.
    """
    instance(log, "log", JointLog)
    for finding in instances(findings, "findings", ColumnFinding):
        absent = [joint for joint in finding.joints if joint not in log.joints]
        if absent:
            raise ArgumentError(
                f"Log {log.name!r} has no joint {absent[0]!r}, whose columns should be corrected.",
                advice=f"Its joints are {', '.join(log.joints)}.",
            )
        log = _corrected(log, finding)
    return log


def _corrected(log: JointLog, finding: ColumnFinding) -> JointLog:
    columns = [log.joints.index(joint) for joint in finding.joints]
    if finding.kind == "time":
        return replace(log, time=log.time * finding.values[0])
    if finding.kind == "effort_limit":
        (j,), effort = columns, log.effort.copy()
        if _has(log, log.joints[j], EFFORT):
            effort[:, j] = limited_effort(log, j, MotorLimit(*finding.values), effort[:, j])
        return replace(log, effort=effort)
    changed: dict[str, Any] = {}
    for name in KINDS[finding.kind].columns:
        if getattr(log, name) is not None:
            changed[name] = values = getattr(log, name).copy()
            if finding.kind.startswith("swapped"):
                values[:, columns] = values[:, columns[::-1]]
            elif finding.kind == "position_zero":
                values[:, columns] += np.asarray(finding.values)
            else:
                values[:, columns] *= np.asarray(finding.values)
    return replace(log, **changed) if changed else log


def corrected_columns(
    columns: Sequence[UnderstoodColumn], findings: Sequence[ColumnFinding]
) -> tuple[UnderstoodColumn, ...]:
    """Return the meanings of a log's columns after the corrections that a mapping can express.

    A mapping cannot express zeros, motor limits, time factors or subtracted terms.
    """
    entries = {(column.joint, column.quantity): column for column in columns}
    for finding in findings:
        quantities = KINDS[finding.kind].columns if finding.kind != "position_zero" else ()
        for quantity in quantities:
            logged = EFFORT_KINDS if quantity == "effort" else (quantity,)
            keys = [k for j in finding.joints for q in logged if (k := (j, q)) in entries]
            previous = [entries[key] for key in keys]
            if finding.kind.startswith("swapped"):
                pairs = zip(keys, previous, reversed(previous), strict=True)
                entries |= {key: replace(b, joint=a.joint) for key, a, b in pairs}
                continue
            factors = dict(zip(finding.joints, finding.values, strict=True))
            scaled = zip(keys, previous, strict=True)
            entries |= {k: replace(b, factor=b.factor * factors[b.joint]) for k, b in scaled}
    return tuple(entries.values())


def with_motor_limits(
    model: RobotModel, logs: Sequence[JointLog], findings: Sequence[ColumnFinding]
) -> RobotModel:
    """Return the model with the motor limits that were found.

    A motor keeps its model entry if it is a servo, which has its own limits, or if its logs contain
    another kind of signal than the model states, such as currents of unknown gains.

    Raises:
        ArgumentError: A finding is about a joint that the model does not have.
    """
    known = {signal.joint: signal for signal in instance(model, "model", RobotModel).effort_signals}
    logs = instances(logs, "logs", JointLog)
    limits = dict[str, MotorLimit]()
    for finding in instances(findings, "findings", ColumnFinding):
        if finding.kind == "effort_limit":
            limits[finding.joints[0]] = MotorLimit(*finding.values)
        elif KINDS[finding.kind].changes == ("gain",):  # the limit was found with the previous gain
            for joint, factor in zip(finding.joints, finding.values, strict=True):
                if joint in limits:
                    limits[joint] = limits[joint].times(abs(factor))
        elif finding.kind in ("swapped_efforts", "swapped_joints"):
            first, second = finding.joints
            other = {first: second, second: first}
            limits = {other.get(joint, joint): limit for joint, limit in limits.items()}
    for joint, limit in limits.items():
        if joint not in model.joints:
            raise ArgumentError(
                f"The model has no joint {joint!r}, whose motor has a limit.",
                advice=f"Its joints are {', '.join(model.joints)}.",
            )
        signal = known.get(joint, EffortSignal(joint, EFFORT, 1.0))
        if signal.kind != COMMAND and all(_has(log, joint, signal.kind) for log in logs):
            known[joint] = replace(signal, limit=limit.effort, no_load_speed=limit.no_load_speed)
    return replace(model, effort_signals=tuple(known.values()))


def _has(log: JointLog, joint: str, signal_kind: str) -> bool:
    """Return whether a log has efforts of a joint, or a signal in their place, of a kind."""
    return joint in log.joints and kind_of(log, joint) == signal_kind
