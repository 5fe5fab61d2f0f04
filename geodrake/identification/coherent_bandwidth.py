"""The bandwidth below which a motion and the measured efforts belong together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from geodrake.model import RobotModel
from geodrake.motion import Motion, Trajectory

Array = NDArray[np.float64]

_EXCESS = 25.0
"""Power by which the needed effort must exceed the measured one: five times its amplitude."""

_SAMPLES = 200_000
"""Samples of the logs that are looked at."""


def coherent_bandwidth(model: RobotModel, trajectories: Sequence[Trajectory]) -> float | None:
    """Frequency above which the motion asks for efforts that were not measured, Hz.

    Vibration, play and elasticity behind the motor move the joint without the motor's effort, and
    position noise asks for efforts that nobody gave. No rigid-body model fits there.

    Args:
        model: The model; a rough one will do.
        trajectories: Prepared logs.

    Returns:
        The frequency from which on the effort that the model needs has more than 25 times the
        measured power, the geometric mean over joints; None if it has not up to the bandwidth.
    """
    bandwidth = trajectories[0].filter.bandwidth
    needed = measured = frequency = np.zeros(1)
    shortest = min(len(s) * s.period for t in trajectories for s in t.segments)
    window = min(0.5 * shortest, 100.0 / bandwidth)
    for segment in (s for t in trajectories for s in t.segments):
        part = slice(0, _SAMPLES)
        position = model.positions(segment.position[part])
        motion = Motion(position, segment.velocity[part], segment.acceleration[part])
        length = int(window / segment.period)
        frequency, density = welch(model.effort(motion), 1 / segment.period, "hann", length, axis=0)
        needed = needed + len(segment) * density
        measured = (
            measured
            + len(segment)
            * welch(segment.effort[part], 1 / segment.period, "hann", length, axis=0)[1]
        )
    inside = (frequency > 0) & (frequency <= bandwidth)
    ratio = np.exp(np.mean(np.log(needed[inside] / measured[inside]), axis=1))
    worst = int(np.argmax(ratio))
    if ratio[worst] <= _EXCESS:
        return None
    together = np.flatnonzero(ratio[:worst] <= _EXCESS)
    return float(frequency[inside][together[-1] + 1 if len(together) else 0])
