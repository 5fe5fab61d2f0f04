"""The bandwidth below which a motion and the measured efforts belong together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.logs.filtering import HIGHEST_BANDWIDTH, spectral_density
from geodrake.logs.motion import JointLog, Motion, Trajectory
from geodrake.logs.preparation import prepare_logs
from geodrake.logs.smoothing import Stretch
from geodrake.logs.uniform_log import UniformLog, make_uniform
from geodrake.model.carried_payloads import carrying
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_EXCESS = 25.0  # times the other's power: five times the amplitude is a clear difference
_ENOUGH = 400  # filtered samples of each joint, which make folds of some fifty
_SAMPLES = 100_000  # of a segment that are looked at
_LARGEST_RATIO = 700.0  # logarithm of a ratio that is a number still


def prepare_for_model(
    model: RobotModel, logs: Sequence[JointLog | UniformLog]
) -> tuple[tuple[Trajectory, ...], str | None]:
    """Prepare logs at a bandwidth that suits motion and efforts alike.

    The motion alone suggests a bandwidth (`prepare_logs`). It is lowered to where the motion asks
    for efforts that were not measured: vibration, play and elasticity behind the motor move the
    joint without the motor's effort. It is raised where the log is short, as far as position noise
    does not ask for more effort than was measured. A rough model will do; logs have their joints in
    its order. With the prepared logs comes a sentence on what was changed and why, if anything was.
    """
    uniform = [log if isinstance(log, UniformLog) else make_uniform(log) for log in logs]
    trajectories = prepare_logs(uniform)
    chosen = min(trajectory.filter.bandwidth for trajectory in trajectories)
    coherent = coherent_bandwidth(model, trajectories)
    if coherent is not None:
        lowered = prepare_logs(
            uniform, bandwidth=coherent, motion_bandwidth=coherent, how="chosen from the data"
        )
        return lowered, (
            f"bandwidth lowered to {coherent:.3g} Hz: above it the motion asks for efforts that "
            "were not measured, as vibration, play or position noise do"
        )
    outputs = sum(sum(trajectory.output_counts) for trajectory in trajectories)
    if outputs >= _ENOUGH:
        return trajectories, None
    highest = HIGHEST_BANDWIDTH / max(t.filter.period for t in trajectories)
    sharp = prepare_logs(uniform, bandwidth=chosen, motion_bandwidth=highest)
    frequency, ratio = effort_ratio(model, sharp)
    noisy = frequency[(frequency > chosen) & (ratio > 1.0)]
    limit = min([highest, *noisy[:1].tolist()])
    raised = min(chosen * _ENOUGH / outputs, limit)
    if raised < 1.2 * chosen:
        return trajectories, None
    return prepare_logs(uniform, bandwidth=raised, how="chosen from the data"), (
        f"bandwidth raised from {chosen:.3g} to {raised:.3g} Hz, as the log is short"
    )


def coherent_bandwidth(model: RobotModel, trajectories: Sequence[Trajectory]) -> float | None:
    """Return the frequency above which the motion asks for efforts that were not measured, Hz.

    From there on the effort that the model needs, a rough one, has more than 25 times the measured
    power, the geometric mean over joints. None if it has not up to the bandwidth, or has from the
    lowest frequency on, as where efforts are in other units.
    """
    frequency, ratio = effort_ratio(model, trajectories)
    inside = frequency <= min(trajectory.filter.bandwidth for trajectory in trajectories)
    frequency, ratio = frequency[inside], ratio[inside]
    worst = int(np.argmax(ratio))
    if ratio[worst] <= _EXCESS:
        return None
    together = np.flatnonzero(ratio[:worst] <= _EXCESS)
    return float(frequency[together[-1] + 1]) if len(together) else None


def effort_ratio(model: RobotModel, trajectories: Sequence[Trajectory]) -> tuple[Array, Array]:
    """Return the power of the effort that the model needs over that of the measured effort.

    Those are frequencies (K,) in Hz, without 0, and ratios (K,), the geometric mean over joints
    that have a motor.
    """
    robots = {t.payloads: carrying(model, t.payloads) for t in trajectories}
    held = [(robots[t.payloads], segment) for t in trajectories for segment in t.segments]
    segments = [segment for _, segment in held]
    window = min(
        0.5 * min(min(len(segment), _SAMPLES) * segment.period for segment in segments),
        100.0 / trajectories[0].filter.bandwidth,
    )
    fastest = 0.5 / max(segment.period for segment in segments)
    frequency = np.arange(1.0 / window, fastest, 1.0 / window)
    needed = measured = np.zeros((len(frequency), len(model.joints)))
    for robot, segment in held:
        start = segment[:_SAMPLES]
        motion = Motion(model.positions(start.position), start.velocity, start.acceleration)
        needed = needed + _density(robot.effort(motion), segment, window, frequency)
        measured = measured + _density(start.effort, segment, window, frequency)
    tiny = np.finfo(float).tiny
    driven = ~np.isin(model.joints, [joint for t in trajectories for joint in t.passive])
    ratio = np.mean((np.log(needed + tiny) - np.log(measured + tiny))[:, driven], axis=1)
    return frequency, np.exp(np.minimum(ratio, _LARGEST_RATIO))


def _density(effort: Array, segment: Stretch, window: float, frequency: Array) -> Array:
    """(K, n) spectral density times samples, on a grid that logs of all rates share."""
    rate = 1.0 / segment.period
    own, density = spectral_density(effort, rate, round(window * rate))
    columns = [np.interp(frequency, own, column) for column in density.T]
    return len(segment) * np.stack(columns, 1)
