"""Limits of motors: efforts that were asked for, and those that a motor can give.

Where the log has what was asked for, the bodies move by what was given (`MotorLimit`). What was
asked for beyond the limit then says nothing of the bodies, and is no error of theirs: it has a
spread of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from geodrake.model.effort_signal import MotorLimit

Array = NDArray[np.float64]

_SHARES = (0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98)  # of the efforts are below a limit that is tried
_SPEEDS = (1.2, 1.7, 2.5, 4.0)  # of the fastest speed, at which a motor gives nothing
_FEWEST = 0.02  # of the samples that are beyond a limit, for it to be seen
_LEAST = 0.1  # of them that are not: else nothing says what the motor gives
_SEEN = 9.0  # times the error: mean square beyond a limit, for it to be seen
_STEPS = 60  # evaluations of the search for a limit's numbers


def spread(error: float, beyond: tuple[float, float]) -> float:
    """Return the mean square of a joint's errors, those beyond its limit counted as they are.

    A sample within the limit has the density of the `error` (N·m)², one beyond it that of what was
    asked for too much, which no less than three deviations of the error tell from noise. The mean
    of the logarithms is that of this value. `beyond` is as of `MotorLimit.beyond`.
    """
    share, square = beyond
    within = error / max(1.0 - share, _LEAST)
    return float(within ** (1.0 - share) * max(square, _SEEN * within) ** share)


def likely_limits(asked: Array, needed: Array, velocity: Array) -> list[MotorLimit]:
    """Return the limit at all speeds, and the one that falls with speed, that explain efforts best.

    They are those that lead from efforts (K,) of a log nearer to what bodies need (K,), at
    velocities (K,) of the joint.
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
    nearest = [nearest_limit(kind, asked, needed, velocity) for kind in (flat, falling) if kind]
    return [limit for limit, cost in nearest if cost < without]


def nearest_limit(
    first: list[MotorLimit], asked: Array, needed: Array, velocity: Array
) -> tuple[MotorLimit, float]:
    """Return the limit of the kind of those that are tried that costs least, and its cost.

    That is the logarithm of `spread`; infinite where too little is beyond the limit, or within it.
    """

    def cost(numbers: Array) -> float:
        limit = MotorLimit(*np.exp(numbers).tolist())
        beyond = limit.beyond(asked, velocity)
        if not _FEWEST <= beyond[0] <= 1.0 - _LEAST:
            return np.inf
        error = float(np.mean((limit.given(asked, velocity) - needed) ** 2))
        return float(np.log(spread(error + 1e-300, beyond)))

    falls = np.isfinite(first[0].no_load_speed)
    starts = np.log([[m.effort, m.no_load_speed] if falls else [m.effort] for m in first])
    start = min(starts, key=cost)
    if not np.isfinite(cost(start)):
        return first[0], np.inf
    simplex = start + 0.1 * np.eye(len(start) + 1, len(start), -1)
    options = {"maxfev": _STEPS, "initial_simplex": simplex}
    found = minimize(cost, start, method="Nelder-Mead", options=options)
    return MotorLimit(*np.exp(found.x).tolist()), float(found.fun)
