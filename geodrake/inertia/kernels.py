"""Maps of inertial parameters without argument checks, for internal use."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PARAMETERS_PER_BODY = 10

_IDENTITY = np.eye(3)


def _bases() -> tuple[Array, Array]:
    """Return the matrices P(eᵢ) and X(eᵢ), (10, 4, 4) each, with tr(P(φ) X(a)) = aᵀφ."""
    P, X = np.zeros((2, PARAMETERS_PER_BODY, 4, 4))
    P[0, 3, 3] = X[0, 3, 3] = 1.0
    for k in range(3):
        following, last = (k + 1) % 3, (k + 2) % 3
        P[1 + k, [k, 3], [3, k]], X[1 + k, [k, 3], [3, k]] = 1.0, 0.5
        P[4 + k, [k, following, last], [k, following, last]] = -0.5, 0.5, 0.5
        X[4 + k, [following, last], [following, last]] = 1.0
        P[7 + k, [k, following], [following, k]], X[7 + k, [k, following], [following, k]] = (
            -1,
            -0.5,
        )
    return P, X


BASIS, DUAL_BASIS = _bases()
_TO_MATRIX, _TO_DUAL = (basis.reshape(PARAMETERS_PER_BODY, 16) for basis in (BASIS, DUAL_BASIS))


def calc_rotational_inertia(phi: Array) -> Array:
    """Return I (..., 3, 3) of φ (..., 10)."""
    return np.asarray(phi[..., [[4, 7, 9], [7, 5, 8], [9, 8, 6]]])


def calc_pseudo_inertia(phi: Array) -> Array:
    """Return P(φ) (..., 4, 4) of φ (..., 10)."""
    flat = phi.reshape(-1, PARAMETERS_PER_BODY) @ _TO_MATRIX
    return np.asarray(flat.reshape((*phi.shape[:-1], 4, 4)))


def calc_dual(covector: Array) -> Array:
    """Return X(a) (..., 4, 4) of a (..., 10)."""
    flat = covector.reshape(-1, PARAMETERS_PER_BODY) @ _TO_DUAL
    return np.asarray(flat.reshape((*covector.shape[:-1], 4, 4)))


def calc_from_pseudo_inertia(matrix: Array) -> Array:
    """Return φ (..., 10) of P(φ) (..., 4, 4)."""
    flat = matrix.reshape(-1, 16) @ _TO_DUAL.T
    return np.asarray(flat.reshape((*matrix.shape[:-2], PARAMETERS_PER_BODY)))


def calc_parallel_axis(mass: Array, com: Array) -> Array:
    """Return inertias m (pᵀp 1 − p pᵀ) (..., 3, 3) of point masses (...) at (..., 3)."""
    square = (com * com).sum(-1)[..., None, None] * _IDENTITY
    return np.asarray(mass[..., None, None] * (square - com[..., :, None] * com[..., None, :]))


def calc_from_mass_com_inertia(mass: Array, com: Array, inertia_com: Array) -> Array:
    """Return φ (..., 10) of masses (...), centres (..., 3) and central inertias (..., 3, 3)."""
    inertia = inertia_com + calc_parallel_axis(mass, com)
    moments = [inertia[..., i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))]
    return np.concatenate([mass[..., None], mass[..., None] * com, np.stack(moments, -1)], -1)


def calc_change_frame(phi: Array, R_AB: Array, p_AoBo_A: Array) -> Array:
    """Return φ (..., 10) about Ao in A from φ about Bo in B; see `change_frame`."""
    H_AB = np.zeros((*np.broadcast_shapes(R_AB.shape[:-2], p_AoBo_A.shape[:-1]), 4, 4))
    H_AB[..., :3, :3], H_AB[..., :3, 3], H_AB[..., 3, 3] = R_AB, p_AoBo_A, 1.0
    return calc_from_pseudo_inertia(H_AB @ calc_pseudo_inertia(phi) @ np.swapaxes(H_AB, -1, -2))
