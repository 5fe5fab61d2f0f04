"""Small normal equations by the thousand: ridged, factored once, or solved for physical bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotrs

from geodrake.errors import IdentificationError
from geodrake.identification.newton import minimize
from geodrake.identification.newton_program import NewtonProgram
from geodrake.identification.problem import FitProblem
from geodrake.inertia import PARAMETERS_PER_BODY, Array, is_physical
from geodrake.inertia.kernels import calc_from_pseudo_inertia, calc_pseudo_inertia

RIDGE = 1e-9
"""What is added to the diagonal of normal matrices that are scaled to have ones there. It keeps
columns that say the same (a friction and its asymmetric form) from making them singular."""

_GAP = 1e-3
"""Weight of the barrier that keeps bodies physical, beside squared residuals in variances."""
_LEAST_RIDGE = 1e-13
_INSIDE = 1e-3  # smallest over largest moment of a body from which to start
_NO_MASS = 1e-6  # kg or kg·m², largest moment of a body that is nothing


def cholesky(matrices: Array, ridge: float = RIDGE) -> Array:
    """Return lower Cholesky factors of symmetric matrices (..., n, n) of unit diagonal, ridged."""
    try:
        factors = np.linalg.cholesky(matrices + ridge * np.eye(matrices.shape[-1]))
    except np.linalg.LinAlgError:
        factors = np.array(np.nan)
    if not np.isfinite(factors).all():
        raise IdentificationError(
            "Some parameters have neither data nor a prior that hold them: the normal matrix of a "
            "fit is not positive definite.",
            advice="Give logs with more motion, or the model file instead of a saved model.",
        )
    return np.asarray(factors)


def scaled_cholesky(matrices: Array, ridge: float = RIDGE) -> tuple[Array, Array]:
    """Return lower Cholesky factors L (..., n, n) and scales s (..., n) of symmetric matrices.

    L Lᵀ is the matrix times s from both sides, which has ones on its diagonal, and the ridge.
    """
    scale = 1.0 / np.sqrt(np.diagonal(matrices, axis1=-2, axis2=-1))
    return cholesky(matrices * scale[..., :, None] * scale[..., None, :], ridge), scale


def solved(factor: Array, right: Array) -> Array:
    """Return solutions of right sides (n,) or (n, m), by the (n, n) that `cholesky` gave."""
    return np.asarray(dpotrs(factor.T, right)[0]) if len(right) else right


def are_physical(x: Array, blocks: Sequence[int]) -> NDArray[np.bool_]:
    """Return (F,) whether all bodies of parameters x (F, p), which start at `blocks`, can exist."""
    return np.asarray(is_physical(x[:, _places(blocks)]).all(axis=1))


def inner_bodies(x: Array, blocks: Sequence[int], small: Array) -> Array:
    """Return parameters (F, p) with bodies at or beyond the boundary moved inside, none far.

    A body that has no mass becomes a small one (10,).
    """
    places = _places(blocks)
    bodies = x[:, places]
    values, vectors = np.linalg.eigh(calc_pseudo_inertia(bodies))
    most = values[..., -1:]
    raised = np.maximum(values, _INSIDE * most)[..., None, :]
    inside = calc_from_pseudo_inertia((vectors * raised) @ np.swapaxes(vectors, 2, 3))
    inside = np.where(values[..., :1] > _INSIDE * most, bodies, inside)
    moved = x.copy()
    moved[:, places] = np.where(most > _NO_MASS, inside, small)
    return moved


def physical_minimizers(
    gram: Array, rhs: Array, blocks: Sequence[int], start: Array, bounds: tuple[Array, Array]
) -> Array:
    """Return minimizers (F, p) of ½ xᵀ G x − rᵀ x with physical bodies within bounds.

    G are positive definite (F, p, p) and r (F, p); inertia blocks begin at `blocks`. The bodies of
    `start` (F, p) are physical and of about the size that is expected. The lower and upper bounds
    (p,) are infinite for inertial parameters.
    """
    p, bodies = rhs.shape[1], start.mean(0)
    common = FitProblem(
        factor=np.zeros((1, p + 1)),
        inertia_blocks=tuple(blocks),
        prior_mean=bodies,
        prior_information=np.zeros((p, p)),
        lower=bounds[0],
        upper=bounds[1],
        entropic={block: (bodies[block : block + 10], _GAP) for block in blocks},
    )
    found = np.empty_like(rhs)
    for x, L, scale, right in zip(found, *scaled_cholesky(gram, _LEAST_RIDGE), rhs, strict=True):
        target = solve_triangular(L, scale * right, lower=True)
        problem = replace(common, factor=np.column_stack([L.T / scale, target]))
        minimum = minimize(NewtonProgram.of(problem), enough=_GAP)
        x[:] = minimum.program.parameters(minimum.z)
    return found


def _places(blocks: Sequence[int]) -> NDArray[np.intp]:
    """Return (n, 10) places of the parameters of every inertia block."""
    return np.array(blocks, int)[:, None] + np.arange(PARAMETERS_PER_BODY)
