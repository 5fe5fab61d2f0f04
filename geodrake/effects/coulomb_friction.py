"""Dry friction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike

from geodrake.effects.base import Array, JointEffect, JointMotion, Parameter
from geodrake.effects.viscous_friction import ViscousFriction


@dataclass(frozen=True)
class CoulombFriction(JointEffect):
    """Dry friction of a joint ([Lee2019] Eq. (5.2.2)).

    effort = F sgn v, with F ≥ 0 in N·m.
    """

    name = "coulomb_friction"
    taken_out_as = "friction"
    law = "F sgn v; `explain` finds below which speed sgn v fades, where that matters"
    list_position = 11
    complexity = 0
    stated_as = "dry friction"
    companion = ViscousFriction
    jumps = True
    usual = True
    beside_gains = True
    parameters = (Parameter("coulomb", "N·m", lower=0.0),)
    signature = "a step of constant height wherever the joint reverses"
    depends_on = frozenset({"v"})

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[sgn v]."""
        return [joint.sign_v]

    def slopes(self, joint: JointMotion) -> Sequence[Mapping[str, ArrayLike]]:
        """One by sgn v."""
        del joint
        return [{"sign_v": 1.0}]
