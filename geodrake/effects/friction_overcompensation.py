"""Dry friction that a drive takes out, and more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike

from geodrake.effects.asymmetric_friction import AsymmetricFriction
from geodrake.effects.base import Array, JointEffect, JointMotion, Parameter
from geodrake.effects.coulomb_friction import CoulombFriction


@dataclass(frozen=True)
class FrictionOvercompensation(JointEffect):
    """What a drive takes out of dry friction beyond what there is.

    effort = −F sgn v, with F ≥ 0 in N·m.

    Drives may add an effort against dry friction that no log shows. If it is larger than the
    friction, the logged effort is smaller the way the joint moves. The drive pushes the joint: this
    is none of the robot's friction, and it makes a joint that is held with a weak controller swing.
    """

    name = "friction_overcompensation"
    of_motor = True
    taken_out_as = "friction"
    law = "−F sgn v: the drive takes out more dry friction than there is"
    list_position = 11.5
    complexity = 1
    contains = (CoulombFriction, AsymmetricFriction)
    jumps = True
    by_drive = True
    parameters = (Parameter("excess", "N·m", lower=0.0),)
    signature = "a step of constant height wherever the joint reverses, along the motion"
    depends_on = frozenset({"v"})

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[−sgn v]."""
        return [-joint.sign_v]

    def slopes(self, joint: JointMotion) -> Sequence[Mapping[str, ArrayLike]]:
        """Minus one by sgn v."""
        del joint
        return [{"sign_v": -1.0}]
