"""A gear or belt that gives way under load."""

from __future__ import annotations

from dataclasses import dataclass

from geodrake.effects.base import Array, Parameter, Proposer, RobotMotion
from geodrake.effects.deflection import Deflection, DeflectionEffect, Give


@dataclass(frozen=True)
class JointElasticity(DeflectionEffect):
    """Elastic joint between a motor, whose position is measured, and its link: two masses.

    effort = −c (∂τ/∂q τ_j + ∂τ/∂v τ̇_j + M τ̈_j), with the compliance c = 1/k ≥ 0 in rad/(N·m).

    The link is at q − τ_j/k, with τ_j the effort that the rigid bodies need at the joint, and needs
    the effort of its own motion, here to first order in c. That is right below the frequency at
    which link and spring resonate. Friction and rotor inertia belong to the motor and stay as they
    are. Rates of τ_j are those along the log; where samples are no series in time, the joint bends
    as at rest.

    A simulation has motor and link as two bodies with a spring, at any frequency.
    """

    name = "joint_elasticity"
    law = "the link gives way by its load over k, to first order in 1/k"
    list_position = 50
    complexity = 1
    proposer = Proposer.BENDING
    hidden_share = 0.0
    other_bandwidths = (0.5,)
    parameters = (Parameter("compliance", "rad/(N·m)", lower=0.0),)
    signature = "follows what moving the joint on by its own load would change, at all joints"

    def deflection(self, motion: RobotMotion) -> Deflection:
        """The load of the joint, as a spring of unit stiffness gives way to it."""
        return Deflection.along(motion.load[:, motion.index(self.joint)], motion.time)

    def give(self, parameters: Array) -> Give:
        """A spring of the compliance."""
        return Give(compliance=max(parameters[0], 0.0))
