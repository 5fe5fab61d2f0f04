"""Conversion of logs of currents, voltages and commands into logs of efforts.

How integrals of servos grow is measured, where they began is not. In a long gap nothing is
measured, and they begin anew after it. Arrays are (N,), of the rows of a log; NaN is not known.
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
"""Gaps over which an error is taken as on a straight line, s; in longer ones it is not known."""

_ROUNDS = 10  # of where an integral is held, and what it begins with


def in_efforts(
    log: JointLog, signals: Sequence[EffortSignal], needed: Array | None = None
) -> JointLog:
    """Return the log with efforts, N·m or N, at joints that have a signal in the place of theirs.

    How well the gains are known becomes the log's `effort_uncertainty` at these joints.

    Args:
        log: What was measured; joints without one stay as they are.
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
    return replace(log, effort=effort, effort_uncertainty=uncertainty, effort_kinds=kinds)


def kind_of(log: JointLog, joint: str) -> str:
    """Return the kind of a joint's effort signal, of `KINDS`."""
    at = log.joints.index(joint)
    told = log.command is not None and np.isfinite(log.command[:, at]).any()
    if told and joint not in log.effort_kinds and not np.isfinite(log.effort[:, at]).any():
        return COMMAND
    kind = log.effort_kinds.get(joint, EFFORT)
    return EFFORT if kind in (PASSIVE, GROUND, UNMEASURED) else kind


def limited_effort(log: JointLog, at: int, motor: MotorLimit, asked: Array) -> Array:
    """Return efforts limited by the motor of a log's joint, N·m or N, along its motion.

    What a log has as velocities may be none. Where positions are not known, the joint stands.
    """
    return motor.given(asked, np.nan_to_num(_derived_velocity(log, at)))


def servo_effort(
    log: JointLog, at: int, signal: EffortSignal, needed: Array | None = None
) -> Array:
    """Return the effort of the servo of a log's joint, N·m or N, by its command.

    An integral begins so that its mean is that of the effort that a model needs; at 0 if None.
    """
    plain, summed = _parts(log, at, signal, needed)
    return np.clip(plain + summed, -signal.limit, signal.limit)


def integral_effort(log: JointLog, at: int, signal: EffortSignal) -> Array:
    """Return the integral part of a servo's effort, N·m or N, from a log's efforts."""
    return _parts(log, at, signal, log.effort[:, at])[1]


def _parts(
    log: JointLog, at: int, signal: EffortSignal, needed: Array | None
) -> tuple[Array, Array]:
    """Return efforts of a servo without its integral, and of that; before the limit is taken.

    What the integral begins with follows from efforts within the limit, and where it is held from
    what it begins with.
    """
    command, rate = delayed_command(log, at, signal.delay)
    error = beyond(command - log.position[:, at], signal.dead_band)
    velocity = _velocity(log, at)
    plain = signal.gain * error
    if signal.damping:
        plain = plain + signal.damping * (signal.rate_share * rate - velocity)
    if not signal.integral:
        return plain, np.zeros(len(plain))
    summed, began = signal.integral * error_integral(log.time, error), np.zeros(len(plain))
    runs = runs_between_gaps(log.time, error)
    for _ in range(_ROUNDS if np.isfinite(signal.limit) else 1):
        if needed is not None:
            inside = np.abs(plain + summed + began) < signal.limit
            left = np.where(inside, needed - plain - summed, np.nan)
            began = constants_beside_friction(left, velocity, runs)
        if np.isfinite(signal.limit):
            start = plain + began, signal.integral, signal.limit
            summed = signal.integral * error_integral(log.time, error, *start)
    return plain, summed + began


def delayed_command(log: JointLog, at: int, delay: float) -> tuple[Array, Array]:
    """Return the delayed command of a joint, and its rate, on straight lines between rows."""
    late, told, rates = late_commands(log, at, delay)
    if len(late) < 2 or log.command is None:
        nothing = np.full(len(log), np.nan)
        return nothing, nothing
    there = np.where(np.isfinite(log.command[:, at]), 0.0, np.nan)
    rate = np.interp(log.time, late, rates)
    return np.interp(log.time, late, told) + there, rate + there


def late_commands(log: JointLog, at: int, delay: float) -> tuple[Array, Array, Array]:
    """Return the instants (K,) at which commands of a joint act, s, the commands, and their rates.

    They are those of the log that are known. A simulation goes on between them as a cubic with
    these rates: straight lines would bend less than commands do, which a servo that knows their
    rate, and acts later, makes up for.
    """
    column = np.full(len(log), np.nan) if log.command is None else log.command[:, at]
    known = np.isfinite(column) & np.isfinite(log.time)
    late, told = log.time[known] + delay, column[known]
    return late, told, np.gradient(told, late) if len(late) > 1 else np.zeros(len(late))


def _velocity(log: JointLog, at: int) -> Array:
    """Return the velocity of a joint, from its positions where it was not measured."""
    derived = _derived_velocity(log, at)
    if log.velocity is None:
        return derived
    return np.where(np.isfinite(log.velocity[:, at]), log.velocity[:, at], derived)


def _derived_velocity(log: JointLog, at: int) -> Array:
    """Return the velocity of a joint, from its positions."""
    position = log.position[:, at]
    known = np.isfinite(position) & np.isfinite(log.time)
    derived = np.full(len(log), np.nan)
    if np.count_nonzero(known) > 1:
        derived[known] = np.gradient(position[known], log.time[known])
    return derived


def error_integral(
    time: Array, error: Array, effort: Array | None = None, gain: float = 1.0, limit: float = np.inf
) -> Array:
    """Return the integral of a servo's error, rad·s or m·s, from 0 on at the first known row.

    Straight lines lead over rows of which nothing is known. It stays where the servo is at its
    limit and would go beyond, with an effort without what the integral adds from the first row on.
    """
    effort = np.zeros(len(error)) if effort is None else effort
    known = np.isfinite(error) & np.isfinite(time) & np.isfinite(effort)
    if np.count_nonzero(known) < 2:
        return np.zeros(len(error))
    grown, columns = np.zeros(np.count_nonzero(known)), (time, error, effort)
    calc_limited_integral(contiguous(np.stack(columns, axis=1)[known]), gain, limit, grown)
    return np.interp(time, time[known], grown)


@compiled
def calc_limited_integral(rows: Array, gain: float, limit: float, out: Array) -> None:
    """Write the integral into zeros (N,), of rows (N, 3): instants, errors, other efforts."""
    for k in range(len(rows) - 1):
        effort, error = rows[k, 2] + gain * out[k], 0.5 * (rows[k, 1] + rows[k + 1, 1])
        beyond = (effort > limit and error > 0.0) or (effort < -limit and error < 0.0)
        out[k + 1] = out[k] + (0.0 if beyond else (rows[k + 1, 0] - rows[k, 0]) * error)


def runs_between_gaps(time: Array, error: Array) -> NDArray[np.intp]:
    """Return numbers, from 0 on, of the runs of rows over which an integral is known to grow.

    A new one begins after each gap that is longer than `LONGEST_BRIDGE`.
    """
    known = np.flatnonzero(np.isfinite(error) & np.isfinite(time))
    begins = known[1:][np.diff(time[known]) > LONGEST_BRIDGE]
    return np.searchsorted(begins, np.arange(len(time)), side="right")


def constants_beside_friction(effort: Array, velocity: Array, runs: NDArray[np.intp]) -> Array:
    """Return the constant of each run in an effort, N·m or N, that is no friction.

    Friction is that of all runs together; a run of which nothing is known has none.
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
