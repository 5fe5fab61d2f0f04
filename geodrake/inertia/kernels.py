"""Maps of inertial parameters behind the doors: they trust their arrays, whatever the values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PARAMETERS_PER_BODY = 10

_IDENTITY = np.eye(3)
_AXES, _NEXT = np.arange(3), np.array([1, 2, 0])


def calc_rotational_inertia(phi: Array) -> Array:
    """I (..., 3, 3) of φ (..., 10)."""
    xx, yy, zz, xy, yz, zx = np.moveaxis(phi[..., 4:], -1, 0)
    rows = [np.stack(row, -1) for row in ((xx, xy, zx), (xy, yy, yz), (zx, yz, zz))]
    return np.stack(rows, -2)


def calc_pseudo_inertia(phi: Array) -> Array:
    """P(φ) (..., 4, 4) of φ (..., 10)."""
    moments = phi[..., 4:7]
    matrix = np.empty((*phi.shape[:-1], 4, 4))
    matrix[..., _AXES, _AXES] = 0.5 * moments.sum(-1, keepdims=True) - moments
    matrix[..., _AXES, _NEXT] = matrix[..., _NEXT, _AXES] = -phi[..., 7:]
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


def calc_from_mass_com_inertia(mass: Array, com: Array, inertia_com: Array) -> Array:
    """φ (..., 10) of masses (...), centres (..., 3) and central inertias (..., 3, 3)."""
    squared = (com * com).sum(-1)[..., None, None] * _IDENTITY - com[..., :, None] * com[
        ..., None, :
    ]
    inertia = inertia_com + mass[..., None, None] * squared
    moments = [inertia[..., i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))]
    return np.concatenate([mass[..., None], mass[..., None] * com, np.stack(moments, -1)], -1)


def calc_change_frame(phi: Array, R_AB: Array, p_AoBo_A: Array) -> Array:
    """φ (..., 10) about Ao in A of φ about Bo in B; see `change_frame`."""
    H_AB = np.zeros((*np.broadcast_shapes(R_AB.shape[:-2], p_AoBo_A.shape[:-1]), 4, 4))
    H_AB[..., :3, :3], H_AB[..., :3, 3], H_AB[..., 3, 3] = R_AB, p_AoBo_A, 1.0
    return calc_from_pseudo_inertia(H_AB @ calc_pseudo_inertia(phi) @ np.swapaxes(H_AB, -1, -2))
