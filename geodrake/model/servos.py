"""Position servos of joints: gains and control law."""

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
    return tuple(signal if signal and signal.kind == COMMAND else None for signal in signals)


def command_delays(model: RobotModel) -> Array:
    """Return delays (n,) of commands, s; 0 at joints without a servo."""
    return np.array([servo.delay if servo else 0.0 for servo in servos_of(model)])


class ServoError(NamedTuple):
    """Inputs of servos, all (..., n)."""

    position: Array  # commanded less measured position, rad or m
    velocity: Array  # ρ times the commanded velocity, less the measured one
    integral: Array  # integral of the position error beyond the dead band, rad·s or m·s
    feedforward: Array  # N·m or N


class ServoGains(NamedTuple):
    """Gains of servos, all (n,), as in `PositionServo`; `limit` may be infinite.

        τ = sat(kp e + kd ė + ki z + τ_ff),   e = dead(c − q),   ż = e,   ė = ρ ċ − v

    with the dead band function dead and saturation at the limit, sat.
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
        """Return the efforts (..., n) without limits, N·m or N."""
        pull = self.kp * beyond(error.position, self.dead_band) + self.kd * error.velocity
        return np.asarray(pull + self.ki * error.integral + error.feedforward)

    def integral_rate(self, error: ServoError) -> Array:
        """Return the rates ż (..., n), with anti-windup: 0 if the effort would exceed its limit."""
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
    """Return errors beyond a dead band: e − b above b, e + b below −b, 0 between."""
    return np.maximum(error - band, 0.0) + np.minimum(error + band, 0.0)


calc_beyond = cast(Callable[[float, float], float], inlined(beyond))
"""Scalar `beyond` for compiled functions."""
