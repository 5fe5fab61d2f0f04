"""Maps of inertial parameters behind the doors: they trust their arrays, whatever the values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PARAMETERS_PER_BODY = 10

_IDENTITY = np.eye(3)


def calc_rotational_inertia(phi: Array) -> Array:
    """I (..., 3, 3) of φ (..., 10)."""
    xx, yy, zz, xy, yz, zx = np.moveaxis(phi[..., 4:], -1, 0)
    rows = [np.stack(row, -1) for row in ((xx, xy, zx), (xy, yy, yz), (zx, yz, zz))]
    return np.stack(rows, -2)


def calc_pseudo_inertia(phi: Array) -> Array:
    """P(φ) (..., 4, 4) of φ (..., 10)."""
    inertia = calc_rotational_inertia(phi)
    half_trace = 0.5 * np.trace(inertia, axis1=-2, axis2=-1)
    matrix = np.empty((*phi.shape[:-1], 4, 4))
    matrix[..., :3, :3] = half_trace[..., None, None] * _IDENTITY - inertia
    matrix[..., :3, 3] = matrix[..., 3, :3] = phi[..., 1:4]
    matrix[..., 3, 3] = phi[..., 0]
    return matrix


def calc_from_pseudo_inertia(matrix: Array) -> Array:
    """φ (..., 10) of P(φ) (..., 4, 4)."""
    second_moment = matrix[..., :3, :3]
    trace = np.trace(second_moment, axis1=-2, axis2=-1)[..., None]
    diagonal = trace - np.diagonal(second_moment, axis1=-2, axis2=-1)
    products = [-second_moment[..., i, j] for i, j in ((0, 1), (1, 2), (2, 0))]
    return np.concatenate(
        [matrix[..., 3:, 3], matrix[..., :3, 3], diagonal, np.stack(products, -1)], -1
    )


BASIS = calc_pseudo_inertia(np.eye(PARAMETERS_PER_BODY))
DUAL_BASIS = np.einsum("ij,jab->iab", np.linalg.inv(np.einsum("iab,jab->ij", BASIS, BASIS)), BASIS)


def calc_dual(covector: Array) -> Array:
    """X(a) (..., 4, 4) of a (..., 10)."""
    return np.asarray(np.einsum("...i,iab->...ab", covector, DUAL_BASIS))
