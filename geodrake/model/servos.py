"""The servos of a model's joints, as its `effort_signals` state them."""

from __future__ import annotations

import numpy as np

from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.model.effort_signal import COMMAND, EffortSignal, signal_of
from geodrake.model.robot_model import RobotModel


def servos_of(model: RobotModel) -> tuple[EffortSignal | None, ...]:
    """Return the servo of each of a model's joints; None where efforts come from something else."""
    signals = (signal_of(model.effort_signals, joint) for joint in model.joints)
    return tuple(each if each and each.kind == COMMAND else None for each in signals)


def servo_gains(model: RobotModel) -> tuple[Array, Array, Array, Array]:
    """Return stiffness, damping, integral gain and largest effort (n,) of the servos.

    They are 0, 0, 0 and ∞ where there is none.
    """
    servos = servos_of(model)
    if not any(servos):
        raise ModelError(
            "The model knows of no servos: none of its efforts comes from a command.",
            advice="Give it effort_signals of the kind 'command'.",
        )
    if len(model.single_joints) < len(model.joints):
        raise ModelError(
            "Servos need joints of one degree of freedom each; this robot has others.",
            advice="Weld the base, or leave such joints out of the model.",
        )
    none = (0.0, 0.0, 0.0, np.inf)
    rows = [(s.gain, s.damping, s.integral, s.limit) if s else none for s in servos]
    kp, kd, ki, limit = np.array(rows).T
    return kp, kd, ki, limit


def command_delays(model: RobotModel) -> Array:
    """Return (n,) times by which commands act late, s; 0 at joints without a servo."""
    return np.array([servo.delay if servo else 0.0 for servo in servos_of(model)])
