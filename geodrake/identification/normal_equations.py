"""Fast solutions of many small normal equations, with a ridge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrs

from geodrake.compiling import compiled, inlined
from geodrake.errors import IdentificationError
from geodrake.inertia import Array

Indices = NDArray[np.intp]

RIDGE = 1e-9
"""Ridge of normal matrices with unit diagonal. It keeps them regular with redundant columns, such
as a friction and its asymmetric form."""


def cholesky(matrices: Array, ridge: float = RIDGE) -> Array:
    """Return lower Cholesky factors of matrices (..., n, n) of unit diagonal plus the ridge."""
    try:
        factors = np.linalg.cholesky(matrices + ridge * np.eye(matrices.shape[-1]))
    except np.linalg.LinAlgError:
        factors = np.array(np.nan)
    if not np.isfinite(factors).all():
        raise singular_error()
    return np.asarray(factors)


def singular_error() -> IdentificationError:
    """Return the error of a fit whose normal matrix is not positive definite."""
    return IdentificationError(
        "Some parameters have neither data nor a prior: the normal matrix of the fit is not "
        "positive definite.",
        advice="Use logs with more motion, or the model file instead of a saved model.",
    )


def scaled_cholesky(matrices: Array, ridge: float = RIDGE) -> tuple[Array, Array]:
    """Return lower Cholesky factors L (..., n, n) and scales s (..., n) of symmetric matrices.

    L Lᵀ = diag(s) A diag(s) + ridge 𝟙, with a unit diagonal of the first term.
    """
    scale = 1.0 / np.sqrt(np.diagonal(matrices, axis1=-2, axis2=-1))
    return cholesky(matrices * scale[..., :, None] * scale[..., None, :], ridge), scale


@compiled
def calc_solution(A: Array, b: Array, ridge: float, groups: Indices) -> tuple[Array, float, Array]:
    """Return the solution (n,) of A x = b, scaled and ridged, log |A|, and a factor.

    Unknowns of different `groups` (n,) do not interact, which saves most of the work; those of
    group −1 interact with all. The factor L of A = L Lᵀ has the unknowns sorted by group, with
    group −1 last.
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
    solution = np.empty(n)
    solution[order] = scale * x
    return solution, logarithm, factor


@inlined
def _eliminate(factor: Array, low: int, high: int, first: int) -> None:
    """Factor columns `low` to `high` in place, and eliminate them from those from `first` on."""
    coupled, count = np.empty(len(factor) - first, np.intp), 0
    for i in range(first, len(factor)):
        for k in range(low, high):
            if factor[i, k] != 0.0:
                coupled[count] = i
                count += 1
                break
    root = np.linalg.cholesky(factor[low:high, low:high].copy())
    factor[low:high, low:high] = root
    if count:
        coupled = coupled[:count]
        rows = np.linalg.solve(root, np.ascontiguousarray(factor[coupled, low:high].T))
        squares = rows.T @ rows
        for i in range(count):
            factor[coupled[i], low:high] = rows[:, i]
            for k in range(i + 1):
                factor[coupled[i], coupled[k]] -= squares[i, k]


def solved(factor: Array, right: Array) -> Array:
    """Return solutions for right-hand sides (n,) or (n, m), with a factor (n, n) of `cholesky`."""
    return np.asarray(dpotrs(factor.T, right)[0]) if len(right) else right
