"""Integrals of servos along logs: how they grow is measured, where they began is not.

In a long gap nothing is measured, and they begin anew after it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, contiguous

Array = NDArray[np.float64]

LONGEST_BRIDGE = 0.1
"""Gaps over which an error is taken as on a straight line, s; in longer ones it is not known."""


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


def runs_between_gaps(time: Array, error: Array) -> NDArray[np.intp]:
    """(N,) numbers, from 0 on, of the runs of rows over which an integral is known to grow.

    A new one begins after each gap that is longer than `LONGEST_BRIDGE`.

    Args:
        time: (N,) instants, s.
        error: (N,) commanded less measured position; NaN where one is not known.
    """
    known = np.flatnonzero(np.isfinite(error) & np.isfinite(time))
    begins = known[1:][np.diff(time[known]) > LONGEST_BRIDGE]
    return np.searchsorted(begins, np.arange(len(time)), side="right")


def constants_beside_friction(effort: Array, velocity: Array, runs: NDArray[np.intp]) -> Array:
    """(N,) the constant of each run in an effort, N·m or N, that is no friction.

    Friction is that of all runs together; a run of which nothing is known has none.

    Args:
        effort: (N,) the effort; NaN where it is not known.
        velocity: (N,) velocity of the joint, rad/s or m/s.
        runs: (N,) numbers of the runs, from 0 on.
    """
    known = np.isfinite(effort) & np.isfinite(velocity)
    run, v = runs[known], velocity[known]
    columns = np.stack([v, np.sign(v), effort[known]], axis=1)
    means, counts = np.zeros((int(runs.max(initial=0)) + 1, 3)), np.bincount(run)
    for k, column in enumerate(columns.T):
        means[: len(counts), k] = np.bincount(run, column) / np.maximum(counts, 1)
    within = columns - means[run]
    friction = np.linalg.lstsq(within[:, :2], within[:, 2], rcond=None)[0]
    return np.asarray((means[:, 2] - means[:, :2] @ friction)[runs])
