"""Bounded nonlinear least squares whose start and solution may lie on the bounds.

SciPy's `least_squares` stays inside, and converges slowly to solutions on a bound, such as zero dry
friction.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SETTLED = 1e-4  # relative decrease of the cost below which a search has converged
_FIRST_DAMPING, _LEAST_DAMPING = 1e-3, 1e-9  # of Levenberg–Marquardt, relative to diag(JᵀJ)
_NOTHING = float(np.finfo(float).tiny)


def bounded_least_squares(
    functions: tuple[Callable[[Array], Array], Callable[[Array], tuple[Array, Array]]],
    x: Array,
    bounds: tuple[Array, Array],
    max_steps: int,
) -> tuple[Array, float]:
    """Minimize the squared residuals from x on within bounds; return the solution and its cost.

    Levenberg–Marquardt. The functions return the residuals, and the residuals with their slopes;
    after a failed step the residuals alone suffice.
    """
    residual_of, with_slopes = functions
    (residual, J), damping = with_slopes(x), _FIRST_DAMPING
    cost = float(residual @ residual)
    for _ in range(max_steps):
        with np.errstate(over="ignore", invalid="ignore"):
            H, gradient = J.T @ J, J.T @ residual
        if not np.isfinite(H).all():  # an unstable servo
            break
        gain, failed = 0.0, False
        while not gain > 0.0:  # also if it is NaN
            damped = H + np.diag(damping * np.diag(H) + _NOTHING)
            step = bounded_step(damped, gradient, bounds[0] - x, bounds[1] - x)
            promised = -float(step @ (2.0 * gradient + H @ step))
            if promised <= _SETTLED * cost:
                return x, cost
            residual, J = (residual_of(x + step), J) if failed else with_slopes(x + step)
            gain = cost - float(residual @ residual)
            failed = failed or not gain > 0.0
            damping *= 0.1 if gain > 0.5 * promised else 1.0 if gain > 0.0 else 10.0
            damping = max(damping, _LEAST_DAMPING)
        x, cost = x + step, cost - gain
        if gain <= _SETTLED * cost:  # with dry friction, slopes may promise more forever
            break
        if failed:
            residual, J = with_slopes(x)
    return x, cost


def bounded_step(H: Array, gradient: Array, lower: Array, upper: Array) -> Array:
    """Return a step within bounds that lowers xᵀ H x / 2 + gradientᵀ x.

    Components that reach a bound stay there.
    """
    step = np.zeros(len(gradient))
    free = ~((lower >= 0.0) & (gradient >= 0.0) | (upper <= 0.0) & (gradient <= 0.0))
    while free.any():
        direction = np.zeros(len(gradient))
        direction[free] = np.linalg.solve(H[np.ix_(free, free)], -(gradient + H @ step)[free])
        bound = np.where(direction < 0.0, lower, upper)
        room = np.divide(
            bound - step, direction, out=np.full(len(direction), np.inf), where=direction != 0.0
        )
        share = min(1.0, float(room.min()))
        step = np.where(room <= share, bound, step + share * direction)
        if share == 1.0:
            break
        free &= room > share
    return step
