"""Estimate the noise floor: the part of the measured effort that no model can predict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.effects.sensors import delayed_by
from geodrake.identification.logs.contact_rows import MixedRows, contact_rows
from geodrake.identification.logs.criteria import JOINT_NOISE_MARGIN, LEAST_NOISE
from geodrake.logs.filtering import (
    passband_density,
    quiet_density,
    steepest_fall,
)
from geodrake.logs.motion import Motion, Trajectory
from geodrake.logs.smoothing import Segment, Stretch
from geodrake.model.carried_payloads import carrying
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_SAMPLES = 100_000  # largest number of samples of a segment to use
_POSES = 200  # number of poses at which the inertia matrix is evaluated


def known_noise(
    trajectories: Sequence[Trajectory],
    model: RobotModel | None = None,
    *,
    sign_width: ArrayLike = 0.0,
    fitted: bool = False,
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return the RMS (n,) of the filtered effort noise, whether it is known, and a part of it.

    The noise is assumed white. Above the motion's bandwidth the spectrum of efforts is that of
    sensors and power electronics; the quietest band there, continued into the passband, is the
    floor. Coloured noise below it looks like an effect and is not counted. Dry friction also jumps
    beyond the bandwidth, so that residuals of a model, which may be `fitted` to the logs, replace
    the efforts where they are quieter. `sign_width` (nv,) are the speeds below which the direction
    of motion is unknown.

    If the band above the bandwidth is quieter than any sensor, efforts were filtered before. The
    floor is then the quietest part of a fitted model's residual below, or, without one, that of
    accelerations alone, and unknown. It is also unknown if a model's residual is much smaller than
    the noise above the bandwidth, which is then not white. The third result is the part (n,) of
    the RMS, N·m or N, due to a free base's accelerations, zero for fixed robots; it is in the
    columns too, and so varies with the motion.
    """
    power = np.zeros(len(trajectories[0].joints))
    weight, claimed, moving = power.copy(), power.copy(), power.copy()
    silent = np.zeros(len(power), bool)
    for trajectory in trajectories:
        robot = None if model is None else carrying(model, trajectory.payloads)
        gain, bandwidth = trajectory.filter.noise_gain, trajectory.filter.bandwidth
        for segment in trajectory.segments:
            rate = 1.0 / segment.period
            start = segment[: sampled(segment)]
            rows = None if robot is None else contact_rows(robot, trajectory, start)
            density = density_of_rows(start, rows, rate, bandwidth)
            start = replace(start, effort=without_contacts(rows, start.effort))
            width = gain**2 * rate / 2.0
            noise = density * width
            if robot is not None:
                residual = effort_residual(start, robot, sign_width, trajectory, rows)
                quiet = _density_of_new(residual, start.held, rate, bandwidth)
                density = np.minimum(density, quiet)
                mean, quietest = passband_density(residual, rate, bandwidth)
                shaken = acceleration_powers(start, robot, trajectory, sign_width, rows)
                carried = np.square(trajectory.acceleration_noise) @ shaken
                below = quietest * width if fitted else carried
                whole = np.where(is_silent(density, start), below, density * width + carried)
                claimed += len(segment) * whole
                noise = np.minimum(whole, mean * width)
                if robot.base_joints:
                    share = np.minimum(carried / np.maximum(whole, np.finfo(float).tiny), 1.0)
                    moving += len(segment) * share * noise
            silent |= is_silent(density, start)
            power += len(segment) * noise
            # Standing limbs have no rows; zeros there are not noise.
            weight += len(segment) * (1.0 if rows is None else rows.shares)
    known, weight = ~silent & (claimed <= JOINT_NOISE_MARGIN**2 * power), np.maximum(weight, 1.0)
    return np.sqrt(power / weight), known, np.sqrt(moving / weight)


def filtered_below(trajectory: Trajectory) -> float:
    """Return the cut-off frequency, Hz, of a filter applied before logging; infinity if none."""
    bandwidth, ends = trajectory.filter.bandwidth, []
    for segment in trajectory.segments:
        start, rate = segment[: sampled(segment)], 1.0 / segment.period
        silent = is_silent(_density_of_new(start.effort, start.held, rate, bandwidth), start)
        if not silent.all():
            return np.inf
        ends.append(steepest_fall(start.effort, rate, bandwidth))
    return float(np.median(np.concatenate(ends)))


def sampled(segment: Stretch) -> int:
    """Return the number of samples of a segment used to estimate noise and a bandwidth."""
    return min(len(segment), _SAMPLES)


def is_silent(density: Array, segment: Segment) -> NDArray[np.bool_]:
    """Return whether white noise of a density (n,) is less than that of any effort sensor."""
    rms = np.sqrt(density * 0.5 / segment.period)
    return np.asarray(rms < LEAST_NOISE * segment.effort.std(axis=0))


def density_of_rows(
    segment: Segment, rows: MixedRows | None, rate: float, bandwidth: float
) -> Array:
    """Return the mean noise density (nv,) in the rows without unknown contact forces.

    The density of the measured efforts is propagated to the rows, since the rows jump where limbs
    lift and touch.
    """
    density = _density_of_new(segment.effort, segment.held, rate, bandwidth)
    return density if rows is None else rows.powers(density)


def _density_of_new(signal: Array, held: int, rate: float, bandwidth: float) -> Array:
    """Return the noise densities (n,) of signals (N, n) in rows with new efforts.

    A source that is slower than the log has no noise above half its rate.
    """
    return quiet_density(signal[::held], rate / held, bandwidth)


def without_contacts(rows: MixedRows | None, efforts: Array) -> Array:
    """Return efforts (N, nv) without unknown contact forces."""
    return efforts if rows is None else rows.efforts(efforts)


def acceleration_powers(
    segment: Segment,
    model: RobotModel,
    trajectory: Trajectory,
    sign_width: ArrayLike,
    rows: MixedRows | None,
) -> Array:
    """Return mean squares (nv, nv) of the efforts due to unit noise of each acceleration."""
    poses = slice(None, None, max(1, len(segment) // _POSES))
    motion = motion_of(segment[poses], model, trajectory)
    rows = None if rows is None else rows[poses]
    effort, powers = model.effort(motion, sign_width=sign_width), list[Array]()
    noise = np.asarray(trajectory.acceleration_noise)
    for j, deviation in enumerate(np.where(noise > 0.0, noise, 1.0)):
        vd = motion.vd.copy()
        vd[:, j] += deviation
        change = model.effort(replace(motion, vd=vd), sign_width=sign_width) - effort
        powers.append(np.square(without_contacts(rows, change) / deviation).mean(0))
    return np.array(powers)


def motion_of(segment: Segment, model: RobotModel, trajectory: Trajectory) -> Motion:
    """Return the model's motion in a segment, with the time and temperatures of its log."""
    return Motion(
        model.positions(segment.position),
        segment.velocity,
        segment.acceleration,
        segment.time - trajectory.began,
        temperature=trajectory.temperature(segment.time),
    )


def effort_residual(
    segment: Segment,
    model: RobotModel,
    sign_width: ArrayLike,
    trajectory: Trajectory,
    rows: MixedRows | None,
) -> Array:
    """Return measured − predicted efforts (K, n) at the full rate."""
    effort = model.effort(motion_of(segment, model, trajectory), sign_width=sign_width)
    return segment.effort - without_contacts(rows, delayed_by(model.delays, effort, segment.period))
