"""Raw logs at uniform instants: gaps, empty cells, jitter, and moving joints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from geodrake.boundary.arguments import Array
from geodrake.errors import LogError
from geodrake.logs.filtering import HIGHEST_BANDWIDTH
from geodrake.logs.held_readings import held_readings
from geodrake.logs.motion import JointLog
from geodrake.logs.sensor_faults import without_faults
from geodrake.logs.smoothing import Piece
from geodrake.logs.time_stamps import longest_step
from geodrake.logs.units_of_values import row_order_hint

_STEP_ROWS = 20_000  # of a log that are examined
_FEWEST, _MOST = 3, 500  # different values, and steps in the range of values
_STEP_TOLERANCE = 0.1  # of differences between values, as printed numbers are rounded
_SHARE = 0.95  # of differences between values that are whole steps
_ROUNDING = 1e-9  # of the largest value
_LEAST_SHARE = 0.25  # of quantization in the power of the noise


def step_notes(log: JointLog) -> Iterator[str]:
    """Yield notes on efforts with much quantization noise, s/√12 for steps s."""
    steps = dict(zip(log.joints, effort_steps(log).tolist(), strict=True))
    coarse = {joint: step for joint, step in steps.items() if step > 0.0}
    each = (f"{joint} {s:.3g} (noise {s / np.sqrt(12.0):.2g})" for joint, s in coarse.items())
    if coarse:
        yield (
            f"efforts are quantized: {', '.join(each)}; the step over √12 is the standard "
            "deviation of the quantization noise before filtering"
        )


def effort_steps(log: JointLog) -> Array:
    """Return the quantization steps (n,) of efforts; 0 if noise hides them."""
    return np.array([_step(column) for column in log.effort[:_STEP_ROWS].T])


def _step(readings: Array) -> float:
    """Return the quantization step of a signal (N,), or 0 if noise hides it."""
    readings = readings[np.isfinite(readings)]
    values = np.unique(readings)
    if len(values) < _FEWEST:
        return 0.0
    gaps = np.diff(values)
    gaps = gaps[gaps > _ROUNDING * np.abs(values).max()]
    reach = values[-1] - values[0]
    for step in (float(gaps.min()), float(np.median(gaps))) if len(gaps) else ():
        counts = np.rint(gaps / step)
        whole = (np.abs(gaps / step - counts) <= _STEP_TOLERANCE * counts) & (counts > 0)
        if reach <= _MOST * step and whole.mean() >= _SHARE:
            noise = np.mean(np.diff(readings, 2) ** 2) / 6.0
            return step if step**2 / 12.0 >= _LEAST_SHARE * noise else 0.0
    return 0.0


# Stamps are uneven if gaps leave more than this share of the time in pieces shorter than this, s;
# steps up to this length, s, are then bridged.
_MOST_SCRAPS, _SCRAP, _LONGEST_BRIDGE = 0.2, 2.0, 0.2
_LEAST_ROWS = 8  # of a piece
_LOST = 1.5  # steps of time, relative to the median, after a lost row
_LONGEST_PERIOD = 0.5  # s; at 2 Hz and less, positions say nothing about accelerations
_SHORTEST_PERIOD = 1e-5  # s; no robot is logged at more than 100 kHz
_COARSEST = 0.1  # of a period, coarsest resolution of time stamps
_STILL_RANGE, _STILL_NOISE = 2e-3, 20.0  # rad or m, and noise deviations: a joint at rest
_ALIKE = 0.1  # relative tolerance of the time scales of different joints
# Samples in a part of a log, number of parts used for estimates, and samples in all of these.
_PART, _PARTS, _LOOKED_AT = 100_000, 8, 200_000


@dataclass(frozen=True, eq=False)
class UniformLog:
    """A log in uniform pieces."""

    log: JointLog
    pieces: tuple[Piece, ...]
    period: float  # time between samples, s
    noise: Array  # (n,) standard deviations of the position noise, rad or m
    moving: NDArray[np.bool_]  # (n,) whether joints move
    notes: tuple[str, ...]

    @property
    def seconds(self) -> float:
        """Total length of the pieces, s."""
        return sum(map(len, self.pieces)) * self.period

    @property
    def highest_bandwidth(self) -> float:
        """Largest bandwidth of the filter of efforts, Hz."""
        return HIGHEST_BANDWIDTH / (self.pieces[0].held * self.period)

    @property
    def time_scale(self) -> float:
        """Factor of time by which derivatives of positions match measured velocities.

        It is NaN without velocities, if most joints disagree, or if its period is impossible.
        """
        pairs = [
            (np.diff(part.position, axis=0) / self.period, part.velocity[1:] + part.velocity[:-1])
            for part in sample_parts(self.pieces)
            if part.velocity is not None
        ]
        if not pairs:
            return np.nan
        speed, rate = (np.concatenate(each) for each in zip(*pairs, strict=True))
        strength = 0.5 * np.sum(rate**2, axis=0)
        usable = self.moving & (strength > 0.0)
        if not usable.any():
            return np.nan
        slopes = np.sum(speed * rate, axis=0)[usable] / strength[usable]
        scale = float(np.median(slopes))
        alike = np.mean(np.abs(slopes - scale) < _ALIKE * abs(scale))
        is_valid = alike > 0.5 and _SHORTEST_PERIOD <= scale * self.period < _LONGEST_PERIOD
        return scale if is_valid else np.nan


@contextmanager
def naming_log(log: JointLog) -> Iterator[None]:
    """Add the log's name to errors as `evidence["log"]`, so that callers can leave it out."""
    try:
        yield
    except LogError as error:
        raise LogError(
            error.problem, advice=error.advice, **{**error.evidence, "log": log.name}
        ) from error


def make_uniform(log: JointLog, *, faultless: bool = False) -> UniformLog:
    """Split a log at gaps in its complete rows, and find its period, noise and moving joints.

    Sensor faults are removed first unless it is `faultless` already.
    """
    with naming_log(log):
        return _uniform(log, faultless=faultless)


def _uniform(log: JointLog, *, faultless: bool) -> UniformLog:
    if (hint := row_order_hint(log)) is not None:
        advice = (
            "Sort the rows by time, and log the time. If they are sorted, the sampling rate is "
        )
        advice += "too low: record 20 rows or more in each oscillation of a joint."
        raise LogError(hint, advice=advice)
    log, held = _with_new_readings(log if faultless else without_faults(log))
    notes = [*log.notes, *step_notes(log)]
    columns = [log.joints.index(joint) for joint in log.measured]
    acceleration = None if log.acceleration is None or not columns else log.acceleration[:, columns]
    if log.acceleration is not None and acceleration is None:
        notes.append("measured accelerations are not used, but derived from velocities")
    velocity = log.velocity
    if velocity is not None and np.isnan(velocity).mean() > 0.1:
        velocity = None
        notes.append("measured velocities are not used, as too many cells are empty")
    measured = [log.time[:, None], log.position, log.effort]
    measured += [x for x in (velocity, acceleration) if x is not None]
    complete = np.logical_and.reduce([np.isfinite(values).all(axis=1) for values in measured])
    if np.count_nonzero(complete) < 2:
        raise LogError(
            f"Only {np.count_nonzero(complete)} of {len(log)} rows of log {log.name!r} have "
            f"no empty cells{_never_measured(log)}.",
            advice="Log time, position and effort (or current, voltage, duty cycle or command) "
            "of all joints in the same row.",
        )
    kept = slice(None) if complete.all() else np.flatnonzero(complete)
    runs, period, note = _runs(log.time[kept])
    _check_period(log, period)
    notes += [note] if note else []
    whole = Piece(
        log.time,
        log.position,
        velocity,
        log.effort,
        period,
        acceleration,
        (*columns,),
        log.ground,
        held,
    ).rows(kept)
    pieces = tuple(whole.rows(run) for run in runs if run.stop - run.start >= _LEAST_ROWS)
    noise, moving = _find_moving(log, pieces, period)
    return UniformLog(log, pieces, period, noise, moving, tuple(notes))


def _with_new_readings(log: JointLog) -> tuple[JointLog, int]:
    """Return a log without repeated positions, and every how many rows its efforts are new.

    Repeated efforts are interpolated between new ones. Notes say both.
    """
    if positions := held_readings(log.position):
        note = f"positions change every {positions[0]} rows: the rows between are not used"
        log = replace(log.rows(positions[1]), notes=(*log.notes, note))
    efforts = held_readings(log.effort)
    if efforts is None:
        return log, 1
    every, is_new = efforts
    effort, measured = log.effort.copy(), np.isfinite(log.effort).any(axis=0)
    readings = effort[:, measured]
    steps = np.diff(log.time, prepend=np.nan)  # after a lost row, a reading may be older
    known = is_new & (steps < _LOST * np.nanmedian(steps)) & np.isfinite(readings).all(axis=1)
    if np.count_nonzero(known) < 2:
        return log, 1
    spline = CubicSpline(log.time[known], readings[known], extrapolate=False)
    effort[:, measured] = spline(log.time)
    note = f"efforts change every {every} rows: interpolated between new ones"
    return replace(log, effort=effort, notes=(*log.notes, note)), every


def _never_measured(log: JointLog) -> str:
    """Return a description of the first column without numbers, or ""."""
    if not np.isfinite(log.time).any():
        return ": none has a time"
    for quantity in ("position", "effort"):
        empty = ~np.isfinite(getattr(log, quantity)).any(axis=0)
        if empty.any():
            has_command = quantity == "effort" and log.command is not None
            or_command = " or command" if has_command else ""
            joint = log.joints[int(np.argmax(empty))]
            return f": none has {quantity}{or_command} of {joint}"
    return ""


def _check_period(log: JointLog, period: float) -> None:
    """Raise for a sampling period or time stamps that are impossible in seconds."""
    latest = float(np.max(np.abs(log.time), initial=0.0, where=np.isfinite(log.time)))
    is_slow = period >= _LONGEST_PERIOD
    if is_slow or period < _SHORTEST_PERIOD:
        why = "too slow for accelerations" if is_slow else "faster than any robot is logged"
        slow = "Is time in ms, µs or ns? --units time=ms converts it to s. Otherwise record at "
        raise LogError(
            f"Log {log.name!r} has a sample every {period:.4g} s (from t = {log.time[0]:.6g} to "
            f"{log.time[-1]:.6g} s), which is {why}.",
            advice=f"{slow}50 Hz or more." if is_slow else "Is time in another unit than s?",
        )
    if np.spacing(latest) > _COARSEST * period:
        raise LogError(
            f"Time stamps of log {log.name!r} reach {latest:.6g} s, where the resolution is "
            f"{np.spacing(latest):.2g} s, but its rows are {period:.4g} s apart.",
            advice="Is one of them wrong? Log the time since the start in s.",
        )


def _runs(time: Array) -> tuple[list[slice], float, str | None]:
    """Return the rows between gaps, the period, and a note if there are gaps."""
    steps = np.diff(time)
    period = float(np.median(steps))
    longest = longest_step(period)
    while longest < _LONGEST_BRIDGE and _in_scraps(steps, longest) > _MOST_SCRAPS:
        longest = min(1.3 * longest, _LONGEST_BRIDGE)
    last = np.flatnonzero(steps > longest).tolist()
    runs = [slice(before + 1, end + 1) for before, end in pairwise([-1, *last, len(time) - 1])]
    if not last:
        return runs, period, None
    longest_gap = max(last, key=steps.__getitem__)
    note = (
        f"split into {len(runs)} pieces at gaps and empty cells; the longest gap is "
        f"{steps[longest_gap]:.3g} s at t = {time[longest_gap]:.2f} s"
    )
    return runs, period, note


def _in_scraps(steps: Array, gap: float) -> float:
    """Return the share of the time between gaps in pieces too short for a filter."""
    ends = np.flatnonzero(steps > gap)
    pieces = np.split(np.where(steps > gap, 0.0, steps), ends + 1)
    seconds = np.array([piece.sum() for piece in pieces])
    return float(seconds[seconds < _SCRAP].sum() / max(seconds.sum(), np.finfo(float).tiny))


def sample_parts(pieces: Sequence[Piece]) -> Iterator[Piece]:
    """Yield a sample of parts of pieces, evenly spread over a long log, for estimates."""
    parts = [
        (piece, part)
        for piece in pieces
        for part in pairwise(_edges(len(piece), max(1, round(len(piece) / _PART))))
    ]
    chosen = np.unique(_edges(len(parts) - 1, min(len(parts), _PARTS) - 1))
    most = _LOOKED_AT // len(chosen) if len(chosen) else 0
    for piece, (start, stop) in (parts[k] for k in chosen.tolist()):
        yield piece[start : min(stop, start + most)]


def _edges(length: int, parts: int) -> list[int]:
    return np.linspace(0, length, parts + 1).round().astype(int).tolist()


def _find_moving(
    log: JointLog, pieces: Sequence[Piece], period: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the position noise (n,), and whether joints (n,) move."""
    if not pieces:
        raise LogError(
            f"Log {log.name!r} has no {_LEAST_ROWS} successive rows without a gap or an "
            "empty cell.",
            advice="Record without dropouts, or log all joints in the same row.",
        )
    seconds = sum(map(len, pieces)) * period
    bends = np.concatenate([np.diff(part.position, 2, axis=0) for part in sample_parts(pieces)])
    noise = np.median(np.abs(bends), axis=0) / (0.6745 * np.sqrt(6.0))
    highest = np.max([piece.position.max(axis=0) for piece in pieces], axis=0)
    lowest = np.min([piece.position.min(axis=0) for piece in pieces], axis=0)
    reach = highest - lowest
    moving = reach > np.maximum(_STILL_NOISE * noise, _STILL_RANGE)
    if not moving.any():
        most = int(np.argmax(reach))
        raise LogError(
            f"No joint moves in log {log.name!r}: in its {seconds:.3g} s none moves by more "
            f"than {_STILL_RANGE:g} rad (m) and {_STILL_NOISE:.0f} times its position noise; "
            f"{log.joints[most]} moves most, by {reach[most]:.3g} with noise "
            f"{noise[most]:.2g}.",
            advice="Record several seconds in which each joint of interest moves back and forth.",
        )
    return noise, moving
