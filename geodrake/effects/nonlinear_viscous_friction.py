"""Friction that grows with a power of speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.effects.base import (
    Array,
    Effect,
    JointEffect,
    JointMotion,
    Parameter,
    Shape,
    require_positive,
)
from geodrake.effects.coulomb_friction import CoulombFriction
from geodrake.effects.viscous_friction import ViscousFriction

_LEAST_RATIO = 1.25  # of the exponent to that of viscous friction


@dataclass(frozen=True)
class NonlinearViscousFriction(JointEffect):
    """Friction that grows with a power of speed: lubricants (α < 1), drag (α = 2).

    effort = c |v|^α sgn v, with c ≥ 0 in N·m·(s/rad)^α.
    """

    exponent: float

    name = "nonlinear_viscous_friction"
    taken_out_as = "friction"
    law = "c |v|^α sgn v"
    list_position = 14
    shapes = (Shape("exponent", grid=(0.5, 1.5, 2.0, 3.0)),)
    parameters = (Parameter("viscous", "N·m·(s/rad)^α", lower=0.0),)
    signature = "follows the joint's speed along a curve and changes sign with it"
    depends_on = frozenset({"v"})

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "exponent")

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[|v|^α sgn v]."""
        return [np.abs(joint.v) ** self.exponent * joint.sign_v]

    def slopes(self, joint: JointMotion) -> Sequence[Mapping[str, ArrayLike]]:
        """Of |v|^α by v, times sgn v."""
        speed = np.abs(joint.v)
        moving = np.where(speed > 0, speed, 1.0)
        slope = self.exponent * moving ** (self.exponent - 1.0) * np.sign(joint.v)
        return [{"v": slope * joint.sign_v, "sign_v": speed**self.exponent}]

    @property
    def distinct(self) -> bool:
        """Whether the exponent is far enough from 1, at which this is viscous friction."""
        return bool(abs(np.log(self.exponent)) >= np.log(_LEAST_RATIO))

    @property
    def refines(self) -> tuple[tuple[type[Effect], ...], ...]:
        """With α < 1, dry and viscous friction, between which it stands; a drag refines nothing."""
        return ((CoulombFriction, ViscousFriction),) if self.exponent < 1.0 else ()
