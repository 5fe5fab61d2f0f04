"""Whether the stated mass of a known payload may be what is wrong, and not the gains of joints."""

from __future__ import annotations

import numpy as np

from geodrake.diagnosis.case import Case
from geodrake.effects import EffortScale
from geodrake.held_payloads import joints_told
from geodrake.model import RobotModel

_ALIKE = 0.01
"""Difference of gains that count as one."""


def stated_mass_notes(case: Case, fitted: RobotModel) -> list[str]:
    """That a mass stated wrong explains the gains which were found, in words; empty if it does not.

    It does where all joints that bear it have one gain, or all but one, as the bodies take in the
    rest. Where bodies are known from other logs, they cannot.

    Args:
        case: The case.
        fitted: The fitted model.
    """
    told = joints_told(case.model, [trajectory.payloads for trajectory in case.trajectories])
    scales = [f for f in fitted.effects if isinstance(f.effect, EffortScale)]
    gains = np.array([1.0 + f.parameters[0] for f in scales if f.effect.where[0] in told])
    if case.model.information is not None or not len(gains):
        return []
    common = float(np.median(gains))
    alike = int(np.sum(np.abs(gains - common) <= _ALIKE))
    if alike < max(2, len(told) - 1):
        return []
    return [
        f"{alike} of {len(told)} joints that bear the known payload have the gain {common:.3g}: "
        f"all are right if its mass is {common:.3g} times the stated one; weigh it again"
    ]
