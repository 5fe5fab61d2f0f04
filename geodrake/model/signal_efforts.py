"""Conversion of logs of currents, voltages and commands into logs of efforts.

The log determines the growth of a servo's integral, but not its initial value, which is unknown
again after each long gap. Arrays (N,) belong to the rows of a log; NaN is unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, contiguous
from geodrake.inertia import Array
from geodrake.logs.motion import GROUND, PASSIVE, UNMEASURED, JointLog
from geodrake.model.effort_signal import COMMAND, EFFORT, EffortSignal, MotorLimit, signal_of
from geodrake.model.servos import beyond

LONGEST_BRIDGE = 0.1
"""Longest gap over which errors are interpolated, s; in longer ones they are unknown."""

_ROUNDS = 10  # of anti-windup and initial value, which depend on each other


def in_efforts(
    log: JointLog, signals: Sequence[EffortSignal], needed: Array | None = None
) -> JointLog:
    """Return the log with efforts, N·m or N, computed from signals that replace them.

    The uncertainty of the gains becomes the log's `effort_uncertainty` at these joints.

    Args:
        needed: (N, n) efforts of a model, N·m or N, whose mean determines the initial values of
            servos' integrals; these are 0 if None.
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
    return replace(log, effort=effort, effort_uncertainty=uncertainty, effort_kinds=kinds)


def kind_of(log: JointLog, joint: str) -> str:
    """Return the kind of a joint's effort signal, of `KINDS`."""
    at = log.joints.index(joint)
    has_command = log.command is not None and np.isfinite(log.command[:, at]).any()
    if has_command and joint not in log.effort_kinds and not np.isfinite(log.effort[:, at]).any():
        return COMMAND
    kind = log.effort_kinds.get(joint, EFFORT)
    return EFFORT if kind in (PASSIVE, GROUND, UNMEASURED) else kind


def limited_effort(log: JointLog, at: int, motor: MotorLimit, asked: Array) -> Array:
    """Return efforts within the motor limits of a log's joint, N·m or N.

    Velocities are derived from positions, as logged ones may be wrong; unknown ones count as 0.
    """
    return motor.given(asked, np.nan_to_num(_derived_velocity(log, at)))


def servo_effort(
    log: JointLog, at: int, signal: EffortSignal, needed: Array | None = None
) -> Array:
    """Return the effort of a joint's servo, N·m or N, from its command.

    `needed` is the effort of a model, for the initial value of an integral; that is 0 if None.
    """
    plain, summed = _servo_terms(log, at, signal, needed)
    return np.clip(plain + summed, -signal.limit, signal.limit)


def integral_effort(log: JointLog, at: int, signal: EffortSignal) -> Array:
    """Return the integral term of a servo's effort, N·m or N, from a log's efforts."""
    return _servo_terms(log, at, signal, log.effort[:, at])[1]


def _servo_terms(
    log: JointLog, at: int, signal: EffortSignal, needed: Array | None
) -> tuple[Array, Array]:
    """Return a servo's effort without the integral term, and that term, without limits.

    Initial value and anti-windup of the integral depend on each other, so they are iterated.
    """
    command, rate = delayed_command(log, at, signal.delay)
    error = beyond(command - log.position[:, at], signal.dead_band)
    velocity = _velocity(log, at)
    plain = signal.gain * error
    if signal.damping:
        plain = plain + signal.damping * (signal.rate_share * rate - velocity)
    if not signal.integral:
        return plain, np.zeros(len(plain))
    integral, initial = signal.integral * error_integral(log.time, error), np.zeros(len(plain))
    runs = runs_between_gaps(log.time, error)
    for _ in range(_ROUNDS if np.isfinite(signal.limit) else 1):
        if needed is not None:
            inside = np.abs(plain + integral + initial) < signal.limit
            remainder = np.where(inside, needed - plain - integral, np.nan)
            initial = constants_beside_friction(remainder, velocity, runs)
        if np.isfinite(signal.limit):
            start = plain + initial, signal.integral, signal.limit
            integral = signal.integral * error_integral(log.time, error, *start)
    return plain, integral + initial


def delayed_command(log: JointLog, at: int, delay: float) -> tuple[Array, Array]:
    """Return the delayed command of a joint and its rate, with linear interpolation."""
    late, commands, rates = late_commands(log, at, delay)
    if len(late) < 2 or log.command is None:
        unknown = np.full(len(log), np.nan)
        return unknown, unknown
    mask = np.where(np.isfinite(log.command[:, at]), 0.0, np.nan)
    rate = np.interp(log.time, late, rates)
    return np.interp(log.time, late, commands) + mask, rate + mask


def late_commands(log: JointLog, at: int, delay: float) -> tuple[Array, Array, Array]:
    """Return the times (K,) at which known commands of a joint act, s, commands, and their rates.

    A simulation interpolates them by a cubic with these rates. Linear interpolation would bias the
    curvature of commands, for which a fitted delay and rate gain would compensate.
    """
    column = np.full(len(log), np.nan) if log.command is None else log.command[:, at]
    known = np.isfinite(column) & np.isfinite(log.time)
    late, commands = log.time[known] + delay, column[known]
    return late, commands, np.gradient(commands, late) if len(late) > 1 else np.zeros(len(late))


def _velocity(log: JointLog, at: int) -> Array:
    """Return the velocity of a joint, derived from positions where it was not measured."""
    derived = _derived_velocity(log, at)
    if log.velocity is None:
        return derived
    return np.where(np.isfinite(log.velocity[:, at]), log.velocity[:, at], derived)


def _derived_velocity(log: JointLog, at: int) -> Array:
    """Return the derivative of a joint's positions."""
    position = log.position[:, at]
    known = np.isfinite(position) & np.isfinite(log.time)
    derived = np.full(len(log), np.nan)
    if np.count_nonzero(known) > 1:
        derived[known] = np.gradient(position[known], log.time[known])
    return derived


def error_integral(
    time: Array, error: Array, effort: Array | None = None, gain: float = 1.0, limit: float = np.inf
) -> Array:
    """Return the integral of a servo's error, rad·s or m·s, from 0 at the first known row.

    Unknown rows are interpolated linearly. The integral stays constant where it would take the
    servo beyond its limit; `effort` is that without the integral since the first row.
    """
    effort = np.zeros(len(error)) if effort is None else effort
    known = np.isfinite(error) & np.isfinite(time) & np.isfinite(effort)
    if np.count_nonzero(known) < 2:
        return np.zeros(len(error))
    integral, columns = np.zeros(np.count_nonzero(known)), (time, error, effort)
    calc_limited_integral(contiguous(np.stack(columns, axis=1)[known]), gain, limit, integral)
    return np.interp(time, time[known], integral)


@compiled
def calc_limited_integral(rows: Array, gain: float, limit: float, out: Array) -> None:
    """Write the integral into zeros (N,), for rows (N, 3) of time, error, and other effort."""
    for k in range(len(rows) - 1):
        effort, error = rows[k, 2] + gain * out[k], 0.5 * (rows[k, 1] + rows[k + 1, 1])
        beyond = (effort > limit and error > 0.0) or (effort < -limit and error < 0.0)
        out[k + 1] = out[k] + (0.0 if beyond else (rows[k + 1, 0] - rows[k, 0]) * error)


def runs_between_gaps(time: Array, error: Array) -> NDArray[np.intp]:
    """Return the index of each row's run, between gaps longer than `LONGEST_BRIDGE`."""
    known = np.flatnonzero(np.isfinite(error) & np.isfinite(time))
    begins = known[1:][np.diff(time[known]) > LONGEST_BRIDGE]
    return np.searchsorted(begins, np.arange(len(time)), side="right")


def constants_beside_friction(effort: Array, velocity: Array, runs: NDArray[np.intp]) -> Array:
    """Return the constant part of an effort in each run, N·m or N, fitted together with friction.

    All runs share the friction; a run without known rows has the constant 0.
    """
    known = np.isfinite(effort) & np.isfinite(velocity)
    run, v = runs[known], velocity[known]
    columns = np.stack([v, np.sign(v), effort[known]], axis=1)
    means, counts = np.zeros((int(runs.max(initial=0)) + 1, 3)), np.bincount(run)
    for k, column in enumerate(columns.T):
        means[: len(counts), k] = np.bincount(run, column) / np.maximum(counts, 1)
    within = columns - means[run]
    friction = np.linalg.lstsq(within[:, :2], within[:, 2], rcond=None)[0]
    return np.asarray((means[:, 2] - means[:, :2] @ friction)[runs])
