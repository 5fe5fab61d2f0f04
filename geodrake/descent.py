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
    """Return how much of a step to take: all of it, a half, a quarter… until the cost falls enough.

    Args:
        decrease: Maps shares (...) of the step to how much lower the cost is there; minus infinity
            outside of its domain.
        promise: (...) what the slope promises of the whole step, above zero.
        rounding: (...) what the cost is not known better than.

    Returns:
        (...) the shares; zero where none lowers the cost.
    """
    share = np.full(np.shape(promise), longest)
    for _ in range(_MOST_HALVINGS):
        enough = decrease(share) >= _SUFFICIENT * share * promise - rounding
        if np.all(enough):
            return share
        share = np.where(enough, share, 0.5 * share)
    return np.where(enough, share, 0.0)


def is_within_rounding(
    promise: Array | float, before: Array | float, rounding: Array | float
) -> NDArray[np.bool_]:
    """Return whether a search is as near to its minimum as rounding lets it come.

    Newton's steps promise less and less, far below what rounding hides of the cost, until rounding
    of the gradient makes them. Then what is left is lost in the cost, and no step changes that.

    Args:
        promise: (...) what the slope promises of the next step.
        before: (...) the same of the last step; infinite at first.
        rounding: (...) what the cost is not known better than.
    """
    return np.asarray((promise <= rounding) & (promise >= _SHRINKS * np.asarray(before)))


def rounding_of_squares(cost: Array | float, weight: Array | float) -> Array:
    """Return what ½ Σ wₖ rₖ² is not known better than, of residuals known to `PRECISION`.

    Small residuals are known no better than others: it is Σ wₖ |rₖ| times that, at most.

    Args:
        cost: (...) the sum.
        weight: (...) Σ wₖ.
    """
    return np.asarray(PRECISION * (np.sqrt(2.0 * weight * cost) + cost))
