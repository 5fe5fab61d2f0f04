"""A gear or belt that gives way under load."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geodrake.effects.base import Array, Parameter, Proposer, RobotMotion, Shape, Values
from geodrake.effects.deflection import SPRING_DAMPING, Deflection, DeflectionEffect, Give
from geodrake.effects.fitted_effect import FittedEffect
from geodrake.errors import ArgumentError


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

    Attributes:
        damping: Of that spring, as a share of the critical one; None for the usual one. A fit of
            efforts does not see it, one of rollouts does.
    """

    damping: float | None = None

    name = "joint_elasticity"
    of_motor = True
    law = "the link gives way by its load over k, to first order in 1/k"
    list_position = 50
    complexity = 1
    proposer = Proposer.BENDING
    shapes = (Shape("damping", "1"),)
    parameters = (Parameter("compliance", "rad/(N·m)", lower=0.0),)
    signature = "follows what moving the joint on by its own load would change, at all joints"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.damping is not None and self.damping < 0.0:
            raise ArgumentError(f"damping of {self.name} must not be negative; got {self.damping}.")

    @property
    def free_shapes(self) -> int:
        """None: efforts do not show the damping."""
        return 0

    def deflection(self, motion: RobotMotion) -> Deflection:
        """Return the load of the joint, as a spring of unit stiffness gives way to it."""
        return Deflection.along(motion.load[:, motion.index(self.joint)], motion.time)

    def give(self, parameters: Array) -> Give:
        """Return a spring of the compliance."""
        return Give(compliance=max(parameters[0], 0.0), damping=self.damping)

    def rollout_values(self, parameters: Array) -> Values:
        """Compliance and damping of a spring that gives way at all."""
        if not parameters[0] > 0.0:
            return {}
        damping = SPRING_DAMPING if self.damping is None else self.damping
        return {
            "compliance": float(parameters[0]),
            **({"damping": damping} if damping > 0.0 else {}),
        }

    def with_rollout_values(self, values: Values, deviations: Values) -> FittedEffect:
        """Return a spring of this compliance and damping."""
        effect = replace(self, damping=values.get("damping", self.damping))
        return FittedEffect(
            effect, np.array([values["compliance"]]), np.array([deviations["compliance"]])
        )
