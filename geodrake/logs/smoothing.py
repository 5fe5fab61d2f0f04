"""Pieces of a log that are resampled and smoothed on access.

A log of hours fills the memory; its uniform, smoothed and differentiated copies would need four
times as much. Each slice is therefore computed from the raw rows around it. As splines and filters
are local, a slice depends on the way a stretch is cut only within rounding. Slices of a short log
are views of a copy in memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import Array
from geodrake.logs.filtering import SPLINE_REACH, ZeroPhaseFilter, differentiate, resample

CHUNK = 20_000
"""Number of samples that are smoothed at once."""

_KEPT = 50_000
"""Number of samples up to which a log's smoothed copy stays in memory."""


@dataclass(frozen=True, eq=False)
class Piece:
    """Rows (K, n) of a log between gaps, with access to samples at uniform instants."""

    time: Array
    position: Array
    velocity: Array | None  # if usable
    effort: Array
    period: float  # time between the uniform instants, s
    acceleration: Array | None = None  # (K, m) of the joints that use them
    measured: tuple[int, ...] = ()  # (m,) indices of these joints
    ground: Array | None = None  # contribution of measured wrenches to the efforts
    held: int = 1  # every how many rows efforts are new; between, they are interpolated

    def __len__(self) -> int:
        return int((self.time[-1] - self.time[0]) / self.period + 1e-3) + 1

    def __getitem__(self, samples: slice) -> Piece:
        """Return resampled samples; a short log is resampled only once."""
        start, stop, _ = samples.indices(len(self))
        if len(self) <= _KEPT:
            return self._whole.rows(slice(start, stop))
        return self._resampled(start, stop)

    @cached_property
    def _whole(self) -> Piece:
        whole = self._resampled(0, len(self))
        for signal in (whole.time, *whole.signals.values()):
            signal.setflags(write=False)  # slices are views
        return whole

    def _resampled(self, start: int, stop: int) -> Piece:
        grid = self.time[0] + self.period * np.arange(start, stop)
        grid = np.minimum(grid, self.time[-1])
        before, after = np.searchsorted(self.time, grid[[0, -1]]) if len(grid) else (0, 0)
        surroundings = self.rows(slice(max(0, before - SPLINE_REACH), after + SPLINE_REACH))
        signals: dict[str, Any] = {
            name: resample(surroundings.time, signal, grid, sharp=name in ("effort", "ground"))
            for name, signal in surroundings.signals.items()
        }
        return replace(self, time=grid, **signals)

    @property
    def signals(self) -> dict[str, Array]:
        """Signals other than time, by name."""
        names = ("position", "velocity", "acceleration", "effort", "ground")
        return {name: signal for name in names if (signal := getattr(self, name)) is not None}

    def rows(self, rows: slice | NDArray[np.intp]) -> Piece:
        """Return selected rows."""
        signals: dict[str, Any] = {name: signal[rows] for name, signal in self.signals.items()}
        return replace(self, time=self.time[rows], **signals)


@dataclass(frozen=True, eq=False)
class Segment:
    """Samples of a log without gaps, at uniform instants.

    Positions, velocities and accelerations (N, n) are smooth. Efforts are resampled, but filtered
    only later, with the regressors; `ground` is the contribution of measured wrenches to them.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    effort: Array
    period: float
    ground: Array | None = None
    held: int = 1  # as in `Piece`

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, samples: slice) -> Segment:
        ground = None if self.ground is None else self.ground[samples]
        time, position, velocity, acceleration, effort = (x[samples] for x in self.signals)
        return replace(
            self,
            time=time,
            position=position,
            velocity=velocity,
            acceleration=acceleration,
            effort=effort,
            ground=ground,
        )

    @property
    def motor_effort(self) -> Array:
        """(N, n) efforts without the contribution of measured wrenches."""
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
    # (n,) lags of measured velocities, s; NaN if derived from the positions, None if all are.
    lag: Array | None
    first: int  # index of the first sample in the piece
    stop: int
    whole: Segment | None = None  # the whole smoothed piece, if it stays in memory

    @property
    def period(self) -> float:
        """Time between samples, s."""
        return self.piece.period

    @property
    def derived(self) -> NDArray[np.bool_]:
        """(n,) whether velocities are derived from positions."""
        joints = self.piece.position.shape[1]
        return np.ones(joints, bool) if self.lag is None else np.isnan(self.lag)

    def __len__(self) -> int:
        return self.stop - self.first

    def __getitem__(self, samples: slice) -> Segment:
        """Return a slice of samples, smoothed."""
        start, stop, _ = samples.indices(len(self))
        start, stop = self.first + start, self.first + max(start, stop)
        return self._smoothed(start, stop) if self.whole is None else self.whole[start:stop]

    @cached_property
    def peak_speed(self) -> Array:
        """(n,) largest speeds of the joints, rad/s or m/s."""
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
        """Yield successive slices, each with the index of its first sample."""
        starts = range(0, len(self), CHUNK)
        for first in reversed(starts) if backwards else starts:
            yield first, self[first : first + CHUNK]

    def _near(self, start: int, stop: int) -> tuple[Piece, slice, Array, Array]:
        """Return surrounding samples, the slice of those requested, and smooth q and v (N, n)."""
        margin = self.smoother.halfwidth + 2 * SPLINE_REACH  # velocities, then accelerations
        low, high = max(0, start - margin), min(len(self.piece), stop + margin)
        piece, inner = self.piece[low:high], slice(start - low, stop - low)
        position = self.smoother.smooth(piece.position)
        if self.lag is None or piece.velocity is None:
            velocity = differentiate(position, self.period)
        else:
            lagging = self.smoother.smooth(piece.velocity)
            velocity = lagging + self.lag * differentiate(lagging, self.period)
            if (derived := self.derived).any():
                velocity[:, derived] = differentiate(position[:, derived], self.period)
        return piece, inner, position, velocity

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
            near.held,
        )


def smooth_pieces(
    pieces: Sequence[Piece], smoother: ZeroPhaseFilter, lag: Array | None
) -> tuple[Stretch, ...]:
    """Return the pieces of a log as stretches; see `Stretch` for arguments."""
    stretches = tuple(Stretch(piece, smoother, lag, 0, len(piece)) for piece in pieces)
    if sum(map(len, pieces)) > _KEPT:
        return stretches
    whole = [stretch[:] for stretch in stretches]
    for signal in (signal for segment in whole for signal in segment.signals):
        signal.setflags(write=False)  # slices are views
    return tuple(replace(each, whole=smooth) for each, smooth in zip(stretches, whole, strict=True))
