"""A gear or belt that gives way under load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import Array, JointEffect, JointMotion, Parameter, RobotMotion
from geodrake.effects.deflection import effort_of_deflection


@dataclass(frozen=True)
class JointElasticity(JointEffect):
    """Elastic joint between a motor, whose position is measured, and its link: two masses.

    effort = −c (∂τ/∂q τ_j + ∂τ/∂v τ̇_j + M τ̈_j), with the compliance c = 1/k ≥ 0 in rad/(N·m).

    The link is at q − τ_j/k, with τ_j the effort that the rigid bodies need at the joint, and needs
    the effort of its own motion, here to first order in c. That is right below the frequency at
    which link and spring resonate. Friction and rotor inertia belong to the motor and stay as they
    are. Rates of τ_j are those along the log; where samples are no series in time, the joint bends
    as at rest.

    In a simulation the state of the robot is that of its links, so that this is no force: put a
    body for the motor and a spring into the plant.
    """

    name = "joint_elasticity"
    parameters = (Parameter("compliance", "rad/(N·m)", lower=0.0),)
    signature = "follows what moving the joint on by its own load would change, at all joints"
    confused_with = ("rotor_inertia", "effort_delay", "wrong_inertia", "joint_spring")
    from_residual = True
    sees_bodies = True
    sees_time = True
    is_force = False

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """Nothing that the joint's own motion says."""
        return [np.zeros_like(joint.v)]

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """[−(∂τ/∂q τ_j + ∂τ/∂v τ̇_j + M τ̈_j)] at all joints."""
        lag = motion.load[:, motion.index(self.joint)]
        change = effort_of_deflection(motion, self.name, self.joint, lag)
        return {joint: change[:, i, None] for i, joint in enumerate(motion.joints)}
