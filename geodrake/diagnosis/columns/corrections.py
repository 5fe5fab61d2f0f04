"""Logs with the mistakes in their columns corrected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import instance, instances
from geodrake.diagnosis.columns.finding import ColumnFinding
from geodrake.errors import ArgumentError
from geodrake.logs.motion import JointLog
from geodrake.model.effort_signal import COMMAND, EFFORT, EffortSignal
from geodrake.model.motor_limit import MotorLimit
from geodrake.model.robot_model import RobotModel
from geodrake.model.signal_efforts import kind_of, limited_effort

Array = NDArray[np.float64]

_MOTION = ("position", "velocity", "acceleration", "command")
_SWAPPED = {
    "swapped_efforts": ("effort",),
    "swapped_positions": _MOTION,
    "swapped_joints": (*_MOTION, "effort", "temperature"),
}
_OF_EFFORTS = ("effort_sign", "effort_unit", "effort_gain", "effort_gains")
_MULTIPLIED = {
    "effort": ("effort",),
    "position": _MOTION,
    "position_alone": ("position", "command"),
    "velocity": ("velocity",),
}


def corrected(log: JointLog, findings: Sequence[ColumnFinding]) -> JointLog:
    """A log with what was found in its columns corrected, one after the other.

    What was taken out of the efforts stays so: no column has it. A limit of a motor is one of its
    efforts: currents, voltages and commands stay as they are.

    Raises:
        ArgumentError: A finding is of a joint that the log does not have.
    """
    instance(log, "log", JointLog)
    for finding in instances(findings, "findings", ColumnFinding):
        absent = [joint for joint in finding.joints if joint not in log.joints]
        if absent:
            raise ArgumentError(
                f"Log {log.name!r} has no joint {absent[0]!r}, whose columns are to be corrected.",
                advice=f"Its joints are {', '.join(log.joints)}.",
            )
        log = _corrected(log, finding)
    return log


def with_motor_limits(
    model: RobotModel, logs: Sequence[JointLog], findings: Sequence[ColumnFinding]
) -> RobotModel:
    """The model that knows what was found of its motors' limits, for these and other logs.

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
        elif finding.kind in _OF_EFFORTS:  # all that the limit was found by
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
    """Whether a log has efforts of a joint, or what stands for them, of a kind."""
    return joint in log.joints and kind_of(log, joint) == kind


def _corrected(log: JointLog, finding: ColumnFinding) -> JointLog:
    at = [log.joints.index(joint) for joint in finding.joints]
    if finding.kind in _SWAPPED:
        return replace(log, **_changed(log, _SWAPPED[finding.kind], lambda own: _swap(own, at)))
    if finding.kind == "time":
        return replace(log, time=log.time * finding.values[0])
    if finding.kind == "position_zero":
        shifted = ("position", "command")
        return replace(log, **_changed(log, shifted, lambda own: _add(own, at, finding.values)))
    if not finding.is_correctable:
        return log
    if finding.kind == "effort_limit":
        return _limited(log, at[0], MotorLimit(*finding.values))
    quantities = _MULTIPLIED[finding.kind.rpartition("_")[0]]
    return replace(log, **_changed(log, quantities, lambda own: _multiply(own, at, finding.values)))


def _changed(log: JointLog, quantities: Sequence[str], change: Any) -> dict[str, Any]:
    """Columns of a log, changed in a copy, as far as it has them."""
    found = {name: getattr(log, name) for name in quantities}
    return {name: change(own.copy()) for name, own in found.items() if own is not None}


def _limited(log: JointLog, joint: int, limit: MotorLimit) -> JointLog:
    """The log whose efforts of one joint are no more than its motor gives."""
    if not _has(log, log.joints[joint], EFFORT):
        return log
    effort = log.effort.copy()
    effort[:, joint] = limited_effort(log, joint, limit, effort[:, joint])
    return replace(log, effort=effort)


def _swap(own: Array, at: Sequence[int]) -> Array:
    own[:, list(at)] = own[:, list(at)[::-1]]
    return own


def _add(own: Array, at: Sequence[int], values: Sequence[float]) -> Array:
    own[:, list(at)] += np.asarray(values)
    return own


def _multiply(own: Array, at: Sequence[int], values: Sequence[float]) -> Array:
    own[:, list(at)] *= np.asarray(values)
    return own
