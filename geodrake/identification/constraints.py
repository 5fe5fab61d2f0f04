"""What is known of the bodies besides a prior: where their mass can be, and how much there is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from geodrake.boundary.arguments import number, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.identification.problem import LinearConstraints
from geodrake.inertia import Array, from_dual, pseudo_inertia

_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyConstraints(Short):
    """Linear constraints on inertial parameters; −inf and inf are no bounds."""

    # (nb, 4, 4) matrices Q with [x;1]ᵀ Q [x;1] ≥ 0 inside an ellipsoid that holds all of a body's
    # mass: tr(P(φ_i) Q_i) ≥ 0 ([Lee2019] Eq. (3.5.46)).
    ellipsoids: ArrayLike | None = None
    total_mass: float | None = None  # sum of all masses, kg
    mass_bounds: ArrayLike | None = None  # (nb, 2) least and greatest masses, kg
    # (nb, 3, 2) least and greatest coordinates of each centre of mass in the body's frame, m.
    com_bounds: ArrayLike | None = None

    def rows(self, prior: Array, size: int) -> LinearConstraints | None:
        """Return those on x = [Φ, extra] (size,) with a prior Φ⁰ (nb, 10), which they may refuse.

        They are None if nothing limits x.
        """
        parts = list(self._parts(prior))
        if not parts:
            return None
        matrix, lower, upper = (np.concatenate(part) for part in zip(*parts, strict=True))
        used = np.isfinite(lower) | np.isfinite(upper)
        if not used.any():
            return None
        wide = np.pad(matrix[used], ((0, 0), (0, size - prior.size)))
        return LinearConstraints(matrix=wide, lower=lower[used], upper=upper[used])

    def _parts(self, prior: Array) -> Iterator[tuple[Array, Array, Array]]:
        """Yield rows (k, 10·nb) on the bodies, with their lower and upper values (k,)."""
        mass, none = np.zeros_like(prior), np.full(len(prior), np.inf)
        mass[:, 0] = 1.0
        if self.ellipsoids is not None:
            yield block_diag(*_ellipsoid_rows(self.ellipsoids, prior)), 0.0 * prior[:, 0], none
        if self.total_mass is not None:
            number(self.total_mass, "total_mass", lower=0.0, strict=True, finite=False)
            total = np.array([float(self.total_mass)])
            yield mass.reshape(1, -1), total, total
        if self.mass_bounds is not None:
            bounds = checked_bounds("mass_bounds", self.mass_bounds, (len(prior), 2))
            if wrong := np.flatnonzero(bounds[:, 1] <= 0).tolist():
                raise ArgumentError(
                    f"mass_bounds leave no positive mass to bodies {wrong}; masses are in kg.",
                    bodies=wrong,
                )
            yield block_diag(*mass), bounds[:, 0], bounds[:, 1]
        if self.com_bounds is not None:
            bounds = checked_bounds("com_bounds", self.com_bounds, (len(prior), 3, 2))
            # h_k − l m ≥ 0 and u m − h_k ≥ 0 are linear, where h/m would not be.
            for axis, (side, sign) in product(range(3), enumerate((1.0, -1.0))):
                limit = bounds[:, axis, side]
                finite = np.isfinite(limit)
                rows = -sign * np.where(finite, limit, 0.0)[:, None] * mass
                rows[:, 1 + axis] = sign
                yield block_diag(*rows), np.where(finite, 0.0, -none), none


def _ellipsoid_rows(ellipsoids: ArrayLike, prior: Array) -> Array:
    """Return covectors (nb, 10) of tr(P(φ_i) Q_i)."""
    Q = real_array(ellipsoids, "ellipsoids", (len(prior), 4, 4))
    Q = 0.5 * (Q + np.swapaxes(Q, 1, 2))
    if wrong := np.flatnonzero(np.linalg.eigvalsh(Q[:, :3, :3])[:, -1] >= 0).tolist():
        raise ArgumentError(
            f"The ellipsoids of bodies {wrong} are not bounded regions [x;1]ᵀQ[x;1] ≥ 0.",
            advice="Q is positive inside: use −Q if yours is negative there.",
            bodies=wrong,
        )
    P = pseudo_inertia(prior)
    inside, size = (np.einsum("bij,bji->b", *pair) for pair in ((Q, P), (np.abs(Q), np.abs(P))))
    if wrong := np.flatnonzero(inside < -_ROUNDING * size).tolist():
        raise ArgumentError(
            f"The ellipsoids of bodies {wrong} do not contain the prior's bodies: tr(P Q) is "
            f"{', '.join(f'{value:.3g}' for value in inside[wrong])} instead of at least 0.",
            advice="Check that prior and ellipsoids are in the same frames and units; else enlarge "
            "the ellipsoids, or move the prior inside.",
            bodies=wrong,
            trace=inside[wrong].tolist(),
        )
    return from_dual(Q)


def checked_bounds(name: str, bounds: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return bounds as an array whose last axis is (least, greatest), which may be ±inf."""
    array = real_array(bounds, name, shape, finite=False)
    low, high = array[..., 0], array[..., 1]
    usable = (low <= high) & (low < np.inf) & (high > -np.inf)
    if not usable.all():
        places = np.argwhere(~usable).tolist()
        raise ArgumentError(
            f"{name} leaves nothing between the least and the greatest value at {places}.",
            places=places,
        )
    return array
