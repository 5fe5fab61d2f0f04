"""Step lengths of Newton's method, and the rounding that ends it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PRECISION = 1e-13
"""Precision of values of size one after a decomposition and a few hundred sums."""

_SUFFICIENT = 1e-4  # least share of the decrease that the slope promises
_SHRINKS = 0.25  # share of its promise that a step leaves to the next one, at most
_MOST_HALVINGS = 50


def step_length(
    decrease: Callable[[Array], Array | float],
    promise: Array | float,
    rounding: Array | float,
    *,
    longest: float = 1.0,
) -> Array:
    """Return step lengths by backtracking, starting with `longest` and halving.

    Args:
        decrease: Maps lengths (...) to the decrease of the cost; minus infinity outside the domain.
        promise: (...) predicted decrease of a step of length 1, to first order, above zero.
        rounding: (...) rounding error of the cost.

    Returns:
        (...) lengths with a sufficient decrease; zero if there are none.
    """
    length = np.full(np.shape(promise), longest)
    for _ in range(_MOST_HALVINGS):
        is_sufficient = decrease(length) >= _SUFFICIENT * length * promise - rounding
        if np.all(is_sufficient):
            return length
        length = np.where(is_sufficient, length, 0.5 * length)
    return np.where(is_sufficient, length, 0.0)


def is_within_rounding(
    promise: Array | float, before: Array | float, rounding: Array | float
) -> NDArray[np.bool_]:
    """Return whether a search has reached its minimum up to rounding.

    Predicted decreases of Newton steps shrink far below the rounding error of the cost, until they
    are dominated by rounding of the gradient and no longer shrink.

    Args:
        promise: (...) predicted decrease of the next step.
        before: (...) predicted decrease of the last step; infinite at first.
        rounding: (...) rounding error of the cost.
    """
    return np.asarray((promise <= rounding) & (promise >= _SHRINKS * np.asarray(before)))


def rounding_of_squares(cost: Array | float, weight: Array | float) -> Array:
    """Return the rounding error of ½ Σ wₖ rₖ², for residuals with errors of `PRECISION`.

    It is bounded by Σ wₖ |rₖ| times that error, as small residuals are no more precise.

    Args:
        cost: (...) the sum.
        weight: (...) Σ wₖ.
    """
    return np.asarray(PRECISION * (np.sqrt(2.0 * weight * cost) + cost))
