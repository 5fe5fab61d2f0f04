"""Fast solutions of many small normal equations, with a ridge."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpotrs

from geodrake.compiling import compiled, summing
from geodrake.errors import IdentificationError
from geodrake.inertia import Array

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
def calc_solution(A: Array, b: Array, ridge: float) -> Array:
    """Return the solution (n,) of A x = b, scaled and ridged."""
    n = len(b)
    scale, x, unit = np.empty(n), np.empty(n), np.empty((n, n))
    for i in range(n):
        scale[i] = A[i, i] ** -0.5
        x[i] = scale[i] * b[i]
        for k in range(i):
            unit[i, k] = unit[k, i] = A[i, k] * scale[i] * scale[k]
        unit[i, i] = 1.0 + ridge
    factor = np.linalg.cholesky(unit)
    for i in range(n):
        x[i] = (x[i] - _product(factor[i], x, i)) / factor[i, i]
    for i in range(n - 1, -1, -1):
        x[i] /= factor[i, i]
        for k in range(i):
            x[k] -= factor[i, k] * x[i]
    for i in range(n):
        x[i] *= scale[i]
    return x


@summing
def _product(one: Array, other: Array, count: int) -> float:
    total = 0.0
    for k in range(count):
        total += one[k] * other[k]
    return total


def solved(factor: Array, right: Array) -> Array:
    """Return solutions for right-hand sides (n,) or (n, m), with a factor (n, n) of `cholesky`."""
    return np.asarray(dpotrs(factor.T, right)[0]) if len(right) else right
