"""Preparation of raw logs as smooth uniform segments, with derivatives."""

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

LEAST_OUTPUTS = 10  # fewest filtered samples of a usable log
_STILL_SPEED, _SPEED_NOISE = 0.01, 4.0  # of the peak speed, and in deviations of its noise
_SHARPER = 3.0  # bandwidth of the smoothed motion relative to that of efforts and regressors
_CLEARLY = 2.0  # bandwidth of each single log relative to that of all: less is chance
_SPEED_AGREEMENT = 0.05  # relative RMS of measured velocity − derivative of position
_EXACT = 1e-3  # relative error of derivatives of positions without noise
_LEAST_LEAN = 12  # samples at an end, where derivatives of splines are less accurate
_FREQUENCIES = 257  # to integrate the spectrum of the acceleration noise
_NOTED_LOSS, _MUCH = 1e-3, 0.01  # unused shares of a log that are noted, and noted first
_ENDS, _MANY_ENDS = "at the ends of pieces", 0.1  # share of these that is noted first
_MOST = 0.5  # share of a log that is unused for any reason, noted first
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
    and differentiated. Standstills at both ends are left out. Measured velocities are used if they
    agree with the positions after correction of a lag.

    Efforts and regressors are filtered later, which removes the noise of all terms linear in the
    acceleration. The motion is therefore smoothed less, so that the reversals of joints, where dry
    friction jumps, stay sharp.

    Args:
        logs: Logs of the same joints; uniform ones if they are prepared more than once.
        bandwidth: Common bandwidth of efforts and regressors, Hz; by default chosen from the data.
        motion_bandwidth: Bandwidth of the smoothed motion, Hz; by default three times the other. It
            is limited to half the sampling rate, or a quarter if ground forces act.
        how: Origin of a given bandwidth, for the notes.
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
    trajectories = []
    for each in uniform:
        with naming_log(each.log):
            trajectories.append(_prepare(each, bandwidth, sharp, how))
    return tuple(trajectories)


def motion_bandwidth_of(uniform: Sequence[UniformLog], *, time_scale: float = 1.0) -> float:
    """Return the bandwidth of the motion in logs, Hz, with time multiplied by a scale.

    If logs of slow and fast motions together have a clearly lower one than each, the latter counts.
    """
    moving = np.any([each.moving for each in uniform], axis=0)
    parts = [
        [(part.position[:, moving], each.period * time_scale) for part in sample_parts(each.pieces)]
        for each in uniform
    ]
    chosen = choose_bandwidth([piece for pieces in parts for piece in pieces])
    long = [pieces for pieces in parts if any(len(piece) >= LEAST_SPECTRUM for piece, _ in pieces)]
    lowest = min(map(choose_bandwidth, long)) if len(long) > 1 else chosen
    chosen = (lowest if lowest > _CLEARLY * chosen else chosen) * time_scale
    return min(chosen, *(each.highest_bandwidth for each in uniform))


def _prepare(
    uniform: UniformLog, bandwidth: float, motion_bandwidth: float, how: str
) -> Trajectory:
    log, period = uniform.log, uniform.period
    low_pass = design_filter(period, bandwidth)
    # Impacts of feet excite frequencies above those that logs contain.
    on_feet = log.ground is not None or log.contacts is not None
    highest = HIGHEST_BANDWIDTH if on_feet else HIGHEST_MOTION
    smoother = design_filter(period, min(motion_bandwidth, highest / period), highest=highest)
    notes = list(uniform.notes)
    notes.append(
        f"bandwidth {low_pass.bandwidth:.3g} Hz {how}; efforts decimated {1 / period:.4g} → "
        f"{1 / low_pass.output_period:.4g} Hz"
    )
    long = tuple(p for p in uniform.pieces if low_pass.output_count(len(p)) > 0)
    # Checked before the smoothing, which takes longest if the filter is longer than the log.
    _check_outputs(uniform, low_pass, sum(low_pass.output_count(len(p)) for p in long))
    usable, standstill = replace(uniform, pieces=long), (0.0, 0.0)
    stretches: tuple[Stretch, ...] = ()
    if long:
        lag, lag_notes = _measured_lag(usable, low_pass, smoother)
        notes += lag_notes
        whole = smooth_pieces(long, smoother, lag)
        stretches, standstill = _trimmed(usable, whole, (low_pass, smoother))
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
    """Return whether many data are unused, and a note on them, or ""."""
    time, piece_seconds = uniform.log.time, uniform.seconds
    stamps = time[np.isfinite(time)]
    total = max(float(stamps[-1] - stamps[0]), piece_seconds)
    used = sum(map(len, stretches)) * uniform.period
    stretch_seconds = sum(len(stretch.piece) for stretch in stretches) * uniform.period
    dropped = len(uniform.pieces) - len(stretches)
    parts = {
        "of standstill at the start": standstill[0],
        "of standstill at the end": standstill[1],
        f"in {dropped} of {len(uniform.pieces)} pieces, which are still or too short to filter": (
            piece_seconds - stretch_seconds
        ),
        _ENDS: stretch_seconds - used - sum(standstill),
        "in gaps and empty cells": total - piece_seconds,
    }
    losses = [f"{s:.3g} s {words}" for words, s in parts.items() if s > _NOTED_LOSS * total]
    lines = []
    if losses:
        share = f"{100 * (total - used) / total:.2g} %"
        lines = [f"{total - used:.3g} of {total:.4g} s ({share}) are not used: {', '.join(losses)}"]
    if joints := uniform.log.left_out:
        named = ", ".join(joint or "''" for joint in joints)
        lines.append(f"not used, as the model has no such joint: {named}")
    ends = parts[_ENDS]  # every log loses some there
    lost = total - used - ends - sum(standstill)  # a standstill has no information to lose
    is_much = lost > _MUCH * total or ends > _MANY_ENDS * total or bool(joints)
    is_much |= total - used > _MOST * total
    return is_much, "; ".join(lines)


def _check_outputs(uniform: UniformLog, low_pass: ZeroPhaseFilter, outputs: int) -> None:
    """Raise a LogError if a log gives too few filtered samples."""
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
    uniform: UniformLog, low_pass: ZeroPhaseFilter, smoother: ZeroPhaseFilter
) -> tuple[Array | None, list[str]]:
    """Return lags (n,), s, of measured velocities, and notes.

    A lag is NaN if the velocity is derived from the position: if it disagrees with the position's
    derivative beyond its noise, or leads to more noise of accelerations. Lags are None without
    measured velocities.
    """
    truths, velocities, slopes = [], [], []
    inner = slice(smoother.halfwidth, -smoother.halfwidth)  # free of reflected data
    for part in sample_parts(uniform.pieces):
        if part.velocity is None:
            return None, []
        truths.append(differentiate(smoother.smooth(part.position), uniform.period)[inner])
        velocity = smoother.smooth(part.velocity)
        velocities.append(velocity[inner])
        slopes.append(differentiate(velocity, uniform.period)[inner])
    truth, measured, slope = (np.concatenate(signals) for signals in (truths, velocities, slopes))
    penalty = np.where(uniform.moving, 0.0, np.inf)
    # Velocities lag if the drive filters them, or derives them from differences of positions.
    power = np.sum(slope**2, axis=0) + penalty
    lag = np.sum((truth - measured) * slope, axis=0) / np.where(power > 0.0, power, np.inf)
    error = np.sum((measured + lag * slope - truth) ** 2, axis=0)
    error = np.maximum(error - len(truth) * _speed_noise(uniform, smoother) ** 2, 0.0)
    # A joint that does not move in these parts is no evidence against its velocities.
    speed = np.sum(truth**2, axis=0) + penalty
    relative = np.sqrt(error / np.where(speed > 0.0, speed, np.inf))
    worst, wrong = int(np.argmax(relative)), relative > _SPEED_AGREEMENT
    every = np.ones(len(wrong), bool)
    noise, least = (_acceleration_noise(uniform, low_pass, derived) for derived in (~every, every))
    noisy = (least < noise) & (noise > _EXACT * np.sqrt(np.mean(slope**2, axis=0))) & ~wrong
    joints, notes = np.array(uniform.log.joints), list[str]()
    if wrong.any():
        notes.append(
            f"measured velocities of {', '.join(joints[wrong])} are not used: that of "
            f"{joints[worst]} differs by {100 * relative[worst]:.0f} % from the derivative of its "
            "position"
        )
    if noisy.any():
        notes.append(
            f"measured velocities of {', '.join(joints[noisy])} are not used: the derivatives of "
            "positions have less noise"
        )
    lag = np.where(wrong | noisy, np.nan, lag)
    latest = int(np.argmax(np.abs(np.nan_to_num(lag))))
    if abs(lag[latest]) >= _NOTED_LAG * uniform.period:
        notes.append(
            "measured velocities are shifted in time to match the positions: "
            f"{joints[latest]} is {1e3 * abs(lag[latest]):.2g} ms "
            f"{'late' if lag[latest] > 0 else 'early'}"
        )
    return lag, notes


def _speed_noise(uniform: UniformLog, smoother: ZeroPhaseFilter) -> Array:
    """Return the deviations (n,) of white position noise, low-passed and differentiated."""
    cutoff = min(smoother.bandwidth, HIGHEST_BANDWIDTH / uniform.period)
    return uniform.noise * 2 * np.pi * cutoff * np.sqrt(2 * cutoff * uniform.period / 3)


def _acceleration_noise(
    uniform: UniformLog, low_pass: ZeroPhaseFilter, derived: NDArray[np.bool_]
) -> Array:
    """Return the deviations (n,) of the acceleration noise.

    White noise is assumed in positions, measured velocities unless `derived`, or accelerations.
    """
    parts = list(sample_parts(uniform.pieces))
    rate, power, weight = 1.0 / uniform.period, np.zeros(len(uniform.log.joints)), 0
    for part in parts:
        # Differences suppress the large slow motion, which would leak into the noise.
        density = quiet_density(part.position, rate, low_pass.bandwidth, differences=2)
        if part.velocity is not None and not derived.all():
            measured = quiet_density(part.velocity, rate, low_pass.bandwidth, differences=1)
            density = np.where(derived, density, measured)
        if part.acceleration is not None:
            measured = quiet_density(part.acceleration, rate, low_pass.bandwidth)
            density[[*part.measured]] = measured
        power += len(part) * density
        weight += len(part)
    orders = np.where(derived, 2, 1)
    orders[[*parts[0].measured]] = 0
    frequency = np.linspace(0.0, 2.0 * low_pass.bandwidth, _FREQUENCIES)
    gain = low_pass.response(frequency) * (2.0 * np.pi * frequency) ** orders[:, None]
    return np.sqrt(power / weight * np.trapezoid(gain**2, frequency))


def _trimmed(
    uniform: UniformLog,
    whole: Sequence[Stretch],
    filters: tuple[ZeroPhaseFilter, ZeroPhaseFilter],
) -> tuple[tuple[Stretch, ...], tuple[float, float]]:
    """Return the usable stretches, and the seconds of standstill removed at both ends of the log.

    Samples near a piece's end are removed unless joints rest, as smoothing uses reflected data
    there. Of a standstill at an end of the log only the length of the filter remains.
    """
    low_pass, smoother = filters
    peak = np.max([stretch.peak_speed for stretch in whole], axis=0)
    threshold = np.maximum(_STILL_SPEED * peak, _SPEED_NOISE * _speed_noise(uniform, smoother))
    threshold = np.where(uniform.moving, threshold, np.inf)
    moving = [_first_and_last_moving(stretch, threshold) for stretch in whole]
    active = [k for k, ends in enumerate(moving) if ends is not None]
    margin, reach = max(smoother.halfwidth, _LEAST_LEAN), low_pass.halfwidth
    kept, standstill = list[Stretch](), np.zeros(2)
    for k in range(active[0], active[-1] + 1) if active else ():
        stretch, ends = whole[k], moving[k]
        count = len(stretch)
        before, after = (count, count) if ends is None else (ends[0], count - 1 - ends[1])
        still = np.maximum([before - reach, after - reach], 0) * [k == active[0], k == active[-1]]
        first, last = np.maximum([margin - before, margin - after], still).tolist()
        part = replace(stretch, first=first, stop=max(first, count - last))
        if low_pass.output_count(len(part)) > 0:
            kept.append(part)
            standstill += still * uniform.period
    return tuple(kept), (float(standstill[0]), float(standstill[1]))


def _first_and_last_moving(stretch: Stretch, threshold: Array) -> tuple[int, int] | None:
    """Return the first and last sample at which a joint exceeds its speed threshold (n,)."""

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
