"""Friction in proportion to speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike

from geodrake.effects.base import Array, JointEffect, JointMotion, Parameter


@dataclass(frozen=True)
class ViscousFriction(JointEffect):
    """Viscous friction of a joint ([Lee2019] Eq. (5.2.2)).

    effort = c v, with c ≥ 0 in N·m·s/rad.
    """

    name = "viscous_friction"
    taken_out_as = "friction"
    law = "c v"
    list_position = 10
    complexity = 0
    stated_as = "damping"
    usual = True
    damps = True
    beside_gains = True
    parameters = (Parameter("viscous", "N·m·s/rad", lower=0.0),)
    signature = "grows in proportion to the joint's speed and changes sign with it"
    depends_on = frozenset({"v"})

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[v]."""
        return [joint.v]

    def slopes(self, joint: JointMotion) -> Sequence[Mapping[str, ArrayLike]]:
        """One by v."""
        del joint
        return [{"v": 1.0}]
