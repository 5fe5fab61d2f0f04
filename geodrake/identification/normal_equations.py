"""Small normal equations by the thousand: ridged, factored once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotrs

from geodrake.errors import IdentificationError

Array = NDArray[np.float64]

RIDGE = 1e-9
"""What is added to the diagonal of normal matrices that are scaled to have ones there. It keeps
columns that say the same (a friction and its asymmetric form) from making them singular."""


def cholesky(matrix: Array, ridge: float = RIDGE) -> Array:
    """Return the lower Cholesky factor of a symmetric matrix of unit diagonal; see `choleskies`.

    Args:
        matrix: (n, n) matrix.
        ridge: What is added to its diagonal.
    """
    return choleskies(matrix[None], ridge)[0]


def choleskies(matrices: Array, ridge: float = RIDGE) -> list[Array]:
    """Return the lower Cholesky factor of each of F symmetric matrices, with a ridge.

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
