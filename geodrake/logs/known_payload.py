"""Payloads of known mass that a robot carried while it was logged, such as weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geodrake.boundary.arguments import Array, instance, real_array
from geodrake.errors import ArgumentError
from geodrake.inertia import from_mass_com_inertia

Vector = tuple[float, float, float]

_HEAVIEST, _FARTHEST = 1e6, 1e3  # kg, m; larger values are typing errors
_POINT = ((0.0, 0.0, 0.0),) * 3


@dataclass(frozen=True)
class KnownPayload:
    """A known body fixed to a link of the robot, but absent from its model.

    The efforts that it needs are known in N·m. Logs with it and without it therefore identify
    effort gains, which are otherwise indistinguishable from scaled inertial parameters.

    Attributes:
        body: Name of the link B that carries it.
        mass: Mass, kg.
        mass_center: Position p_BoBcm_B of its centre of mass from the link's origin, expressed in
            the link's frame, m.
        inertia: Rotational inertia about its centre of mass, in the axes of the link's frame,
            kg·m²; by default that of a point mass.
    """

    body: str
    mass: float
    mass_center: Vector = (0.0, 0.0, 0.0)
    inertia: tuple[Vector, Vector, Vector] = _POINT

    def __post_init__(self) -> None:
        instance(self.body, "body", str)
        real_array(self.mass, "mass", (), finite=False)
        if not 0.0 < self.mass <= _HEAVIEST:
            raise ArgumentError(
                f"A known payload of {self.body} has a mass of {self.mass:g} kg.",
                advice=f"Use the mass from a scale: above 0 kg and up to {_HEAVIEST:g} kg.",
            )
        center = real_array(self.mass_center, "mass_center", (3,), finite=False)
        inertia = real_array(self.inertia, "inertia", (3, 3), finite=False)
        bounds = (center, _FARTHEST), (inertia, _HEAVIEST * _FARTHEST**2)
        if not all((np.abs(x) <= most).all() for x, most in bounds):
            raise ArgumentError(
                f"A known payload of {self.body} has its centre of mass at "
                f"{self.mass_center} m and the inertia {self.inertia} kg·m².",
                advice=f"Use coordinates x, y, z up to {_FARTHEST:g} m.",
            )

        object.__setattr__(self, "mass_center", tuple(center.tolist()))
        object.__setattr__(self, "inertia", tuple(map(tuple, inertia.tolist())))

    @property
    def phi(self) -> Array:
        """(10,) inertial parameters about the link's origin, expressed in the link's frame."""
        return from_mass_com_inertia(self.mass, self.mass_center, self.inertia)
