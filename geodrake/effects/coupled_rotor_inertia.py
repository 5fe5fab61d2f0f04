"""Inertia of a rotor that turns with two joints at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import Array, Parameter, RobotMotion
from geodrake.effects.gradient import RobotGradient
from geodrake.effects.shared_actuator import Direction, SharedActuatorEffect


@dataclass(frozen=True)
class CoupledRotorInertia(SharedActuatorEffect):
    """What a rotor that turns with vᵢ and vⱼ adds between the two joints.

    effort of joint i = I v̇ⱼ and effort of joint j = I v̇ᵢ, from the kinetic energy I vᵢ vⱼ: one
    symmetric pair of entries of the mass matrix. I is in kg·m², and negative where the rotor turns
    with the difference. What the same rotor adds to each joint alone is `rotor_inertia` of either
    joint, so |I| ≤ √(Iᵢ Iⱼ) of those two.
    """

    name = "coupled_rotor_inertia"
    of_motor = True
    taken_out_as = "rotor inertia"
    law = "I v̇_j on joint i and I v̇_i on joint j; of any two joints, like `coupled_friction`"
    list_position = 41
    complexity = 1
    parameters = (Parameter("inertia", "kg·m²"),)
    signature = "at each of two joints, follows the acceleration of the other one"
    depends_on = frozenset({"vd"})

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """[v̇ⱼ] at joint i and [v̇ᵢ] at joint j."""
        i, j = map(motion.joint, self.joints)
        return motion.at_both(self.joints, j.vd[:, None], i.vd[:, None])

    @staticmethod
    def shared(v: Array, turned_v: Array, turned_vd: Array, direction: Direction) -> Array:
        """[s v̇ⱼ]."""
        del v, turned_v, direction
        return turned_vd[..., np.newaxis]

    def gradient(self, motion: RobotMotion, weights: Array) -> RobotGradient | None:
        """Of either column by the other joint's v̇."""
        if not set(motion.joints).issuperset(self.joints):
            return None
        i, j = map(motion.index, self.joints)
        gradient = RobotGradient.zero(motion)
        gradient.vd[:, i], gradient.vd[:, j] = weights[:, j, 0], weights[:, i, 0]
        return gradient
