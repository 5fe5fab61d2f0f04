"""A spring and a damper that two joints stretch together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import Array, JointPairEffect, Parameter, RobotMotion
from geodrake.effects.gradient import RobotGradient


@dataclass(frozen=True)
class JointCoupling(JointPairEffect):
    """What a spring and a damper of length cᵢ qᵢ + cⱼ qⱼ add between the two joints.

    effort of joint i = k qⱼ + d vⱼ and effort of joint j = k qᵢ + d vᵢ, from the energy k qᵢ qⱼ:
    k = cᵢ cⱼ times the stiffness of a tendon over both, and d likewise. What the tendon is at each
    joint alone is a `joint_spring` and `viscous_friction` there; a tendon over more joints has one
    coupling for each two of them.
    """

    name = "joint_coupling"
    law = "k q_j + d v_j on joint i, and k q_i + d v_i on joint j"
    list_position = 102
    complexity = 3
    parameters = (Parameter("stiffness", "N·m/rad"), Parameter("damping", "N·m·s/rad"))
    signature = "at each of two joints, follows the position and the speed of the other one"
    depends_on = frozenset({"q", "v"})

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """[qⱼ, vⱼ] at joint i and [qᵢ, vᵢ] at joint j."""
        i, j = map(motion.joint, self.joints)
        return motion.at_both(self.joints, *(np.stack([x.q, x.v], -1) for x in (j, i)))

    def gradient(self, motion: RobotMotion, weights: Array) -> RobotGradient | None:
        """Of either joint's columns by the other one's q and v."""
        if not set(motion.joints).issuperset(self.joints):
            return None
        gradient = RobotGradient.zero(motion)
        i, j = map(motion.index, self.joints)
        for at, of in ((i, j), (j, i)):
            gradient.q[:, of], gradient.v[:, of] = weights[:, at, 0], weights[:, at, 1]
        return gradient

    @classmethod
    def candidates(cls, joints: tuple[str, str]) -> Iterable[JointCoupling]:
        """None: a file states it."""
        return ()
