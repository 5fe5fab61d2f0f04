"""Bodies as point masses at given places: their masses are identified, and φ follows from them.

[Lee2019] Eqs. (3.5.54)–(3.5.56), (3.7.87): with masses that are not negative, every body can exist
and lies inside the hull of its points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, eigvalsh

from geodrake.boundary.arguments import instance, instances, integer, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.identification.problem import checked
from geodrake.inertia import (
    PARAMETERS_PER_BODY,
    Array,
    Ellipsoid,
    from_pseudo_inertia,
    is_physical,
    pseudo_inertia,
)

_MOST = 1_000_000  # points of a body


@dataclass(frozen=True, eq=False)
class PointMasses(Short):
    """Point masses of several bodies: (n_i, 3) positions in each one's frame, m, and ⁰μ > 0, kg."""

    positions: tuple[Array, ...]
    masses: tuple[Array, ...]  # (n_i,) prior masses ⁰μ

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
        """Equal masses, spread evenly over the uniform ellipsoid of every body of phi (nb, 10).

        They have the bodies' inertial parameters exactly, so that `parameters()` returns phi. The
        counts, one or one a body, are at least 10 points.
        """
        phi, numbers = _checked_bodies(phi, counts)
        positions = []
        for P, number in zip(pseudo_inertia(phi), numbers, strict=True):
            com = P[:3, 3] / P[3, 3]
            spread = np.linalg.cholesky(P[:3, :3] / P[3, 3] - np.outer(com, com))
            positions.append(com + _unit_ball(number) @ spread.T)
        masses = [np.full(n, body[0] / n) for n, body in zip(numbers, phi, strict=True)]
        return cls(tuple(positions), tuple(masses))

    @classmethod
    def within(
        cls, phi: ArrayLike, ellipsoids: Ellipsoid, counts: int | Sequence[int] = 85
    ) -> PointMasses:
        """Points all over the regions that bodies fit into, heavier where the bodies are.

        Half of the points are spread evenly over the region, with equal masses, half of what the
        body can have there. The other points are those of `of_bodies` for the rest of the body.
        Regions are of shape (nb,) for phi (nb, 10); counts, one or one a body, at least 20 points.
        """
        phi, numbers = _checked_bodies(phi, counts, least=2 * PARAMETERS_PER_BODY)
        regions = instance(ellipsoids, "ellipsoids", Ellipsoid)
        if regions.center.shape != (len(phi), 3):
            raise ArgumentError(
                f"Ellipsoids of shape ({len(phi)},) are needed, one a body; got those of shape "
                f"{regions.center.shape[:-1]}."
            )
        positions, masses = [], []
        for k, (body, number) in enumerate(zip(phi, numbers, strict=True)):
            ball = _unit_ball(number // 2)
            spread = regions.rotation[k] * regions.semi_axes[k]
            far = regions.center[k] + ball / np.linalg.norm(ball, axis=1).max() @ spread.T
            shape = _moments(far).mean(0)
            given = 0.5 / float(eigvalsh(shape, pseudo_inertia(body))[-1])
            near = cls.of_bodies([body - given * from_pseudo_inertia(shape)], number - len(far))
            positions.append(np.vstack([*near.positions, far]))
            masses.append(np.append(near.masses[0], np.full(len(far), given / len(far))))
        return cls(tuple(positions), tuple(masses))

    @property
    def prior(self) -> Array:
        """⁰μ of all bodies in a row, (N,) kg."""
        return np.concatenate(self.masses)

    def matrix(self) -> Array:
        """R (10·nb, N) with Φ = R μ."""
        blocks = [from_pseudo_inertia(_moments(places)).T for places in self.positions]
        return np.asarray(block_diag(*blocks))

    def parameters(self, masses: ArrayLike | None = None) -> Array:
        """Inertial parameters (nb, 10) of masses μ (N,), of the prior ones if None."""
        mu = self.prior if masses is None else checked("masses", masses, (len(self.prior),))
        return (self.matrix() @ mu).reshape(-1, PARAMETERS_PER_BODY)


def _checked_bodies(
    phi: ArrayLike, counts: int | Sequence[int], least: int = PARAMETERS_PER_BODY
) -> tuple[Array, list[int]]:
    """Physical bodies (nb, 10), and how many points each gets."""
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
    return phi, [integer(n, "counts", lower=least, upper=_MOST) for n in counts]


def _moments(places: Array) -> Array:
    """[x;1][x;1]ᵀ (n, 4, 4) of places (n, 3): the pseudo inertias of unit masses."""
    homogeneous = np.column_stack([places, np.ones(len(places))])
    return np.asarray(homogeneous[:, :, None] * homogeneous[:, None])


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
