"""Choose the bandwidth of motion and efforts: as high as noise allows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import ArgumentError, LogError
from geodrake.identification.logs.contact_rows import MixedRows, contact_rows
from geodrake.identification.logs.noise import (
    acceleration_powers,
    density_of_rows,
    effort_residual,
    is_silent,
    sampled,
    without_contacts,
)
from geodrake.logs.filtering import spectral_density
from geodrake.logs.motion import JointLog, Motion, Trajectory
from geodrake.logs.preparation import prepare_logs
from geodrake.logs.smoothing import Segment, Stretch
from geodrake.logs.uniform_log import UniformLog, make_uniform
from geodrake.model.carried_payloads import carrying
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]
Prepared = tuple[Trajectory, ...]
Change = tuple[Prepared, str]
"""Logs with another bandwidth, and a sentence on the change and its reason."""

_EXCESS = 25.0  # power ratio of a clear mismatch, five times the amplitude
_FEWEST = 60  # least number of filtered samples after lowering the bandwidth
_FEWEST_MOVING = 30  # the same in motion, if it is lowered due to noise
_ENOUGH = 400  # filtered samples of each joint, enough for folds of about fifty
_MOST_NOISE = 2.0  # acceptable noise power, relative to that of efforts alone
_TOO_NOISY = 3.0  # the same, above which the bandwidth is lowered
_MOST_BIAS = 0.002  # acceptable relative bias of an inertia due to noise in its column
_STILL = 0.01  # speed of a joint at rest, relative to the peak speed
_IN_MOTION = 4.0  # least peak speed of a moving joint, in standard deviations of its noise
_MOST_SHAKING = 0.1  # acceptable noise of an acceleration, relative to its standard deviation
_STEP, _TRIES = 1.2, 4  # factor between candidates, and number of higher ones
_LOWER = 1.44  # factor between lower candidates
_MOST_VAIN = 2  # candidates without gain before the search stops
_TINY = np.finfo(float).tiny
_LARGEST_RATIO = 700.0  # largest logarithm of a finite ratio


def prepare_for_model(
    model: RobotModel, logs: Sequence[JointLog | UniformLog]
) -> tuple[Prepared, str | None]:
    """Prepare logs at a bandwidth that suits motion and efforts; explain a change in a sentence.

    `prepare_logs` chooses a bandwidth from the motion alone. It is lowered to exclude motion that
    does not match the measured efforts: vibration, backlash and elasticity behind the motor move
    the joint without the motor's effort. It is lowered further while noise of accelerations, which
    inertias turn into efforts, is costly or biases inertias, and enough samples remain. Otherwise,
    for short logs, it is raised as far as that noise costs little. A rough model suffices; logs
    have their joints in its order.
    """
    uniform = [log if isinstance(log, UniformLog) else make_uniform(log) for log in logs]
    prepared, reasons, cache = prepare_logs(uniform), list[str](), ContactRowCache(model)
    if coherent := _with_coherent_motion(cache, uniform, prepared):
        prepared, reason = coherent
        reasons.append(reason)
    if quiet := _with_less_noise(cache, uniform, prepared, is_coherent=coherent is not None):
        prepared, reason = quiet
        reasons.append(reason)
    if not reasons and (longer := _with_more_samples(cache, uniform, prepared)):
        prepared, reason = longer
        reasons.append(reason)
    return prepared, "; ".join(reasons) or None


def _with_coherent_motion(
    cache: ContactRowCache, uniform: Sequence[UniformLog], trajectories: Prepared
) -> Change | None:
    """Lower the bandwidth to where the motion matches the measured efforts."""
    coherent = coherent_bandwidth(cache, trajectories)
    if coherent is None:
        return None
    chosen = _lowest(trajectories)
    outputs = sum(sum(trajectory.output_counts) for trajectory in trajectories)
    coherent = max(coherent, chosen * min(1.0, _FEWEST / max(outputs, 1)))
    if coherent >= chosen:
        return None
    lowered = prepare_logs(
        uniform, bandwidth=coherent, motion_bandwidth=coherent, how="chosen from the data"
    )
    return lowered, (
        f"bandwidth lowered to {coherent:.3g} Hz, as the motion above it does not match "
        "the measured efforts: vibration, backlash or position noise"
    )


def _lowest(trajectories: Prepared) -> float:
    return min(trajectory.filter.bandwidth for trajectory in trajectories)


def _with_less_noise(
    cache: ContactRowCache,
    uniform: Sequence[UniformLog],
    trajectories: Prepared,
    *,
    is_coherent: bool,
) -> Change | None:
    """Lower the bandwidth until noise of accelerations costs little.

    If it was lowered to coherent motion already (`is_coherent`), errors of the model exceed noise,
    which then matters only if it biases inertias.
    """
    best, best_noise = trajectories, (noise := _acceleration_noise(cache, trajectories))
    lower = chosen = _lowest(trajectories)
    if is_coherent and not noise.is_biasing:
        return None
    vain = 0  # candidates since the best one
    while noise.is_costly and noise.fewest > _LOWER * _FEWEST_MOVING and vain < _MOST_VAIN:
        lower /= _LOWER
        try:
            candidate = prepare_logs(uniform, bandwidth=lower, how="chosen from the data")
        except (ArgumentError, LogError):  # a log would be too short
            break
        noise = _acceleration_noise(cache, candidate)
        if noise.is_better_than(best_noise):
            best, best_noise, vain = candidate, noise, 0
        else:
            vain += 1
    lowered = _lowest(best)
    if lowered == chosen:
        return None
    return best, (
        f"bandwidth lowered from {chosen:.3g} to {lowered:.3g} Hz, as noise of accelerations makes "
        "up most of the noise in efforts"
    )


def _with_more_samples(
    cache: ContactRowCache, uniform: Sequence[UniformLog], trajectories: Prepared
) -> Change | None:
    """Raise the bandwidth of short logs, as far as noise costs little."""
    chosen = _lowest(trajectories)
    outputs = sum(sum(trajectory.output_counts) for trajectory in trajectories)
    if outputs >= _ENOUGH:
        return None
    highest = min(each.highest_bandwidth for each in uniform)
    sharp = prepare_logs(uniform, bandwidth=chosen, motion_bandwidth=highest)
    frequency, ratio = effort_ratio(cache, sharp)
    noisy = frequency[(frequency > chosen) & (ratio > 1.0)]
    limit = min([highest, *noisy[:1].tolist()])
    raised, lowest = min(chosen * _ENOUGH / outputs, limit), _STEP * chosen
    if raised < lowest:
        return None
    count = 1 + int(np.log(raised / lowest) / np.log(_STEP))
    for higher in np.geomspace(raised, lowest, min(count, _TRIES)).tolist():
        longer = prepare_logs(uniform, bandwidth=higher, how="chosen from the data")
        if _acceleration_noise(cache, longer).is_small:
            change = f"from {chosen:.3g} to {higher:.3g} Hz, as the log is short"
            return longer, f"bandwidth raised {change}"
    return None


@dataclass(frozen=True)
class _AccelerationNoise:
    """Effect of filtered acceleration noise on residuals and columns."""

    loss: Array  # (nv,) noise power relative to that of efforts alone
    deviation: Array  # (nv,) standard deviation of the noise, rad/s² or m/s²
    size: Array  # (nv,) standard deviation of the unfiltered accelerations, rad/s² or m/s²
    motion: Array  # (nv,) of the filtered accelerations without noise; 0 for a joint at rest
    samples: NDArray[np.intp]  # (nv,) filtered samples in motion; 0 for a joint at rest

    @property
    def whole(self) -> float:
        """Geometric mean of the loss over moving joints."""
        return self._mean(self.loss, self.samples > 0)

    @property
    def is_small(self) -> bool:
        """Whether the noise neither dominates residuals nor biases inertias."""
        return self.whole <= _MOST_NOISE and bool(
            np.all(self.deviation <= _MOST_SHAKING * self.size)
        )

    @property
    def is_costly(self) -> bool:
        """Whether the noise dominates residuals, or biases inertias."""
        return self.whole > _TOO_NOISY or self.is_biasing

    @property
    def is_biasing(self) -> bool:
        """Whether the bias of an inertia due to noise in its column is significant."""
        return bool(np.any((self._shares > _MOST_BIAS) & (self._biases > 1.0)))

    @property
    def fewest(self) -> int:
        """Smallest number of filtered samples of a moving joint."""
        return int(min(self.samples[self.samples > 0], default=0))

    def is_better_than(self, other: _AccelerationNoise) -> bool:
        """Return whether this filter determines inertias at least as well, on average."""
        moves = (self.motion > 0.0) & (other.motion > 0.0)
        ratio = np.divide(self.motion, other.motion, out=np.ones(len(moves)), where=moves)
        mine, others = (each.loss * (1.0 + each._biases) for each in (self, other))
        return self._mean(mine / others / np.square(ratio), moves) <= 1.0

    @property
    def _shares(self) -> Array:
        """(nv,) relative bias of each joint's inertia due to noise in its column."""
        noise = np.square(self.deviation)
        return np.asarray(noise / np.maximum(noise + np.square(self.motion), _TINY))

    @property
    def _biases(self) -> Array:
        """(nv,) squared bias of each inertia, relative to its variance by effort noise alone."""
        return np.asarray(self.samples * self._shares * (self.loss - 1.0))

    @staticmethod
    def _mean(ratios: Array, which: NDArray[np.bool_]) -> float:
        """Return the geometric mean of the selected ratios, 1 without any."""
        return float(np.exp(np.log(ratios[which]).mean())) if which.any() else 1.0


class ContactRowCache:
    """Cache of contact rows and acceleration powers, which hardly depend on the bandwidth."""

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self._entries = dict[int, list[tuple[Array, MixedRows | None, Array]]]()

    def of(
        self, number: int, trajectory: Trajectory, segment: Segment
    ) -> tuple[MixedRows | None, Array]:
        """Return contact rows of a segment of a log, and its `acceleration_powers`."""
        entries = self._entries.setdefault(number, [])
        for time, rows, powers in entries:
            first = int(np.searchsorted(time, segment.time[0]))
            same = slice(first, first + len(segment))
            if np.array_equal(time[same], segment.time):
                return None if rows is None else rows[same], powers
        robot = carrying(self.model, trajectory.payloads)
        rows = contact_rows(robot, trajectory, segment)
        powers = acceleration_powers(segment, robot, trajectory, 0.0, rows)
        entries.append((segment.time, rows, powers))
        return rows, powers


def _acceleration_noise(
    cache: ContactRowCache, trajectories: Sequence[Trajectory]
) -> _AccelerationNoise:
    """Return the effect of acceleration noise, which inertias turn into effort noise.

    The model may lack rotors, so their inertias are estimated from each joint's residual, with
    friction and a spring. Joints at rest do not count.
    """
    model, columns, residuals = cache.model, list[Array](), list[Array]()
    spreads = list[Array]()
    noise, carried, shaking, samples = list[Array](), list[Array](), list[Array](), list[int]()
    size, own_rows = np.zeros(len(model.joints)), True
    for number, trajectory in enumerate(trajectories):
        robot, low_pass = carrying(model, trajectory.payloads), trajectory.filter
        for segment in trajectory.segments:
            start, rate = segment[: sampled(segment)], 1.0 / segment.period
            rows, powers = cache.of(number, trajectory, start)
            own_rows &= rows is None
            density = density_of_rows(start, rows, rate, low_pass.bandwidth)
            start = replace(start, effort=without_contacts(rows, start.effort))
            power = density * low_pass.noise_gain**2 * rate / 2.0
            noise.append(np.where(is_silent(density, start), 0.0, power))
            carried.append(np.square(trajectory.acceleration_noise) @ powers)
            shaking.append(trajectory.acceleration_noise)
            samples.append(len(start))
            size = np.maximum(size, start.acceleration.std(axis=0))  # a joint may rest in some
            v = start.velocity
            signals = [start.acceleration, v, np.sign(v), start.position, np.ones_like(v)]
            columns.append(low_pass.apply(np.stack(signals, 2)))
            residuals.append(low_pass.apply(effort_residual(start, robot, 0.0, trajectory, rows)))
            spreads.append(columns[-1][:, :, 0].std(axis=0))
    A, b = np.concatenate(columns), np.concatenate(residuals)
    speed, peak = np.abs(A[:, :, 1]), np.abs(A[:, :, 1]).max(axis=0)
    moves = peak > _IN_MOTION * np.max([t.speed_noise for t in trajectories], axis=0)
    deviation = np.max(shaking, axis=0)
    rotors = np.zeros(len(moves))
    for j in np.flatnonzero(moves) if own_rows else ():
        scale = np.maximum(np.abs(A[:, j]).max(axis=0), _TINY)
        rotors[j] = max(np.linalg.lstsq(A[:, j] / scale, b[:, j])[0][0] / scale[0], 0.0)
    power = np.array(carried) + np.square(rotors * np.array(shaking))
    is_noisy = np.array(noise) > 0.0
    weights = np.array(samples)[:, None] * is_noisy
    losses = np.log1p(np.divide(power, noise, out=np.zeros_like(power), where=is_noisy))
    loss = np.exp((weights * losses).sum(axis=0) / np.maximum(weights.sum(axis=0), 1))
    counts = np.where(moves, np.sum(speed > _STILL * peak, axis=0), 0)
    visible = np.square(np.max(spreads, axis=0)) - np.square(deviation)
    motion = np.where(moves, np.sqrt(np.maximum(visible, 0.0)), 0.0)
    return _AccelerationNoise(loss, deviation, size, motion, counts)


def coherent_bandwidth(cache: ContactRowCache, trajectories: Sequence[Trajectory]) -> float | None:
    """Return the frequency above which the motion and the measured efforts disagree, Hz.

    Above it the model's effort has more than 25 times the measured power, as geometric mean over
    joints. Return None if they agree up to the bandwidth, or nowhere, as with other units.
    """
    frequency, ratio = effort_ratio(cache, trajectories)
    inside = frequency <= min(each.filter.bandwidth for each in trajectories)
    frequency, ratio = frequency[inside], ratio[inside]
    worst = int(np.argmax(ratio))
    if ratio[worst] <= _EXCESS:
        return None
    coherent = np.flatnonzero(ratio[:worst] <= _EXCESS)
    return float(frequency[coherent[-1] + 1]) if len(coherent) else None


def effort_ratio(cache: ContactRowCache, trajectories: Sequence[Trajectory]) -> tuple[Array, Array]:
    """Return frequencies (K,) > 0, Hz, and the power ratio (K,) of model and measured efforts.

    It is the geometric mean over joints with motors, and over a free base if ground forces are
    measured or eliminated.
    """
    model = cache.model
    robots = {t.payloads: carrying(model, t.payloads) for t in trajectories}
    numbered = [(k, segment) for k, t in enumerate(trajectories) for segment in t.segments]
    segments = [segment for _, segment in numbered]
    window = min(
        0.5 * min(sampled(segment) * segment.period for segment in segments),
        100.0 / trajectories[0].filter.bandwidth,
    )
    fastest = 0.5 / max(segment.period for segment in segments)
    frequency = np.arange(1.0 / window, fastest, 1.0 / window)
    model_power = measured_power = np.zeros((len(frequency), len(model.joints)))
    for number, segment in numbered:
        trajectory = trajectories[number]
        robot = robots[trajectory.payloads]
        start = segment[: sampled(segment)]
        motion = Motion(model.positions(start.position), start.velocity, start.acceleration)
        rows, _ = cache.of(number, trajectory, start)
        effort = without_contacts(rows, robot.effort(motion))
        model_power = model_power + _density(effort, segment, window, frequency)
        measured_power = measured_power + _density(
            without_contacts(rows, start.effort), segment, window, frequency
        )
    passive = [joint for t in trajectories for joint in t.passive]
    grounded = all(trajectory.is_grounded for trajectory in trajectories)
    driven = ~np.isin(model.joints, [*passive, *(() if grounded else model.base_joints)])
    if (measured_power[:, driven] > 0.0).any():  # limbs that stand throughout have no rows
        driven &= (measured_power > 0.0).any(axis=0)
    ratio = np.mean(
        (np.log(model_power + _TINY) - np.log(measured_power + _TINY))[:, driven], axis=1
    )
    return frequency, np.exp(np.minimum(ratio, _LARGEST_RATIO))


def _density(effort: Array, segment: Stretch, window: float, frequency: Array) -> Array:
    """Return the spectral density times samples (K, n), interpolated to common frequencies."""
    rate = 1.0 / segment.period
    grid, density = spectral_density(effort, rate, round(window * rate))
    columns = [np.interp(frequency, grid, column) for column in density.T]
    return len(segment) * np.stack(columns, 1)
