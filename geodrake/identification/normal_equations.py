"""Small normal equations by the thousand: ridged, and factored once."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpotrs

from geodrake.compiling import compiled
from geodrake.errors import IdentificationError
from geodrake.inertia import Array

RIDGE = 1e-9
"""What is added to the diagonal of normal matrices that are scaled to have ones there. It keeps
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
def calc_solution(A: Array, b: Array, ridge: float) -> tuple[Array, float, Array]:
    """Return the solution (n,) of A x = b, scaled and ridged as above, log |A|, and L, A = L Lᵀ."""
    n = len(b)
    scale, x, scaled = np.empty(n), np.empty(n), np.empty((n, n))
    for i in range(n):
        scale[i] = A[i, i] ** -0.5
    for i in range(n):
        x[i] = scale[i] * b[i]
        for k in range(n):
            scaled[i, k] = A[i, k] * scale[i] * scale[k]
        scaled[i, i] += ridge
    factor, logarithm = np.ascontiguousarray(np.linalg.cholesky(scaled)), 0.0
    for i in range(n):
        x[i] = (x[i] - factor[i, :i] @ x[:i]) / factor[i, i]
        logarithm += 2.0 * np.log(factor[i, i] / scale[i])
    for i in range(n - 1, -1, -1):
        x[i] /= factor[i, i]
        for k in range(i):
            x[k] -= factor[i, k] * x[i]
        for k in range(i + 1):
            factor[i, k] /= scale[i]
    return scale * x, logarithm, factor


def solved(factor: Array, right: Array) -> Array:
    """Return solutions of right sides (n,) or (n, m), by the (n, n) that `cholesky` gave."""
    return np.asarray(dpotrs(factor.T, right)[0]) if len(right) else right
