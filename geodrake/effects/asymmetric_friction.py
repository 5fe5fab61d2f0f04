"""Friction that differs between the two directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.effects.base import Array, JointEffect, JointMotion, Parameter
from geodrake.effects.coulomb_friction import CoulombFriction
from geodrake.effects.effort_offset import EffortOffset
from geodrake.effects.viscous_friction import ViscousFriction


@dataclass(frozen=True)
class AsymmetricFriction(JointEffect):
    """Dry and viscous friction with magnitudes of their own in each direction.

    effort = F₊ + c₊ v where v > 0, and −F₋ + c₋ v where v < 0; F in N·m, c in N·m·s/rad, all ≥ 0.

    It contains Coulomb and viscous friction (F₊ = F₋, c₊ = c₋), so it replaces that pair. It always
    brakes: at rest it is zero, and effort · v ≥ 0.
    """

    name = "asymmetric_friction"
    taken_out_as = "friction"
    law = "F₊, F₋, c₊, c₋ by direction"
    list_position = 12
    complexity = 1
    contains = (CoulombFriction, ViscousFriction, EffortOffset)
    jumps = True
    parameters = (
        Parameter("coulomb_positive", "N·m", lower=0.0),
        Parameter("coulomb_negative", "N·m", lower=0.0),
        Parameter("viscous_positive", "N·m·s/rad", lower=0.0),
        Parameter("viscous_negative", "N·m·s/rad", lower=0.0),
    )
    signature = "a step at reversals, and slopes or heights that differ between the directions"
    depends_on = frozenset({"v"})

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[max(sgn v, 0), min(sgn v, 0), max(v, 0), min(v, 0)]."""
        s, v = joint.sign_v, joint.v
        return [np.maximum(s, 0.0), np.minimum(s, 0.0), np.maximum(v, 0.0), np.minimum(v, 0.0)]

    def slopes(self, joint: JointMotion) -> Sequence[Mapping[str, ArrayLike]]:
        """Where each direction is, one by sgn v or v."""
        s, v = joint.sign_v, joint.v
        return [{"sign_v": s > 0}, {"sign_v": s < 0}, {"v": v > 0}, {"v": v < 0}]
