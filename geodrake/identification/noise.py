"""The noise floor: how much of the measured effort no model of the motion can predict."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import welch
from scipy.stats import gamma

from geodrake.effects.effort_delay import EffortDelay
from geodrake.model import RobotModel
from geodrake.motion import Motion, Segment, Trajectory

Array = NDArray[np.float64]

_LEAST_BINS = 12
_SAMPLES = 100_000  # of a segment that are looked at


def noise_floor(
    trajectories: Sequence[Trajectory],
    model: RobotModel | None = None,
    *,
    sign_width: ArrayLike = 0.0,
) -> Array:
    """RMS of the efforts' sensor noise after filtering, if the noise is white.

    Above the motion's bandwidth the effort's spectrum holds what sensors and power electronics
    add. The quietest band there, continued into the passband, is the floor: coloured noise below
    it cannot be told from an effect, and is not counted. Jumps of dry friction reach beyond the
    bandwidth too; a model fitted to the logs takes them away.

    Args:
        trajectories: The prepared logs.
        model: A model; the floor is then that of its residuals where they are quieter than the
            efforts, as those of a model fitted to the logs are.
        sign_width: (nv,) speed below which the direction of motion is not known, for the model.

    Returns:
        (n,) floor of each joint, N·m or N.
    """
    power, weight = np.zeros(len(trajectories[0].joints)), 0
    for trajectory in trajectories:
        gain, bandwidth = trajectory.filter.noise_gain, trajectory.filter.bandwidth
        for segment in trajectory.segments:
            rate = 1.0 / segment.period
            start = segment[:_SAMPLES]
            density = _quiet_density(start.effort, rate, bandwidth)
            if model is not None:
                residual = _residual(start, model, sign_width, trajectory.began)
                density = np.minimum(density, _quiet_density(residual, rate, bandwidth))
            power += len(segment) * density * gain**2 * rate / 2.0
            weight += len(segment)
    return np.sqrt(power / weight)


def _residual(segment: Segment, model: RobotModel, sign_width: ArrayLike, began: float) -> Array:
    """(K, n) measured − predicted effort at the full rate."""
    q, since = model.positions(segment.position), segment.time - began
    motion = Motion(q, segment.velocity, segment.acceleration, since)
    needed = model.effort(motion, sign_width=sign_width)
    return segment.effort - EffortDelay(model.delay).delayed(needed, segment.period)


def _quiet_density(effort: Array, rate: float, bandwidth: float) -> Array:
    """(n,) one-sided spectral density of the quietest band above the bandwidth, (N·m)²/Hz."""
    length = min(len(effort), max(64, round(8 * rate / bandwidth)))
    frequency, density = welch(effort, rate, "hann", length, axis=0)
    lowest, highest = 1.6 * bandwidth, 0.45 * rate
    averages = max(1.0, 0.9 * (2 * len(effort) / length - 1))
    median = gamma.ppf(0.5, averages) / averages
    bands = max(1, int(np.log2(highest / lowest) * 2))
    edges = np.geomspace(lowest, highest, bands + 1)
    levels = []
    for low, high in pairwise(edges.tolist()):
        inside = (frequency >= low) & (frequency < high)
        if inside.sum() >= _LEAST_BINS:
            levels.append(np.median(density[inside], axis=0) / median)
    if not levels:
        inside = frequency >= min(lowest, frequency[-1])
        levels.append(np.median(density[inside], axis=0) / median)
    return np.min(levels, axis=0)
