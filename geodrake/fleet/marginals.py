"""Normal equations of logs whose parameters scatter from log to log."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


def calc_marginal(
    information: Array, right: Array, factor: Array, columns: Indices | None = None
) -> tuple[Array, Array]:
    """Normal equations of the mean x̄, where each log has parameters x̄ + u, u ~ N(0, F Fᵀ).

    M = (H⁻¹ + F Fᵀ)⁻¹ and m = (𝟙 + H F Fᵀ)⁻¹ s, which exist for singular H too.

    Args:
        information: (..., p, p) normal matrices H.
        right: (..., p) right sides s.
        factor: (p, r) or (..., p, r) factor F of the scatter's covariance.
        columns: (c,) which columns of M and elements of m are asked for; all if None.

    Returns:
        (..., p, c) columns of matrices M, and (..., c) right sides m.
    """
    columns = np.arange(right.shape[-1]) if columns is None else columns
    seen = information @ factor
    inner = np.swapaxes(seen, -1, -2) @ factor
    inner[..., np.arange(inner.shape[-1]), np.arange(inner.shape[-1])] += 1.0
    rows = np.concatenate([seen[..., columns, :], right[..., None, :] @ factor], axis=-2)
    solved = np.linalg.solve(inner, np.swapaxes(rows, -1, -2))
    marginal = information[..., columns] - seen @ solved[..., :-1]
    return marginal, right[..., columns] - (seen[..., columns, :] @ solved[..., -1:])[..., 0]


def narrow_factor(factor: Array) -> Array:
    """Factors (..., p, min(p, r)) of the covariances F Fᵀ of wider ones.

    Args:
        factor: (..., p, r) factors F.
    """
    if factor.shape[-1] <= factor.shape[-2]:
        return factor
    return np.swapaxes(np.linalg.qr(np.swapaxes(factor, -1, -2), "r"), -1, -2)
