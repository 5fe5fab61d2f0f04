"""Whether the stated mass of a known payload may be what is wrong, and not the gains of joints."""

from __future__ import annotations

import numpy as np

from geodrake.effects import Role
from geodrake.identification.logs.case import Case
from geodrake.model.carried_payloads import joints_with_known_gain
from geodrake.model.robot_model import RobotModel

_ALIKE = 0.01
"""Gains are alike if they differ by less than this."""


def stated_mass_notes(case: Case, fitted: RobotModel) -> list[str]:
    """That a mass stated wrong explains the gains which were found, in words; empty if it does not.

    It does where all joints that bear it have one gain, or all but one, as the bodies take in the
    rest. Where bodies are known from other logs, they cannot.
    """
    known = joints_with_known_gain(
        case.model, [trajectory.payloads for trajectory in case.trajectories]
    )
    scales = [f for f in fitted.effects if f.effect.role is Role.SCALE]
    gains = np.array([1.0 + f.parameters[0] for f in scales if f.effect.where[0] in known])
    if case.model.information is not None or not len(gains):
        return []
    common = float(np.median(gains))
    alike = int(np.sum(np.abs(gains - common) <= _ALIKE))
    if alike < max(2, len(known) - 1):
        return []
    return [
        f"{alike} of {len(known)} joints that bear the known payload have the gain {common:.3g}: "
        f"all are right if its mass is {common:.3g} times the stated one; weigh it again"
    ]
