"""Friction that changes as a gear warms up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import (
    Array,
    Effect,
    JointEffect,
    JointMotion,
    Parameter,
    Proposer,
    RobotMotion,
    Shape,
    require_positive,
)
from geodrake.effects.coulomb_friction import CoulombFriction
from geodrake.effects.viscous_friction import ViscousFriction


@dataclass(frozen=True)
class FrictionDrift(JointEffect):
    """What dry and viscous friction have at the start of a log over what they settle at.

    effort = e^{−t/T} (F sgn v + c v), with F in N·m and c in N·m·s/rad, t s after the log began.

    It goes on top of `coulomb_friction` and `viscous_friction`, which have the settled values,
    if these are not none. F and c are positive where grease warms up, but need not be. Where time
    is not known the joint has settled.

    Attributes:
        time_constant: T, s.
    """

    time_constant: float

    name = "friction_drift"
    taken_out_as = "friction"
    law = "e^(−t/T) (F sgn v + c v): friction of a gear that warms up, on top of what it settles at"
    list_position = 17
    proposer = Proposer.WARMING
    shapes = (
        Shape("time_constant", "s", grid=(0.1, 0.3, 1.0, 3.0), scale="duration", usual=300.0),
    )
    parameters = (Parameter("coulomb_change", "N·m"), Parameter("viscous_change", "N·m·s/rad"))
    signature = "friction that is another one at the end of a log than at its start"
    depends_on = frozenset({"v", "time"})

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
        left = self.course(motion.time)
        return {self.joint: left[:, None] * np.stack([joint.sign_v, joint.v], -1)}

    def course(self, along: Array) -> Array:
        """Share e^{−t/T} of the change that is left at instants (N,) since the log began, s."""
        return np.exp(-along / self.time_constant)

    @property
    def refines(self) -> tuple[tuple[type[Effect], ...], ...]:
        """Dry friction or viscous friction, or nothing: what runs in may settle at none."""
        return ((CoulombFriction,), (ViscousFriction,), ())
