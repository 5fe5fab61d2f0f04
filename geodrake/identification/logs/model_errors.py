"""Errors of a model on logs: by joint, by circumstance, and over time."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from geodrake.boundary.showing import Short, Shown
from geodrake.identification.logs.criteria import JOINT_NOISE_MARGIN, NOISE_MARGIN

Array = NDArray[np.float64]

_BLOCK = re.compile(r"^(?P<log>.+) -?[\d.]+–-?[\d.]+ s$")
_SHARE = 0.03  # length of the averaging window, relative to a joint's samples
_LEAST_SAMPLES = 5
_NOTABLE = 2.0  # mean square of a bad window, relative to the joint's


@dataclass(frozen=True)
class JointError:
    """Error of one joint's effort, N·m or N."""

    joint: str
    rms: float  # RMS of measured − predicted effort
    # Standard deviation of the measured effort; for a joint at rest its holding effort, or the
    # largest effort of gravity.
    std: float
    floor: float  # estimated RMS of the sensor noise
    knows_noise: bool = True  # whether the floor is known independently of a model

    @property
    def nrms(self) -> float:
        """RMS over standard deviation."""
        return self.rms / self.std

    @property
    def shows_noise(self) -> bool:
        """Whether the floor is positive, unlike that of filtered efforts."""
        return self.floor > 0.0

    @property
    def is_noise(self) -> bool:
        """Whether the joint's error is only sensor noise."""
        return self.rms <= JOINT_NOISE_MARGIN * self.floor

    @property
    def removable(self) -> float:
        """Share of the squared error that a model could still remove; NaN without a floor."""
        if not self.shows_noise:
            return math.nan
        return max(0.0, 1.0 - (self.floor / self.rms) ** 2) if self.rms > 0 else 0.0


def _root_mean_square(values: Iterator[float]) -> float:
    return float(np.sqrt(np.mean(np.square([*values]))))


@dataclass(frozen=True)
class ErrorTable(Short):
    """Errors of all joints."""

    joints: tuple[JointError, ...]

    @property
    def nrms(self) -> float:
        """Root mean square over joints of rms / std."""
        return _root_mean_square(joint.nrms for joint in self.joints)

    @property
    def floor_nrms(self) -> float:
        """The nrms of the noise floor."""
        return _root_mean_square(joint.floor / joint.std for joint in self.joints)

    @property
    def pooled_rms(self) -> float:
        """Root mean square over joints of the RMS, N·m or N."""
        return _root_mean_square(joint.rms for joint in self.joints)

    @property
    def pooled_floor(self) -> float:
        """Root mean square over joints of the noise floor, N·m or N."""
        return _root_mean_square(joint.floor for joint in self.joints)

    @property
    def shows_noise(self) -> bool:
        """Whether the floor is positive, unlike that of filtered efforts."""
        return self.floor_nrms > 0.0

    @property
    def knows_noise(self) -> bool:
        """Whether the noise of all joints is known independently of a model, and small enough.

        If noise dominates the efforts, any error passes for noise.
        """
        return not self.is_mostly_noise and all(joint.knows_noise for joint in self.joints)

    @property
    def is_mostly_noise(self) -> bool:
        """Whether noise is at least half of the mean square of the efforts."""
        return self.floor_nrms**2 >= 0.5

    @property
    def is_noise(self) -> bool:
        """Whether the error is only sensor noise, in total and at every joint."""
        return self.whole_is_noise and not self.above_noise

    @property
    def whole_is_noise(self) -> bool:
        """Whether the total error is only sensor noise."""
        return self.nrms <= NOISE_MARGIN * self.floor_nrms

    @property
    def above_noise(self) -> tuple[JointError, ...]:
        """Joints whose error exceeds noise."""
        return tuple(joint for joint in self.joints if not joint.is_noise)

    def by_joint(self) -> dict[str, float]:
        """Return the RMS of each joint by name."""
        return {joint.joint: joint.rms for joint in self.joints}


@dataclass(frozen=True, eq=False)
class Series(Short):
    """Filtered and decimated signals (K,) of one joint in one block, for figures."""

    joint: str
    block: str
    time: Array  # s
    position: Array  # rad or m
    velocity: Array  # rad/s or m/s
    acceleration: Array  # rad/s² or m/s²
    measured: Array  # effort, N·m or N
    predicted: Array  # effort, N·m or N

    @property
    def log(self) -> str:
        """Name of the log that the block was cut from."""
        return _log_of(self.block)

    @property
    def residual(self) -> Array:
        """(K,) measured − predicted."""
        return self.measured - self.predicted


@dataclass(frozen=True)
class Failing:
    """A circumstance in which a joint's error is larger than elsewhere."""

    joint: str
    circumstance: str  # such as "at speeds below 0.05 rad/s"
    rms: float  # RMS of the error there, N·m or N
    elsewhere: float  # RMS of the error elsewhere, N·m or N
    share: float  # share of the joint's squared error there
    time: float  # share of the samples there
    unit: str = "N·m"  # of the joint's effort


@dataclass(frozen=True, eq=False)
class Comparison(Shown):
    """Errors of a model on logs, and where they are largest."""

    errors: ErrorTable
    failing: tuple[Failing, ...]  # where the error is concentrated, worst first
    series: tuple[Series, ...]  # measured and predicted signals
    notes: tuple[str, ...]  # on the preparation of the logs, and on the model
    first: tuple[str, ...] = ()  # the most important of these: doubts and unused data


@dataclass(frozen=True)
class WorstWindow:
    """A time window with an unusually large error of a joint."""

    joint: str
    block: str  # name of its fold
    start: float  # first instant in the log's time, s
    end: float  # last instant, s
    rms: float  # of measured − predicted effort there, N·m or N
    share: float  # share of the joint's squared error there

    @property
    def log(self) -> str:
        """Name of the log that the block was cut from."""
        return _log_of(self.block)


def _log_of(block: str) -> str:
    """Return the name of a block without its time window."""
    match = _BLOCK.match(block)
    return match["log"] if match else block


def worst_windows(series: Sequence[Series], *, most: int = 3) -> tuple[WorstWindow, ...]:
    """Return the worst windows of one joint, by their share of its squared error.

    There are none if the error is about uniform.
    """
    squares = [np.square(s.residual) for s in series]
    count, total = sum(map(len, squares)), float(sum(block.sum() for block in squares))
    if total == 0.0 or not np.isfinite(total):
        return ()
    width = max(_LEAST_SAMPLES, round(_SHARE * count))
    windows = []
    for s, square in zip(series, squares, strict=True):
        if len(square) < 2:
            continue
        above = uniform_filter1d(square, min(width, len(square))) > _NOTABLE * total / count
        edges = np.flatnonzero(np.diff(np.concatenate([[False], above, [False]])))
        for first, last in edges.reshape(-1, 2).tolist():
            if last - first >= 2:
                times = float(s.time[first]), float(s.time[last - 1])
                rms, share = np.sqrt(square[first:last].mean()), square[first:last].sum() / total
                windows.append(WorstWindow(s.joint, s.block, *times, float(rms), float(share)))
    return tuple(sorted(windows, key=lambda window: -window.share)[:most])
