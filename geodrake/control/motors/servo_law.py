"""The law of position servos."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geodrake.boundary.arguments import instance
from geodrake.control.motors.joint_scalars import JointScalars, joint_scalars
from geodrake.model.formulas.evaluation import Scalars


@dataclass(frozen=True, eq=False)
class ServoGains(JointScalars):
    """Gains of n servos, all (n,).

    Attributes:
        kp: Effort per error of position, N·m/rad or N/m.
        kd: Effort per error of velocity, N·m·s/rad or N·s/m.
        ki: Effort per integral of the error of position, N·m/(rad·s) or N/(m·s).
        limit: Largest effort, N·m or N; infinite for none.
        dead_band: Error of position up to which a servo does nothing about it, rad or m.
    """

    kp: Scalars
    kd: Scalars
    ki: Scalars
    limit: Scalars
    dead_band: Scalars


@dataclass(frozen=True, eq=False)
class ServoError(JointScalars):
    """What n servos act upon, all (n,).

    Attributes:
        position: Commanded less measured position, rad or m.
        velocity: Commanded less measured velocity.
        integral: Integral of the error of position beyond the dead band, rad·s or m·s.
        feedforward: Effort that is added, N·m or N.
    """

    position: Scalars
    velocity: Scalars
    integral: Scalars
    feedforward: Scalars


def servo_effort(gains: ServoGains, error: ServoError) -> Scalars:
    """Efforts of servos.

        τ = sat(kp e + kd ė + ki z + τ_ff),   e = dead(c − q),   ż = e,   ė = ċ − v

    where dead takes the dead band off an error, and sat keeps the limit.

    Returns:
        (n,) efforts, N·m or N.
    """
    return np.maximum(np.minimum(_unlimited(gains, error), gains.limit), -gains.limit)


def integral_rate(gains: ServoGains, error: ServoError) -> Scalars:
    """Rates ż (n,) of the integrals; 0 where the effort is at its limit and would go beyond."""
    effort, e = _unlimited(gains, error), _beyond(error.position, gains.dead_band)
    wound_up = np.logical_or(
        np.logical_and(effort > gains.limit, e > 0.0),
        np.logical_and(effort < -gains.limit, e < 0.0),
    )
    return np.where(wound_up, 0.0, e)


def _unlimited(gains: ServoGains, error: ServoError) -> Scalars:
    shape = instance(gains, "gains", ServoGains).shape
    joint_scalars(shape, vars(instance(error, "error", ServoError)))
    e = _beyond(error.position, gains.dead_band)
    return gains.kp * e + gains.kd * error.velocity + gains.ki * error.integral + error.feedforward


def _beyond(e: Scalars, band: Scalars) -> Scalars:
    """Errors less a dead band: e − b above b, e + b below −b, 0 between."""
    return np.maximum(e - band, 0.0) + np.minimum(e + band, 0.0)
