"""Logs of currents, voltages, commands and efforts asked for, turned into logs of efforts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geodrake.logs.motion import PASSIVE, JointLog
from geodrake.model.effort_signal import COMMAND, EFFORT, EffortSignal, signal_of
from geodrake.model.motor_limit import MotorLimit
from geodrake.model.servo_integrals import (
    constants_beside_friction,
    error_integral,
    limited_integral,
    runs_between_gaps,
)

Array = NDArray[np.float64]

_ROUNDS = 10  # of where an integral is held, and what it begins with


def in_efforts(
    log: JointLog, signals: Sequence[EffortSignal], needed: Array | None = None
) -> JointLog:
    """The log with efforts, N·m or N, at the joints that have a signal in the place of theirs.

    How well the gains are known becomes the log's `effort_uncertainty` at these joints.

    Args:
        log: What was measured; joints without one stay as they are.
        signals: What makes efforts of it.
        needed: (N, n) efforts that a model needs, N·m or N, by whose mean integrals of servos
            begin; at 0 if None.
    """
    effort, uncertainty = log.effort.copy(), log.gain_deviations.copy()
    kinds = dict(log.effort_kinds)
    for at, joint in enumerate(log.joints):
        signal = signal_of(signals, joint)
        if signal is None or signal.kind != kind_of(log, joint):
            continue
        if signal.kind == COMMAND:
            wanted = None if needed is None else needed[:, at]
            effort[:, at] = servo_effort(log, at, signal, wanted)
        else:
            effort[:, at] *= signal.gain
            if np.isfinite(signal.limit):
                effort[:, at] = limited_effort(log, at, signal.motor, effort[:, at])
            kinds.pop(joint, None)
        if signal.kind != EFFORT:
            uncertainty[at] = min(signal.uncertainty, 1.0)
    return replace(
        log,
        effort=effort,
        effort_uncertainty=uncertainty,
        effort_kinds=kinds,
    )


def kind_of(log: JointLog, joint: str) -> str:
    """What stands for the effort of a joint: of `KINDS`.

    Args:
        log: The log.
        joint: One of its joints.
    """
    at = log.joints.index(joint)
    told = log.command is not None and np.isfinite(log.command[:, at]).any()
    if told and joint not in log.effort_kinds and not np.isfinite(log.effort[:, at]).any():
        return COMMAND
    kind = log.effort_kinds.get(joint, EFFORT)
    return EFFORT if kind == PASSIVE else kind


def limited_effort(log: JointLog, at: int, motor: MotorLimit, asked: Array) -> Array:
    """(N,) what a motor gives, N·m or N, as the positions of its joint change.

    What a log has as velocities may be none. Where positions are not known, the joint stands.

    Args:
        log: The log.
        at: Which of its joints.
        motor: What its motor can give.
        asked: (N,) efforts that were asked for, N·m or N.
    """
    return motor.given(asked, np.nan_to_num(_derived_velocity(log, at)))


def servo_effort(
    log: JointLog, at: int, signal: EffortSignal, needed: Array | None = None
) -> Array:
    """(N,) effort of a servo, N·m or N, by the command of a log.

    Args:
        log: The log.
        at: Which of its joints.
        signal: Its gains.
        needed: (N,) effort that a model needs, by whose mean an integral begins; at 0 if None.
    """
    plain, summed = _parts(log, at, signal, needed)
    return np.clip(plain + summed, -signal.limit, signal.limit)


def integral_effort(log: JointLog, at: int, signal: EffortSignal) -> Array:
    """(N,) what the integral of a servo makes of its effort, N·m or N, by the efforts of a log.

    Args:
        log: The log, with efforts.
        at: Which of its joints.
        signal: Its gains.
    """
    return _parts(log, at, signal, log.effort[:, at])[1]


def _parts(
    log: JointLog, at: int, signal: EffortSignal, needed: Array | None
) -> tuple[Array, Array]:
    """(N,) efforts of a servo without its integral, and of that; before the limit is taken.

    What the integral begins with follows from efforts within the limit, and where it is held from
    what it begins with.
    """
    error, rate = _behind(log, at, signal)
    plain = signal.gain * error + (signal.damping * rate if signal.damping else 0.0)
    if not signal.integral:
        return plain, np.zeros(len(plain))
    summed, began = signal.integral * error_integral(log.time, error), np.zeros(len(plain))
    runs = runs_between_gaps(log.time, error)
    for _ in range(_ROUNDS if np.isfinite(signal.limit) else 1):
        if needed is not None:
            inside = np.abs(plain + summed + began) < signal.limit
            left = np.where(inside, needed - plain - summed, np.nan)
            began = constants_beside_friction(left, _velocity(log, at), runs)
        if np.isfinite(signal.limit):
            start = plain + began, signal.integral, signal.limit
            summed = signal.integral * limited_integral(log.time, error, *start)
    return plain, summed + began


def _behind(log: JointLog, at: int, signal: EffortSignal) -> tuple[Array, Array]:
    """(N,) by how much a joint is behind its late command, and how fast that grows."""
    command, rate = delayed_command(log, at, signal.delay)
    return command - log.position[:, at], rate - _velocity(log, at)


def delayed_command(log: JointLog, at: int, delay: float) -> tuple[Array, Array]:
    """(N,) the command of a joint as it was some time before, and its rate.

    NaN where there was none.

    Args:
        log: A log with commands.
        at: Which of its joints.
        delay: How long before, s.
    """
    column = np.full(len(log), np.nan) if log.command is None else log.command[:, at]
    known = np.isfinite(column) & np.isfinite(log.time)
    if np.count_nonzero(known) < 2:
        nothing = np.full(len(log), np.nan)
        return nothing, nothing
    late, told = log.time[known] + delay, column[known]
    there = np.where(np.isfinite(column), 0.0, np.nan)
    rate = np.interp(log.time, late, np.gradient(told, late))
    return np.interp(log.time, late, told) + there, rate + there


def _velocity(log: JointLog, at: int) -> Array:
    """(N,) velocity of a joint, from its positions where it was not measured."""
    derived = _derived_velocity(log, at)
    if log.velocity is None:
        return derived
    return np.where(np.isfinite(log.velocity[:, at]), log.velocity[:, at], derived)


def _derived_velocity(log: JointLog, at: int) -> Array:
    """(N,) velocity of a joint, from its positions."""
    position = log.position[:, at]
    known = np.isfinite(position) & np.isfinite(log.time)
    derived = np.full(len(log), np.nan)
    if np.count_nonzero(known) > 1:
        derived[known] = np.gradient(position[known], log.time[known])
    return derived
