"""Integrals of servos along logs: how they grow is measured, where they began is not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, contiguous

Array = NDArray[np.float64]


def error_integral(time: Array, error: Array) -> Array:
    """(N,) integral of what a servo is behind, rad·s or m·s, from 0 on at the first known row.

    Straight lines lead over rows of which nothing is known.

    Args:
        time: (N,) instants, s.
        error: (N,) commanded less measured position; NaN where one is not known.
    """
    known = np.isfinite(error) & np.isfinite(time)
    if np.count_nonzero(known) < 2:
        return np.zeros(len(error))
    t, e = time[known], error[known]
    grown = np.concatenate([[0.0], np.cumsum(np.diff(t) * 0.5 * (e[1:] + e[:-1]))])
    return np.interp(time, t, grown)


def limited_integral(time: Array, error: Array, effort: Array, gain: float, limit: float) -> Array:
    """As `error_integral`, but it stays where the servo is at its limit and would go beyond.

    Args:
        time: (N,) instants, s.
        error: (N,) commanded less measured position; NaN where one is not known.
        effort: (N,) effort without what the integral adds from the first row on; NaN where unknown.
        gain: The integral gain.
        limit: Largest effort, N·m or N.
    """
    known = np.isfinite(error) & np.isfinite(time) & np.isfinite(effort)
    if np.count_nonzero(known) < 2:
        return np.zeros(len(error))
    grown, columns = np.zeros(np.count_nonzero(known)), (time, error, effort)
    calc_limited_integral(contiguous(np.stack(columns, axis=1)[known]), gain, limit, grown)
    return np.interp(time, time[known], grown)


@compiled
def calc_limited_integral(rows: Array, gain: float, limit: float, out: Array) -> None:
    """Writes the integral (N,), 0 at first.

    Args:
        rows: (N, 3) instants, errors, and efforts without the integral.
        gain: The integral gain.
        limit: Largest effort, N·m or N.
        out: (N,) zeros, then the integral.
    """
    for k in range(len(rows) - 1):
        effort, error = rows[k, 2] + gain * out[k], 0.5 * (rows[k, 1] + rows[k + 1, 1])
        beyond = (effort > limit and error > 0.0) or (effort < -limit and error < 0.0)
        out[k + 1] = out[k] + (0.0 if beyond else (rows[k + 1, 0] - rows[k, 0]) * error)


def constant_beside_friction(effort: Array, velocity: Array) -> float:
    """The constant in an effort, N·m or N, that is no friction; 0 if nothing is known.

    Args:
        effort: (N,) the effort; NaN where it is not known.
        velocity: (N,) velocity of the joint, rad/s or m/s.
    """
    known = np.isfinite(effort) & np.isfinite(velocity)
    if not known.any():
        return 0.0
    v = velocity[known]
    columns = np.stack([np.ones_like(v), v, np.sign(v)], axis=1)
    return float(np.linalg.lstsq(columns, effort[known], rcond=None)[0][0])
