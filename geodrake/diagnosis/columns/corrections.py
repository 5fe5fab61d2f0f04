"""Logs with the mistakes in their columns corrected."""

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
    """Return a log whose columns are corrected, one finding after the other.

    Terms that were subtracted from efforts cannot be restored. Motor limits apply to efforts only;
    currents, voltages and commands are unchanged.

    Raises:
        ArgumentError: A finding is of a joint that the log does not have.
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
    at = [log.joints.index(joint) for joint in finding.joints]
    if finding.kind == "time":
        return replace(log, time=log.time * finding.values[0])
    if finding.kind == "effort_limit":
        (j,), effort = at, log.effort.copy()
        if _has(log, log.joints[j], EFFORT):
            effort[:, j] = limited_effort(log, j, MotorLimit(*finding.values), effort[:, j])
        return replace(log, effort=effort)
    changed: dict[str, Any] = {}
    for name in KINDS[finding.kind].columns:
        if getattr(log, name) is not None:
            changed[name] = own = getattr(log, name).copy()
            if finding.kind.startswith("swapped"):
                own[:, at] = own[:, at[::-1]]
            elif finding.kind == "position_zero":
                own[:, at] += np.asarray(finding.values)
            else:
                own[:, at] *= np.asarray(finding.values)
    return replace(log, **changed) if changed else log


def corrected_columns(
    columns: Sequence[UnderstoodColumn], findings: Sequence[ColumnFinding]
) -> tuple[UnderstoodColumn, ...]:
    """Return what columns of a log are, with what was found corrected that a mapping can say.

    Zeros, limits of motors, time and what was taken out of efforts are no part of it.
    """
    found = {(each.joint, each.quantity): each for each in columns}
    for finding in findings:
        kinds = KINDS[finding.kind].columns if finding.kind != "position_zero" else ()
        for quantity in kinds:
            own = EFFORT_KINDS if quantity == "effort" else (quantity,)
            at = [k for j in finding.joints for q in own if (k := (j, q)) in found]
            before = [found[key] for key in at]
            if finding.kind.startswith("swapped"):
                pairs = zip(at, before, reversed(before), strict=True)
                found |= {key: replace(b, joint=a.joint) for key, a, b in pairs}
                continue
            factors = dict(zip(finding.joints, finding.values, strict=True))
            each = zip(at, before, strict=True)
            found |= {k: replace(b, factor=b.factor * factors[b.joint]) for k, b in each}
    return tuple(found.values())


def with_motor_limits(
    model: RobotModel, logs: Sequence[JointLog], findings: Sequence[ColumnFinding]
) -> RobotModel:
    """Return the model with the motor limits that were found, for these and other logs.

    Limits are left out of motors whose logs have something else than what the model knows of them,
    such as currents of unknown gains, and of servos, which have their own.

    Raises:
        ArgumentError: A finding is of a joint that the model does not have.
    """
    known = {signal.joint: signal for signal in instance(model, "model", RobotModel).effort_signals}
    logs = instances(logs, "logs", JointLog)
    found = dict[str, MotorLimit]()
    for finding in instances(findings, "findings", ColumnFinding):
        if finding.kind == "effort_limit":
            found[finding.joints[0]] = MotorLimit(*finding.values)
        elif KINDS[finding.kind].changes == ("gain",):  # all that the limit was found by
            for joint, factor in zip(finding.joints, finding.values, strict=True):
                if joint in found:
                    found[joint] = found[joint].times(abs(factor))
        elif finding.kind in ("swapped_efforts", "swapped_joints"):
            first, second = finding.joints
            other = {first: second, second: first}
            found = {other.get(joint, joint): limit for joint, limit in found.items()}
    for joint, limit in found.items():
        if joint not in model.joints:
            raise ArgumentError(
                f"The model has no joint {joint!r}, whose motor has a limit.",
                advice=f"Its joints are {', '.join(model.joints)}.",
            )
        signal = known.get(joint, EffortSignal(joint, EFFORT, 1.0))
        if signal.kind != COMMAND and all(_has(log, joint, signal.kind) for log in logs):
            known[joint] = replace(signal, limit=limit.effort, no_load_speed=limit.no_load_speed)
    return replace(model, effort_signals=tuple(known.values()))


def _has(log: JointLog, joint: str, kind: str) -> bool:
    """Return whether a log has efforts of a joint, or what stands for them, of a kind."""
    return joint in log.joints and kind_of(log, joint) == kind
