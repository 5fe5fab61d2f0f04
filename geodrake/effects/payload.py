"""A body held by the robot that its model does not have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from geodrake.effects.base import Array, BodyEffect, Parameter, RobotMotion, Role, Values
from geodrake.effects.gradient import RobotGradient
from geodrake.inertia import PARAMETER_NAMES, PARAMETER_UNITS, to_mass_com_inertia
from geodrake.manifolds import Manifold, PhysicalInertia

_NEVER_NEGATIVE = ("m", "Ixx", "Iyy", "Izz")


@dataclass(frozen=True)
class Payload(BodyEffect):
    """Rigid body fixed to a link.

    effort = Y_B(q, v, v̇) φ, with the regressor of the link's own inertial parameters and the
    payload's φ about the link's origin, expressed in the link's frame; P(φ) ≻ 0.
    """

    name = "payload"
    law = "ten inertial parameters, P ≻ 0"
    list_position = 60
    complexity = 1
    role = Role.BODY
    summary = "mass"
    parameters = tuple(
        Parameter(name, unit, lower=0.0 if name in _NEVER_NEGATIVE else -np.inf)
        for name, unit in zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True)
    )
    signature = "a body carried by the robot that its model does not have"
    depends_on = frozenset({"q", "v", "vd"})

    @classmethod
    def unit_of(cls, name: str) -> str:
        """Unit of a parameter, or of the mass or the centre of mass that results report."""
        return {"mass": "kg", **{f"com_{axis}": "m" for axis in "xyz"}}.get(
            name, super().unit_of(name)
        )

    def reported(self, parameters: Array, deviations: Array) -> tuple[Values, Values]:
        """Mass and centre of mass, and their standard deviations."""
        mass, com, _ = to_mass_com_inertia(parameters)
        # To first order of the deviations, those of mass and moment taken as independent.
        spread = np.hypot(deviations[1:4], com * deviations[0]) / mass
        return _by_name(float(mass), com), _by_name(float(deviations[0]), spread)

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


def _by_name(mass: float, com: Array) -> Values:
    x, y, z = com.tolist()
    return {"mass": mass, "com_x": x, "com_y": y, "com_z": z}
