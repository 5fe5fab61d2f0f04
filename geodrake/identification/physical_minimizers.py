"""Quadratic fits whose bodies stay physical, given by their normal equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from geodrake.identification.newton import solve_alike
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
    gram: Array, rhs: Array, blocks: Sequence[int], start: Array, bounds: tuple[Array, Array]
) -> Array:
    """Return minimizers (F, p) of ½ xᵀ G x − rᵀ x with physical bodies within bounds.

    Args:
        gram: (F, p, p) positive definite matrices G.
        rhs: (F, p) right sides r.
        blocks: First parameter of every inertia block.
        start: (F, p) parameters whose bodies are physical, of about the size that is expected.
        bounds: Lower and upper bounds (p,), infinite for inertial parameters.

    Raises:
        IdentificationError: Rounding gets in the way.
    """
    p, bodies = rhs.shape[1], start.mean(0)
    scales = 1.0 / np.sqrt(np.diagonal(gram, axis1=1, axis2=2))
    roots = choleskies(gram * scales[:, :, None] * scales[:, None, :], _RIDGE)
    common = FitProblem(
        factor=np.zeros((1, p + 1)),
        inertia_blocks=tuple(blocks),
        prior_mean=bodies,
        prior_information=np.zeros((p, p)),
        lower=bounds[0],
        upper=bounds[1],
        entropic={block: (bodies[block : block + 10], _GAP) for block in blocks},
    )
    targets = (
        solve_triangular(L, s * r, lower=True) for L, s, r in zip(roots, scales, rhs, strict=True)
    )
    factors = (
        np.column_stack([L.T / s, t]) for L, s, t in zip(roots, scales, targets, strict=True)
    )
    return solve_alike((replace(common, factor=factor) for factor in factors), enough=_GAP)


def _places(blocks: Sequence[int]) -> NDArray[np.intp]:
    """Return (n, 10) places of the parameters of every inertia block."""
    return np.array(blocks, int)[:, None] + np.arange(PARAMETERS_PER_BODY)
