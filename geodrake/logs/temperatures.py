"""Temperatures of joints during a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import Array

_FAILED = (-1.0, 0.0, 127.0, 255.0, (255.0 - 32.0) / 1.8)  # °C, readings of failed sensors
_ROUNDING = 1e-4  # °C, of conversions and 32-bit numbers
_NEAR = 5.0  # °C; such a reading is valid if another one is closer to it than this
_SECOND = 1.0  # s, over which readings are averaged, as they change slowly, by whole degrees


@dataclass(frozen=True, eq=False)
class Temperatures:
    """Temperatures of joints over time."""

    # Joint -> instants (K,), s since the log began, and temperatures (K,), °C.
    courses: Mapping[str, tuple[Array, Array]]

    @classmethod
    def of(cls, joints: Sequence[str], time: Array, readings: Array | None) -> Temperatures | None:
        """Return measured temperatures, averaged over seconds, or None.

        Readings (N, n), °C, of failed sensors are left out, such as 0 far from all others.
        """
        if readings is None:
            return None
        since = time - time[np.isfinite(time)][0]
        pairs = zip(joints, map(_without_failed, readings.T), strict=True)
        courses = {joint: _averaged(since, raw) for joint, raw in pairs if np.isfinite(raw).any()}
        return cls(courses) if courses else None

    def at(self, time: ArrayLike, joints: Sequence[str]) -> Array:
        """Return temperatures (N, n), °C, or NaN, at instants (N,), s since the log began."""
        instants = np.atleast_1d(np.asarray(time, float))
        temperatures = np.full((len(instants), len(joints)), np.nan)
        for j, joint in enumerate(joints):
            if joint in self.courses:
                temperatures[:, j] = np.interp(instants, *self.courses[joint])
        return temperatures


def _without_failed(readings: Array) -> Array:
    """Return readings (N,), with NaN where the sensor failed."""
    failed = {value: np.isclose(readings, value, rtol=0.0, atol=_ROUNDING) for value in _FAILED}
    valid = ~np.any([*failed.values()], axis=0) & np.isfinite(readings)
    for value in _FAILED:
        if not np.any(np.abs(readings[valid] - value) <= _NEAR):
            readings = np.where(failed[value], np.nan, readings)
    return readings


def _averaged(time: Array, readings: Array) -> tuple[Array, Array]:
    """Average time and readings (N,) over each of the K seconds with readings."""
    known = np.isfinite(readings) & np.isfinite(time)
    seconds = np.floor(time[known] / _SECOND)
    _, second, counts = np.unique(seconds, return_inverse=True, return_counts=True)
    mean_time, mean = (np.bincount(second, x[known]) / counts for x in (time, readings))
    return mean_time, mean
