"""Inertia of a rotor that turns with two joints at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import Array, JointPairEffect, Parameter, RobotMotion
from geodrake.effects.gradient import RobotGradient


@dataclass(frozen=True)
class CoupledRotorInertia(JointPairEffect):
    """What a rotor that turns with vᵢ and vⱼ adds between the two joints.

    effort of joint i = I v̇ⱼ and effort of joint j = I v̇ᵢ, from the kinetic energy I vᵢ vⱼ: one
    symmetric pair of entries of the mass matrix. I is in kg·m², and negative where the rotor turns
    with the difference. What the same rotor adds to each joint alone is `rotor_inertia` of either
    joint, so |I| ≤ √(Iᵢ Iⱼ) of those two.

    A diagnosis tries it at joints that follow each other, and at any other two whose residuals both
    go with the acceleration of the other one, beyond that of their own.
    """

    name = "coupled_rotor_inertia"
    parameters = (Parameter("inertia", "kg·m²"),)
    signature = "at each of two joints, follows the acceleration of the other one"
    confused_with = ("wrong_inertia", "payload", "rotor_inertia")

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """[v̇ⱼ] at joint i and [v̇ᵢ] at joint j."""
        i, j = self.joints
        return {
            i: motion.vd[:, motion.index(j), np.newaxis],
            j: motion.vd[:, motion.index(i), np.newaxis],
        }

    def gradient(self, motion: RobotMotion, weights: Array) -> RobotGradient:
        """Of either column by the other joint's v̇."""
        i, j = map(motion.index, self.joints)
        gradient = RobotGradient.zero(motion)
        gradient.vd[:, i], gradient.vd[:, j] = weights[:, j, 0], weights[:, i, 0]
        return gradient
