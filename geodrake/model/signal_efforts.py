"""Logs of currents, voltages and commands, turned into logs of efforts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geodrake.logs.motion import JointLog
from geodrake.model.effort_signal import COMMAND, EffortSignal, signal_of

Array = NDArray[np.float64]


def in_efforts(log: JointLog, signals: Sequence[EffortSignal]) -> JointLog:
    """The log with efforts, N·m or N, at the joints that have a signal in the place of theirs.

    How well the gains are known becomes the log's `effort_uncertainty` at these joints.

    Args:
        log: What was measured; joints without one stay as they are.
        signals: What makes efforts of it.
    """
    effort, uncertainty = log.effort.copy(), log.gain_deviations.copy()
    kinds, notes = dict(log.effort_kinds), list(log.notes)
    for at, joint in enumerate(log.joints):
        signal = signal_of(signals, joint)
        if signal is None or signal.kind != kind_of(log, joint):
            continue
        if signal.kind == COMMAND:
            effort[:, at] = servo_effort(log, at, signal)
        else:
            effort[:, at] *= signal.gain
            kinds.pop(joint, None)
        uncertainty[at] = min(signal.uncertainty, 1.0)
    return replace(
        log,
        effort=effort,
        effort_uncertainty=uncertainty,
        effort_kinds=kinds,
        notes=tuple(notes),
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
    return log.effort_kinds.get(joint, "effort")


def servo_effort(log: JointLog, at: int, signal: EffortSignal) -> Array:
    """(N,) effort of a servo, N·m or N, by the command of a log.

    Args:
        log: The log.
        at: Which of its joints.
        signal: Its gains.
    """
    command = delayed_command(log, at, signal.delay)
    effort = signal.gain * (command - log.position[:, at])
    if signal.damping:
        velocity = np.gradient(log.position[:, at], log.time)
        if log.velocity is not None:
            measured = log.velocity[:, at]
            velocity = np.where(np.isfinite(measured), measured, velocity)
        effort += signal.damping * (np.gradient(command, log.time) - velocity)
    return np.clip(effort, -signal.limit, signal.limit)


def delayed_command(log: JointLog, at: int, delay: float) -> Array:
    """(N,) the command of a joint as it was some time before, NaN where there was none.

    Args:
        log: A log with commands.
        at: Which of its joints.
        delay: How long before, s.
    """
    column = np.empty(0) if log.command is None else log.command[:, at]
    known = np.isfinite(column) & np.isfinite(log.time)
    moved = np.interp(log.time - delay, log.time[known], column[known])
    return np.where(np.isfinite(column), moved, np.nan)
