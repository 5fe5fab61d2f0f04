"""Parameter spaces with one metric everywhere, where adaptation laws have a constant gain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import Sizes, instance, positive_definite, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.manifolds import Manifold
from geodrake.manifolds.base import Array
from geodrake.manifolds.mirror import MirrorLine, scale_of

_NOT_INVERSE = 1e-3  # error of the product of a matrix and its inverse, on a unit diagonal


@dataclass(frozen=True, eq=False)
class ConstantMetric(Manifold, Short):
    """ℝⁿ with h = ½ xᵀ Γ x: no bounds, straight geodesics and D(x‖y) = ½ (x − y)ᵀ Γ (x − y).

    Attributes:
        matrix: (n, n) symmetric positive definite Γ.
    """

    matrix: Array
    inverse: Array

    def __post_init__(self) -> None:
        sizes: Sizes = {}
        matrix = positive_definite(self.matrix, "matrix", ("n", "n"), sizes)
        inverse = real_array(self.inverse, "inverse", ("n", "n"), sizes)
        scale = np.sqrt(np.diagonal(matrix))
        off = (matrix @ inverse) / scale[:, None] * scale - np.eye(len(matrix))
        if np.abs(off).max(initial=0.0) > _NOT_INVERSE:
            raise ArgumentError(
                f"inverse must be that of matrix; their product is {np.abs(off).max():.2g} off the "
                "identity."
            )
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "inverse", inverse)

    @classmethod
    def of(cls, manifold: Manifold, x: ArrayLike) -> ConstantMetric:
        """Return the metric of another manifold at one of its points x (n,), used everywhere.

        The inverse comes from the manifold too, so that it is as precise as there.
        """
        x = real_array(x, "x", (instance(manifold, "manifold", Manifold).dimension,))
        inverse = manifold.inverse_metric_times(x, np.eye(manifold.dimension))
        return cls(manifold.metric(x), 0.5 * (inverse + inverse.T))

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return len(self.matrix)

    def calc_contains(self, x: Array) -> NDArray[np.bool_]:
        """Return whether x is finite (...)."""
        return np.asarray(np.isfinite(x).all(-1))

    def calc_barrier(self, x: Array) -> Array:
        """Return ½ xᵀ Γ x."""
        return np.asarray(0.5 * (x * (x @ self.matrix)).sum(-1))

    def calc_gradient(self, x: Array) -> Array:
        """Return Γ x, (..., n)."""
        return np.asarray(x @ self.matrix)

    def calc_metric(self, x: Array) -> Array:
        """Return Γ, (..., n, n)."""
        return np.broadcast_to(self.matrix, (*np.shape(x)[:-1], *self.matrix.shape)).copy()

    def calc_inverse_metric_times(self, x: Array, b: Array) -> Array:
        """Return Γ⁻¹ b, whatever x is."""
        return np.asarray(b @ self.inverse)

    def calc_divergence(self, x: Array, y: Array) -> Array:
        """Return ½ (x − y)ᵀ Γ (x − y)."""
        return self.calc_barrier(x - y)

    def calc_longest_step(self, x: Array, v: Array) -> Array:
        """Return infinity."""
        return np.full(np.broadcast_shapes(np.shape(x), np.shape(v))[:-1], np.inf)

    def calc_mirror_line(self, x: Array, b: Array) -> MirrorLine:
        """Return the straight line x + t Γ⁻¹ b."""
        v = self.calc_inverse_metric_times(x, b)
        start, slope = float(np.vdot(b, x)), float(np.vdot(b, v))
        return MirrorLine(
            lambda t: x + t * v, lambda t: start + t * slope, np.inf, scale_of(np.sqrt(slope))
        )

    def calc_retract(self, x: Array, v: Array) -> Array:
        """Return x + v."""
        return x + v
