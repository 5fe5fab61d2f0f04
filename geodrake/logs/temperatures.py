"""Temperatures of joints through a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import Array

_FAILED = (-1.0, 0.0, 127.0, 255.0, (255.0 - 32.0) / 1.8)  # °C, what sensors that fail read
_ROUNDING = 1e-4  # °C, of conversions and of numbers of 32 bits
_NEAR = 5.0  # °C, from one of these within which another reading may make it a true one
_SECOND = 1.0  # over which readings are averaged, as they come in whole degrees and change slowly


@dataclass(frozen=True, eq=False)
class Temperatures:
    """Courses of the temperatures of joints."""

    # Joint -> instants since its log began (K,), s, and temperatures (K,), °C.
    courses: Mapping[str, tuple[Array, Array]]

    @classmethod
    def of(cls, joints: Sequence[str], time: Array, readings: Array | None) -> Temperatures | None:
        """Return the courses of measured temperatures, averaged second by second.

        Readings (N, n), °C, of sensors that fail are left out, such as 0 far from all others.
        """
        if readings is None:
            return None
        since = time - time[np.isfinite(time)][0]
        both = zip(joints, map(_without_failed, readings.T), strict=True)
        courses = {joint: _averaged(since, own) for joint, own in both if np.isfinite(own).any()}
        return cls(courses) if courses else None

    def at(self, time: ArrayLike, joints: Sequence[str]) -> Array:
        """Return (N, n), °C, at instants (N,), s since the log began; NaN at joints without."""
        instants = np.atleast_1d(np.asarray(time, float))
        found = np.full((len(instants), len(joints)), np.nan)
        for j, joint in enumerate(joints):
            if joint in self.courses:
                found[:, j] = np.interp(instants, *self.courses[joint])
        return found


def _without_failed(readings: Array) -> Array:
    """Return readings (N,), NaN where the sensor fails."""
    failed = {value: np.isclose(readings, value, rtol=0.0, atol=_ROUNDING) for value in _FAILED}
    true = ~np.any([*failed.values()], axis=0) & np.isfinite(readings)
    for value in _FAILED:
        if not np.any(np.abs(readings[true] - value) <= _NEAR):
            readings = np.where(failed[value], np.nan, readings)
    return readings


def _averaged(time: Array, readings: Array) -> tuple[Array, Array]:
    """Return means (K,) of time and readings (N,) over every second with readings."""
    known = np.isfinite(readings) & np.isfinite(time)
    seconds = np.floor(time[known] / _SECOND)
    _, second, counts = np.unique(seconds, return_inverse=True, return_counts=True)
    mean_time, mean = (np.bincount(second, x[known]) / counts for x in (time, readings))
    return mean_time, mean
