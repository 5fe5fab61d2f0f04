"""Fast solutions of many small normal equations, with a ridge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrs

from geodrake.compiling import compiled, inlined, summing
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

    log |A| is not finite if A is not positive definite.
    Unknowns of different `groups` (n,) do not interact, which saves most of the work; those of
    group −1 interact with all. The factor L of A = L Lᵀ has the unknowns sorted by group, with
    group −1 last.
    """
    n, first = len(b), 0
    order, scale, x, factor = np.empty(n, np.intp), np.empty(n), np.empty(n), np.zeros((n, n))
    for i in range(n):  # by insertion, as sorting takes seconds to compile
        k = i
        while k > 0 and _is_after(groups[order[k - 1]], groups[i]):
            order[k] = order[k - 1]
            k -= 1
        order[k] = i
        first += groups[i] >= 0
    for i in range(n):
        scale[i] = A[order[i], order[i]] ** -0.5
        x[i] = scale[i] * b[order[i]]
        row = A[order[i]]
        for k in range(i):
            factor[i, k] = row[order[k]] * scale[i] * scale[k]
        factor[i, i] = 1.0 + ridge
    low, logarithm = 0, 0.0
    while low < first:
        high = low + 1
        while high < first and groups[order[high]] == groups[order[low]]:
            high += 1
        _eliminate(factor, low, high, first)
        low = high
    _factorize(factor, first)
    for i in range(n):
        x[i] = (x[i] - _product(factor[i], x, 0, i)) / factor[i, i]
        logarithm += 2.0 * np.log(factor[i, i] / scale[i])
    for i in range(n - 1, -1, -1):
        x[i] /= factor[i, i]
        for k in range(i):
            x[k] -= factor[i, k] * x[i]
        back = 1.0 / scale[i]
        for k in range(i + 1):
            factor[i, k] *= back
    solution = np.empty(n)
    for i in range(n):
        solution[order[i]] = scale[i] * x[i]
    return solution, logarithm, factor


@inlined
def _is_after(group: int, other: int) -> bool:
    return other >= 0 and (group < 0 or group > other)


@summing
def _product(one: Array, other: Array, low: int, high: int) -> float:
    total = 0.0
    for k in range(low, high):
        total += one[k] * other[k]
    return total


@inlined
def _factorize(factor: Array, first: int) -> None:
    """Replace the lower triangle from `first` on by its Cholesky factor."""
    block = np.linalg.cholesky(factor[first:, first:].copy())
    for i in range(first, len(factor)):
        for k in range(first, i + 1):
            factor[i, k] = block[i - first, k - first]


@inlined
def _eliminate(factor: Array, low: int, high: int, first: int) -> None:
    """Factor columns `low` to `high` in place, and eliminate them from those from `first` on."""
    size, coupled, count = high - low, np.empty(len(factor) - first, np.intp), 0
    for i in range(first, len(factor)):
        for k in range(low, high):
            if factor[i, k] != 0.0:
                coupled[count] = i
                count += 1
                break
    columns, squares = np.empty((size, count)), np.empty(count)
    for i in range(low, high):
        _substitute(factor[i], factor, low, i)
        factor[i, i] = np.sqrt(factor[i, i] - _product(factor[i], factor[i], low, i))
    for i in range(count):
        row = factor[coupled[i]]
        _substitute(row, factor, low, high)
        for a in range(size):
            columns[a, i] = row[low + a]
        squares[: i + 1] = 0.0
        for a in range(size):
            for k in range(i + 1):
                squares[k] += columns[a, i] * columns[a, k]
        for k in range(i + 1):
            row[coupled[k]] -= squares[k]


@inlined
def _substitute(row: Array, factor: Array, low: int, high: int) -> None:
    """Solve row = x Lᵀ from column `low` to `high`, in place."""
    for k in range(low, high):
        row[k] = (row[k] - _product(row, factor[k], low, k)) / factor[k, k]


def solved(factor: Array, right: Array) -> Array:
    """Return solutions for right-hand sides (n,) or (n, m), with a factor (n, n) of `cholesky`."""
    return np.asarray(dpotrs(factor.T, right)[0]) if len(right) else right
