"""Normal equations of logs whose parameters scatter from log to log."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def calc_marginal(information: Array, right: Array, factor: Array) -> tuple[Array, Array]:
    """Normal equations of the mean x̄, where each log has parameters x̄ + u, u ~ N(0, F Fᵀ).

    M = (H⁻¹ + F Fᵀ)⁻¹ and m = (𝟙 + H F Fᵀ)⁻¹ s, which exist for singular H too.

    Args:
        information: (..., p, p) normal matrices H.
        right: (..., p) right sides s.
        factor: (p, r) or (..., p, r) factor F of the scatter's covariance.

    Returns:
        (..., p, p) matrices M, and (..., p) right sides m.
    """
    seen = information @ factor
    inner = np.swapaxes(seen, -1, -2) @ factor + np.eye(factor.shape[-1])
    both = np.concatenate([seen, right[..., None, :] @ factor], axis=-2)
    half = np.linalg.solve(np.linalg.cholesky(inner), np.swapaxes(both, -1, -2))
    left, side = half[..., :-1], half[..., -1]
    shared = np.swapaxes(left, -1, -2)
    return information - shared @ left, right - (shared @ side[..., None])[..., 0]
