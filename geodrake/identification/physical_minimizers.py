"""Quadratic fits whose bodies stay physical, given by their normal equations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.identification.newton_path import minimize
from geodrake.identification.newton_program import NewtonProgram
from geodrake.identification.normal_equations import choleskies
from geodrake.identification.problem import FitProblem
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.inertia.kernels import calc_from_pseudo_inertia, calc_pseudo_inertia

Array = NDArray[np.float64]

_GAP = 1e-3
"""Weight of the barrier that keeps bodies physical, beside squared residuals in variances."""
_RIDGE = 1e-13
_INSIDE = 1e-3  # smallest over largest moment of a body from which to start
_NO_MASS = 1e-6  # kg or kg·m², largest moment of a body that is nothing


def are_physical(x: Array, blocks: Sequence[int]) -> NDArray[np.bool_]:
    """Return (F,) whether all bodies of parameters x (F, p) are physical.

    Args:
        x: (F, p) parameters.
        blocks: First parameter of every inertia block.
    """
    P = calc_pseudo_inertia(x[:, _places(blocks)])
    return np.asarray((np.linalg.eigvalsh(P)[..., 0] > 0.0).all(axis=1))


def inner_bodies(x: Array, blocks: Sequence[int], small: Array) -> Array:
    """Return parameters (F, p) with bodies at or beyond the boundary moved inside, none far.

    Args:
        x: (F, p) parameters.
        blocks: First parameter of every inertia block.
        small: (10,) what becomes of a body that has no mass.
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
    gram: Array,
    rhs: Array,
    blocks: Sequence[int],
    start: Array,
    bounds: tuple[Array, Array],
) -> Array:
    """Return minimizers (F, p) of ½ xᵀ G x − rᵀ x with physical bodies within bounds.

    Parameters without constraints are eliminated first.

    Args:
        gram: (F, p, p) positive definite matrices G.
        rhs: (F, p) right sides r.
        blocks: First parameter of every inertia block.
        start: (F, p) parameters whose bodies are physical, of about the size that is expected.
        bounds: Lower and upper bounds (p,), infinite for inertial parameters.

    Raises:
        IdentificationError: Rounding gets in the way.
    """
    lower, upper = bounds
    held = np.isfinite(lower) | np.isfinite(upper)
    held[_places(blocks)] = True
    order = np.argsort(held, kind="stable")
    k = np.count_nonzero(~held)
    at = np.searchsorted(order[k:], blocks).tolist()
    p = len(order) - k
    x = np.empty_like(rhs)
    scales = 1.0 / np.sqrt(np.diagonal(gram, axis1=1, axis2=2))
    scaled = gram * scales[:, :, None] * scales[:, None, :]
    for f, factor in enumerate(choleskies(scaled[:, order[:, None], order], _RIDGE)):
        # ½ ‖U y − u‖² with the upper triangular U, of whose last rows the free ones drop out.
        U = factor.T / scales[f, order]
        u = np.linalg.solve(U.T, rhs[f, order])
        problem = FitProblem(
            factor=np.column_stack([U[k:, k:], u[k:]]),
            inertia_blocks=at,
            prior_mean=start[f, order[k:]],
            prior_information=np.zeros((p, p)),
            lower=lower[order[k:]],
            upper=upper[order[k:]],
            entropic={i: (start[f, order[k:]][i : i + 10], _GAP) for i in at},
        )
        program = NewtonProgram.of(problem)
        y = program.coordinates.parameters(minimize(program.weighted(1.0)).point.z)
        x[f, order[k:]] = np.clip(y, problem.lower, problem.upper)
        x[f, order[:k]] = np.linalg.solve(U[:k, :k], u[:k] - U[:k, k:] @ x[f, order[k:]])
    return x


def _places(blocks: Sequence[int]) -> NDArray[np.intp]:
    """Return (n, 10) places of the parameters of every inertia block."""
    return np.array(blocks, int)[:, None] + np.arange(PARAMETERS_PER_BODY)
