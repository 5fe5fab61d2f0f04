"""Joints that rest while others move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import Array

LARGEST = 1e9
"""Magnitude that positions, velocities and efforts of robots in SI units do not exceed."""

_SHARE = 0.01  # of what the joint of its kind moves that moves most: less is rest
_FAR = 1.0  # rad or m; that a wheel turns a hundred times makes no joint of an arm rest
_STILL = 2e-3  # rad or m, where no joint of its kind moves
_SAMPLES = 100_000  # of a log, by which its noise is judged
_WIDTH = 9.0  # deviations of noise between the least and the largest of very many samples
_WALK = 4.0  # deviations of a random walk's end, beyond which next to none gets
_COARSE = 0.02  # rad or m: no encoder's steps are that far apart
_STEPS = 3.5  # of an encoder, between which a position at rest may change


def readings(column: Array) -> Array:
    """Return values that were measured and are plausible."""
    return column[np.abs(column) <= LARGEST]  # which NaN is not


def logged_ranges(positions: Sequence[Array]) -> tuple[Array, Array, Array]:
    """Return the range of positions of joints over all logs, and that caused by noise.

    Positions (N, n) of each log are in rad or m. Returned are the (n,) least and largest, NaN of a
    joint that was not measured, and the (n,) width that noise and steps of encoders have at rest.
    """
    joints = positions[0].shape[1]
    low, high, wide = np.full(joints, np.nan), np.full(joints, np.nan), np.zeros(joints)
    for j in range(joints):
        for measured in positions:
            here = readings(measured[:, j])
            if len(here):
                low[j] = np.fmin(low[j], here.min())
                high[j] = np.fmax(high[j], here.max())
                wide[j] = max(wide[j], _width(here[:_SAMPLES]))
    return low, high, wide


def resting(
    low: ArrayLike, high: ArrayLike, sliding: ArrayLike, noise: ArrayLike = 0.0
) -> NDArray[np.bool_]:
    """Return (n,) whether joints hardly move, compared with others of their kind.

    Each is told by its least and largest position, rad or m if `sliding`, and by the part of that
    range that is noise.
    """
    sliding = np.asarray(sliding, bool)
    reach = np.maximum(np.subtract(high, low) - noise, 0.0)
    most = np.zeros(len(reach))
    for kind in (sliding, ~sliding):
        most[kind] = np.fmax.reduce(reach[kind], initial=0.0)
    limit = np.where(most > _STILL, _SHARE * np.minimum(most, _FAR), _STILL)
    return np.asarray(reach <= limit)  # NaN is no rest


def travels(velocity: Array, period: float, least: float) -> bool:
    """Return whether measured velocities add up to a motion that their noise does not explain.

    White noise adds up to a random walk; a motion counts from `least` on.
    """
    walk = _WALK * _white_noise(velocity) * np.sqrt(len(velocity)) * period
    return bool(np.ptp(np.cumsum(velocity)) * period > max(least, walk))


def _width(position: Array) -> float:
    """Return the range caused by noise and quantization at rest."""
    changes = np.abs(np.diff(position))
    step = float(changes.min(initial=np.inf, where=changes > 0.0))
    steps = min(_STEPS * step, _COARSE) if np.isfinite(step) else 0.0
    return max(_WIDTH * _white_noise(position), steps)


def _white_noise(signal: Array) -> float:
    """Return the deviation of the white noise of a signal."""
    bends = np.abs(np.diff(signal, 4))  # in which next to nothing of a motion is left
    return float(np.median(bends)) / (0.6745 * np.sqrt(70.0)) if len(bends) else 0.0
