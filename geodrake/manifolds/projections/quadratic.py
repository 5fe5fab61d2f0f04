"""The projection in a flat metric, which is Newton's step of the one in a curved metric."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from geodrake.manifolds.base import Array

_DEPENDENT = 1e-11  # singular value, relative to the largest, of rows that say nothing new
_CONSISTENT = 1e-9  # error of rows that are solved with as equations
_SLIGHT = 1e-12  # error of a row, or of the sign of a multiplier, that is none
_MOST_GUESSES = 12
_MOST_SCALINGS = 4
_EMPTY = 1e-13  # least share of the unit row that a non-empty polyhedron leaves


def least_change(G: Array, lower: Array, upper: Array, held: Array) -> Array | None:
    """The change d of multipliers `held` with which z = Gᵀ d is the best step.

    z is least ½ |z + Gᵀ held|² with lower ≤ G z ≤ upper, and held + d are its multipliers: above
    zero where a lower limit binds, below where an upper one does.

    Args:
        G: (k, n) rows of unit length.
        lower: (k,) limits; −inf for none.
        upper: (k,) limits; inf for none, the same as lower for equations.
        held: (k,) multipliers so far.

    Returns:
        (k,) d; None if no z keeps the limits.
    """
    equal = lower == upper
    side = np.sign(held)
    side = np.where(side == 0, np.where(lower > 0, 1.0, np.where(upper < 0, -1.0, 0.0)), side)
    found = _by_guesses(G, (lower, upper), held, np.where(equal, 1.0, side))
    if found is not None:
        return found
    # Limits for z + Gᵀ held, which is to be as short as it can be.
    shift = G @ (G.T @ held)
    multipliers = _least_distance(G, lower + shift, upper + shift)
    if multipliers is None:
        return None
    side = np.where(equal, 1.0, np.sign(multipliers))
    found = _by_guesses(G, (lower, upper), held, side)
    return multipliers - held if found is None else found


def _by_guesses(G: Array, limits: tuple[Array, Array], held: Array, side: Array) -> Array | None:
    """Solves with the limits that bind as equations, and corrects which those are."""
    lower, upper = limits
    equal = lower == upper
    for _ in range(_MOST_GUESSES):
        binding = side != 0
        target = np.where(side > 0, lower, upper)[binding]
        if not np.isfinite(target).all():
            return None
        d = -held
        d[binding] = 0.0
        part = _solved(G[binding], target - G[binding] @ (G.T @ d))
        if part is None:
            return None
        d[binding] = part
        value, multipliers = G @ (G.T @ d), held + d
        slight = _SLIGHT * (1.0 + np.abs(value))
        wrong = binding & ~equal & (multipliers * side < -_SLIGHT * np.abs(multipliers).max())
        below, above = lower - value > slight, value - upper > slight
        missed = ~binding & (below | above)
        if not (wrong.any() or missed.any()):
            return _cleaned(d, held, side, equal)
        side = np.where(wrong, 0.0, np.where(missed, np.where(below, 1.0, -1.0), side))
    return None


def _cleaned(d: Array, held: Array, side: Array, equal: NDArray[np.bool_]) -> Array:
    """The change without signs that rounding got wrong."""
    wrong = ~equal & ((held + d) * side < 0)
    return np.where(wrong, -held, d)


def _solved(G: Array, target: Array) -> Array | None:
    """The shortest d with G Gᵀ d = target; None if rows contradict each other."""
    if not len(target):
        return target
    if len(target) == 1:
        return np.asarray(target / (G @ G.T)[0])
    U, values, _ = np.linalg.svd(G, full_matrices=False)
    kept = values > _DEPENDENT * values[0]
    turned = U[:, kept].T @ target
    if not kept.all() or len(values) < len(target):
        rest = target - U[:, kept] @ turned
        if np.abs(rest).max() > _CONSISTENT * (_CONSISTENT + np.abs(target).max()):
            return None
    return np.asarray(U[:, kept] @ (turned / values[kept] ** 2))


def _least_distance(G: Array, lower: Array, upper: Array) -> Array | None:
    """Multipliers μ (k,) of the shortest z = Gᵀ μ with lower ≤ G z ≤ upper; None if there is none.

    Lawson and Hanson's least-distance program: it stands rows that depend on each other.
    """
    below, above = np.flatnonzero(np.isfinite(lower)), np.flatnonzero(np.isfinite(upper))
    rows = np.concatenate([G[below], -G[above]])
    limit = np.concatenate([lower[below], -upper[above]])
    scale = float(limit.max(initial=0.0))
    if scale <= 0:
        return np.zeros(len(lower))
    unit = np.zeros(G.shape[1] + 1)
    unit[-1] = 1.0
    for _ in range(_MOST_SCALINGS):
        matrix = np.vstack([rows.T, limit / scale])
        try:
            u, _ = nnls(matrix, unit)
        except RuntimeError:
            return None
        left = 1.0 - float(matrix[-1] @ u)
        if not left > _EMPTY:
            return None
        length = float(np.linalg.norm(rows.T @ u)) / left
        if length < 10.0:
            break
        scale *= length
    multipliers = np.zeros(len(lower))
    np.add.at(multipliers, below, u[: len(below)] * (scale / left))
    np.add.at(multipliers, above, -u[len(below) :] * (scale / left))
    return multipliers
