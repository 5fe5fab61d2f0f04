"""Integrals of servos along logs: how they grow is measured, where they began is not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
