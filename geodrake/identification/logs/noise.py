"""The noise floor: how much of the measured effort no model of the motion can predict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.effects.sensors import delayed_by
from geodrake.identification.logs.criteria import JOINT_NOISE_MARGIN, LEAST_NOISE
from geodrake.logs.filtering import passband_density, quiet_density, steepest_fall
from geodrake.logs.motion import Motion, Trajectory
from geodrake.logs.smoothing import Segment
from geodrake.model.carried_payloads import carrying
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_SAMPLES = 100_000  # of a segment that are looked at
_POSES = 200  # at which the inertia matrix is looked at


def noise_floor(
    trajectories: Sequence[Trajectory],
    model: RobotModel | None = None,
    *,
    sign_width: ArrayLike = 0.0,
    fitted: bool = False,
) -> Array:
    """Return (n,) RMS of the sensors' noise in filtered efforts, N·m or N; see `known_noise`."""
    return known_noise(trajectories, model, sign_width=sign_width, fitted=fitted)[0]


def known_noise(
    trajectories: Sequence[Trajectory],
    model: RobotModel | None = None,
    *,
    sign_width: ArrayLike = 0.0,
    fitted: bool = False,
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the RMS of the sensors' noise in efforts after filtering, and whether it is known.

    The noise is taken to be white.

    Above the motion's bandwidth the effort's spectrum holds what sensors and power electronics
    add. The quietest band there, continued into the passband, is the floor: coloured noise below
    it looks like an effect, and is not counted. Jumps of dry friction reach beyond the bandwidth
    too; a model fitted to the logs takes them away. Noise is never more than such a model leaves.
    Where there is less above the bandwidth than any sensor's noise, efforts were filtered before:
    the floor is then that of the quietest part of what a fitted model leaves below, or not known,
    and zero but for the noise of accelerations.

    Args:
        model: A model; the floor is then that of its residuals where they are quieter than the
            efforts, as those of a model fitted to the logs are.
        sign_width: (nv,) speed below which the direction of motion is not known, for the model.
        fitted: Whether the model was fitted to these logs.

    Returns:
        (n,) floor of each joint, N·m or N, and (n,) whether it is known whatever a model leaves:
        not where efforts were filtered before, nor where a model leaves much less than the noise
        above the bandwidth, which is then not white.
    """
    power, weight = np.zeros(len(trajectories[0].joints)), 0
    claimed, silent = power.copy(), np.zeros(len(power), bool)
    for trajectory in trajectories:
        robot = None if model is None else carrying(model, trajectory.payloads)
        gain, bandwidth = trajectory.filter.noise_gain, trajectory.filter.bandwidth
        for segment in trajectory.segments:
            rate = 1.0 / segment.period
            start = segment[:_SAMPLES]
            density, width = quiet_density(start.effort, rate, bandwidth), gain**2 * rate / 2.0
            noise = density * width
            if robot is not None:
                residual = _residual(start, robot, sign_width, trajectory)
                density = np.minimum(density, quiet_density(residual, rate, bandwidth))
                mean, quietest = passband_density(residual, rate, bandwidth)
                carried = _carried(start, robot, trajectory, sign_width)
                below = quietest * width if fitted else carried
                noise = np.where(_is_silent(density, start), below, density * width + carried)
                claimed += len(segment) * noise
                noise = np.minimum(noise, mean * width)
            silent |= _is_silent(density, start)
            power += len(segment) * noise
            weight += len(segment)
    known = ~silent & (claimed <= JOINT_NOISE_MARGIN**2 * power)
    return np.sqrt(power / weight), known


def filtered_below(trajectory: Trajectory) -> float:
    """Return where the efforts of a log end, Hz, if they were filtered before; else infinity."""
    bandwidth, ends = trajectory.filter.bandwidth, []
    for segment in trajectory.segments:
        start, rate = segment[:_SAMPLES], 1.0 / segment.period
        silent = _is_silent(quiet_density(start.effort, rate, bandwidth), start)
        if not silent.all():
            return np.inf
        ends.append(steepest_fall(start.effort, rate, bandwidth))
    return float(np.median(np.concatenate(ends)))


def _is_silent(density: Array, segment: Segment) -> NDArray[np.bool_]:
    """(n,) whether white noise of a density is less than any sensor of efforts has."""
    rms = np.sqrt(density * 0.5 / segment.period)
    return np.asarray(rms < LEAST_NOISE * segment.effort.std(axis=0))


def _carried(
    segment: Segment, model: RobotModel, trajectory: Trajectory, sign_width: ArrayLike
) -> Array:
    """(n,) mean square that noise of the accelerations makes of a segment's predicted efforts."""
    motion = _motion(segment[:: max(1, len(segment) // _POSES)], model, trajectory)
    power, needed = np.zeros(len(trajectory.joints)), model.effort(motion, sign_width=sign_width)
    for j, deviation in enumerate(trajectory.acceleration_noise):
        faster = motion.vd.copy()
        faster[:, j] += deviation
        more = model.effort(replace(motion, vd=faster), sign_width=sign_width) - needed
        power += np.square(more).mean(0)
    return power


def _motion(segment: Segment, model: RobotModel, trajectory: Trajectory) -> Motion:
    """A segment as the model's motion, in the time and at the temperatures of its log."""
    return Motion(
        model.positions(segment.position),
        segment.velocity,
        segment.acceleration,
        segment.time - trajectory.began,
        temperature=trajectory.temperature(segment.time),
    )


def _residual(
    segment: Segment, model: RobotModel, sign_width: ArrayLike, trajectory: Trajectory
) -> Array:
    """(K, n) measured − predicted effort at the full rate."""
    needed = model.effort(_motion(segment, model, trajectory), sign_width=sign_width)
    return segment.effort - delayed_by(model.delays, needed, segment.period)
