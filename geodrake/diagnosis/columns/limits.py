"""Motor limits: commanded efforts, and those that a motor can give.

If a log contains commands, the bodies still move by the limited effort (`MotorLimit`). The excess
of the commands is then no error of the bodies, and has a spread of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from geodrake.model.effort_signal import MotorLimit

Array = NDArray[np.float64]

_QUANTILES = (0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98)  # of the efforts: candidate limits
_SPEEDS = (1.2, 1.7, 2.5, 4.0)  # candidate no-load speeds, over the largest speed
_FEWEST = 0.02  # least share of samples beyond a limit
_LEAST = 0.1  # least share of samples within a limit
_VISIBLE = 9.0  # least mean square beyond a limit, over that of the error
_STEPS = 60  # evaluations of the search for a limit


def spread(error: float, beyond: tuple[float, float]) -> float:
    """Return the geometric mean of a joint's error variance and its excess beyond a limit.

    Samples within the limit have the density of the `error`, (N·m)², those beyond it that of the
    excess, whose variance is at least nine times that of the error. `beyond` is the result of
    `MotorLimit.beyond`.
    """
    share, square = beyond
    within = error / max(1.0 - share, _LEAST)
    return float(within ** (1.0 - share) * max(square, _VISIBLE * within) ** share)


def likely_limits(commanded: Array, needed: Array, velocity: Array) -> list[MotorLimit]:
    """Return the constant limit and the one that falls with speed that best explain the efforts.

    A limit must bring the logged efforts (K,) closer to those that the bodies need (K,), at
    velocities (K,) of the joint.
    """
    unlimited = float(np.log(np.mean((commanded - needed) ** 2) + 1e-300))
    largest, fastest = np.quantile(np.abs(commanded), _QUANTILES), float(np.abs(velocity).max())
    flat = [MotorLimit(float(effort)) for effort in largest if effort > 0.0]
    falling = [
        MotorLimit(limit.effort / max(1.0 - 0.5 / w, 0.1), w * fastest)
        for limit in flat
        for w in _SPEEDS
        if fastest > 0.0
    ]
    fits = [nearest_limit(kind, commanded, needed, velocity) for kind in (flat, falling) if kind]
    return [limit for limit, cost in fits if cost < unlimited]


def nearest_limit(
    candidates: list[MotorLimit], commanded: Array, needed: Array, velocity: Array
) -> tuple[MotorLimit, float]:
    """Return the limit of least cost and the cost, of the same type as the first candidates.

    The cost is the logarithm of `spread`, or infinite if too few samples are beyond or within the
    limit.
    """

    def cost(numbers: Array) -> float:
        limit = MotorLimit(*np.exp(numbers).tolist())
        beyond = limit.beyond(commanded, velocity)
        if not _FEWEST <= beyond[0] <= 1.0 - _LEAST:
            return np.inf
        error = float(np.mean((limit.given(commanded, velocity) - needed) ** 2))
        return float(np.log(spread(error + 1e-300, beyond)))

    has_speed = np.isfinite(candidates[0].no_load_speed)
    starts = np.log([[m.effort, m.no_load_speed] if has_speed else [m.effort] for m in candidates])
    start = min(starts, key=cost)
    if not np.isfinite(cost(start)):
        return candidates[0], np.inf
    simplex = start + 0.1 * np.eye(len(start) + 1, len(start), -1)
    options = {"maxfev": _STEPS, "initial_simplex": simplex}
    result = minimize(cost, start, method="Nelder-Mead", options=options)
    return MotorLimit(*np.exp(result.x).tolist()), float(result.fun)
