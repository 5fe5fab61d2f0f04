"""Parameter spaces with one metric everywhere, where adaptation laws have a constant gain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.errors import ArgumentError
from geodrake.manifolds import Manifold
from geodrake.manifolds.base import Array
from geodrake.manifolds.mirror import MirrorLine

_ASYMMETRY = 1e-9


@dataclass(frozen=True, eq=False)
class ConstantMetric(Manifold):
    """ℝⁿ with h = ½ xᵀ Γ x: no bounds, straight geodesics and D(x‖y) = ½ (x − y)ᵀ Γ (x − y).

    Attributes:
        matrix: (n, n) symmetric positive definite Γ.
        inverse: (n, n) its inverse.
    """

    matrix: Array
    inverse: Array

    def __post_init__(self) -> None:
        matrix, inverse = np.asarray(self.matrix, float), np.asarray(self.inverse, float)
        n = len(matrix)
        if not (n and matrix.shape == inverse.shape == (n, n)):
            raise ArgumentError(
                f"A metric and its inverse are both (n, n); got {matrix.shape}, {inverse.shape}."
            )
        # Units of parameters differ by orders of magnitude: judged on a unit diagonal.
        diagonal = np.diagonal(matrix)
        if not (np.isfinite(matrix).all() and (diagonal > 0).all()):
            raise ArgumentError(f"A metric has a positive diagonal; got {diagonal.tolist()}.")
        scaled = matrix / np.sqrt(diagonal[:, None] * diagonal)
        if np.abs(scaled - scaled.T).max() > _ASYMMETRY or np.linalg.eigvalsh(scaled)[0] <= 0:
            raise ArgumentError("A metric is symmetric and positive definite; this one is not.")
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "inverse", inverse)

    @classmethod
    def of(cls, manifold: Manifold, x: ArrayLike) -> ConstantMetric:
        """The metric of another manifold at one of its points x (n,), used everywhere.

        The inverse comes from the manifold too, so that it is as precise as there.
        """
        x = np.asarray(x, float)
        inverse = manifold.inverse_metric_times(x, np.eye(manifold.dimension))
        return cls(manifold.metric(x), 0.5 * (inverse + inverse.T))

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return len(self.matrix)

    def contains(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Whether x is finite (...)."""
        return np.isfinite(np.asarray(x, float)).all(-1)

    def barrier(self, x: ArrayLike) -> Array:
        """½ xᵀ Γ x."""
        x = np.asarray(x, float)
        return np.asarray(0.5 * (x * (x @ self.matrix)).sum(-1))

    def gradient(self, x: ArrayLike) -> Array:
        """Γ x, (..., n)."""
        return np.asarray(np.asarray(x, float) @ self.matrix)

    def metric(self, x: ArrayLike) -> Array:
        """Γ, (..., n, n)."""
        return np.broadcast_to(self.matrix, (*np.shape(x)[:-1], *self.matrix.shape)).copy()

    def inverse_metric_times(self, x: ArrayLike, b: ArrayLike) -> Array:
        """Γ⁻¹ b, whatever x is."""
        return np.asarray(np.asarray(b, float) @ self.inverse)

    def divergence(self, x: ArrayLike, y: ArrayLike) -> Array:
        """½ (x − y)ᵀ Γ (x − y)."""
        return self.barrier(np.asarray(x, float) - np.asarray(y, float))

    def longest_step(self, x: ArrayLike, v: ArrayLike) -> Array:
        """Infinite."""
        return np.full(np.broadcast_shapes(np.shape(x), np.shape(v))[:-1], np.inf)

    def mirror_line(self, x: ArrayLike, b: ArrayLike) -> MirrorLine:
        """The straight line x + t Γ⁻¹ b."""
        x, b = np.asarray(x, float), np.asarray(b, float)
        v = self.inverse_metric_times(x, b)
        start, slope = float(b @ x), float(b @ v)
        return MirrorLine(
            lambda t: x + t * v, lambda t: start + t * slope, np.inf, 1.0 / np.sqrt(slope)
        )

    def retract(self, x: ArrayLike, v: ArrayLike) -> Array:
        """The straight line x + v."""
        return np.asarray(x, float) + np.asarray(v, float)
