"""Pieces of a log that are resampled and smoothed on access only.

A log of hours fills memory by itself; its uniform, smoothed and differentiated copies would do so
four times over. Each slice is therefore made from the raw rows around it. Splines and filters
forget what is far away, so that a slice does not depend, beyond rounding, on how a stretch is cut.
Those of a short log are made once, and kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import Array
from geodrake.logs.filtering import ZeroPhaseFilter, differentiate, resample

CHUNK = 20_000
"""Samples that are resampled and smoothed at once."""

_KEPT = 50_000
"""Samples of a log that stay in memory, smoothed, where it has no more."""

SPLINE_REACH = 40
"""Samples beyond which an interpolating spline is not affected by a change."""


@dataclass(frozen=True, eq=False)
class Piece:
    """Rows of a log between gaps, as logged (K, n), seen at uniform instants."""

    time: Array
    position: Array
    velocity: Array | None  # if any are of use
    effort: Array
    period: float  # time between the uniform instants, s
    acceleration: Array | None = None  # (K, m) those of joints where they are used
    measured: tuple[int, ...] = ()  # (m,) which joints these are
    ground: Array | None = None  # the part of the efforts that is of measured wrenches

    def __len__(self) -> int:
        return int((self.time[-1] - self.time[0]) / self.period + 1e-3) + 1

    def __getitem__(self, samples: slice) -> Piece:
        """Return some of its samples, resampled; those of a short log once and for all."""
        start, stop, _ = samples.indices(len(self))
        if len(self) <= _KEPT:
            return self._whole.rows(slice(start, stop))
        return self._resampled(start, stop)

    @cached_property
    def _whole(self) -> Piece:
        whole = self._resampled(0, len(self))
        for signal in (whole.time, *whole.signals.values()):
            signal.setflags(write=False)  # whoever looks gets a view
        return whole

    def _resampled(self, start: int, stop: int) -> Piece:
        grid = self.time[0] + self.period * np.arange(start, stop)
        grid = np.minimum(grid, self.time[-1])
        before, after = np.searchsorted(self.time, grid[[0, -1]]) if len(grid) else (0, 0)
        near = self.rows(slice(max(0, before - SPLINE_REACH), after + SPLINE_REACH))
        signals: dict[str, Any] = {
            name: resample(near.time, signal, grid, sharp=name in ("effort", "ground"))
            for name, signal in near.signals.items()
        }
        return replace(self, time=grid, **signals)

    @property
    def signals(self) -> dict[str, Array]:
        """Its signals besides time, by name."""
        names = ("position", "velocity", "acceleration", "effort", "ground")
        return {name: signal for name in names if (signal := getattr(self, name)) is not None}

    def rows(self, rows: slice | NDArray[np.intp]) -> Piece:
        """Return some of its rows."""
        signals: dict[str, Any] = {name: signal[rows] for name, signal in self.signals.items()}
        return replace(self, time=self.time[rows], **signals)


@dataclass(frozen=True, eq=False)
class Segment:
    """Samples of a log without gaps, at uniform instants.

    Positions, velocities and accelerations (N, n) are smooth. Efforts are resampled but not
    filtered, as regressors are later; `ground` is the part of them that is of measured wrenches.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    effort: Array
    period: float
    ground: Array | None = None

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, samples: slice) -> Segment:
        ground = None if self.ground is None else self.ground[samples]
        time, position, velocity, acceleration, effort = (x[samples] for x in self.signals)
        return Segment(time, position, velocity, acceleration, effort, self.period, ground)

    @property
    def motor_effort(self) -> Array:
        """(N, n) efforts of the motors alone, without those of measured wrenches."""
        return self.effort if self.ground is None else self.effort - self.ground

    @property
    def signals(self) -> tuple[Array, ...]:
        """Time, position, velocity, acceleration and effort."""
        return self.time, self.position, self.velocity, self.acceleration, self.effort


@dataclass(frozen=True, eq=False)
class Stretch:
    """Usable part of a piece of a log, smoothed and differentiated slice by slice."""

    piece: Piece
    smoother: ZeroPhaseFilter
    # (n,) time by which measured velocities are late, s; NaN of those that are derived from the
    # positions instead, None if all are.
    lag: Array | None
    first: int  # first of the piece's samples that is in it
    stop: int
    whole: Segment | None = None  # the whole piece, smoothed, if it stays in memory

    @property
    def period(self) -> float:
        """Time between samples, s."""
        return self.piece.period

    @property
    def derived(self) -> NDArray[np.bool_]:
        """(n,) whether velocities are derived from the positions."""
        joints = self.piece.position.shape[1]
        return np.ones(joints, bool) if self.lag is None else np.isnan(self.lag)

    def __len__(self) -> int:
        return self.stop - self.first

    def __getitem__(self, samples: slice) -> Segment:
        """Return some of the samples, in memory."""
        start, stop, _ = samples.indices(len(self))
        start, stop = self.first + start, self.first + max(start, stop)
        return self._smoothed(start, stop) if self.whole is None else self.whole[start:stop]

    @cached_property
    def peak_speed(self) -> Array:
        """(n,) largest speed of every joint, rad/s or m/s."""
        peaks = []
        for first in range(self.first, self.stop, CHUNK):
            stop = min(first + CHUNK, self.stop)
            if self.whole is not None:
                velocity = self.whole.velocity[first:stop]
            else:
                _, inner, _, near = self._near(first, stop)
                velocity = near[inner]
            peaks.append(np.abs(velocity).max(axis=0))
        return np.max(peaks, axis=0)

    def chunks(self, *, backwards: bool = False) -> Iterator[tuple[int, Segment]]:
        """Yield the first sample and samples of one slice after another, from either end."""
        starts = range(0, len(self), CHUNK)
        for first in reversed(starts) if backwards else starts:
            yield first, self[first : first + CHUNK]

    def _near(self, start: int, stop: int) -> tuple[Piece, slice, Array, Array]:
        """Return samples with those around them, and positions and velocities (N, n) of all."""
        margin = self.smoother.halfwidth + 2 * SPLINE_REACH  # velocities, then accelerations
        low, high = max(0, start - margin), min(len(self.piece), stop + margin)
        near, inner = self.piece[low:high], slice(start - low, stop - low)
        position = self.smoother.smooth(near.position)
        if self.lag is None or near.velocity is None:
            velocity = differentiate(position, self.period)
        else:
            late = self.smoother.smooth(near.velocity)
            velocity = late + self.lag * differentiate(late, self.period)
            if (derived := self.derived).any():
                velocity[:, derived] = differentiate(position[:, derived], self.period)
        return near, inner, position, velocity

    def _smoothed(self, start: int, stop: int) -> Segment:
        near, inner, position, velocity = self._near(start, stop)
        acceleration = differentiate(velocity, self.period)
        if near.acceleration is not None:
            acceleration[:, near.measured] = self.smoother.smooth(near.acceleration)
        return Segment(
            near.time[inner],
            position[inner],
            velocity[inner],
            acceleration[inner],
            near.effort[inner],
            self.period,
            None if near.ground is None else near.ground[inner],
        )


def smooth_pieces(
    pieces: Sequence[Piece], smoother: ZeroPhaseFilter, lag: Array | None
) -> tuple[Stretch, ...]:
    """Return the pieces of a log, smoothed on access; see `Stretch` for arguments."""
    found = tuple(Stretch(piece, smoother, lag, 0, len(piece)) for piece in pieces)
    if sum(map(len, pieces)) > _KEPT:
        return found
    whole = [stretch[:] for stretch in found]
    for signal in (signal for segment in whole for signal in segment.signals):
        signal.setflags(write=False)  # whoever looks gets a view
    return tuple(replace(each, whole=own) for each, own in zip(found, whole, strict=True))
