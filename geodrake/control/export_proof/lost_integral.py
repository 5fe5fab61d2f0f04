"""Integrals of servos, which no format holds: named, with what the motion departs without them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geodrake.control.rollout import case_rollout
from geodrake.control.rollout.acting import told_joints
from geodrake.errors import LogError, ModelError
from geodrake.identification.logs.case import Case
from geodrake.model.exporting.held import ExportFormat
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import servos_of

_WINDOWS = 6


def lost_integrals(model: RobotModel, form: ExportFormat, case: Case | None) -> tuple[str, ...]:
    """A note on servos whose integral an export does not hold; none if it holds all.

    Args:
        case: Model and logs; None without logs.
    """
    joints = [servo.joint for servo in servos_of(model) if servo and servo.integral]
    if not joints or not form.servos:
        return ()
    words = f"servos of {form.name} have no integral, such as that of {', '.join(joints)}"
    at = [model.joints.index(joint) for joint in joints]
    if case is not None and any(told_joints(case.model, log)[at].any() for log in case.asked.logs):
        words += _departures(case)
    return (f"{words}; PositionServo in a Drake diagram has it",)


def _departures(case: Case) -> str:
    """What a robot departs by without integrals and with them; nothing if rollouts do not say."""
    without = tuple(replace(s, integral=0.0) for s in case.model.effort_signals)
    models = replace(case.model, effort_signals=without), case.model
    try:
        shares = [
            case_rollout(replace(case, model=each), most=_WINDOWS, commands=True).relative
            for each in models
        ]
    except (LogError, ModelError):  # logs that are too short, or a robot that is not simulated
        return ""
    if not np.isfinite(shares).all():
        return ""
    return (
        f": under the commands of the logs the robot departs by {100 * shares[0]:.2g} % of its "
        f"motion without it, and by {100 * shares[1]:.2g} % with it"
    )
