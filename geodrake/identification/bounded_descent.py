"""Least squares within bounds, where numbers may lie on these from the beginning.

SciPy's `least_squares` keeps away from bounds, and goes on and on where the best numbers are on
them, such as dry friction that is not there.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SETTLED = 1e-4  # share of its sum of squares that the last step of a search takes off
_FIRST_DAMPING, _LEAST_DAMPING = 1e-3, 1e-9  # of steps, over squares of slopes
_NOTHING = float(np.finfo(float).tiny)


def descended(
    functions: tuple[Callable[[Array], Array], Callable[[Array], tuple[Array, Array]]],
    x: Array,
    bounds: tuple[Array, Array],
    most: int,
) -> tuple[Array, float]:
    """Return the least squares of residuals by their slopes, from x on within bounds, and the sum.

    Steps are those of Levenberg and Marquardt. Functions return residuals, and these with their
    slopes; after a step that failed the next may fail, too, and needs none.
    """
    residual, with_slopes = functions
    (left, J), damping = with_slopes(x), _FIRST_DAMPING
    cost = float(left @ left)
    for _ in range(most):
        with np.errstate(over="ignore", invalid="ignore"):
            H, pull = J.T @ J, J.T @ left
        if not np.isfinite(H).all():  # of a servo that makes its joint swing up
            break
        gain, failed = 0.0, False
        while not gain > 0.0:  # nor if it is no number
            damped = H + np.diag(damping * np.diag(H) + _NOTHING)
            step = bounded_step(damped, pull, bounds[0] - x, bounds[1] - x)
            promised = -float(step @ (2.0 * pull + H @ step))
            if promised <= _SETTLED * cost:
                return x, cost
            left, J = (residual(x + step), J) if failed else with_slopes(x + step)
            gain = cost - float(left @ left)
            failed = failed or not gain > 0.0
            damping *= 0.1 if gain > 0.5 * promised else 1.0 if gain > 0.0 else 10.0
            damping = max(damping, _LEAST_DAMPING)
        x, cost = x + step, cost - gain
        if gain <= _SETTLED * cost:  # dry friction lets slopes promise more, again and again
            break
        if failed:
            left, J = with_slopes(x)
    return x, cost


def bounded_step(H: Array, pull: Array, lower: Array, upper: Array) -> Array:
    """Return a step within bounds that lowers xᵀ H x / 2 + pullᵀ x; what meets a bound stays there.

    What a bound holds from the beginning does not move.
    """
    step = np.zeros(len(pull))
    free = ~((lower >= 0.0) & (pull >= 0.0) | (upper <= 0.0) & (pull <= 0.0))
    while free.any():
        way = np.zeros(len(pull))
        way[free] = np.linalg.solve(H[np.ix_(free, free)], -(pull + H @ step)[free])
        bound = np.where(way < 0.0, lower, upper)
        room = np.divide(bound - step, way, out=np.full(len(way), np.inf), where=way != 0.0)
        share = min(1.0, float(room.min()))
        step = np.where(room <= share, bound, step + share * way)
        if share == 1.0:
            break
        free &= room > share
    return step
