"""A body held by the robot that its model does not have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from geodrake.effects.base import Array, BodyEffect, Parameter, RobotMotion
from geodrake.effects.gradient import RobotGradient
from geodrake.inertia import PARAMETER_NAMES, PARAMETER_UNITS
from geodrake.manifolds import Manifold, PhysicalInertia

_NEVER_NEGATIVE = ("m", "Ixx", "Iyy", "Izz")


@dataclass(frozen=True)
class Payload(BodyEffect):
    """Rigid body fixed to a link.

    effort = Y_B(q, v, v̇) φ, with the regressor of the link's own inertial parameters and the
    payload's φ about the link's origin, expressed in the link's frame; P(φ) ≻ 0.

    Attributes:
        body: Name of the link.
    """

    name = "payload"
    parameters = tuple(
        Parameter(name, unit, lower=0.0 if name in _NEVER_NEGATIVE else -np.inf)
        for name, unit in zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True)
    )
    signature = "follows gravity and acceleration at all joints up to the link that carries it"
    confused_with = ("wrong_inertia", "rotor_inertia", "gravity_tilt", "effort_scale")

    @property
    def manifold(self) -> Manifold:
        """Inertial parameters of a body that can exist."""
        return PhysicalInertia()

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """The link's ten inertial columns at every joint."""
        columns = motion.body_columns(self.body)
        return {joint: columns[:, i] for i, joint in enumerate(motion.joints)}

    def regressor(self, motion: RobotMotion) -> Array:
        """The link's inertial regressor, (N, nv, 10)."""
        return motion.body_columns(self.body)

    def gradient(self, motion: RobotMotion, weights: Array) -> RobotGradient:
        """The weights themselves, of the link's inertial regressor."""
        return replace(RobotGradient.zero(motion), bodies={self.body: weights})
