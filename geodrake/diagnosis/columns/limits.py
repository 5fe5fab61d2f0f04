"""Limits of motors: efforts that were asked for, and those that a motor can give.

Where the log has what was asked for, the bodies move by what was given (`MotorLimit`). What was
asked for beyond the limit then says nothing of the bodies, and is no error of theirs: it has a
spread of its own.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from geodrake.model.motor_limit import MotorLimit

Array = NDArray[np.float64]

_SHARES = (0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98)  # of the efforts are below a limit that is tried
_SPEEDS = (1.2, 1.7, 2.5, 4.0)  # of the fastest speed, at which a motor gives nothing
_FEWEST = 0.02  # of the samples that are beyond a limit, for it to be seen
_LEAST = 0.1  # of them that are not: else nothing says what the motor gives
_SEEN = 9.0  # times the error: mean square beyond a limit, for it to be seen
_STEPS = 60  # evaluations of the search for a limit's numbers


def spread(error: float, beyond: tuple[float, float]) -> float:
    """Mean square of a joint's errors, those of samples beyond its limit counted as they are.

    A sample within the limit has the density of the error, one beyond it that of what was asked
    for too much, which no less than three deviations of the error tell from noise. The mean of the
    logarithms is that of this value.

    Args:
        error: Mean squared error of given efforts, (N·m)² or N².
        beyond: Share and mean square, as of `MotorLimit.beyond`.
    """
    share, square = beyond
    within = error / max(1.0 - share, _LEAST)
    return float(within ** (1.0 - share) * max(square, _SEEN * within) ** share)


def likely_limits(asked: Array, needed: Array, velocity: Array) -> tuple[MotorLimit, ...]:
    """The limit at all speeds, and the one that falls with the speed, that explain efforts best.

    Only those are told with which what bodies need is nearer.

    Args:
        asked: (K,) efforts of the log.
        needed: (K,) what the bodies and effects of a fit need.
        velocity: (K,) velocities of the joint.
    """
    without = float(np.log(np.mean((asked - needed) ** 2) + 1e-300))
    largest, fastest = np.quantile(np.abs(asked), _SHARES), float(np.abs(velocity).max())
    flat = [MotorLimit(float(effort)) for effort in largest if effort > 0.0]
    falling = [
        MotorLimit(limit.effort / max(1.0 - 0.5 / w, 0.1), w * fastest)
        for limit in flat
        for w in _SPEEDS
        if fastest > 0.0
    ]
    found = []
    for kind in (flat, falling):
        costs = [_cost(limit, asked, needed, velocity) for limit in kind]
        if costs and np.isfinite(min(costs)):
            first = kind[int(np.argmin(costs))]
            limit = nearest_limit(first, lambda x: _cost(x, asked, needed, velocity))
            found += [limit] if _cost(limit, asked, needed, velocity) < without else []
    return tuple(found)


def nearest_limit(first: MotorLimit, cost: Callable[[MotorLimit], float]) -> MotorLimit:
    """Return the limit of the same kind that costs least."""
    flat = not np.isfinite(first.no_load_speed)
    start = np.log([first.effort] if flat else [first.effort, first.no_load_speed])
    found = minimize(
        lambda x: cost(MotorLimit(*np.exp(x).tolist())),
        start,
        method="Nelder-Mead",
        options={
            "maxfev": _STEPS,
            "initial_simplex": start + 0.1 * np.eye(len(start) + 1, len(start), -1),
        },
    )
    return MotorLimit(*np.exp(found.x).tolist())


def _cost(limit: MotorLimit, asked: Array, needed: Array, velocity: Array) -> float:
    """Logarithm of `spread`; infinite where too little is beyond the limit, or within it."""
    beyond = limit.beyond(asked, velocity)
    if not _FEWEST <= beyond[0] <= 1.0 - _LEAST:
        return np.inf
    error = float(np.mean((limit.given(asked, velocity) - needed) ** 2))
    return float(np.log(spread(error + 1e-300, beyond)))
