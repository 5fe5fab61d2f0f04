"""Vectors of three numbers for compiled loops, as tuples, which stay in registers."""

from __future__ import annotations

from typing import Any

from geodrake.compiling import inlined
from geodrake.inertia import Array

Vector = tuple[float, float, float]


@inlined
def vector(x: Array) -> Vector:
    """Return an array (3,) as a vector."""
    return x[0], x[1], x[2]


@inlined
def put(out: Array, x: Vector) -> None:
    """Write a vector into an array (3,)."""
    out[0], out[1], out[2] = x


@inlined
def row(array: Array, i: int, k: int) -> Vector:
    """Return the vector at (i, k) of an array (m, n, 3)."""
    return array[i, k, 0], array[i, k, 1], array[i, k, 2]


@inlined
def put_row(array: Array, i: int, k: int, x: Vector) -> None:
    """Write a vector to (i, k) of an array (m, n, 3)."""
    array[i, k, 0], array[i, k, 1], array[i, k, 2] = x


@inlined
def column(matrix: Array, k: int) -> Vector:
    """Return column k of a matrix (3, m)."""
    return matrix[0, k], matrix[1, k], matrix[2, k]


@inlined
def add(x: Vector, y: Vector) -> Vector:
    """Return the sum x + y."""
    return x[0] + y[0], x[1] + y[1], x[2] + y[2]


@inlined
def subtract(x: Vector, y: Vector) -> Vector:
    """Return the difference x − y."""
    return x[0] - y[0], x[1] - y[1], x[2] - y[2]


@inlined
def scale(factor: float, x: Vector) -> Vector:
    """Return a scalar times x."""
    return factor * x[0], factor * x[1], factor * x[2]


@inlined
def dot(x: Vector, y: Vector) -> float:
    """Return the inner product x · y."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@inlined
def cross(x: Vector, y: Vector) -> Vector:
    """Return the cross product x × y."""
    return x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]


@inlined
def times(R: Array, x: Vector) -> Vector:
    """Return R x for a matrix (3, 3)."""
    return (
        R[0, 0] * x[0] + R[0, 1] * x[1] + R[0, 2] * x[2],
        R[1, 0] * x[0] + R[1, 1] * x[1] + R[1, 2] * x[2],
        R[2, 0] * x[0] + R[2, 1] * x[1] + R[2, 2] * x[2],
    )


@inlined
def transposed_times(R: Array, x: Vector) -> Vector:
    """Return Rᵀ x for a matrix (3, 3)."""
    return (
        R[0, 0] * x[0] + R[1, 0] * x[1] + R[2, 0] * x[2],
        R[0, 1] * x[0] + R[1, 1] * x[1] + R[2, 1] * x[2],
        R[0, 2] * x[0] + R[1, 2] * x[1] + R[2, 2] * x[2],
    )


@inlined
def combination(columns: Array, factors: Array, n: int, span: Any) -> Vector:
    """Return Σ_k columns[:, k] factors[n, first + k] for arrays (3, m) and (N, ·).

    The span is (first, count).
    """
    x = y = z = 0.0
    for k in range(span[1]):
        factor = factors[n, span[0] + k]
        x += columns[0, k] * factor
        y += columns[1, k] * factor
        z += columns[2, k] * factor
    return x, y, z


@inlined
def inertia_times(phi: Array, b: int, x: Vector) -> Vector:
    """Return I x for body b of φ (nb, 10): m, h, Ixx, Iyy, Izz, Ixy, Iyz, Izx."""
    return (
        phi[b, 4] * x[0] + phi[b, 7] * x[1] + phi[b, 9] * x[2],
        phi[b, 7] * x[0] + phi[b, 5] * x[1] + phi[b, 8] * x[2],
        phi[b, 9] * x[0] + phi[b, 8] * x[1] + phi[b, 6] * x[2],
    )
