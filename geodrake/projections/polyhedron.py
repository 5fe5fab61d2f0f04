"""Half-spaces, affine sets, slabs and polyhedra."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.errors import ArgumentError
from geodrake.manifolds.base import Array


@dataclass(frozen=True, eq=False)
class Polyhedron:
    """The points y with lower ≤ matrix y ≤ upper.

    Attributes:
        matrix: (k, n) coefficients.
        lower: (k,) least values; −inf for none.
        upper: (k,) greatest values; inf for none, and the same as `lower` for an equation.
    """

    matrix: Array
    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        matrix = np.asarray(self.matrix, float)
        lower, upper = np.asarray(self.lower, float), np.asarray(self.upper, float)
        if matrix.ndim != 2 or not lower.shape == upper.shape == matrix.shape[:1]:
            raise ArgumentError(
                f"Expected a matrix (k, n) with lower and upper values (k,); got {matrix.shape}, "
                f"{lower.shape} and {upper.shape}."
            )
        if not (np.isfinite(matrix).all() and (lower <= upper).all()):
            raise ArgumentError(
                "Expected finite coefficients, and lower values that do not exceed the upper ones; "
                f"got matrix {matrix.tolist()}, lower {lower.tolist()}, upper {upper.tolist()}."
            )
        for name, value in (("matrix", matrix), ("lower", lower), ("upper", upper)):
            object.__setattr__(self, name, value)

    def violation(self, y: ArrayLike) -> Array:
        """(k,) how far each row is outside of its limits at y (n,)."""
        value = self.matrix @ np.asarray(y, float)
        return np.maximum(0.0, np.maximum(self.lower - value, value - self.upper))


def halfspace(a: ArrayLike, b: float) -> Polyhedron:
    """The points y with aᵀ y ≥ b, for a (n,)."""
    return Polyhedron(np.atleast_2d(np.asarray(a, float)), np.array([b]), np.array([np.inf]))


def affine_set(A: ArrayLike, b: ArrayLike) -> Polyhedron:
    """The points y with A y = b, for A (k, n) and b (k,)."""
    A, b = np.atleast_2d(np.asarray(A, float)), np.atleast_1d(np.asarray(b, float))
    return Polyhedron(A, b, b)


def slab(a: ArrayLike, lower: float, upper: float) -> Polyhedron:
    """The points y with lower ≤ aᵀ y ≤ upper, for a (n,)."""
    return Polyhedron(np.atleast_2d(np.asarray(a, float)), np.array([lower]), np.array([upper]))
