"""Where joints are to go: the trunk sways above planted feet, or the feet trot in place."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from diagrams.benchmarks.floating.draws import TROT
from diagrams.benchmarks.floating.robots import ROBOTS, Robot
from diagrams.benchmarks.floating.world import Array, Secret, compiled, joint_names, sole_points

_RATE = 100.0  # Hz, of targets
_RAMP = 2.0  # s, until a motion is whole
_WAVES = ((0.15, 0.4), (0.4, 0.9), (0.9, 1.8))  # Hz
_SHARES = (0.5, 0.35, 0.15)
_STANCE = 0.6  # share of a trot's period in which a foot stands
_ITERATIONS = 4


def standing(model: mujoco.MjModel, robot: Robot) -> Array:
    """Return positions of the root and the joints where the feet stand on the ground."""
    data = mujoco.MjData(model)
    names = joint_names(model)
    data.qpos[:7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    data.qpos[7:] = [robot.posture.get(joint, 0.0) for joint in names]
    mujoco.mj_kinematics(model, data)
    heights = [data.body(foot).xpos[2] for foot in robot.feet]
    data.qpos[2] = -min(heights)
    return data.qpos.copy()


def joint_targets(
    name: str, motion: str, duration: float, rng: np.random.Generator
) -> tuple[Array, Callable[[float], Array], Callable[[float], Array]]:
    """Return where a robot starts, and targets of its joints and their rates by time."""
    robot, model = ROBOTS[name], compiled(name, Secret())
    start = standing(model, robot)
    time = np.arange(0.0, duration + 2.0 / _RATE, 1.0 / _RATE)
    ramp = np.clip(time / _RAMP, 0.0, 1.0)
    ramp = ramp**2 * (3.0 - 2.0 * ramp)
    share = 0.5 if motion == TROT else 1.0
    sway = np.column_stack([share * half * _waves(robot.pace * time, rng) for half in robot.sway])
    sway *= ramp[:, None]
    data = mujoco.MjData(model)
    data.qpos[:] = start
    mujoco.mj_kinematics(model, data)
    feet = [model.body(foot).id for foot in robot.feet]
    places = data.xpos[feet].copy()
    turns = data.xmat[feet].copy()
    lifts = _lifts(robot, time, rng) * ramp[:, None] if motion == TROT else None
    columns = [
        [model.joint(joint).dofadr[0] for joint in leg if joint] for leg in robot.feet.values()
    ]
    legs = {int(k) for leg in columns for k in leg}
    free = [k for k in range(6, model.nv) if k not in legs]
    wanted = np.tile(start[7:], (len(time), 1))
    for k in free:
        wanted[:, k - 6] += robot.swing * ramp * _waves(robot.pace * time, rng)
    has_sole = any(robot.sole)
    for i in range(len(time)):
        data.qpos[:3] = start[:3] + sway[i, :3]
        mujoco.mju_euler2Quat(data.qpos[3:7], sway[i, 3:], "xyz")
        if i:
            data.qpos[7:] = np.where(
                np.isin(np.arange(6, model.nv), free), wanted[i], wanted[i - 1]
            )
        for _ in range(_ITERATIONS):
            _reach(model, data, feet, columns, places, turns, lifts, i, sole=has_sole)
        wanted[i] = data.qpos[7:]
    spline = CubicSpline(time, wanted)
    return start, spline, spline.derivative()


def _reach(model, data, feet, columns, places, turns, lifts, i, *, sole) -> None:  # type: ignore[no-untyped-def]
    """Bring each foot nearer to its place, by the joints of its leg."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    along, about = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for k, (foot, leg) in enumerate(zip(feet, columns, strict=True)):
        mujoco.mj_jacBody(model, data, along, about, foot)
        away = places[k] - data.xpos[foot]
        if lifts is not None:
            away[2] += lifts[i, k]
        jacobian = along[:, leg]
        if sole:
            turn = turns[k].reshape(3, 3) @ data.xmat[foot].reshape(3, 3).T
            quaternion, angle = np.zeros(4), np.zeros(3)
            mujoco.mju_mat2Quat(quaternion, turn.ravel())
            mujoco.mju_quat2Vel(angle, quaternion, 1.0)
            away = np.concatenate([away, angle])
            jacobian = np.vstack([jacobian, about[:, leg]])
        damped = jacobian.T @ jacobian + 1e-8 * np.eye(len(leg))
        data.qpos[np.add(leg, 1)] += np.linalg.solve(damped, jacobian.T @ away)


def _waves(time: Array, rng: np.random.Generator) -> Array:
    """Return a sum of waves between −1 and 1, of random frequencies and phases, 0 at first."""
    found = np.zeros_like(time)
    for (low, high), share in zip(_WAVES, _SHARES, strict=True):
        frequency, phase = rng.uniform(low, high), rng.uniform(0.0, 2.0 * np.pi)
        found += share * np.sin(2.0 * np.pi * frequency * time + phase)
    return found


def _lifts(robot: Robot, time: Array, rng: np.random.Generator) -> Array:
    """Return the height of each foot in a trot, whose diagonal feet swing together."""
    period = (robot.period or 1.0) * rng.uniform(0.9, 1.1)
    found = np.zeros((len(time), len(robot.feet)))
    for k in range(len(robot.feet)):
        phase = time / period + (0.5 if k in (1, 2) else 0.0)
        swing = (phase % 1.0 - _STANCE) / (1.0 - _STANCE)
        found[:, k] = robot.lift * np.where(swing > 0.0, np.sin(np.pi * swing.clip(0.0)) ** 2, 0.0)
    return found
