"""Servos of joints: their gains, and the law by which they make efforts of errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, cast

import numpy as np

from geodrake.compiling import inlined
from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.model.effort_signal import COMMAND, EffortSignal, signal_of
from geodrake.model.robot_model import RobotModel


def servos_of(model: RobotModel) -> tuple[EffortSignal | None, ...]:
    """Return the servo of each of a model's joints; None for other effort signals."""
    signals = (signal_of(model.effort_signals, joint) for joint in model.joints)
    return tuple(each if each and each.kind == COMMAND else None for each in signals)


def command_delays(model: RobotModel) -> Array:
    """Return (n,) times by which commands act late, s; 0 at joints without a servo."""
    return np.array([servo.delay if servo else 0.0 for servo in servos_of(model)])


class ServoError(NamedTuple):
    """Differences that servos act upon, all (..., n)."""

    position: Array  # commanded less measured position, rad or m
    velocity: Array  # the known share of the commanded velocity less the measured one
    integral: Array  # integral of the error of position beyond the dead band, rad·s or m·s
    feedforward: Array  # effort that is added, N·m or N


class ServoGains(NamedTuple):
    """Gains of servos, all (n,), as in `PositionServo`; `limit` is infinite without a limit.

        τ = sat(kp e + kd ė + ki z + τ_ff),   e = dead(c − q),   ż = e,   ė = ρ ċ − v

    where dead takes the dead band off an error, and sat keeps the limit.
    """

    kp: Array
    kd: Array
    ki: Array
    limit: Array
    dead_band: Array
    rate_share: Array

    def effort(self, error: ServoError) -> Array:
        """Return the efforts (..., n), N·m or N."""
        return np.maximum(np.minimum(self.unlimited(error), self.limit), -self.limit)

    def unlimited(self, error: ServoError) -> Array:
        """Return what efforts (..., n) would be without limits, N·m or N."""
        pull = self.kp * beyond(error.position, self.dead_band) + self.kd * error.velocity
        return np.asarray(pull + self.ki * error.integral + error.feedforward)

    def integral_rate(self, error: ServoError) -> Array:
        """Return the rates ż (..., n); 0 where the effort is at its limit and would go beyond."""
        effort, e = self.unlimited(error), beyond(error.position, self.dead_band)
        wound_up = np.logical_or(
            np.logical_and(effort > self.limit, e > 0.0),
            np.logical_and(effort < -self.limit, e < 0.0),
        )
        return np.where(wound_up, 0.0, e)


NO_SERVO = ServoGains(*np.array([0.0, 0.0, 0.0, np.inf, 0.0, 1.0]))
"""Gains of a joint without a servo."""


def servo_gains(model: RobotModel) -> ServoGains:
    """Return the gains of the servos of a model's joints."""
    servos = servos_of(model)
    if not any(servos):
        raise ModelError(
            "The model has no servos: none of its efforts is computed from a command.",
            advice="Add effort_signals of the kind 'command'.",
        )
    if len(model.single_joints) < len(model.joints):
        raise ModelError(
            "Servos need joints with one degree of freedom.",
            advice="Weld the base, or remove such joints from the model.",
        )
    rows = [
        (s.gain, s.damping, s.integral, s.limit, s.dead_band, s.rate_share) if s else NO_SERVO
        for s in servos
    ]
    return ServoGains(*np.array(rows).T)


def beyond(error: Array, band: Array | float) -> Array:
    """Return errors less a dead band: e − b above b, e + b below −b, 0 between."""
    return np.maximum(error - band, 0.0) + np.minimum(error + band, 0.0)


calc_beyond = cast(Callable[[float, float], float], inlined(beyond))
"""`beyond` of numbers, for compiled functions."""
