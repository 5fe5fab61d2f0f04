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


def _basis() -> Array:
    """P (10, 4, 4) of the unit vectors e_i: P(φ) = Σ φ_i P(e_i)."""
    basis = np.zeros((PARAMETERS_PER_BODY, 4, 4))
    basis[0, 3, 3] = 1.0
    for i in range(3):
        basis[1 + i, i, 3] = basis[1 + i, 3, i] = 1.0
        basis[4 + i, :3, :3] = np.diag([-0.5 if k == i else 0.5 for k in range(3)])
        a, b = ((0, 1), (1, 2), (2, 0))[i]
        basis[7 + i, a, b] = basis[7 + i, b, a] = -1.0
    return basis


BASIS = _basis()
_FLAT = BASIS.reshape(PARAMETERS_PER_BODY, 16)


def calc_pseudo_inertia(phi: Array) -> Array:
    """P(φ) (..., 4, 4) of φ (..., 10)."""
    return np.asarray(phi @ _FLAT).reshape(*phi.shape[:-1], 4, 4)


def calc_from_pseudo_inertia(matrix: Array) -> Array:
    """φ (..., 10) of P(φ) (..., 4, 4)."""
    second_moment = matrix[..., :3, :3]
    trace = np.trace(second_moment, axis1=-2, axis2=-1)[..., None]
    diagonal = trace - np.diagonal(second_moment, axis1=-2, axis2=-1)
    products = [-second_moment[..., i, j] for i, j in ((0, 1), (1, 2), (2, 0))]
    return np.concatenate(
        [matrix[..., 3:, 3], matrix[..., :3, 3], diagonal, np.stack(products, -1)], -1
    )


DUAL_BASIS = np.einsum("ij,jab->iab", np.linalg.inv(np.einsum("iab,jab->ij", BASIS, BASIS)), BASIS)


def calc_dual(covector: Array) -> Array:
    """X(a) (..., 4, 4) of a (..., 10)."""
    return np.asarray(np.einsum("...i,iab->...ab", covector, DUAL_BASIS))


def calc_from_mass_com_inertia(mass: Array, com: Array, inertia_com: Array) -> Array:
    """φ (..., 10) of masses (...), centres (..., 3) and central inertias (..., 3, 3).

    Args:
        mass: (...) masses, kg.
        com: (..., 3) centres of mass p_BoBcm_B, m.
        inertia_com: (..., 3, 3) rotational inertias about the centres of mass, expressed in B,
            kg·m².
    """
    squared = (com * com).sum(-1)[..., None, None] * _IDENTITY - com[..., :, None] * com[
        ..., None, :
    ]
    inertia = inertia_com + mass[..., None, None] * squared
    moments = [inertia[..., i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))]
    return np.concatenate([mass[..., None], mass[..., None] * com, np.stack(moments, -1)], -1)


def calc_change_frame(phi: Array, R_AB: Array, p_AoBo_A: Array) -> Array:
    """φ (..., 10) about Ao in A of φ about Bo in B.

    Args:
        phi: (..., 10) inertial parameters about Bo, expressed in B.
        R_AB: (..., 3, 3) rotations of B in A.
        p_AoBo_A: (..., 3) positions of Bo from Ao, expressed in A, m.
    """
    H_AB = np.zeros((*np.broadcast_shapes(R_AB.shape[:-2], p_AoBo_A.shape[:-1]), 4, 4))
    H_AB[..., :3, :3], H_AB[..., :3, 3], H_AB[..., 3, 3] = R_AB, p_AoBo_A, 1.0
    return calc_from_pseudo_inertia(H_AB @ calc_pseudo_inertia(phi) @ np.swapaxes(H_AB, -1, -2))
