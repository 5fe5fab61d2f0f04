"""Inertial parameters of a body with linear constraints, such as an ellipsoid it must fit into."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.errors import ArgumentError
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.manifolds.base import Array, Lift, Manifold, excess
from geodrake.manifolds.inertia import PhysicalInertia
from geodrake.manifolds.interval import Positive
from geodrake.manifolds.product import Product

_INERTIA = PhysicalInertia()


@dataclass(frozen=True, eq=False)
class ConstrainedInertia(Manifold):
    """Inertial parameters φ with P(φ) ≻ 0 and aₖᵀ φ > bₖ for m constraints.

    h = −log det P(φ) − α Σ log(aₖᵀ φ − bₖ), [Lee2019] Eq. (5.3.27). It does not depend on the
    scale of a constraint, so that α has no unit.

    Attributes:
        normals: (m, 10) rows aₖᵀ, such as `geodrake.ellipsoids.realizability_row`.
        offsets: (m,) values bₖ.
        weight: α > 0.
    """

    normals: Array
    offsets: Array
    weight: float = 1.0

    def __post_init__(self) -> None:
        normals, offsets = np.asarray(self.normals, float), np.asarray(self.offsets, float)
        if (
            normals.shape != (len(normals), PARAMETERS_PER_BODY)
            or offsets.shape != normals.shape[:1]
        ):
            raise ArgumentError(
                f"Constraints on a body have normals (m, 10) and offsets (m,); got "
                f"{normals.shape} and {offsets.shape}."
            )
        if not (np.isfinite(normals).all() and np.isfinite(offsets).all() and self.weight > 0):
            raise ArgumentError(
                f"Constraints are finite and their weight is above zero; got weight {self.weight}, "
                f"normals {normals.tolist()} and offsets {offsets.tolist()}."
            )
        object.__setattr__(self, "normals", normals)
        object.__setattr__(self, "offsets", offsets)

    @property
    def dimension(self) -> int:
        """Ten."""
        return PARAMETERS_PER_BODY

    def slacks(self, x: ArrayLike) -> Array:
        """How far each constraint is from being broken, aₖᵀ x − bₖ, (..., m)."""
        return np.asarray(np.asarray(x, float) @ self.normals.T - self.offsets)

    def contains(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Whether P(x) ≻ 0 and all constraints hold (...), [Lee2019] Eq. (5.3.26)."""
        return _INERTIA.contains(x) & (self.slacks(x) > 0).all(-1)

    def barrier(self, x: ArrayLike) -> Array:
        """h(x), [Lee2019] Eq. (5.3.27)."""
        return np.asarray(_INERTIA.barrier(x) - self.weight * np.log(self.slacks(x)).sum(-1))

    def gradient(self, x: ArrayLike) -> Array:
        """∇h(x), (..., 10)."""
        return np.asarray(_INERTIA.gradient(x) - self.weight * self._scaled(x).sum(-2))

    def metric(self, x: ArrayLike) -> Array:
        """g(x), (..., 10, 10), [Lee2019] Eq. (5.3.28)."""
        rows = self._scaled(x)
        return np.asarray(_INERTIA.metric(x) + self.weight * np.swapaxes(rows, -1, -2) @ rows)

    def frame(self, x: ArrayLike) -> Array:
        """That of the body, corrected for the constraints."""
        T = _INERTIA.frame(x)
        rows = self._scaled(x) @ T
        L = np.linalg.cholesky(np.eye(len(T)) + self.weight * rows.T @ rows)
        return np.asarray(T @ np.linalg.inv(L).T)

    def lift(self) -> Lift:
        """The body next to its slacks, as positive parameters."""
        m = len(self.offsets)
        return Lift(
            Product((_INERTIA, Positive(m)), (1.0, self.weight)),
            np.concatenate([np.eye(PARAMETERS_PER_BODY), self.normals]),
            np.concatenate([np.zeros(PARAMETERS_PER_BODY), -self.offsets]),
            np.arange(PARAMETERS_PER_BODY),
            np.concatenate([self.normals, -np.eye(m)], 1),
            self.offsets,
        )

    def inverse_metric_times(self, x: ArrayLike, b: ArrayLike) -> Array:
        """g(x)⁻¹ b by Woodbury's identity, [Lee2019] Eq. (B.4.21) without its factors 2.

        Only an m×m matrix is solved with.
        """
        x, b = np.asarray(x, float), np.asarray(b, float)
        rows = self._scaled(x)
        free = _INERTIA.inverse_metric_times(x, b)
        rows_free = _INERTIA.inverse_metric_times(x[..., None, :], rows)
        small = np.eye(len(self.offsets)) / self.weight + rows @ np.swapaxes(rows_free, -1, -2)
        pull = np.linalg.solve(small, (rows @ free[..., None]))
        return np.asarray(free - (np.swapaxes(rows_free, -1, -2) @ pull)[..., 0])

    def divergence(self, x: ArrayLike, y: ArrayLike) -> Array:
        """D(x‖y), [Lee2019] Eq. (5.3.29)."""
        difference = np.asarray(x, float) - np.asarray(y, float)
        terms = excess(difference @ self.normals.T / self.slacks(y))
        return np.asarray(_INERTIA.divergence(x, y) + self.weight * terms.sum(-1))

    def longest_step(self, x: ArrayLike, v: ArrayLike) -> Array:
        """The time (...) at which P(x + t v) becomes singular or a constraint binds."""
        rates = np.asarray(v, float) @ self.normals.T
        falling = rates < 0
        times = np.where(falling, self.slacks(x) / np.where(falling, -rates, 1.0), np.inf)
        return np.minimum(_INERTIA.longest_step(x, v), times.min(-1, initial=np.inf))

    def _well_inside(self, x: Array) -> NDArray[np.bool_]:
        return _INERTIA._well_inside(x) & (self.slacks(x) > 0).all(-1)

    def _scaled(self, x: ArrayLike) -> Array:
        """Rows aₖᵀ / (aₖᵀ x − bₖ), (..., m, 10)."""
        return np.asarray(self.normals / self.slacks(x)[..., None])
