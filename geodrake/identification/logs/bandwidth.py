"""The bandwidth of motion and efforts: as much of the motion as the noise allows."""

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
    looked_at,
    without_contacts,
)
from geodrake.logs.filtering import HIGHEST_BANDWIDTH, spectral_density
from geodrake.logs.motion import JointLog, Motion, Trajectory
from geodrake.logs.preparation import prepare_logs
from geodrake.logs.smoothing import Segment, Stretch
from geodrake.logs.uniform_log import UniformLog, make_uniform
from geodrake.model.carried_payloads import carrying
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]
Prepared = tuple[Trajectory, ...]
Change = tuple[Prepared, str]
"""Logs prepared anew, and a sentence on what was changed and why."""

_EXCESS = 25.0  # times the other's power: five times the amplitude is a clear difference
_FEWEST = 60  # filtered samples that a lower bandwidth leaves at least, as far as there are so many
_FEWEST_MOVING = 30  # of a joint that moves, where the bandwidth is lowered for noise
_ENOUGH = 400  # filtered samples of each joint, which make folds of some fifty
_MOST_NOISE = 2.0  # power of noise, with that of accelerations, over that of efforts alone
_TOO_NOISY = 3.0  # the same, above which a bandwidth is lowered
_MOST_BIAS = 0.002  # share of an inertia lost to noise in its column; a rotor alone loses more
_STILL = 0.01  # of the peak speed
_IN_MOTION = 4.0  # deviations of its noise that the peak speed of a joint in motion has at least
_MOST_SHAKING = 0.1  # over the deviation of the acceleration itself
_STEP, _TRIES = 1.2, 4  # factor between bandwidths that are tried, and so many higher ones
_LOWER = 1.44  # the same of lower ones
_MOST_VAIN = 2  # so many are tried without gain: noise is not known to the last per cent
_TINY = np.finfo(float).tiny
_LARGEST_RATIO = 700.0  # logarithm of a ratio that is a number still


def prepare_for_model(
    model: RobotModel, logs: Sequence[JointLog | UniformLog]
) -> tuple[Prepared, str | None]:
    """Prepare logs at a bandwidth that suits motion and efforts alike.

    The motion alone suggests a bandwidth (`prepare_logs`). It is lowered to where the motion asks
    for efforts that were not measured: vibration, play and elasticity behind the motor move the
    joint without the motor's effort. It is lowered further while noise of accelerations, which
    inertias carry into efforts, costs much or makes inertias too small, and enough samples stay.
    If it is not lowered, it is raised where the log is short, as far as that noise costs little.
    A rough model will do; logs have their joints in its order. With the prepared logs comes a
    sentence on what was changed and why, if anything was.
    """
    uniform = [log if isinstance(log, UniformLog) else make_uniform(log) for log in logs]
    prepared, why, known = prepare_logs(uniform), list[str](), Known(model)
    if coherent := _with_coherent_motion(known, uniform, prepared):
        prepared, words = coherent
        why.append(words)
    if quiet := _with_less_noise(known, uniform, prepared, is_coherent=coherent is not None):
        prepared, words = quiet
        why.append(words)
    if not why and (longer := _with_more_samples(known, uniform, prepared)):
        prepared, words = longer
        why.append(words)
    return prepared, "; ".join(why) or None


def _with_coherent_motion(
    known: Known, uniform: Sequence[UniformLog], trajectories: Prepared
) -> Change | None:
    """Lower the bandwidth to where the motion does not match the measured efforts."""
    coherent = coherent_bandwidth(known, trajectories)
    if coherent is None:
        return None
    chosen = _lowest(trajectories)
    outputs = sum(sum(trajectory.output_counts) for trajectory in trajectories)
    coherent = max(coherent, chosen * min(1.0, _FEWEST / max(outputs, 1)))  # enough to hold out
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
    known: Known,
    uniform: Sequence[UniformLog],
    trajectories: Prepared,
    *,
    is_coherent: bool,
) -> Change | None:
    """Lower the bandwidth until noise of accelerations costs little, to where inertias are known.

    After a cut to motion that matches the efforts (`is_coherent`), errors of the model are larger
    than noise, which matters only where it makes inertias too small.
    """
    found, best = trajectories, (noise := _acceleration_noise(known, trajectories))
    lower = chosen = _lowest(trajectories)
    if is_coherent and not noise.is_biasing:
        return None
    vain = 0  # tries since the best one
    while noise.is_costly and noise.fewest > _LOWER * _FEWEST_MOVING and vain < _MOST_VAIN:
        lower /= _LOWER
        try:
            tried = prepare_logs(uniform, bandwidth=lower, how="chosen from the data")
        except (ArgumentError, LogError):  # a log would be too short
            break
        noise = _acceleration_noise(known, tried)
        if noise.is_better_than(best):
            found, best, vain = tried, noise, 0
        else:
            vain += 1
    suits = _lowest(found)
    if suits == chosen:
        return None
    return found, (
        f"bandwidth lowered from {chosen:.3g} to {suits:.3g} Hz, as noise of accelerations makes "
        "up most of the noise in efforts"
    )


def _with_more_samples(
    known: Known, uniform: Sequence[UniformLog], trajectories: Prepared
) -> Change | None:
    """Raise the bandwidth of short logs, as far as noise costs little."""
    chosen = _lowest(trajectories)
    outputs = sum(sum(trajectory.output_counts) for trajectory in trajectories)
    if outputs >= _ENOUGH:
        return None
    highest = HIGHEST_BANDWIDTH / max(t.filter.period for t in trajectories)
    sharp = prepare_logs(uniform, bandwidth=chosen, motion_bandwidth=highest)
    frequency, ratio = effort_ratio(known, sharp)
    noisy = frequency[(frequency > chosen) & (ratio > 1.0)]
    limit = min([highest, *noisy[:1].tolist()])
    raised, lowest = min(chosen * _ENOUGH / outputs, limit), _STEP * chosen
    if raised < lowest:
        return None
    apart = 1 + int(np.log(raised / lowest) / np.log(_STEP))
    for higher in np.geomspace(raised, lowest, min(apart, _TRIES)).tolist():
        longer = prepare_logs(uniform, bandwidth=higher, how="chosen from the data")
        if _acceleration_noise(known, longer).is_small:
            words = f"from {chosen:.3g} to {higher:.3g} Hz, as the log is short"
            return longer, f"bandwidth raised {words}"
    return None


@dataclass(frozen=True)
class _AccelerationNoise:
    """Noise of accelerations, filtered as efforts are, in residuals and in columns."""

    loss: Array  # (nv,) power of noise, with that of accelerations, over that of efforts alone
    deviation: Array  # (nv,) of the noise, rad/s² or m/s²
    size: Array  # (nv,) the same of accelerations themselves, before they are filtered
    motion: Array  # (nv,) of filtered accelerations without their noise; 0 of a joint at rest
    samples: NDArray[np.intp]  # (nv,) filtered samples in motion; 0 of a joint at rest

    @property
    def whole(self) -> float:
        """The loss of all joints in motion, the geometric mean."""
        return self._mean(self.loss, self.samples > 0)

    @property
    def is_small(self) -> bool:
        """Whether residuals are not much larger, and inertias not much too small, due to it."""
        return self.whole <= _MOST_NOISE and bool(
            np.all(self.deviation <= _MOST_SHAKING * self.size)
        )

    @property
    def is_costly(self) -> bool:
        """Whether it makes residuals much larger, or inertias too small."""
        return self.whole > _TOO_NOISY or self.is_biasing

    @property
    def is_biasing(self) -> bool:
        """Whether an inertia is clearly too small due to noise in its column."""
        return bool(np.any((self._shares > _MOST_BIAS) & (self._biases > 1.0)))

    @property
    def fewest(self) -> int:
        """Filtered samples of a joint in motion, the least of all joints."""
        return int(min(self.samples[self.samples > 0], default=0))

    def is_better_than(self, other: _AccelerationNoise) -> bool:
        """Return whether inertias are known at least as well with this filter, on average."""
        moves = (self.motion > 0.0) & (other.motion > 0.0)
        ratio = np.divide(self.motion, other.motion, out=np.ones(len(moves)), where=moves)
        mine, others = (each.loss * (1.0 + each._biases) for each in (self, other))
        return self._mean(mine / others / np.square(ratio), moves) <= 1.0

    @property
    def _shares(self) -> Array:
        """(nv,) share of each joint's inertia that is lost to noise in its column."""
        noise = np.square(self.deviation)
        return np.asarray(noise / np.maximum(noise + np.square(self.motion), _TINY))

    @property
    def _biases(self) -> Array:
        """(nv,) squared loss of each inertia, over its variance by noise of efforts alone."""
        return np.asarray(self.samples * self._shares * (self.loss - 1.0))

    @staticmethod
    def _mean(ratios: Array, which: NDArray[np.bool_]) -> float:
        """Return the geometric mean of some joints' ratios; 1 if there is none."""
        return float(np.exp(np.log(ratios[which]).mean())) if which.any() else 1.0


class Known:
    """Parts of logs that hardly depend on the bandwidth: those of the first serve all others."""

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self._looked = dict[int, list[tuple[Array, MixedRows | None, Array]]]()

    def of(
        self, number: int, trajectory: Trajectory, segment: Segment
    ) -> tuple[MixedRows | None, Array]:
        """Return contact rows of a segment of a log, and its `acceleration_powers`."""
        looked = self._looked.setdefault(number, [])
        for time, rows, powers in looked:
            first = int(np.searchsorted(time, segment.time[0]))
            same = slice(first, first + len(segment))
            if np.array_equal(time[same], segment.time):
                return None if rows is None else rows[same], powers
        robot = carrying(self.model, trajectory.payloads)
        rows = contact_rows(robot, trajectory, segment)
        powers = acceleration_powers(segment, robot, trajectory, 0.0, rows)
        looked.append((segment.time, rows, powers))
        return rows, powers


def _acceleration_noise(known: Known, trajectories: Sequence[Trajectory]) -> _AccelerationNoise:
    """Return what noise of accelerations does at the least, as inertias carry it into efforts.

    The model's inertia may lack rotors: roughly, each joint has what a fit of its residuals with
    friction and a spring finds. Joints at rest do not count.
    """
    model, columns, residuals = known.model, list[Array](), list[Array]()
    segments = list[Array]()
    noise, carried, shaking, samples = list[Array](), list[Array](), list[Array](), list[int]()
    size, own_rows = np.zeros(len(model.joints)), True
    for number, trajectory in enumerate(trajectories):
        robot, low_pass = carrying(model, trajectory.payloads), trajectory.filter
        for segment in trajectory.segments:
            start, rate = segment[: looked_at(segment)], 1.0 / segment.period
            rows, powers = known.of(number, trajectory, start)
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
            own = [start.acceleration, v, np.sign(v), start.position, np.ones_like(v)]
            columns.append(low_pass.apply(np.stack(own, 2)))
            residuals.append(low_pass.apply(effort_residual(start, robot, 0.0, trajectory, rows)))
            segments.append(columns[-1][:, :, 0].std(axis=0))
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
    visible = np.square(np.max(segments, axis=0)) - np.square(deviation)
    motion = np.where(moves, np.sqrt(np.maximum(visible, 0.0)), 0.0)
    return _AccelerationNoise(loss, deviation, size, motion, counts)


def coherent_bandwidth(known: Known, trajectories: Sequence[Trajectory]) -> float | None:
    """Return the frequency above which the motion and the measured efforts disagree, Hz.

    From there on the effort that the model needs, a rough one, has more than 25 times the measured
    power, the geometric mean over joints. None if it has not up to the bandwidth, or has from the
    lowest frequency on, as where efforts are in other units.
    """
    frequency, ratio = effort_ratio(known, trajectories)
    inside = frequency <= min(each.filter.bandwidth for each in trajectories)
    frequency, ratio = frequency[inside], ratio[inside]
    worst = int(np.argmax(ratio))
    if ratio[worst] <= _EXCESS:
        return None
    together = np.flatnonzero(ratio[:worst] <= _EXCESS)
    return float(frequency[together[-1] + 1]) if len(together) else None


def effort_ratio(known: Known, trajectories: Sequence[Trajectory]) -> tuple[Array, Array]:
    """Return the power of the effort that the model needs over that of the measured effort.

    Those are frequencies (K,) in Hz, without 0, and ratios (K,), the geometric mean over joints
    that have a motor, and over a free base where the ground's forces are measured or taken out.
    """
    model = known.model
    robots = {t.payloads: carrying(model, t.payloads) for t in trajectories}
    held = [(k, segment) for k, t in enumerate(trajectories) for segment in t.segments]
    segments = [segment for _, segment in held]
    window = min(
        0.5 * min(looked_at(segment) * segment.period for segment in segments),
        100.0 / trajectories[0].filter.bandwidth,
    )
    fastest = 0.5 / max(segment.period for segment in segments)
    frequency = np.arange(1.0 / window, fastest, 1.0 / window)
    needed = measured = np.zeros((len(frequency), len(model.joints)))
    for number, segment in held:
        trajectory = trajectories[number]
        robot = robots[trajectory.payloads]
        start = segment[: looked_at(segment)]
        motion = Motion(model.positions(start.position), start.velocity, start.acceleration)
        rows, _ = known.of(number, trajectory, start)
        effort = without_contacts(rows, robot.effort(motion))
        needed = needed + _density(effort, segment, window, frequency)
        measured = measured + _density(
            without_contacts(rows, start.effort), segment, window, frequency
        )
    idle = [joint for t in trajectories for joint in t.passive]
    grounded = all(trajectory.is_grounded for trajectory in trajectories)
    driven = ~np.isin(model.joints, [*idle, *(() if grounded else model.base_joints)])
    if (measured[:, driven] > 0.0).any():  # limbs that stand throughout have no rows
        driven &= (measured > 0.0).any(axis=0)
    ratio = np.mean((np.log(needed + _TINY) - np.log(measured + _TINY))[:, driven], axis=1)
    return frequency, np.exp(np.minimum(ratio, _LARGEST_RATIO))


def _density(effort: Array, segment: Stretch, window: float, frequency: Array) -> Array:
    """Return (K, n) spectral density times samples, on a grid that logs of all rates share."""
    rate = 1.0 / segment.period
    own, density = spectral_density(effort, rate, round(window * rate))
    columns = [np.interp(frequency, own, column) for column in density.T]
    return len(segment) * np.stack(columns, 1)
