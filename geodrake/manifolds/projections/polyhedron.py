"""Half-spaces, affine sets, slabs and polyhedra."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import Sizes, number, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.manifolds.base import Array


@dataclass(frozen=True, eq=False)
class Polyhedron(Short):
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
        sizes: Sizes = {}
        matrix = real_array(self.matrix, "matrix", ("k", "n"), sizes)
        lower = real_array(self.lower, "lower", ("k",), sizes, finite=False)
        upper = real_array(self.upper, "upper", ("k",), sizes, finite=False)
        if not ((lower <= upper) & (lower < np.inf) & (upper > -np.inf)).all():
            raise ArgumentError(
                "Expected lower values that do not exceed the upper ones, with something between; "
                f"got lower {lower.tolist()}, upper {upper.tolist()}."
            )
        for name, value in (("matrix", matrix), ("lower", lower), ("upper", upper)):
            object.__setattr__(self, name, value)

    def violation(self, y: ArrayLike) -> Array:
        """(k,) how far each row is outside of its limits at y (n,)."""
        value = self.matrix @ real_array(y, "y", (self.matrix.shape[1],))
        return np.maximum(0.0, np.maximum(self.lower - value, value - self.upper))


def halfspace(a: ArrayLike, b: float) -> Polyhedron:
    """The points y with aᵀ y ≥ b, for a (n,).

    Args:
        a: (n,) normal, pointing inside.
    """
    return slab(a, number(b, "b"), np.inf)


def affine_set(A: ArrayLike, b: ArrayLike) -> Polyhedron:
    """The points y with A y = b, for A (k, n) and b (k,).

    Args:
        A: (k, n) rows, or (n,) a single one.
        b: (k,) values of A y, or one number.
    """
    A, b = np.atleast_2d(real_array(A, "A")), np.atleast_1d(real_array(b, "b"))
    return Polyhedron(A, b, b)


def slab(a: ArrayLike, lower: float, upper: float) -> Polyhedron:
    """The points y with lower ≤ aᵀ y ≤ upper, for a (n,).

    Args:
        a: (n,) normal.
        lower: Least value of aᵀ y; −inf for none.
        upper: Greatest value of aᵀ y; inf for none.
    """
    limits = (number(lower, "lower", finite=False), number(upper, "upper", finite=False))
    return Polyhedron(real_array(a, "a", ("n",))[None], *(np.array([limit]) for limit in limits))
