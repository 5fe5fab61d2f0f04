"""From raw logs to smooth uniform segments: gaps, standstills, jitter, bandwidth, derivatives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import Array
from geodrake.errors import ArgumentError, LogError
from geodrake.logs.filtering import (
    HIGHEST_BANDWIDTH,
    HIGHEST_MOTION,
    LEAST_SPECTRUM,
    ZeroPhaseFilter,
    choose_bandwidth,
    design_filter,
    differentiate,
    quiet_density,
)
from geodrake.logs.floating import FORCE, frames_of
from geodrake.logs.motion import JointLog, Trajectory
from geodrake.logs.smoothing import Segment, Stretch, smooth_pieces
from geodrake.logs.temperatures import Temperatures
from geodrake.logs.uniform_log import UniformLog, make_uniform, naming_log, sample_parts
from geodrake.logs.units_of_values import position_unit_hint

LEAST_OUTPUTS = 10  # filtered samples that a log must give to be of use
_STILL_SPEED, _SPEED_NOISE = 0.01, 4.0  # of the peak speed, and deviations of the speed's noise
_SHARPER = 3.0  # bandwidth of the smoothed motion over that of efforts and regressors
_CLEARLY = 2.0  # bandwidth of each log alone over that of all: less is chance
_SPEED_AGREEMENT = 0.05  # relative RMS of measured velocity − derivative of position
_LEAST_LEAN = 12  # samples near an end, where derivatives of splines are less exact
_FREQUENCIES = 257  # at which the noise of accelerations is added up
_NOTED_LOSS, _MUCH = 1e-3, 0.01  # of a log's time, that is said, and said before all else
_ENDS, _MANY_ENDS = "at the ends of pieces", 0.1  # and how much of these is
_NOTED_LAG = 0.1  # of the sampling period, between measured velocity and position


def prepare_logs(
    logs: Sequence[JointLog | UniformLog],
    *,
    bandwidth: float | None = None,
    motion_bandwidth: float | None = None,
    how: str = "as requested",
) -> tuple[Trajectory, ...]:
    """Turn raw logs into smooth uniform segments and the filter for efforts and regressors.

    A log is split at NaN rows and gaps, resampled to its median time step, low-passed without lag
    and differentiated, and standstills at its two ends are left out. Measured velocities are
    used when they agree with the positions, apart from a lag, which is taken out.

    Efforts and regressors are filtered later, which takes the noise from all that is linear in the
    acceleration. The motion is therefore smoothed less than they are, so that the instants at
    which joints turn round, where dry friction jumps, stay sharp.

    Args:
        logs: The logs, all of the same joints; uniform ones if they are prepared more than once.
        bandwidth: Common bandwidth of efforts and regressors, Hz; by default chosen from the data.
        motion_bandwidth: Bandwidth of the smoothed motion, Hz; by default three times the other. It
            is at most half the sampling rate, and a quarter where the ground pushes.
        how: Where a given bandwidth comes from, for the notes.
    """
    if not logs:
        raise ArgumentError("There are no logs.", advice="Use at least one.")
    uniform = [each if isinstance(each, UniformLog) else make_uniform(each) for each in logs]
    joints = [each.log.joints for each in uniform]
    if any(names != joints[0] for names in joints):
        raise ArgumentError(
            f"Logs to prepare must have the same joints; got {joints}.",
            advice="Match every log to the model's joints first.",
        )
    if bandwidth is None:
        how = "chosen from the data"
        bandwidth = motion_bandwidth_of(uniform)
    sharp = motion_bandwidth or _SHARPER * bandwidth
    found = []
    for each in uniform:
        with naming_log(each.log):
            found.append(_prepare(each, bandwidth, sharp, how))
    return tuple(found)


def motion_bandwidth_of(uniform: Sequence[UniformLog], *, time_scale: float = 1.0) -> float:
    """Return the bandwidth of the motion in logs, Hz; their time may be on another scale.

    It is not clearly lower than that of each log alone, as the spectrum of a slow and a quick one.
    """
    moving = np.any([each.moving for each in uniform], axis=0)
    parts = [
        [(part.position[:, moving], each.period * time_scale) for part in sample_parts(each.pieces)]
        for each in uniform
    ]
    chosen = choose_bandwidth([piece for own in parts for piece in own])
    long = [own for own in parts if any(len(piece) >= LEAST_SPECTRUM for piece, _ in own)]
    alone = min(map(choose_bandwidth, long)) if len(long) > 1 else chosen
    return (alone if alone > _CLEARLY * chosen else chosen) * time_scale


def _prepare(
    uniform: UniformLog, bandwidth: float, motion_bandwidth: float, how: str
) -> Trajectory:
    log, period = uniform.log, uniform.period
    low_pass = design_filter(period, bandwidth)
    # Feet that touch the ground shake a robot at frequencies that no log holds.
    on_feet = log.ground is not None or log.contacts is not None
    highest = HIGHEST_BANDWIDTH if on_feet else HIGHEST_MOTION
    smoother = design_filter(period, min(motion_bandwidth, highest / period), highest=highest)
    notes = list(uniform.notes)
    notes.append(
        f"bandwidth {low_pass.bandwidth:.3g} Hz {how}; efforts decimated {1 / period:.4g} → "
        f"{1 / low_pass.output_period:.4g} Hz"
    )
    long = tuple(p for p in uniform.pieces if low_pass.output_count(len(p)) > 0)
    # Known before the work, which for a filter longer than the log is the longest there is.
    _check_outputs(uniform, low_pass, sum(low_pass.output_count(len(p)) for p in long))
    usable, standstill = replace(uniform, pieces=long), (0.0, 0.0)
    stretches: tuple[Stretch, ...] = ()
    if long:
        lag, note = _measured_lag(usable, smoother)
        notes += [note] if note else []
        whole = smooth_pieces(long, smoother, lag)
        stretches, standstill = _of_use(usable, whole, (low_pass, smoother))
    derived = np.any([stretch.derived for stretch in stretches], axis=0)
    temperatures = Temperatures.of(log.joints, log.time, log.temperature)
    if log.temperature is not None:
        read = np.array(log.joints)[np.isfinite(log.temperature).any(axis=0)]
        failed = [j for j in read if temperatures is None or j not in temperatures.courses]
        words = f"temperature of {', '.join(failed)} is not used: the sensor fails"
        notes += [words] * bool(failed)
    is_much, left_out = _left_out(uniform, stretches, standstill)
    notes += [left_out] if left_out and not is_much else []
    trajectory = Trajectory(
        log.name,
        log.joints,
        stretches,
        low_pass,
        _speed_noise(uniform, smoother),
        _acceleration_noise(uniform, low_pass, derived),
        tuple(notes),
        float(log.time[np.isfinite(log.time)][0]),
        log.payloads,
        log.gain_deviations,
        (bandwidth, motion_bandwidth),
        temperatures,
        log.passive,
        log.contacts,
        left_out if is_much else "",
        () if log.ground is None else frames_of(log.floating, FORCE),
        log.unmeasured,
    )
    _check_outputs(uniform, low_pass, sum(trajectory.output_counts))
    return trajectory


def _left_out(
    uniform: UniformLog, stretches: Sequence[Stretch], standstill: tuple[float, float]
) -> tuple[bool, str]:
    """Return a note on data that are not used, and whether they are many; "" for none."""
    time, of_pieces = uniform.log.time, uniform.seconds
    known = time[np.isfinite(time)]
    whole = max(float(known[-1] - known[0]), of_pieces)
    used = sum(map(len, stretches)) * uniform.period
    held = sum(len(stretch.piece) for stretch in stretches) * uniform.period
    dropped = len(uniform.pieces) - len(stretches)
    parts = {
        "of standstill at the start": standstill[0],
        "of standstill at the end": standstill[1],
        f"in {dropped} of {len(uniform.pieces)} pieces, which are still or too short to filter": (
            of_pieces - held
        ),
        _ENDS: held - used - sum(standstill),
        "in gaps and empty cells": whole - of_pieces,
    }
    said = [f"{s:.3g} s {words}" for words, s in parts.items() if s > _NOTED_LOSS * whole]
    lines = []
    if said:
        share = f"{100 * (whole - used) / whole:.2g} %"
        lines = [f"{whole - used:.3g} of {whole:.4g} s ({share}) are not used: {', '.join(said)}"]
    if joints := uniform.log.left_out:
        named = ", ".join(joint or "''" for joint in joints)
        lines.append(f"not used, as the model has no such joint: {named}")
    ends = parts[_ENDS]  # of which every log has some
    is_much = whole - used - ends > _MUCH * whole or ends > _MANY_ENDS * whole or bool(joints)
    return is_much, "; ".join(lines)


def _check_outputs(uniform: UniformLog, low_pass: ZeroPhaseFilter, outputs: int) -> None:
    """Raise a LogError unless a log gives enough filtered samples."""
    if outputs >= LEAST_OUTPUTS:
        return
    ends = 4 * low_pass.halfwidth * uniform.period
    hint = position_unit_hint(uniform.log)
    raise LogError(
        f"Log {uniform.log.name!r} is too short: its {uniform.seconds:.3g} s leave {outputs} of "
        f"the {LEAST_OUTPUTS} filtered samples that are needed at a bandwidth of "
        f"{low_pass.bandwidth:.3g} Hz.",
        advice=(f"{hint} " if hint else "")
        + f"Record at least {ends + LEAST_OUTPUTS * low_pass.output_period:.3g} s of motion "
        "without gaps, or use a larger bandwidth.",
    )


def _measured_lag(
    uniform: UniformLog, smoother: ZeroPhaseFilter
) -> tuple[Array | None, str | None]:
    """Return (n,) lag of measured velocities, s; NaN if positions are better.

    The noise of positions is no disagreement: where it makes up their derivatives, measured
    velocities are the better ones. None if there are none.
    """
    truths, measured, slopes = [], [], []
    inner = slice(smoother.halfwidth, -smoother.halfwidth)  # free of reflected data
    for part in sample_parts(uniform.pieces):
        if part.velocity is None:
            return None, None
        truths.append(differentiate(smoother.smooth(part.position), uniform.period)[inner])
        velocity = smoother.smooth(part.velocity)
        measured.append(velocity[inner])
        slopes.append(differentiate(velocity, uniform.period)[inner])
    truth, found, slope = (np.concatenate(signals) for signals in (truths, measured, slopes))
    still = np.where(uniform.moving, 0.0, np.inf)
    # Differences of positions, or a filter in the drive, make velocities late.
    steepness = np.sum(slope**2, axis=0) + still
    lag = np.sum((truth - found) * slope, axis=0) / np.where(steepness > 0.0, steepness, np.inf)
    error = np.sum((found + lag * slope - truth) ** 2, axis=0)
    error = np.maximum(error - len(truth) * _speed_noise(uniform, smoother) ** 2, 0.0)
    # A joint that does not move in these parts says nothing against its velocities.
    speed = np.sum(truth**2, axis=0) + still
    relative = np.sqrt(error / np.where(speed > 0.0, speed, np.inf))
    worst, wrong = int(np.argmax(relative)), relative > _SPEED_AGREEMENT
    note = (
        f"measured velocities of {', '.join(np.array(uniform.log.joints)[wrong])} are not "
        f"used: that of {uniform.log.joints[worst]} differs by {100 * relative[worst]:.0f} % "
        "from the derivative of its position"
    )
    if wrong.any():
        return np.where(wrong, np.nan, lag), note
    latest = int(np.argmax(np.abs(lag)))
    if abs(lag[latest]) < _NOTED_LAG * uniform.period:
        return lag, None
    return lag, (
        "measured velocities are shifted in time to match the positions: "
        f"{uniform.log.joints[latest]} is {1e3 * abs(lag[latest]):.2g} ms "
        f"{'late' if lag[latest] > 0 else 'early'}"
    )


def _speed_noise(uniform: UniformLog, smoother: ZeroPhaseFilter) -> Array:
    """Return (n,) deviation of white noise of the positions, low-passed and differentiated."""
    cutoff = min(smoother.bandwidth, HIGHEST_BANDWIDTH / uniform.period)
    return uniform.noise * 2 * np.pi * cutoff * np.sqrt(2 * cutoff * uniform.period / 3)


def _acceleration_noise(
    uniform: UniformLog, low_pass: ZeroPhaseFilter, derived: NDArray[np.bool_]
) -> Array:
    """Return (n,) deviation of the accelerations' noise, for white noise of the positions.

    It is that of velocities that are measured and not `derived` (n,), or of accelerations.
    """
    parts = list(sample_parts(uniform.pieces))
    rate, power, weight = 1.0 / uniform.period, np.zeros(len(uniform.log.joints)), 0
    for part in parts:
        # Differences are free of the motion's large slow part, which would leak into the noise.
        density = quiet_density(part.position, rate, low_pass.bandwidth, differences=2)
        if part.velocity is not None and not derived.all():
            own = quiet_density(part.velocity, rate, low_pass.bandwidth, differences=1)
            density = np.where(derived, density, own)
        if part.acceleration is not None:
            own = quiet_density(part.acceleration, rate, low_pass.bandwidth)
            density[[*part.measured]] = own
        power += len(part) * density
        weight += len(part)
    orders = np.where(derived, 2, 1)
    orders[[*parts[0].measured]] = 0
    frequency = np.linspace(0.0, 2.0 * low_pass.bandwidth, _FREQUENCIES)
    passed = low_pass.response(frequency) * (2.0 * np.pi * frequency) ** orders[:, None]
    return np.sqrt(power / weight * np.trapezoid(passed**2, frequency))


def _of_use(
    uniform: UniformLog,
    whole: Sequence[Stretch],
    filters: tuple[ZeroPhaseFilter, ZeroPhaseFilter],
) -> tuple[tuple[Stretch, ...], tuple[float, float]]:
    """Return stretches that are of use, and seconds of standstill that go at both ends of these.

    Samples near a piece's end go, where smoothing leans on reflected data, unless joints rest. Of a
    standstill at an end of the log only what the filter needs stays.
    """
    low_pass, smoother = filters
    peak = np.max([stretch.peak_speed for stretch in whole], axis=0)
    threshold = np.maximum(_STILL_SPEED * peak, _SPEED_NOISE * _speed_noise(uniform, smoother))
    threshold = np.where(uniform.moving, threshold, np.inf)
    moving = [_first_and_last_moving(stretch, threshold) for stretch in whole]
    busy = [k for k, ends in enumerate(moving) if ends is not None]
    lean, reach = max(smoother.halfwidth, _LEAST_LEAN), low_pass.halfwidth
    kept, standstill = list[Stretch](), np.zeros(2)
    for k in range(busy[0], busy[-1] + 1) if busy else ():
        stretch, ends = whole[k], moving[k]
        count = len(stretch)
        before, after = (count, count) if ends is None else (ends[0], count - 1 - ends[1])
        still = np.maximum([before - reach, after - reach], 0) * [k == busy[0], k == busy[-1]]
        first, last = np.maximum([lean - before, lean - after], still).tolist()
        part = replace(stretch, first=first, stop=max(first, count - last))
        if low_pass.output_count(len(part)) > 0:
            kept.append(part)
            standstill += still * uniform.period
    return tuple(kept), (float(standstill[0]), float(standstill[1]))


def _first_and_last_moving(stretch: Stretch, threshold: Array) -> tuple[int, int] | None:
    """Return the first and last sample at which a joint is faster than its threshold (n,)."""

    def moving(chunks: Iterator[tuple[int, Segment]]) -> Iterator[NDArray[np.intp]]:
        for first, chunk in chunks:
            fast = (np.abs(chunk.velocity) > threshold).any(axis=1)
            if fast.any():
                yield first + np.flatnonzero(fast)

    earliest = next(moving(stretch.chunks()), None)
    if earliest is None:
        return None
    latest = next(moving(stretch.chunks(backwards=True)))
    return int(earliest[0]), int(latest[-1])
