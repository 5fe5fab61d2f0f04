"""More dry friction at low speed."""

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

_SHARES = tuple(np.geomspace(0.01, 0.3, 4).tolist())  # of the peak speed


@dataclass(frozen=True)
class StribeckFriction(JointEffect):
    """What dry friction has at low speed over its value at high speed.

    effort = (S − F) exp(−|v / v_s|^α) sgn v, with the excess S − F ≥ 0 in N·m.

    It goes on top of `coulomb_friction`, which has the F of the whole Stribeck curve
    (F + (S − F) exp(−|v / v_s|^α)) sgn v, and of `viscous_friction`.

    Attributes:
        stribeck_velocity: v_s, rad/s or m/s.
        exponent: α; 1 (Tustin) and 2 (Gaussian) are usual.
    """

    stribeck_velocity: float
    exponent: float = 1.0

    name = "stribeck_friction"
    taken_out_as = "friction"
    law = "(S − F) exp(−|v/v_s|^α) sgn v, on top of Coulomb friction"
    list_position = 13
    jumps = True
    shapes = (Shape("stribeck_velocity", "rad/s", grid=_SHARES, scale="speed"),)
    parameters = (Parameter("excess", "N·m", lower=0.0),)
    signature = "extra friction near reversals that fades as the joint speeds up"
    depends_on = frozenset({"v"})

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "stribeck_velocity", "exponent")

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[exp(−|v / v_s|^α) sgn v]."""
        fading = np.exp(-(np.abs(joint.v / self.stribeck_velocity) ** self.exponent))
        return [fading * joint.sign_v]

    def slopes(self, joint: JointMotion) -> Sequence[Mapping[str, ArrayLike]]:
        """Of exp(−|v / v_s|^α) by v, times sgn v."""
        u = np.abs(joint.v / self.stribeck_velocity)
        fading = np.exp(-(u**self.exponent))
        moving = np.where(u > 0, u, 1.0)
        steepness = self.exponent * moving ** (self.exponent - 1.0) / self.stribeck_velocity
        slope = -fading * steepness * np.sign(joint.v)
        return [{"v": slope * joint.sign_v, "sign_v": fading}]

    @property
    def refines(self) -> tuple[tuple[type[Effect], ...], ...]:
        """Dry friction, with viscous friction or without."""
        return ((CoulombFriction,), (CoulombFriction, ViscousFriction))
