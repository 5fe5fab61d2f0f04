"""Probability that frames touch the ground, for logs without contact flags.

A touching frame is at the height of the ground (or, less often, of a step), at rest, and carries a
share of the robot's weight, so the efforts of its limb lack Jᵀ f. A frame in the air is at any
height, moves, and carries nothing. Each state has a density of height, speed and load, and a hidden
Markov model with two states changes between them as rarely as a robot steps. Quantities that were
not measured are ignored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from geodrake.compiling import compiled
from geodrake.logs.motion import JointLog, Motion
from geodrake.model.robot_model import RobotModel
from geodrake.robot.transmission import times

Array = NDArray[np.float64]

_SMOOTH = 0.05  # s, over which velocities and efforts are smoothed
_HEIGHT, _SPEED = 0.01, 0.1  # m and m/s, of frames that touch: noise of base and joints, soft feet
_HIGH, _FAST = 0.1, 1.0  # m and m/s, of frames in the air
_STEP = 0.1  # probability of touching something other than level ground
HIGHEST = 0.2
"""Greatest height of such an object over level ground, m."""
_LIGHT = 0.1  # error of a force in the air, as a share of the weight per frame
_LARGEST = 1.3  # standard deviation of the largest of three standard normal errors
_EFFORT = 0.03  # noise of joints' efforts as a share of them, as in `contact_rows`
_ANYTHING, _NEVER = 1e-4, 1e-12  # floor of densities, as a share of the largest; of heights
_MEMORY = 0.03  # s, correlation time of errors
_NEARLY = 0.05  # relative singular value of a limb that is nearly stretched
_STEPS_LAST = 0.3  # s, mean duration of stance and of swing


@dataclass(frozen=True, eq=False)
class FrameSigns:
    """Evidence of contact of c frames at N instants; NaN where unknown."""

    time: Array
    heights: Array  # (N, c) over the ground, m
    speeds: Array  # (N, c) of the points that may touch, m/s
    # (N, c) largest component of the force from the efforts of the limb, over its deviation in air
    loads: Array


def touching_probability(signs: FrameSigns) -> Array:
    """Return probabilities (N, c) that frames touch the ground."""
    count = signs.heights.shape[1]
    log_odds = np.zeros(signs.heights.shape)
    level = _normal(signs.heights, _HEIGHT)
    is_low = (signs.heights > 0.0) & (signs.heights < HIGHEST)
    step = np.where(is_low, 1.0 / HIGHEST, 0.0)
    touching = np.where(np.isnan(signs.heights), np.nan, (1.0 - _STEP) * level + _STEP * step)
    _add_log_odds(log_odds, touching, _density_in_air(signs.heights), _NEVER)
    _add_log_odds(log_odds, 2.0 * _normal(signs.speeds, _SPEED), 2.0 * _normal(signs.speeds, _FAST))
    # A touching frame may carry any force, also that of sticky ground.
    most = 2.0 * max(count, 1) / _LIGHT
    load = np.where(signs.loads < most, 1.0 / most, 0.0)
    load[np.isnan(signs.loads)] = np.nan
    _add_log_odds(log_odds, load, 2.0 * _normal(signs.loads, _LARGEST))
    period = float(np.median(np.diff(signs.time))) if len(signs.time) > 1 else _MEMORY
    log_odds *= min(1.0, period / _MEMORY)
    probability = np.empty(log_odds.shape)
    for k in range(count):
        _forward_backward(log_odds[:, k], min(0.5, period / _STEPS_LAST), probability[:, k])
    return probability


def _normal(x: Array, deviation: float | Array) -> Array:
    return np.asarray(np.exp(-0.5 * (x / deviation) ** 2) / (np.sqrt(2.0 * np.pi) * deviation))


def _density_in_air(heights: Array) -> Array:
    """Return the density of heights in the air; noise extends it slightly below the ground."""
    above = 1.0 / (_HIGH * (1.0 + np.maximum(heights, 0.0) / _HIGH) ** 2)
    return np.asarray(above * np.exp(-0.5 * (np.minimum(heights, 0.0) / _HEIGHT) ** 2))


def _add_log_odds(log_odds: Array, touching: Array, aloft: Array, share: float = _ANYTHING) -> None:
    """Add the log odds of two densities in place; NaN adds nothing.

    Both densities get a floor, a share of the largest value.
    """
    largest = np.fmax(touching, 0.0).max(initial=0.0), np.fmax(aloft, 0.0).max(initial=0.0)
    least = share * max(*largest, 1e-300)
    odds = np.log(touching + least) - np.log(aloft + least)
    log_odds += np.where(np.isfinite(odds), odds, 0.0)


@compiled
def _forward_backward(log_odds: Array, change: float, out: Array) -> None:
    """Write the smoothed probabilities (N,) of the first of two states.

    `change` is the transition probability between samples.
    """
    ahead = 0.5
    for n in range(len(log_odds)):
        ahead = ahead * (1.0 - change) + (1.0 - ahead) * change
        odds = ahead / (1.0 - ahead) * np.exp(log_odds[n])
        ahead = min(max(odds / (1.0 + odds), 1e-12), 1.0 - 1e-12)
        out[n] = ahead
    behind = 0.5  # likelihood of later samples in the first state, as a share of that in both
    for n in range(len(log_odds) - 1, -1, -1):
        odds = out[n] / (1.0 - out[n]) * behind / (1.0 - behind)
        after = behind / (1.0 - behind) * np.exp(log_odds[n])
        share = min(max(after / (1.0 + after), 1e-12), 1.0 - 1e-12)
        behind = share * (1.0 - change) + (1.0 - share) * change
        out[n] = odds / (1.0 + odds)


def smooth_rates(log: JointLog, model: RobotModel) -> tuple[Array, Array] | None:
    """Return rates and smoothed accelerations (N, nv) of the model's joints; None if too short."""
    at = [log.joints.index(joint) for joint in model.joints]
    if len(log) < 4 or len(log) < 2 * _window(log.time):
        return None
    rates = log.velocity
    if rates is None:
        rates = np.gradient(log.position, log.time, axis=0)
    v = rates[:, at]
    vd = _smoothed(log.time, v, order=1)
    if log.acceleration is not None:
        measured = log.acceleration[:, at]
        vd = np.where(np.isfinite(measured), measured, vd)
    return v, vd


def _window(time: Array) -> int:
    return 2 * max(1, round(0.5 * _SMOOTH / float(np.median(np.diff(time))))) + 1


def _smoothed(time: Array, values: Array, order: int = 0) -> Array:
    """Return smoothed values (N, n) or their rates from a Savitzky–Golay filter of order 2.

    `scipy.signal.savgol_filter` does the same, but takes a third of a second to import.
    """
    window, period = _window(time), float(np.median(np.diff(time)))
    at = period * (np.arange(window) - window // 2)
    weights = np.linalg.pinv(np.vander(at, 3, increasing=True))[order]
    return np.asarray(correlate1d(values, weights, axis=0, mode="nearest"))


def signs_of(
    log: JointLog,
    model: RobotModel,
    jacobians: Array,
    heights: Array,
    known: NDArray[np.bool_],
    *,
    by_efforts: bool,
) -> FrameSigns:
    """Return heights and speeds of frames in a log, and loads if `by_efforts`.

    Args:
        jacobians: (K, c, 3 or 6, nv) in W, translational above rotational.
        heights: (K, c) over the ground, m.
        known: (N,) K instants with known positions.
    """
    at = [log.joints.index(joint) for joint in model.joints]
    q, tau = log.position[:, at], log.effort[:, at]
    is_measured = np.array([log.effort_kinds.get(j, "effort") == "effort" for j in model.joints])
    count = jacobians.shape[1]
    shape = len(log), count
    all_heights, speeds, loads = np.full((3, *shape), np.nan)
    all_heights[known] = heights
    if (rates := smooth_rates(log, model)) is None:
        return FrameSigns(log.time, all_heights, speeds, loads)
    v, vd = rates
    tau = _smoothed(log.time, tau)
    for k, J in enumerate(np.moveaxis(jacobians, 1, 0)):
        speeds[known, k] = np.linalg.norm(times(J[:, :3], v[known]), axis=1)
    weight = float(model.total_phi[:, 0].sum() * np.linalg.norm(model.tree.gravity))
    is_known = np.asarray(np.isfinite(np.hstack([q, v, vd])).all(axis=1))
    rows = is_known[known]
    if by_efforts and is_measured.any() and rows.any():
        at_base = np.isin(model.joints, model.base_joints)
        motion = Motion(model.positions(q[is_known]), v[is_known], vd[is_known])
        missing = model.effort(motion) - tau[is_known]
        noise = _EFFORT * np.sqrt(np.nanmean(np.square(tau[is_known]), axis=0))
        for k, J in enumerate(np.moveaxis(jacobians, 1, 0)):
            limb = np.asarray(J.any(axis=(0, 1))) & ~at_base
            if not limb.any() or not is_measured[limb].all():
                continue
            inverse = np.linalg.pinv(np.swapaxes(J[rows][:, :, limb], 1, 2), rcond=_NEARLY)
            solution = inverse[:, :3]
            by_noise = np.square(solution * noise[limb]).sum(axis=2)
            deviations = np.sqrt((_LIGHT * weight / count) ** 2 + by_noise)
            force = times(solution, missing[:, limb])
            loads[is_known, k] = (np.abs(force) / deviations).max(axis=1)
    return FrameSigns(log.time, all_heights, speeds, loads)
