"""Small normal equations by the thousand: ridged, factored once, solved within bounds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotrs
from scipy.optimize import lsq_linear

from geodrake.errors import IdentificationError

Array = NDArray[np.float64]

RIDGE = 1e-9
"""What is added to the diagonal of normal matrices that are scaled to have ones there. It keeps
columns that say the same (a friction and its asymmetric form) from making them singular."""

_MOST_EXCHANGES = 20
"""Exchanges of bounds after which another method is taken."""


def cholesky(matrix: Array, ridge: float = RIDGE) -> Array:
    """The lower Cholesky factor of a symmetric matrix of unit diagonal; see `choleskies`.

    Args:
        matrix: (n, n) matrix.
        ridge: What is added to its diagonal.
    """
    return choleskies(matrix[None], ridge)[0]


def choleskies(matrices: Array, ridge: float = RIDGE) -> list[Array]:
    """The lower Cholesky factor of each of F symmetric matrices, with a ridge.

    LAPACK is called as it is: such matrices are small, and there are thousands of them.

    Args:
        matrices: (F, n, n) matrices.
        ridge: What is added to their diagonals.

    Returns:
        (n, n) arrays whose lower triangles are the factors; above it there may be anything.

    Raises:
        IdentificationError: A matrix is not positive definite, or not finite.
    """
    ridged = np.array(matrices, order="C")
    diagonals = np.einsum("fii->fi", ridged)
    diagonals += ridge
    factors, failed = [], False
    for matrix in ridged:  # whose transpose, the same, has the order of LAPACK's arrays
        factor, info = dpotrf(matrix.T, lower=True, clean=False, overwrite_a=True)
        factors.append(factor)
        failed |= info != 0
    # Factors stand where their matrices were, so that these are the diagonals of the factors.
    if failed or not np.isfinite(diagonals).all():
        raise IdentificationError(
            "Some parameters have neither data nor a prior that hold them: the normal matrix of a "
            "fit is not positive definite.",
            advice="Give logs with more motion, or the model file instead of a saved model.",
        )
    return factors


def solved(factor: Array, right: Array) -> Array:
    """Solutions, shaped as the right sides (n,) or (n, m), by the (n, n) that `cholesky` gave.

    Args:
        factor: (n, n) lower triangular factor.
        right: (n,) or (n, m) right sides.
    """
    return np.asarray(dpotrs(factor, right, lower=True)[0]) if len(right) else right


def bounded_minimizers(gram: Array, rhs: Array, lower: Array, upper: Array) -> Array:
    """Minimizers of ½ yᵀ S y − rᵀ y within bounds, for F problems at once.

    Args:
        gram: (F, k, k) matrices S, positive semidefinite but for rounding.
        rhs: (F, k) right sides r.
        lower: (k,) or (F, k) lower bounds.
        upper: (k,) or (F, k) upper bounds.

    Returns:
        (F, k) minimizers y.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(gram, axis1=1, axis2=2), 1e-300))
    scaled = gram * scale[:, :, None] * scale[:, None]
    if gram.shape[1] == 1:
        values = np.maximum(scaled[:, 0], 0.0) + RIDGE
        return np.clip(scale**2 * rhs / values, lower, upper)
    # Columns that say the same leave eigenvalues that rounding may make negative.
    values, vectors = np.linalg.eigh(scaled)
    values = np.maximum(values, 0.0) + RIDGE
    bounds = lower / scale, upper / scale
    matrix = (vectors * values[:, None]) @ np.swapaxes(vectors, 1, 2)
    return np.clip(scale * _within(matrix, scale * rhs, *bounds), lower, upper)


def _within(matrix: Array, rhs: Array, lower: Array, upper: Array) -> Array:
    """(F, k) minimizers of ½ yᵀ M y − rᵀ y for positive definite M, within bounds (F, k).

    By exchanging which parameters are held at which bound, until none of the others leaves its own
    and none that is held is pulled back from it. That may run in a circle, though rarely; such
    problems are left to a method that never does.
    """
    held, at, y = np.zeros(rhs.shape, bool), np.zeros(rhs.shape), np.empty_like(rhs)
    unit, left = np.eye(rhs.shape[1]), np.arange(len(rhs))
    for _ in range(_MOST_EXCHANGES):
        m, r, fixed, place = matrix[left], rhs[left], held[left], at[left]
        system = np.where(fixed[:, :, None], unit, m)
        found = np.linalg.solve(system, np.where(fixed, place, r)[..., None])[..., 0]
        found = np.where(fixed, place, found)  # but for rounding it is
        pull = r - (m @ found[..., None])[..., 0]
        leaves = ~fixed & ((found < lower[left]) | (found > upper[left]))
        stays = fixed & np.where(place <= lower[left], pull <= 0.0, pull >= 0.0)
        y[left], held[left] = found, leaves | stays
        at[left] = np.where(leaves, np.clip(found, lower[left], upper[left]), place)
        left = left[np.any(leaves | (fixed & ~stays), axis=1)]
        if not len(left):
            return y
    for f in left:
        root, bounds = np.linalg.cholesky(matrix[f]), (lower[f], upper[f])
        found = lsq_linear(root.T, np.linalg.solve(root, rhs[f]), bounds, method="bvls").x
        y[f] = np.clip(found, *bounds)  # which rounding may have left
    return y
