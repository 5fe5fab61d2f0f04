"""Passages of logs in which the robot moves: what is simulated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geodrake.effects.sensors import delayed_by
from geodrake.errors import ArgumentError, LogError
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.reduce import peak_speeds
from geodrake.inertia import Array
from geodrake.logs.motion import MEMORY
from geodrake.logs.smoothing import Segment, Stretch

_MOVING = 0.05  # share of the peak speeds that the mean speed of a passage must have


@dataclass(frozen=True, eq=False)
class Passage:
    """Some seconds of a log in which the robot moves."""

    log: str
    began: float  # the log's first time stamp, s
    # The samples, with the efforts that acted there: a model's delays are taken out.
    segment: Segment
    stretch: Stretch  # the part of the log without gaps that the passage is from
    start: int  # number of its first sample in the stretch

    @property
    def time(self) -> Array:
        """(K,) instants since the log began, s."""
        return self.segment.time - self.began

    @property
    def logged(self) -> Array:
        """(K, nv) positions as they were logged, not smoothed."""
        first = self.stretch.first + self.start
        return self.stretch.piece[first : first + len(self.segment)].position

    @property
    def before(self) -> Array:
        """(M, nv) positions right before the first sample, as far as effects look back."""
        return self.stretch[max(0, self.start - MEMORY) : self.start].position


Span = tuple[str, float, float]


def chosen_passages(
    case: Case, horizon: float, most: int, within: Sequence[Span] | None = None
) -> list[Passage]:
    """Choose passages of a length, spread evenly over all in which the robot of a case moves.

    Args:
        horizon: Length of each passage, s.
        within: Logs, and first and last instants of theirs, s, outside of which none is; anywhere
            if None.
    """
    peak = peak_speeds(case.trajectories)
    found = [
        Passage(trajectory.name, trajectory.began, segment, stretch, start)
        for trajectory in case.trajectories
        for stretch in trajectory.segments
        for start, segment in _moving(stretch, horizon, peak, case.model.delays)
        if within is None or any(_holds(span, trajectory.name, segment.time) for span in within)
    ]
    if not found:
        raise LogError(
            f"No log has {horizon:g} s of motion without a gap.",
            advice="Use a shorter horizon, or a longer log.",
        )
    count = min(most, len(found))
    chosen = np.unique(np.linspace(0, len(found) - 1, count).round().astype(int))
    return [found[k] for k in chosen.tolist()]


def _holds(span: Span, log: str, time: Array) -> bool:
    name, first, last = span
    return name == log and first <= time[0] and time[-1] <= last


def _moving(
    stretch: Stretch, seconds: float, peak: Array, delays: Array
) -> Iterator[tuple[int, Segment]]:
    """Yield the passages of a stretch, one after another, with the numbers of first samples."""
    count = round(seconds / stretch.period) + 1
    if count < 2:
        raise ArgumentError(
            f"A horizon of {seconds:g} s is shorter than the sampling period of "
            f"{stretch.period:.4g} s.",
            advice="Use a longer one.",
        )
    ahead = round(float(np.abs(delays).max()) / stretch.period) + 1
    for start in range(ahead, len(stretch) - count - ahead, count):
        near = stretch[start - ahead : start + count + ahead]
        inner = near[ahead : ahead + count]
        speed = np.abs(inner.velocity) / np.maximum(peak, 1e-300)
        if speed.mean(0).max() > _MOVING:
            effort = delayed_by(-delays, near.effort, stretch.period)
            yield start, replace(inner, effort=effort[ahead:][:count])
