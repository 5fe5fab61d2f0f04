"""Sensor faults: outliers, wraps, stuck readings, impossible values.

A fault differs from motion by its size: a robot's steps from row to row are of similar size
throughout a log, whereas those of a faulty sensor are arbitrary. On 97 joints of 20 public logs
(UR10e, TX40, EMPS, LWR4, KR300 and a double pendulum at 100 Hz to 1 kHz, with payloads, pushes and
fast reversals) the largest step of a position is 2.2 times an ordinary one, at 15 rad/s; that of a
velocity 12 times, at 1,800 rad/s²; that of an effort 14 times, at 1.2e6 N·m/s. While a joint moves,
its effort is constant for at most 0.02 s, and its position until it has moved by 4e-4 rad. The
thresholds are about ten times as large. Deviations that last one or two rows are at most 6.5
ordinary steps high. Faulty readings are treated as empty cells, and reported.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import Array
from geodrake.errors import LogError
from geodrake.logs.motion import JointLog
from geodrake.logs.resting import LARGEST, travels
from geodrake.logs.time_stamps import longest_step
from geodrake.logs.units_of_values import check_ticks

Indices = NDArray[np.intp]

_JUMP = {"position": (20.0, 20.0), "velocity": (100.0, 1e5), "effort": (100.0, 1e7)}
"""Least size of a jump, in ordinary steps, and its least rate, in units of the quantity per s."""

_BLOCK, _ORDINARY = 50, 0.75  # rows, and the share of such blocks without a larger step
_FEW = 5  # rows, longest spike
_MOST, _ENOUGH = 0.99, 200_000  # share of steps that are ordinary, and number of steps examined
_BRIEF = 2  # rows, longest spike below the rate of a jump
_APART, _SMALL = 15.0, 4.0  # ordinary steps: higher spikes count if none is between these
_FEWEST = 3  # dropouts
_BACK = 0.15  # of a spike's height, largest difference of the readings before and after it
_ALONE = 0.05  # of a jump, largest step just before and after it
_TURNS, _WRAP = (2.0 * np.pi, 360.0), 0.05  # one turn, and the tolerance of a wrap relative to it
_FROZEN_SECONDS, _FROZEN_ROWS = 0.25, 20  # shortest duration of a frozen reading
_MOVING = 0.1, 0.01, 0.02  # share of the peak speed, rad/s or m/s, and rad or m: a moving joint
_HELD_RANGE, _HELD_SPEED = 2e-3, 0.05  # rad or m, and of the fastest joint's RMS: a held joint
_CATCH_UP = 3.0  # step at the end of a frozen position, relative to the largest elsewhere
_RARE = 20.0  # duration of a frozen effort relative to the 99 % quantile of constant efforts
_MOST_FROZEN = 0.5  # of a log; if more is frozen, the log is refused


def without_faults(log: JointLog) -> JointLog:
    """Return a log without its sensor faults, with notes; itself if it has none.

    Positions that wrap at a full turn are unwrapped. Readings become NaN if they jump and return
    within a few rows, and if positions or efforts are stuck while the joint moves. So do the last
    positions before a permanent jump.
    """
    check_ticks(log)
    steps = np.diff(log.time[np.isfinite(log.time)])
    if not len(steps):
        return log
    period, notes, repaired = float(np.median(steps)), list(log.notes), dict[str, Any]()
    for quantity in _JUMP:
        for joint in range(0 if getattr(log, quantity) is None else len(log.joints)):
            with np.errstate(over="ignore"):  # by corrupt numbers
                column, messages = _Sensor.of(log, quantity, joint, period).repaired()
            if messages:
                repaired.setdefault(quantity, getattr(log, quantity).copy())[:, joint] = column
                notes += messages
    return replace(log, **repaired, notes=tuple(notes)) if repaired else log


def _dropouts(values: Array) -> Indices:
    """Return the readings (K,) of zero for one or two rows, far from those before and after.

    A few are needed, as a single one may be anything.
    """
    zero = np.concatenate([[True], values == 0.0, [True]])
    edges = np.flatnonzero(zero[1:] != zero[:-1])  # of runs of other readings
    first, last = edges[1:-1:2], edges[2::2]  # of runs of zeros between them
    steps = np.abs(np.diff(values))[~(zero[1:-2] | zero[2:-1])]
    if len(first) < _FEWEST or not len(steps):
        return np.zeros(0, int)
    resolution = np.diff(np.unique(values)).min()  # of coarse readings, for which 0 is a level
    ordinary = max(np.quantile(steps, _MOST), resolution)
    before, after = values[first - 1], values[last]
    is_far = np.minimum(np.abs(before), np.abs(after)) > _SMALL * ordinary
    is_far &= (last - first <= _BRIEF) & (np.abs(after - before) <= _SMALL * ordinary)
    if np.count_nonzero(is_far) < _FEWEST:
        return np.zeros(0, int)
    runs = zip(first[is_far].tolist(), last[is_far].tolist(), strict=True)
    return np.concatenate([np.arange(begin, end) for begin, end in runs])


@dataclass(frozen=True, eq=False)
class _Sensor:
    """Measurements of one sensor of one joint."""

    log: JointLog
    quantity: str
    joint: int
    period: float  # typical time between rows, s
    rows: Indices | slice  # (K,) rows with readings; a slice for all
    time: Array  # (K,) instants, s
    values: Array  # (K,) readings
    dropouts: Indices  # rows with zero where nothing was read

    @classmethod
    def of(cls, log: JointLog, quantity: str, joint: int, period: float) -> _Sensor:
        """Return the measurements of a quantity of a joint."""
        column = getattr(log, quantity)[:, joint]
        known = np.isfinite(column) & np.isfinite(log.time)
        dropouts = np.flatnonzero(known)[_dropouts(column[known])]
        known[dropouts] = False
        rows = slice(None) if known.all() else np.flatnonzero(known)
        return cls(log, quantity, joint, period, rows, log.time[rows], column[rows], dropouts)

    @property
    def name(self) -> str:
        """Name in messages, such as `position of elbow`."""
        return f"{self.quantity} of {self.log.joints[self.joint]}"

    def repaired(self) -> tuple[Array, list[str]]:
        """Return the log's column (N,) without faults, and notes on these."""
        column = getattr(self.log, self.quantity)[:, self.joint]
        values, words = self._unwrapped() if self.quantity == "position" else (self.values, "")
        notes = [f"the {self.name} {words}"] if words else []
        if len(self.dropouts):
            first = self.log.time[self.dropouts[0]]
            words = f"drops to 0 in {len(self.dropouts)} rows, the first at t = {first:.2f} s"
            notes.append(f"the {self.name} {words}: not used")
        invalid = np.zeros(len(values), bool)
        for where, words in replace(self, values=values)._faults():
            invalid[where] = True
            notes.append(f"the {self.name} {words}: not used")
        if notes:
            column = column.copy()
            column[self.rows] = np.where(invalid, np.nan, values)
            column[self.dropouts] = np.nan
        return column, notes

    def _faults(self) -> Iterator[tuple[Indices | slice, str]]:
        """Yield invalid readings, and descriptions of their faults."""
        jumps = self._jumps()
        spikes = self._spikes(jumps)
        if len(spikes):
            first = spikes[0]
            count = f"{len(spikes)} outliers, the first" if len(spikes) > 1 else "an outlier"
            yield (
                spikes,
                f"has {count} at t = {self.time[first]:.2f} s: {self.values[first]:.4g}",
            )
        self._check_possible(spikes)
        explained = [spikes, spikes - 1]
        for first, last in self._frozen(jumps):
            seconds = self.time[last] - self.time[first]
            words = (
                f"is stuck at {self.values[first]:.4g} for {seconds:.3g} s from t = "
                f"{self.time[first]:.2f} s on, while the joint moves"
            )
            if last - first > _MOST_FROZEN * len(self.values):
                raise LogError(
                    f"In log {self.log.name!r} the {self.name} {words}.",
                    advice="Has the sensor failed? If the joint was locked, remove its "
                    "velocity columns.",
                )
            yield slice(first, last + 1), words
            explained.append(np.array([last]))
        if self.quantity == "position":
            yield from self._permanent_jumps(np.setdiff1d(jumps, np.concatenate(explained)))

    def _check_possible(self, spikes: Indices) -> None:
        """Raise a LogError for impossible readings other than outliers."""
        rows = np.setdiff1d(np.flatnonzero(np.abs(self.values) > LARGEST), spikes)
        if len(rows):
            row = int(np.arange(len(self.log))[self.rows][rows[0]]) + 1
            raise LogError(
                f"Row {row} of log {self.log.name!r} has {self.values[rows[0]]:.4g} as the "
                f"{self.name}, which no robot reaches in SI units; {len(rows)} rows have such "
                "values.",
                advice="Are these encoder ticks, or has the sensor failed?",
            )

    def _unwrapped(self) -> tuple[Array, str]:
        """Return positions without wraps at a full turn, and a note."""
        steps = np.diff(self.values)
        fast = np.abs(steps) > _JUMP["position"][1] * np.maximum(np.diff(self.time), self.period)
        for turn in _TURNS if fast.any() else ():
            wraps = fast & (np.abs(np.abs(steps) - turn) < _WRAP * turn)
            residual = np.abs(np.where(wraps, steps - np.copysign(turn, steps), steps))
            padded = np.concatenate([[0.0], residual, [0.0]])  # speeds change little at a wrap
            ordinary = np.maximum(np.maximum(padded[:-2], padded[2:]), _typical(residual))
            wraps &= (residual <= 2.0 * ordinary) & (np.abs(steps) > 5.0 * ordinary)
            if wraps.any():
                turns = np.concatenate([[0.0], np.cumsum(np.where(wraps, np.sign(steps), 0.0))])
                words = f"wraps at {turn:.4g}, {np.count_nonzero(wraps)} times, the first "
                words += f"at t = {self.time[int(np.argmax(wraps))]:.2f} s: unwrapped"
                values = self.values - turn * turns
                center = 0.5 * (values.min() + values.max())
                if self.values.min() >= 0.0 and np.ptp(values) < turn:  # zero is at 0 or a turn
                    values -= turn * np.rint(center / turn)
                return values, words
        return self.values, ""

    def _jumps(self) -> Indices:
        """Return the indices of the readings before impossible steps."""
        steps = self._steps
        ratio, rate = _JUMP[self.quantity]
        if not steps.max(initial=0.0) > rate * self.period:
            return np.zeros(0, int)
        limit = rate * np.maximum(np.diff(self.time), self.period)
        return np.flatnonzero(steps > np.maximum(limit, ratio * self._ordinary))

    @cached_property
    def _steps(self) -> Array:
        """(K − 1,) sizes of the steps between readings."""
        return np.abs(np.diff(self.values))

    @cached_property
    def _ordinary(self) -> float:
        """Size of an ordinary step."""
        return _typical(self._steps)

    def _spikes(self, jumps: Indices) -> Indices:
        """Return the readings between a jump and the return, or an end of the log.

        Deviations of one or two rows must be as high as a jump, or as `_APART` if none is lower:
        efforts of joints with backlash have deviations of all heights.
        """
        sample = self._steps[:: len(self._steps) // _ENOUGH + 1]  # most blocks may be at rest
        ordinary = max(self._ordinary, float(np.quantile(sample, _MOST)) if len(sample) else 0.0)
        spikes = [*self._excursions(jumps, ordinary or np.inf)]
        are_apart = all(height > _APART for _, height in spikes)
        least = _APART if are_apart else _JUMP[self.quantity][0]
        return np.concatenate([np.zeros(0, int), *(rows for rows, high in spikes if high > least)])

    def _excursions(self, jumps: Indices, ordinary: float) -> Iterator[tuple[Indices, float]]:
        """Yield rows that deviate from those before and after, and their height in ordinary steps.

        The height is infinite for jumps, which may last longer, and start or end a log.
        """
        values, last, steps = self.values, len(self.values) - 1, self._steps
        starts = np.flatnonzero(steps > _SMALL * ordinary)
        starts = starts[starts < last - _BRIEF]
        returns = np.abs(values[starts[:, None] + np.arange(2, 2 + _BRIEF)] - values[starts, None])
        starts = starts[returns.min(axis=1) <= _BACK * steps[starts]]
        impossible, free = set(jumps.tolist()), 0
        for before in np.union1d(jumps, starts).tolist():
            if before < free:
                continue
            height, jumped = steps[before], before in impossible
            after = values[before + 2 : before + 2 + (_FEW if jumped else _BRIEF)]
            back = np.flatnonzero(np.abs(after - values[before]) <= _BACK * height)
            start = before + 1
            if len(back):
                free = before + 2 + int(back[0])
            elif jumped and before < _FEW and steps[before + 1] <= _ALONE * height:
                start, free = 0, before + 1
            elif jumped and last - before <= _FEW and steps[before - 1] <= _ALONE * height:
                free = last + 1
            else:
                continue
            yield np.arange(start, free), np.inf if jumped else float(height) / ordinary

    def _permanent_jumps(self, jumps: Indices) -> Iterator[tuple[slice, str]]:
        """Yield the readings before each permanent jump, so many that they form a gap."""
        steps = self._steps
        for before in jumps.tolist():
            neighbours = steps[max(0, before - 1) : before], steps[before + 1 : before + 2]
            if max(step.max(initial=0.0) for step in neighbours) <= _ALONE * steps[before]:
                values = f"{self.values[before]:.4g} to {self.values[before + 1]:.4g}"
                words = f"jumps from {values} at t = {self.time[before]:.2f} s and stays there"
                gap = longest_step(self.period) + self.period
                first = int(np.searchsorted(self.time, self.time[before + 1] - gap))
                if first <= before:  # otherwise there is a gap already
                    count = f"the {before + 1 - first} rows before it"
                    yield slice(first, before + 1), f"{words}, {count}"

    def _frozen(self, jumps: Indices) -> Iterator[tuple[int, int]]:
        """Yield the first and last readings of constant stretches in which the joint moves."""
        steps = self._steps.copy()
        edges = np.concatenate([[-1], np.flatnonzero(steps), [len(steps)]])
        lengths = np.diff(edges)
        least = max(_FROZEN_ROWS, round(_FROZEN_SECONDS / self.period))
        if self.quantity == "velocity" or lengths.max(initial=0) < least:
            return
        if self.quantity == "effort":
            least = max(least, round(_RARE * float(np.quantile(lengths, 0.99))))
        runs = np.flatnonzero(lengths >= least)
        firsts, lasts = edges[runs] + 1, edges[runs + 1]
        ends = np.append(steps, 0.0)[lasts]  # steps at the ends of runs; zero at the end of the log
        steps[jumps] = steps[lasts[lasts < len(steps)]] = 0.0
        limit = max(_JUMP["position"][1] * self.period, _CATCH_UP * float(steps.max(initial=0.0)))
        for first, last, end in zip(firsts.tolist(), lasts.tolist(), ends.tolist(), strict=True):
            run = slice(first, last + 1)
            if self.quantity == "effort":
                frozen = self._is_frozen_effort(run)
            else:
                frozen = end > limit or self._moves_on(run)
            if frozen:
                yield first, last

    def _moves_on(self, run: slice) -> bool:
        """Return whether the velocity shows motion while the position is stuck."""
        share, speed, least = _MOVING
        if self._rests:
            return False
        velocity = self._velocity[run]
        moves = np.abs(velocity).mean() > max(share * np.abs(self._velocity).max(), speed)
        return bool(moves) and travels(velocity, self.period, least)

    @cached_property
    def _rests(self) -> bool:
        """Whether positions are constant, and velocities small compared with other joints."""
        if np.ptp(self.values) > _HELD_RANGE or self.log.velocity is None:
            return False
        squares = np.square(np.clip(self.log.velocity, -LARGEST, LARGEST))
        speeds = np.sqrt(np.nanmean(np.where(np.isfinite(squares), squares, 0.0), axis=0))
        return bool(speeds[self.joint] <= _HELD_SPEED * speeds.max())

    @cached_property
    def _velocity(self) -> Array:
        """(K,) measured velocities; 0 where missing."""
        if self.log.velocity is None:
            return np.zeros(len(self.values))
        velocity = self.log.velocity[:, self.joint][self.rows]
        return np.where(np.isfinite(velocity), velocity, 0.0)

    def _is_frozen_effort(self, run: slice) -> bool:
        """Return whether the joint moves; efforts may stay at zero or at the limit of the drive."""
        if self.values[run.start] in (0.0, self.values.min(), self.values.max()):
            return False
        position = self.log.position[:, self.joint][self.rows][run]
        position = position[np.isfinite(position)]
        low, high = np.quantile(position, [0.05, 0.95]) if len(position) else (0.0, 0.0)
        return bool(high - low > _MOVING[2])  # quantiles ignore spikes


def _typical(steps: Array) -> float:
    """Return the size of an ordinary step: the 75 % quantile of the largest steps of blocks."""
    whole = len(steps) // _BLOCK * _BLOCK
    if not whole:
        return float(steps.max(initial=0.0))
    return float(np.quantile(steps[:whole].reshape(-1, _BLOCK).max(axis=1), _ORDINARY))
