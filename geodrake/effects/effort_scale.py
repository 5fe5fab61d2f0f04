"""A wrong gain of a joint's effort."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from geodrake.effects.base import Array, JointEffect, JointMotion, Parameter, RobotMotion, Role


@dataclass(frozen=True)
class EffortScale(JointEffect):
    """Gain of a joint's effort that is not one: a torque constant, a gear ratio, a sensor's slope.

    effort = (1 + ε) × all that the joint needs otherwise, so that ε times it is added; ε > −1.

    A joint that reads 10 % too much and bodies that are 10 % heavier look alike. The gain can be
    told only by inertias that are known from elsewhere: those of a model fitted to other logs, or
    a payload of known mass that the robot held in some of the logs and not in all, at the joints
    that bear it. A diagnosis tries it only then. A mass that is stated too large by a factor looks
    like gains of all these joints that are too small by the same factor.
    """

    name = "effort_scale"
    of_motor = True
    law = (
        "the logged effort is (1 + ε) that of the joint, where the inertia is trusted or a known "
        "payload is carried in one log"
    )
    list_position = 21
    complexity = 1
    role = Role.SCALE
    parameters = (Parameter("gain_error", "1", lower=-0.99),)
    signature = "in proportion to everything else that the joint needs"
    depends_on = frozenset({"load"})
    needs_known_inertia = True

    def columns(self, joint: JointMotion) -> tuple[Array]:
        """[τ] of the rigid bodies, where no more is known."""
        return (joint.load,)

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """[τ], what the joint needs by all other effects of the model."""
        if motion.effort is None:
            return super().rows(motion)
        at = motion.index(self.joint)
        return {self.joint: motion.effort()[:, at, None]}
