"""Constant tensors of spatial algebra: vectors (rotation, translation), bilinear products as gemm.

A spatial velocity is V = (ω, v), a wrench F = (n, f), both about one point and in one frame.
"""

from __future__ import annotations

import numpy as np

from geodrake.inertia import PARAMETERS_PER_BODY, Array, spatial_inertia_matrix


def _cross_tensor() -> Array:
    """(3, 3, 3) tensor with (a × b)_i = Σ_jk a_k T[k, i, j] b_j."""
    tensor = np.zeros((3, 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        tensor[j, i, k], tensor[k, i, j] = 1.0, -1.0
    return tensor


def _motion_cross_tensor() -> Array:
    """(6, 6, 6) tensor with (V × U)_i = Σ V_k T[k, i, j] U_j, U the motion vector moved along V."""
    tensor = np.zeros((6, 6, 6))
    tensor[:3, :3, :3] = tensor[:3, 3:, 3:] = tensor[3:, 3:, :3] = _cross_tensor()
    return tensor


_SKEW = _cross_tensor().reshape(3, 9)

MOTION_CROSS = _motion_cross_tensor().reshape(6, 36)
"""V @ MOTION_CROSS is the 6×6 matrix of V × on motion vectors, row after row."""

INERTIA = spatial_inertia_matrix(np.eye(PARAMETERS_PER_BODY)).reshape(PARAMETERS_PER_BODY, 36)
"""φ @ INERTIA is the spatial inertia G(φ), row after row."""

MOMENTUM = INERTIA.reshape(-1, 6, 6).transpose(2, 0, 1).reshape(6, 60).copy()
"""V @ MOMENTUM is the 10×6 matrix X with the momentum φᵀ X = G(φ) V, row after row."""

SWAP = np.array([3, 4, 5, 0, 1, 2])
"""Exchanges rotation and translation."""


def motion_cross(V: Array) -> Array:
    """The matrices (..., 6, 6) of V × on motion vectors, for V (..., 6)."""
    return (V @ MOTION_CROSS).reshape(*V.shape, 6)


def skew(p: Array) -> Array:
    """The matrices (..., 3, 3) of p ×, for p (..., 3)."""
    return (p @ _SKEW).reshape(*p.shape, 3)


def motion_transform(R: Array, p: Array) -> Array:
    """The matrix (6, 6) that takes motions about Ao in A to Bo in B, B at R (3, 3), p (3,) in A.

    Args:
        R: (3, 3) rotation R_AB.
        p: (3,) position p_AoBo_A, m.
    """
    X = np.zeros((6, 6))
    X[:3, :3] = X[3:, 3:] = R.T
    X[3:, :3] = -R.T @ skew(p)
    return X


def _slotine_li_tensor() -> Array:
    """(42, 60) tensor behind SLOTINE_LI."""
    tensor = np.empty((42, PARAMETERS_PER_BODY, 6))
    momenta = MOMENTUM.reshape(6, PARAMETERS_PER_BODY, 6)
    tensor[:6] = momenta
    crosses = MOTION_CROSS.reshape(6, 6, 6)
    for i, U_cross in enumerate(crosses):
        for j, V_cross in enumerate(crosses):
            # V ×* = −(V ×)ᵀ, and momenta are rows here.
            turned = np.tensordot(V_cross[:, i], momenta, 1)
            tensor[6 + 6 * i + j] = -0.5 * (turned + momenta[i] @ V_cross + momenta[j] @ U_cross)
    return tensor.reshape(42, 60)


SLOTINE_LI = _slotine_li_tensor()
"""[A, U ⊗ V] @ SLOTINE_LI is the 10×6 matrix X, row after row, with φᵀ X the wrench

    F = G A' + ½ (V ×* G U + U ×* G V),   A' = A − ½ V × U.
"""
