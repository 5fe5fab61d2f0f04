"""Inertial parameters of a body with linear constraints, such as an enclosing ellipsoid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import Sizes, positive, real_array
from geodrake.boundary.showing import Short
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.manifolds.base import Array, Manifold, excess
from geodrake.manifolds.inertia import PhysicalInertia

_INERTIA = PhysicalInertia()


@dataclass(frozen=True, eq=False)
class ConstrainedInertia(Manifold, Short):
    """Inertial parameters φ with P(φ) ≻ 0 and aₖᵀ φ > bₖ for m constraints.

    h = −log det P(φ) − α Σ log(aₖᵀ φ − bₖ), [Lee2019] Eq. (5.3.27). α is dimensionless, as h does
    not depend on the scale of a constraint.

    Attributes:
        normals: (m, 10) rows aₖᵀ, such as `geodrake.inertia.ellipsoids.realizability_row`.
        offsets: (m,) values bₖ.
        weight: α > 0.
    """

    normals: Array
    offsets: Array
    weight: float = 1.0

    def __post_init__(self) -> None:
        sizes: Sizes = {}
        normals = real_array(self.normals, "normals", ("m", PARAMETERS_PER_BODY), sizes)
        offsets = real_array(self.offsets, "offsets", ("m",), sizes)
        positive(self.weight, "weight")
        object.__setattr__(self, "normals", normals)
        object.__setattr__(self, "offsets", offsets)

    @property
    def dimension(self) -> int:
        """Ten."""
        return PARAMETERS_PER_BODY

    @property
    def least_weight(self) -> float:
        """Return min(α, 1)."""
        return min(1.0, self.weight)

    def slacks(self, x: ArrayLike) -> Array:
        """Return the slacks aₖᵀ x − bₖ (..., m) of the constraints."""
        return self.calc_slacks(real_array(x, "x", ("...", PARAMETERS_PER_BODY)))

    def calc_slacks(self, x: Array) -> Array:
        """Kernel of `slacks`."""
        return np.asarray(x @ self.normals.T - self.offsets)

    def calc_contains(self, x: Array) -> NDArray[np.bool_]:
        """Return whether P(x) ≻ 0 and all constraints hold (...), [Lee2019] Eq. (5.3.26)."""
        finite = np.asarray(np.isfinite(x).all(-1))
        slacks = self.calc_slacks(np.where(finite[..., None], x, 0.0))
        return np.asarray(_INERTIA.calc_contains(x) & (slacks > 0).all(-1))

    def calc_barrier(self, x: Array) -> Array:
        """Return h(x), [Lee2019] Eq. (5.3.27)."""
        return np.asarray(
            _INERTIA.calc_barrier(x) - self.weight * np.log(self.calc_slacks(x)).sum(-1)
        )

    def calc_gradient(self, x: Array) -> Array:
        """Return ∇h(x), (..., 10)."""
        return np.asarray(_INERTIA.calc_gradient(x) - self.weight * self._scaled(x).sum(-2))

    def calc_metric(self, x: Array) -> Array:
        """Return g(x), (..., 10, 10), [Lee2019] Eq. (5.3.28)."""
        rows = self._scaled(x)
        return np.asarray(_INERTIA.calc_metric(x) + self.weight * np.swapaxes(rows, -1, -2) @ rows)

    def calc_frame(self, x: Array) -> Array:
        """Return the frame of the body, corrected for the constraints."""
        T = _INERTIA.calc_frame(x)
        rows = self._scaled(x) @ T
        L = np.linalg.cholesky(np.eye(len(T)) + self.weight * rows.T @ rows)
        return np.asarray(T @ np.linalg.inv(L).T)

    def calc_inverse_metric_times(self, x: Array, b: Array) -> Array:
        """Return g(x)⁻¹ b by Woodbury's identity, [Lee2019] Eq. (B.4.21) without its factors 2."""
        rows = self._scaled(x)
        free = _INERTIA.calc_inverse_metric_times(x, b)
        rows_free = _INERTIA.calc_inverse_metric_times(x[..., None, :], rows)
        small = np.eye(len(self.offsets)) / self.weight + rows @ np.swapaxes(rows_free, -1, -2)
        pull = np.linalg.solve(small, (rows @ free[..., None]))
        return np.asarray(free - (np.swapaxes(rows_free, -1, -2) @ pull)[..., 0])

    def calc_divergence(self, x: Array, y: Array) -> Array:
        """Return D(x‖y), [Lee2019] Eq. (5.3.29)."""
        difference = x - y
        terms = excess(difference @ self.normals.T / self.calc_slacks(y))
        return np.asarray(_INERTIA.calc_divergence(x, y) + self.weight * terms.sum(-1))

    def calc_longest_step(self, x: Array, v: Array) -> Array:
        """Return the time (...) at which P(x + t v) becomes singular or a constraint binds."""
        rates = v @ self.normals.T
        falling = rates < 0
        times = np.where(falling, self.calc_slacks(x) / np.where(falling, -rates, 1.0), np.inf)
        return np.minimum(_INERTIA.calc_longest_step(x, v), times.min(-1, initial=np.inf))

    def _well_inside(self, x: Array) -> NDArray[np.bool_]:
        return _INERTIA._well_inside(x) & (self.calc_slacks(x) > 0).all(-1)

    def _scaled(self, x: Array) -> Array:
        """Return rows aₖᵀ / (aₖᵀ x − bₖ), (..., m, 10)."""
        return np.asarray(self.normals / self.calc_slacks(x)[..., None])
