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


SKEW = _cross_tensor().reshape(3, 9)
"""p @ SKEW is the 3×3 matrix of p ×, row after row."""

MOTION_CROSS = _motion_cross_tensor().reshape(6, 36)
"""V @ MOTION_CROSS is the 6×6 matrix of V × on motion vectors, row after row."""

INERTIA = spatial_inertia_matrix(np.eye(PARAMETERS_PER_BODY)).reshape(PARAMETERS_PER_BODY, 36)
"""φ @ INERTIA is the spatial inertia G(φ), row after row."""

MOMENTUM = INERTIA.reshape(-1, 6, 6).transpose(2, 1, 0).reshape(6, 60).copy()
"""V @ MOMENTUM is the 6×10 matrix that maps φ to the momentum G(φ) V, row after row."""

SWAP = np.array([3, 4, 5, 0, 1, 2])
"""Exchanges rotation and translation."""


def motion_cross(V: Array) -> Array:
    """The matrices (..., 6, 6) of V × on motion vectors, for V (..., 6)."""
    return (V @ MOTION_CROSS).reshape(*V.shape, 6)
