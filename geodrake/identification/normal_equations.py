"""Small normal equations by the thousand: ridged, and factored once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrs

from geodrake.compiling import compiled, inlined
from geodrake.errors import IdentificationError
from geodrake.inertia import Array

Indices = NDArray[np.intp]

RIDGE = 1e-9
"""Addition to the diagonal of normal matrices that are scaled to have ones there. It keeps
columns that say the same (a friction and its asymmetric form) from making them singular."""


def cholesky(matrices: Array, ridge: float = RIDGE) -> Array:
    """Return lower Cholesky factors of symmetric matrices (..., n, n) of unit diagonal, ridged."""
    try:
        factors = np.linalg.cholesky(matrices + ridge * np.eye(matrices.shape[-1]))
    except np.linalg.LinAlgError:
        factors = np.array(np.nan)
    if not np.isfinite(factors).all():
        raise not_held()
    return np.asarray(factors)


def not_held() -> IdentificationError:
    """Return the error of a fit whose normal matrix is not positive definite."""
    return IdentificationError(
        "Some parameters have neither data nor a prior: the normal matrix of the fit is not "
        "positive definite.",
        advice="Use logs with more motion, or the model file instead of a saved model.",
    )


def scaled_cholesky(matrices: Array, ridge: float = RIDGE) -> tuple[Array, Array]:
    """Return lower Cholesky factors L (..., n, n) and scales s (..., n) of symmetric matrices.

    L Lᵀ is the matrix times s from both sides, which has ones on its diagonal, and the ridge.
    """
    scale = 1.0 / np.sqrt(np.diagonal(matrices, axis1=-2, axis2=-1))
    return cholesky(matrices * scale[..., :, None] * scale[..., None, :], ridge), scale


@compiled
def calc_solution(A: Array, b: Array, ridge: float, groups: Indices) -> tuple[Array, float, Array]:
    """Return the solution (n,) of A x = b, scaled and ridged as above, log |A|, and a factor.

    Unknowns of different `groups` (n,) have no products with each other, which saves most of the
    work. Those of group −1 have some with all. The factor L of A = L Lᵀ has them last, and those of
    each group together.
    """
    n, first = len(b), int(np.sum(groups >= 0))
    order = np.argsort(np.where(groups < 0, n, groups), kind="mergesort")
    scale, x, factor = np.empty(n), np.empty(n), np.empty((n, n))
    for i in range(n):
        scale[i] = A[order[i], order[i]] ** -0.5
        x[i] = scale[i] * b[order[i]]
        row = A[order[i]]
        for k in range(i):
            factor[i, k] = row[order[k]] * scale[i] * scale[k]
        factor[i, i] = 1.0 + ridge
    low, logarithm = 0, 0.0
    while low < first:
        high = low + int(np.sum(groups == groups[order[low]]))
        _eliminate(factor, low, high, first)
        low = high
    factor[first:, first:] = np.linalg.cholesky(factor[first:, first:].copy())
    for i in range(n):
        x[i] = (x[i] - factor[i, :i] @ x[:i]) / factor[i, i]
        logarithm += 2.0 * np.log(factor[i, i] / scale[i])
    for i in range(n - 1, -1, -1):
        x[i] /= factor[i, i]
        for k in range(i):
            x[k] -= factor[i, k] * x[i]
        back = 1.0 / scale[i]
        for k in range(i + 1):
            factor[i, k] *= back
    found = np.empty(n)
    found[order] = scale * x
    return found, logarithm, factor


@inlined
def _eliminate(factor: Array, low: int, high: int, first: int) -> None:
    """Factor columns from `low` to `high` in place, and take them out of those from `first` on."""
    felt, count = np.empty(len(factor) - first, np.intp), 0
    for i in range(first, len(factor)):
        for k in range(low, high):
            if factor[i, k] != 0.0:
                felt[count] = i
                count += 1
                break
    root = np.linalg.cholesky(factor[low:high, low:high].copy())
    factor[low:high, low:high] = root
    if count:
        felt = felt[:count]
        rows = np.linalg.solve(root, np.ascontiguousarray(factor[felt, low:high].T))
        squares = rows.T @ rows
        for i in range(count):
            factor[felt[i], low:high] = rows[:, i]
            for k in range(i + 1):
                factor[felt[i], felt[k]] -= squares[i, k]


def solved(factor: Array, right: Array) -> Array:
    """Return solutions of right sides (n,) or (n, m), by the (n, n) that `cholesky` gave."""
    return np.asarray(dpotrs(factor.T, right)[0]) if len(right) else right
