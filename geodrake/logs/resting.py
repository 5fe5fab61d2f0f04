"""Joints that rest while others move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import Array

LARGEST = 1e9
"""Largest plausible magnitude of positions, velocities and efforts in SI units."""

_SHARE = 0.01  # of the largest range of a joint of its kind: less is rest
_FAR = 1.0  # rad or m, limit of that range, so that a spinning wheel makes no other joint rest
_STILL = 2e-3  # rad or m, threshold if no joint of its kind moves
_SAMPLES = 100_000  # of a log, to estimate its noise
_WIDTH = 9.0  # range of very many samples of noise, in deviations
_WALK = 4.0  # deviations of the end of a random walk: hardly any goes farther
_COARSE = 0.02  # rad or m, larger than the resolution of any encoder
_STEPS = 3.5  # of an encoder, range of a position at rest


def readings(column: Array) -> Array:
    """Return the plausible measured values of a column."""
    return column[np.abs(column) <= LARGEST]  # excludes NaN


def logged_ranges(positions: Sequence[Array]) -> tuple[Array, Array, Array]:
    """Return the least and largest positions (n,) over all logs, and the range (n,) due to noise.

    Positions (N, n) of each log are in rad or m. Bounds are NaN for joints without measurements.
    Noise includes the quantization of encoders.
    """
    joints = positions[0].shape[1]
    low, high, width = np.full(joints, np.nan), np.full(joints, np.nan), np.zeros(joints)
    for j in range(joints):
        for measured in positions:
            values = readings(measured[:, j])
            if len(values):
                low[j] = np.fmin(low[j], values.min())
                high[j] = np.fmax(high[j], values.max())
                width[j] = max(width[j], _width(values[:_SAMPLES]))
    return low, high, width


def resting(
    low: ArrayLike, high: ArrayLike, sliding: ArrayLike, noise: ArrayLike = 0.0
) -> NDArray[np.bool_]:
    """Return whether joints (n,) hardly move, compared with others of their kind.

    Arguments (n,) are the least and largest positions, rad, or m if `sliding`, and the part of the
    range due to noise.
    """
    sliding = np.asarray(sliding, bool)
    travel = np.maximum(np.subtract(high, low) - noise, 0.0)
    largest = np.zeros(len(travel))
    for kind in (sliding, ~sliding):
        largest[kind] = np.fmax.reduce(travel[kind], initial=0.0)
    limit = np.where(largest > _STILL, _SHARE * np.minimum(largest, _FAR), _STILL)
    return np.asarray(travel <= limit)  # NaN does not rest


def travels(velocity: Array, period: float, least: float) -> bool:
    """Return whether the integral of measured velocities shows more motion than noise explains.

    Integrated white noise is a random walk. A motion is at least `least` long.
    """
    walk = _WALK * _white_noise(velocity) * np.sqrt(len(velocity)) * period
    return bool(np.ptp(np.cumsum(velocity)) * period > max(least, walk))


def _width(position: Array) -> float:
    """Return the range of positions at rest due to noise and quantization."""
    changes = np.abs(np.diff(position))
    step = float(changes.min(initial=np.inf, where=changes > 0.0))
    steps = min(_STEPS * step, _COARSE) if np.isfinite(step) else 0.0
    return max(_WIDTH * _white_noise(position), steps)


def _white_noise(signal: Array) -> float:
    """Return the standard deviation of the white noise in a signal."""
    differences = np.abs(np.diff(signal, 4))  # suppresses the motion
    return float(np.median(differences)) / (0.6745 * np.sqrt(70.0)) if len(differences) else 0.0
