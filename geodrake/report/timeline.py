"""Logs laid out one after the other on a common axis of time."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.identification.logs.model_errors import Series

Array = NDArray[np.float64]

_BLOCK = re.compile(r"^(?P<log>.+) -?[\d.]+–-?[\d.]+ s$")
_GAP = 1.5
"""Samples farther apart than so many times the usual are not joined by a line."""


@dataclass(frozen=True)
class Timeline:
    """Logs laid out one after the other on a common axis.

    Attributes:
        spans: Log -> first and last instant in its own time, s.
        shifts: Log -> what to add to its own time, s.
        length: Length of the whole, s.
    """

    spans: Mapping[str, tuple[float, float]]
    shifts: Mapping[str, float]
    length: float

    @classmethod
    def of(cls, series: Sequence[Series]) -> Timeline:
        """The timeline of all logs that series come from."""
        spans: dict[str, tuple[float, float]] = {}
        for s in (s for s in series if len(s.time)):  # not where a joint stands still throughout
            low, high = spans.get(log_of(s), (np.inf, -np.inf))
            spans[log_of(s)] = min(low, float(s.time[0])), max(high, float(s.time[-1]))
        gap = 0.02 * sum(high - low for low, high in spans.values())
        shifts, at = {}, 0.0
        for log, (low, high) in spans.items():
            shifts[log] = at - low
            at += high - low + gap
        return cls(spans, shifts, at - gap)

    def place(self, s: Series) -> Array:
        """(K,) instants on the common axis, s."""
        return s.time + self.shifts[log_of(s)]

    def broken(self, series: Sequence[Series], name: str) -> tuple[Array, Array]:
        """Return instants and values of a signal, NaN where samples are missing."""
        time, values = [np.array([])], [np.array([])]
        for s in series:
            breaks = breaks_of(s.time)
            time.append(np.insert(self.place(s), breaks, np.nan))
            values.append(np.insert(getattr(s, name), breaks, np.nan))
        return np.concatenate(time), np.concatenate(values)


def breaks_of(time: Array) -> NDArray[np.intp]:
    """Where a line breaks: before samples that come late, and at the end."""
    steps = np.diff(time)
    late = 1 + np.flatnonzero(steps > _GAP * np.median(steps)) if len(steps) else steps
    return np.append(late.astype(int), len(time))


def log_of(series: Series) -> str:
    """The log that a block was cut from: its name without the stretch of time."""
    match = _BLOCK.match(series.block)
    return match["log"] if match else series.block
