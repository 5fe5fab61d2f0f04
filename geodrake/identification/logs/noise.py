"""The noise floor: how much of the measured effort no model of the motion can predict."""

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

_SAMPLES = 100_000  # of a segment that are looked at
_POSES = 200  # at which the inertia matrix is looked at


def known_noise(
    trajectories: Sequence[Trajectory],
    model: RobotModel | None = None,
    *,
    sign_width: ArrayLike = 0.0,
    fitted: bool = False,
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return the sensors' noise in efforts after filtering: its RMS, if it is known, and a part.

    The noise is taken to be white.

    Above the motion's bandwidth the effort's spectrum holds what sensors and power electronics
    add. The quietest band there, continued into the passband, is the floor: coloured noise below
    it looks like an effect, and is not counted. Jumps of dry friction reach beyond the bandwidth
    too; a model fitted to the logs takes them away. Noise is never more than such a model leaves.
    Where there is less above the bandwidth than any sensor's noise, efforts were filtered before:
    the floor is then that of the quietest part of what a fitted model leaves below, or not known,
    and zero but for the noise of accelerations.

    With a model the floor is that of its residuals where they are quieter than the efforts, as
    those of a model `fitted` to the logs are; below speeds `sign_width` (nv,) the direction of
    motion is not known. Returned are (n,) floors, N·m or N, and (n,) whether they are known
    whatever a model leaves: not where efforts were filtered before, nor where a model leaves much
    less than the noise above the bandwidth, which is then not white. The third result is the part
    (n,) of the floors, N·m or N, that a free base's accelerations add; it is zero for robots fixed
    to the world. That noise is in the columns, too, so that it varies with the motion.
    """
    power = np.zeros(len(trajectories[0].joints))
    weight, claimed, moving = power.copy(), power.copy(), power.copy()
    silent = np.zeros(len(power), bool)
    for trajectory in trajectories:
        robot = None if model is None else carrying(model, trajectory.payloads)
        gain, bandwidth = trajectory.filter.noise_gain, trajectory.filter.bandwidth
        for segment in trajectory.segments:
            rate = 1.0 / segment.period
            start = segment[: looked_at(segment)]
            rows = None if robot is None else contact_rows(robot, trajectory, start)
            density = density_of_rows(start, rows, rate, bandwidth)
            start = replace(start, effort=without_contacts(rows, start.effort))
            width = gain**2 * rate / 2.0
            noise = density * width
            if robot is not None:
                residual = effort_residual(start, robot, sign_width, trajectory, rows)
                density = np.minimum(density, quiet_density(residual, rate, bandwidth))
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
            # Limbs that stand have no rows, and what is zero there is no noise.
            weight += len(segment) * (1.0 if rows is None else rows.shares)
    known, weight = ~silent & (claimed <= JOINT_NOISE_MARGIN**2 * power), np.maximum(weight, 1.0)
    return np.sqrt(power / weight), known, np.sqrt(moving / weight)


def filtered_below(trajectory: Trajectory) -> float:
    """Return where the efforts of a log end, Hz, if they were filtered before; else infinity."""
    bandwidth, ends = trajectory.filter.bandwidth, []
    for segment in trajectory.segments:
        start, rate = segment[: looked_at(segment)], 1.0 / segment.period
        silent = is_silent(quiet_density(start.effort, rate, bandwidth), start)
        if not silent.all():
            return np.inf
        ends.append(steepest_fall(start.effort, rate, bandwidth))
    return float(np.median(np.concatenate(ends)))


def looked_at(segment: Stretch) -> int:
    """Return how many samples of a segment are looked at for noise and a bandwidth."""
    return min(len(segment), _SAMPLES)


def is_silent(density: Array, segment: Segment) -> NDArray[np.bool_]:
    """Return (n,) whether white noise of a density is less than any sensor of efforts has."""
    rms = np.sqrt(density * 0.5 / segment.period)
    return np.asarray(rms < LEAST_NOISE * segment.effort.std(axis=0))


def density_of_rows(
    segment: Segment, rows: MixedRows | None, rate: float, bandwidth: float
) -> Array:
    """Return the density (nv,) of noise in efforts without unknown contact forces, the mean.

    It is that of the efforts as they were measured, by their shares in the rows. These begin and
    end where limbs lift and touch, and such jumps are no noise.
    """
    density = quiet_density(segment.effort, rate, bandwidth)
    return density if rows is None else rows.powers(density)


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
    """Return (nv, nv) mean squares of predicted efforts due to noise of each acceleration.

    They are over the square of that noise.
    """
    some = slice(None, None, max(1, len(segment) // _POSES))
    motion, rows = motion_of(segment[some], model, trajectory), None if rows is None else rows[some]
    needed, found = model.effort(motion, sign_width=sign_width), list[Array]()
    noise = np.asarray(trajectory.acceleration_noise)
    for j, deviation in enumerate(np.where(noise > 0.0, noise, 1.0)):
        faster = motion.vd.copy()
        faster[:, j] += deviation
        more = model.effort(replace(motion, vd=faster), sign_width=sign_width) - needed
        found.append(np.square(without_contacts(rows, more) / deviation).mean(0))
    return np.array(found)


def motion_of(segment: Segment, model: RobotModel, trajectory: Trajectory) -> Motion:
    """Return a segment as the model's motion, in the time and at the temperatures of its log."""
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
    """Return (K, n) measured − predicted effort at the full rate."""
    needed = model.effort(motion_of(segment, model, trajectory), sign_width=sign_width)
    return segment.effort - without_contacts(rows, delayed_by(model.delays, needed, segment.period))
