"""From raw logs to smooth uniform segments: gaps, standstills, jitter, bandwidth, derivatives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import ArgumentError, LogError
from geodrake.filtering import (
    HIGHEST_BANDWIDTH,
    ZeroPhaseFilter,
    choose_bandwidth,
    design_filter,
    differentiate,
    resample,
)
from geodrake.motion import JointLog, Segment, Trajectory

Array = NDArray[np.float64]

LEAST_OUTPUTS = 10  # filtered samples that a log must give to be of use
_GAP_STEPS, _GAP_SECONDS = 5.0, 0.02  # a longer time step is a gap, a shorter one is jitter
_LEAST_ROWS = 8  # of a piece worth resampling
_STILL_RANGE, _STILL_NOISE = 2e-3, 20.0  # rad or m, and noise deviations, of a joint at rest
_STILL_SPEED, _SPEED_NOISE = 0.01, 4.0  # of the peak speed, and deviations of the speed's noise
_SHARPER = 3.0  # bandwidth of the smoothed motion over that of efforts and regressors
_SPEED_AGREEMENT = 0.05  # relative RMS of measured velocity − derivative of position
_NOTED_LAG = 0.1  # of the sampling period, between measured velocity and position


@dataclass(frozen=True, eq=False)
class _Piece:
    """A stretch of a log between gaps, at uniform instants."""

    time: Array
    position: Array
    velocity: Array | None
    effort: Array


@dataclass(frozen=True, eq=False)
class _Uniform:
    """A log in uniform pieces, and which of its joints move."""

    log: JointLog
    pieces: tuple[_Piece, ...]
    period: float
    noise: Array
    moving: NDArray[np.bool_]
    notes: tuple[str, ...]


def prepare_log(log: JointLog, *, bandwidth: float | None = None) -> Trajectory:
    """Prepare one log; see `prepare_logs`."""
    return prepare_logs([log], bandwidth=bandwidth)[0]


def prepare_logs(
    logs: Sequence[JointLog],
    *,
    bandwidth: float | None = None,
    motion_bandwidth: float | None = None,
    how: str = "as asked for",
) -> tuple[Trajectory, ...]:
    """Turn raw logs into smooth uniform segments and the filter for efforts and regressors.

    A log is split at NaN rows and gaps, resampled to its median time step, low-passed without lag
    and differentiated, and standstills at its two ends are left out. Measured velocities are
    used when they agree with the positions, apart from a lag, which is taken out.

    Efforts and regressors are filtered later, which takes the noise from all that is linear in the
    acceleration. The motion is therefore smoothed less than they are, so that the instants at
    which joints turn round, where dry friction jumps, stay sharp.

    Args:
        logs: The logs, all of the same joints.
        bandwidth: Common bandwidth of efforts and regressors, Hz; by default chosen from the data.
        motion_bandwidth: Bandwidth of the smoothed motion, Hz; by default three times the other.
        how: Where a given bandwidth comes from, for the notes.

    Raises:
        ArgumentError: If there is no log, joints differ, or the bandwidth does not fit.
        LogError: If a log is still throughout, or too short for the bandwidth.
    """
    if not logs:
        raise ArgumentError("There is no log.", advice="Give at least one.")
    if any(log.joints != logs[0].joints for log in logs):
        raise ArgumentError(
            f"Logs to prepare must be of the same joints; got {[log.joints for log in logs]}.",
            advice="Match every log to the model's joints first.",
        )
    uniform = [_make_uniform(log) for log in logs]
    if bandwidth is None:
        how = "chosen from the data"
        moving = np.any([each.moving for each in uniform], axis=0)
        bandwidth = choose_bandwidth(
            [(piece.position[:, moving], each.period) for each in uniform for piece in each.pieces]
        )
    sharp = motion_bandwidth or _SHARPER * bandwidth
    return tuple(_prepare(each, bandwidth, sharp, how) for each in uniform)


def _make_uniform(log: JointLog) -> _Uniform:
    notes = list(log.notes)
    if log.acceleration is not None:
        notes.append("measured accelerations are not used; they are derived from velocities")
    velocity = log.velocity
    if velocity is not None and np.isnan(velocity).mean() > 0.1:
        velocity = None
        notes.append("measured velocities have too many empty cells and are not used")
    measured = [log.position, log.effort] + ([] if velocity is None else [velocity])
    complete = np.isfinite(np.column_stack([log.time, *measured])).all(axis=1)
    rows = np.flatnonzero(complete)
    steps = np.diff(log.time[rows])
    if len(steps) == 0:
        raise LogError(
            f"Log {log.name!r} has {len(rows)} rows without empty cells out of {len(log)}.",
            advice="Log time, position and effort of every joint in the same row.",
        )
    period = float(np.median(steps))
    gap = (steps > max(_GAP_STEPS * period, _GAP_SECONDS)) | (np.diff(rows) > 1)
    runs = np.split(rows, np.flatnonzero(gap) + 1)
    if gap.any():
        longest = int(np.argmax(np.where(gap, steps, 0.0)))
        notes.append(
            f"split into {len(runs)} pieces at gaps and empty cells, the longest of "
            f"{steps[longest]:.3g} s at t = {log.time[rows[longest]]:.2f} s"
        )
    smooth = np.hstack([log.position] if velocity is None else [log.position, velocity])
    pieces = []
    for run in (run for run in runs if len(run) >= _LEAST_ROWS):
        time, signals, effort = resample(log.time[run], smooth[run], log.effort[run], period)
        position, speed = signals[:, : len(log.joints)], signals[:, len(log.joints) :]
        pieces.append(_Piece(time, position, None if velocity is None else speed, effort))
    noise, moving = _find_moving(log, pieces, period)
    return _Uniform(log, tuple(pieces), period, noise, moving, tuple(notes))


def _find_moving(
    log: JointLog, pieces: Sequence[_Piece], period: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Noise deviation (n,) of each position, and which joints (n,) move."""
    if not pieces:
        raise LogError(
            f"Log {log.name!r} has no {_LEAST_ROWS} rows in a row without a gap or an empty cell.",
            advice="Record without dropouts, or log all joints in the same row.",
        )
    seconds = sum(len(piece.time) for piece in pieces) * period
    bends = np.concatenate([np.diff(piece.position, 2, axis=0) for piece in pieces])
    noise = np.median(np.abs(bends), axis=0) / (0.6745 * np.sqrt(6.0))
    position = np.concatenate([piece.position for piece in pieces])
    reach = np.ptp(position, axis=0)
    moving = reach > np.maximum(_STILL_NOISE * noise, _STILL_RANGE)
    if not moving.any():
        most = int(np.argmax(reach))
        raise LogError(
            f"Log {log.name!r} is still throughout: in its {seconds:.3g} s no joint moves by more "
            f"than {_STILL_RANGE:g} rad (m) and {_STILL_NOISE:.0f} times its position noise; "
            f"{log.joints[most]} comes nearest with {reach[most]:.3g}, noise {noise[most]:.2g}.",
            advice="Record several seconds in which each joint of interest moves back and forth.",
        )
    return noise, moving


def _prepare(uniform: _Uniform, bandwidth: float, motion_bandwidth: float, how: str) -> Trajectory:
    log, period = uniform.log, uniform.period
    low_pass = design_filter(period, bandwidth)
    smoother = design_filter(period, min(motion_bandwidth, HIGHEST_BANDWIDTH / period))
    notes = list(uniform.notes)
    notes.append(
        f"bandwidth {low_pass.bandwidth:.3g} Hz {how}; efforts decimated {1 / period:.4g} → "
        f"{1 / low_pass.output_period:.4g} Hz"
    )
    seconds = sum(len(piece.time) for piece in uniform.pieces) * period
    long = tuple(p for p in uniform.pieces if low_pass.output_count(len(p.time)) > 0)
    segments = _smooth(replace(uniform, pieces=long), low_pass, smoother, notes) if long else ()
    speed_noise = _speed_noise(uniform, smoother)
    trajectory = Trajectory(log.name, log.joints, segments, low_pass, speed_noise, tuple(notes))
    outputs = sum(trajectory.output_counts)
    if outputs < LEAST_OUTPUTS:
        ends = 4 * low_pass.halfwidth * period
        raise LogError(
            f"Log {log.name!r} is too short: its {seconds:.3g} s give {outputs} filtered samples "
            f"at a bandwidth of {low_pass.bandwidth:.3g} Hz, and {LEAST_OUTPUTS} are needed.",
            advice=f"Record at least {ends + LEAST_OUTPUTS * low_pass.output_period:.3g} s of "
            "motion in one piece, or ask for a larger bandwidth.",
            seconds=seconds,
            bandwidth=low_pass.bandwidth,
        )
    dropped = len(uniform.pieces) - len(segments)
    if dropped:
        note = f"left out {dropped} of {len(uniform.pieces)} pieces: still, or short for the filter"
        return replace(trajectory, notes=(*notes, note))
    return trajectory


def _smooth(
    uniform: _Uniform, low_pass: ZeroPhaseFilter, smoother: ZeroPhaseFilter, notes: list[str]
) -> tuple[Segment, ...]:
    velocities, note = _choose_velocities(uniform, smoother)
    notes += [note] if note else []
    kept = _keep(uniform, velocities, low_pass, smoother, notes)
    return tuple(
        Segment(
            piece.time[rows],
            smoother.smooth(piece.position)[rows],
            velocity[rows],
            differentiate(velocity, uniform.period)[rows],
            piece.effort[rows],
            uniform.period,
        )
        for piece, velocity, rows in zip(uniform.pieces, velocities, kept, strict=True)
        if low_pass.output_count(rows.stop - rows.start) > 0
    )


def _choose_velocities(
    uniform: _Uniform, smoother: ZeroPhaseFilter
) -> tuple[list[Array], str | None]:
    """Smooth velocities of each piece: measured ones if they agree with the positions."""
    derived = [
        differentiate(smoother.smooth(piece.position), uniform.period) for piece in uniform.pieces
    ]
    measured = [
        smoother.smooth(piece.velocity) for piece in uniform.pieces if piece.velocity is not None
    ]
    if not measured:
        return derived, None
    slopes = [differentiate(velocity, uniform.period) for velocity in measured]
    inner = slice(smoother.halfwidth, -smoother.halfwidth)  # free of reflected data
    truth, found, slope = (
        np.concatenate([signal[inner] for signal in signals])
        for signals in (derived, measured, slopes)
    )
    still = np.where(uniform.moving, 0.0, np.inf)
    # Differences of positions, or a filter in the drive, make velocities late.
    steepness = np.sum(slope**2, axis=0) + still
    lag = np.sum((truth - found) * slope, axis=0) / np.where(steepness > 0.0, steepness, np.inf)
    error = np.sum((found + lag * slope - truth) ** 2, axis=0)
    relative = np.sqrt(error / (np.sum(truth**2, axis=0) + still))
    worst, latest = int(np.argmax(relative)), int(np.argmax(np.abs(lag)))
    if relative[worst] > _SPEED_AGREEMENT:
        return derived, (
            f"measured velocities are not used: that of {uniform.log.joints[worst]} is "
            f"{100 * relative[worst]:.0f} % off the derivative of its position"
        )
    shifted = [velocity + lag * slope for velocity, slope in zip(measured, slopes, strict=True)]
    if abs(lag[latest]) < _NOTED_LAG * uniform.period:
        return shifted, None
    return shifted, (
        f"measured velocities moved onto the positions; that of {uniform.log.joints[latest]} is "
        f"{1e3 * abs(lag[latest]):.2g} ms {'late' if lag[latest] > 0 else 'early'}"
    )


def _speed_noise(uniform: _Uniform, smoother: ZeroPhaseFilter) -> Array:
    """(n,) deviation of white noise of the positions, low-passed and differentiated."""
    cutoff = smoother.bandwidth
    return uniform.noise * 2 * np.pi * cutoff * np.sqrt(2 * cutoff * uniform.period / 3)


def _keep(
    uniform: _Uniform,
    velocities: Sequence[Array],
    low_pass: ZeroPhaseFilter,
    smoother: ZeroPhaseFilter,
    notes: list[str],
) -> Iterator[slice]:
    """Samples of each piece to keep.

    Near a piece's end, smoothing leans on reflected data, which is right only for a joint at rest:
    those samples go. Of a standstill at an end of the log only what the filter needs to reach the
    first moving sample stays.
    """
    peak = np.max([np.abs(velocity).max(axis=0) for velocity in velocities], axis=0)
    threshold = np.maximum(_STILL_SPEED * peak, _SPEED_NOISE * _speed_noise(uniform, smoother))
    moving = [
        np.flatnonzero((np.abs(velocity) > threshold)[:, uniform.moving].any(axis=1))
        for velocity in velocities
    ]
    busy = [k for k, samples in enumerate(moving) if len(samples)]
    lean, reach = smoother.halfwidth, low_pass.halfwidth
    for k, (velocity, samples) in enumerate(zip(velocities, moving, strict=True)):
        count = len(velocity)
        if not busy or k < busy[0] or k > busy[-1]:
            yield slice(0, 0)
            continue
        before = int(samples[0]) if len(samples) else count
        after = count - 1 - int(samples[-1]) if len(samples) else count
        first, last = max(lean - before, 0), max(lean - after, 0)
        if k == busy[0] and before > reach:
            first = before - reach
            notes.append(f"left out {first * uniform.period:.2f} s of standstill at the start")
        if k == busy[-1] and after > reach:
            last = after - reach
            notes.append(f"left out {last * uniform.period:.2f} s of standstill at the end")
        yield slice(first, max(first, count - last))
