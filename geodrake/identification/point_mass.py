"""Bodies as point masses at given places: their masses are identified, and φ follows from them.

[Lee2019] Eqs. (3.5.54)–(3.5.56), (3.7.87): with masses that are not negative, every body can exist
and lies inside the hull of its points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from geodrake.boundary.arguments import instances, integer, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.identification.problem import checked
from geodrake.inertia import (
    PARAMETERS_PER_BODY,
    Array,
    from_pseudo_inertia,
    is_physical,
    pseudo_inertia,
)

_MOST = 1_000_000  # points of a body


@dataclass(frozen=True, eq=False)
class PointMasses(Short):
    """Point masses of several bodies.

    Attributes:
        positions: For every body (n_i, 3) positions in its frame, m.
        masses: For every body (n_i,) prior masses ⁰μ > 0, kg.
    """

    positions: tuple[Array, ...]
    masses: tuple[Array, ...]

    def __post_init__(self) -> None:
        places = instances(self.positions, "positions", object)
        given = instances(self.masses, "masses", object)
        positions = [checked(f"positions[{i}]", p, (None, 3)) for i, p in enumerate(places)]
        if len(given) != len(positions):
            raise ArgumentError(
                f"Masses are needed for each of the {len(positions)} bodies; got those of "
                f"{len(given)}."
            )
        masses = [
            checked(f"masses[{i}]", mass, (len(place),))
            for i, (mass, place) in enumerate(zip(given, positions, strict=True))
        ]
        wrong = [i for i, mass in enumerate(masses) if not (len(mass) and (mass > 0).all())]
        if wrong:
            raise ArgumentError(f"Bodies {wrong} have no points, or prior masses that are not > 0.")
        object.__setattr__(self, "positions", tuple(positions))
        object.__setattr__(self, "masses", tuple(masses))

    @classmethod
    def of_bodies(cls, phi: ArrayLike, counts: int | Sequence[int] = 85) -> PointMasses:
        """Equal masses, spread evenly over the uniform ellipsoid of every body.

        They have the bodies' inertial parameters exactly, so that `parameters()` returns phi.

        Args:
            phi: (nb, 10) physical inertial parameters.
            counts: Number of points of every body, or of each; at least 10.

        Raises:
            ArgumentError: A shape is wrong, a body is not physical, or there are too few points.
        """
        phi = checked("phi", phi, (None, PARAMETERS_PER_BODY))
        wrong = np.flatnonzero(~is_physical(phi)).tolist()
        if wrong:
            raise ArgumentError(
                f"Bodies {wrong} are not physical, so no point masses amount to them.",
                bodies=wrong,
            )
        if isinstance(counts, int | np.integer):
            counts = (counts,) * len(phi)
        elif real_array(counts, "counts").shape != (len(phi),):
            raise ArgumentError(f"counts must have shape ({len(phi)},); got {np.shape(counts)}.")
        numbers = [integer(n, "counts", lower=PARAMETERS_PER_BODY, upper=_MOST) for n in counts]
        positions = []
        for P, number in zip(pseudo_inertia(phi), numbers, strict=True):
            com = P[:3, 3] / P[3, 3]
            spread = np.linalg.cholesky(P[:3, :3] / P[3, 3] - np.outer(com, com))
            positions.append(com + _unit_ball(number) @ spread.T)
        masses = [np.full(n, body[0] / n) for n, body in zip(numbers, phi, strict=True)]
        return cls(tuple(positions), tuple(masses))

    @property
    def prior(self) -> Array:
        """⁰μ of all bodies in a row, (N,) kg."""
        return np.concatenate(self.masses)

    def matrix(self) -> Array:
        """R (10·nb, N) with Φ = R μ."""
        blocks = []
        for places in self.positions:
            homogeneous = np.column_stack([places, np.ones(len(places))])
            blocks.append(from_pseudo_inertia(homogeneous[:, :, None] * homogeneous[:, None]).T)
        return np.asarray(block_diag(*blocks))

    def parameters(self, masses: ArrayLike | None = None) -> Array:
        """Inertial parameters (nb, 10) of masses μ (N,), of the prior ones if None."""
        mu = self.prior if masses is None else checked("masses", masses, (len(self.prior),))
        return (self.matrix() @ mu).reshape(-1, PARAMETERS_PER_BODY)


def _unit_ball(number: int) -> Array:
    """(n, 3) points spread evenly over a ball, their mean zero and their covariance the identity.

    R_3 low-discrepancy points (M. Roberts 2018) in a cube, mapped to the ball and then corrected.
    """
    fractions = np.power(1.2207440846057596, -np.arange(1, 4))
    cube = (0.5 + np.arange(1, number + 1)[:, None] * fractions) % 1.0
    radius, height = np.cbrt(cube[:, 0]), 2.0 * cube[:, 1] - 1.0
    angle, side = 2.0 * np.pi * cube[:, 2], np.sqrt(1.0 - height**2)
    ball = radius[:, None] * np.column_stack([side * np.cos(angle), side * np.sin(angle), height])
    ball -= ball.mean(0)
    root = np.linalg.cholesky(ball.T @ ball / number)
    return np.asarray(np.linalg.solve(root, ball.T).T)
