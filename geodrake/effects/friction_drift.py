"""Friction that changes as a gear warms up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import (
    Array,
    JointEffect,
    JointMotion,
    Parameter,
    RobotMotion,
    require_positive,
)

_USUAL = 300.0


@dataclass(frozen=True)
class FrictionDrift(JointEffect):
    """What dry and viscous friction have at the start of a log over what they settle at.

    effort = e^{−t/T} (F sgn v + c v), with F in N·m and c in N·m·s/rad, t s after the log began.

    It goes on top of `coulomb_friction` and `viscous_friction`, which have the settled values. F
    and c are positive where grease warms up, but need not be. Where time is not known the joint
    has settled.

    Attributes:
        time_constant: T, s.
    """

    time_constant: float

    name = "friction_drift"
    parameters = (Parameter("coulomb_change", "N·m"), Parameter("viscous_change", "N·m·s/rad"))
    signature = "friction that is another one at the end of a log than at its start"
    confused_with = ("coulomb_friction", "viscous_friction")
    from_residual = True
    sees_time = True

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "time_constant")

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """Nothing, of a joint that has settled."""
        return [np.zeros_like(joint.v), np.zeros_like(joint.v)]

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """e^{−t/T} [sgn v, v]."""
        if motion.time is None:
            return super().rows(motion)
        joint = motion.joint(self.joint)
        left = np.exp(-motion.time / self.time_constant)
        return {self.joint: left[:, None] * np.stack([joint.sign_v, joint.v], -1)}

    @classmethod
    def candidates(cls, joint: str, peak_speed: float) -> tuple[FrictionDrift, ...]:
        """Five minutes; a diagnosis tries what suits the length of the logs."""
        del peak_speed
        return (cls(joint, _USUAL),)
