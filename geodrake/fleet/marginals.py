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
    inner = np.swapaxes(seen, -1, -2) @ factor
    inner[..., np.arange(inner.shape[-1]), np.arange(inner.shape[-1])] += 1.0
    both = np.concatenate([seen, right[..., None, :] @ factor], axis=-2)
    solved = np.linalg.solve(inner, np.swapaxes(both, -1, -2))
    taken = seen @ solved
    marginal = information - taken[..., :-1]
    # What rounding makes of a symmetric matrix.
    return 0.5 * (marginal + np.swapaxes(marginal, -1, -2)), right - taken[..., -1]
