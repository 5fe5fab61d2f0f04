"""Logs of a robot on its feet: simulated, measured with noise, and written as tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd

from diagrams.benchmarks.floating.draws import NO_FLAGS, WRONG_FLAGS, Draw
from diagrams.benchmarks.floating.motions import joint_targets
from diagrams.benchmarks.floating.robots import ROBOTS, by_name, robot_text
from diagrams.benchmarks.floating.world import (
    STEP,
    Array,
    Secret,
    compiled,
    foot_wrench,
    joint_names,
    secret_of,
)

_SETTLING = 1.0  # s, simulated before a log begins
_ENCODER, _TACHO = 2e-4, 5e-3  # rad, rad/s
_GYRO, _FORCE = 5e-3, 0.05  # rad/s, m/s²
_PLACE, _TURN = 1.5e-3, np.deg2rad(0.15)  # m, rad, of the slow error of the base
_WHITE = 0.1  # of it, white
_SLOWNESS = 5.0  # s
_VELOCITY = 0.01  # m/s, of the base
_EFFORT, _WRENCH = 0.01, 0.005  # of the range of a joint, of the weight
_ARM = 0.05  # m, of a foot sensor
_WRONG = 0.1
_EVERY = 17  # samples, of which one is checked
_UPRIGHT = 0.7
_HOLD, _BRAKE = 1000.0, 300.0  # N·m/m and N·m·s/m of the centre of mass, of an ankle
_XYZ = "xyz"


@dataclass(frozen=True, eq=False)
class Motion:
    """What happened, exactly.

    Attributes:
        model: The robot that hides something.
        joints, feet: Their names.
        time: (N,) s.
        q, v, a: Positions, rates and accelerations of MuJoCo.
        effort: (N, n) efforts of the motors.
        touching: (N, F) whether a foot touches the ground.
        wrench: (N, F, 6) of the ground on it.
    """

    model: mujoco.MjModel
    joints: tuple[str, ...]
    feet: tuple[str, ...]
    time: Array
    q: Array
    v: Array
    a: Array
    effort: Array
    touching: Array
    wrench: Array


@dataclass(frozen=True, eq=False)
class Recording:
    """Files of a draw, and what is true of them.

    Attributes:
        model, logs: Paths of the URDF and of the tables.
        secret: What the file has not.
        deviations: Deviation of each joint's logged effort in all logs, N·m; empty without.
        same: Links that are welded to the trunk.
        inverse_error: How far MuJoCo's inverse dynamics are from the logged efforts before noise,
            with the feet's wrenches, as a share of the largest effort.
    """

    model: Path
    logs: tuple[Path, ...]
    secret: Secret
    deviations: Mapping[str, float]
    same: tuple[str, ...]
    inverse_error: float


def simulate(draw: Draw, folder: Path) -> Recording:
    """Write the URDF and the logs of a draw into a folder."""
    secret = secret_of(draw)
    urdf = folder / f"{draw.robot}.urdf"
    urdf.write_text(robot_text(draw.robot), encoding="utf-8")
    paths, errors, tables = [], [], []
    for k, _ in enumerate(draw.motions):
        motion = run(draw, secret, k)
        errors.append(inverse_error(draw.robot, secret, motion))
        tables.append(pd.DataFrame(log_columns(draw, secret, motion, draw.rng(f"noise of {k}"))))
        paths.append(folder / f"log{k + 1}.csv")
        tables[-1].to_csv(paths[-1], index=False, float_format="%.10g")
    efforts = pd.concat(tables).filter(like=".effort")
    deviations = {name.removesuffix(".effort"): float(efforts[name].std()) for name in efforts}
    same = _welded(motion.model, ROBOTS[draw.robot].trunk)
    return Recording(urdf, tuple(paths), secret, deviations, same, max(errors))


def inverse_error(name: str, secret: Secret, motion: Motion) -> float:
    """Return how far inverse dynamics with measured wrenches are from efforts, at some samples.

    Contacts are off: what they do comes from the wrenches and MuJoCo's Jacobians alone.
    """
    model = compiled(name, secret)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data, worst = mujoco.MjData(model), 0.0
    along, about = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for k in range(0, len(motion.time), _EVERY):
        data.qpos[:], data.qvel[:], data.qacc[:] = motion.q[k], motion.v[k], motion.a[k]
        mujoco.mj_inverse(model, data)
        left = data.qfrc_inverse.copy()
        left[6:] -= motion.effort[k]
        for foot, wrench in zip(motion.feet, motion.wrench[k], strict=True):
            body = model.body(foot).id
            axes = data.xmat[body].reshape(3, 3)
            mujoco.mj_jacBody(model, data, along, about, body)
            left -= along.T @ (axes @ wrench[:3]) + about.T @ (axes @ wrench[3:])
        worst = max(worst, float(np.abs(left).max()))
    return worst / float(np.abs(motion.effort).max())


def _welded(model: mujoco.MjModel, link: str) -> tuple[str, ...]:
    """Return all links that nothing moves against a link."""
    own = model.body_weldid[model.body(link).id]
    return tuple(model.body(k).name for k in np.flatnonzero(model.body_weldid == own))


def run(draw: Draw, secret: Secret, log: int) -> Motion:
    """Simulate a log of a draw."""
    robot, model = ROBOTS[draw.robot], compiled(draw.robot, secret)
    joints, feet = joint_names(model), tuple(robot.feet)
    length = draw.duration + _SETTLING
    start, target, rate = joint_targets(
        draw.robot, draw.motions[log], length, draw.rng(f"motion of {log}")
    )
    stiffness = np.array([by_name(robot.stiffness, joint) for joint in joints])
    damping = np.array([by_name(robot.damping, joint) for joint in joints])
    data = mujoco.MjData(model)
    data.qpos[:] = start
    every = round(1.0 / (draw.rate * STEP))
    begin, steps = round(_SETTLING / STEP), round(length / STEP)
    times = np.arange(steps) * STEP
    wanted, rates = target(times), rate(times)
    mujoco.mj_forward(model, data)
    places = [data.body(foot).xpos[:2] for foot in feet]
    center, before = np.mean(places, axis=0), data.subtree_com[0, :2].copy()
    balance = [(joints.index(joint), *push) for joint, push in robot.balance.items()]
    found: list[tuple[Array, ...]] = []
    for k in range(steps):
        effort = stiffness * (wanted[k] - data.qpos[7:]) + damping * (rates[k] - data.qvel[6:])
        now = data.subtree_com[0, :2].copy()
        push = _HOLD * (now - center) + _BRAKE * (now - before) / STEP
        before = now
        for joint, axis, sign in balance:
            effort[joint] += sign * push[axis]
        data.qfrc_applied[6:] = effort
        if k < begin or k % every:
            mujoco.mj_step(model, data)
            continue
        mujoco.mj_forward(model, data)
        found.append(
            (
                data.qpos.copy(),
                data.qvel.copy(),
                data.qacc.copy(),
                effort,
                *foot_wrench(model, data, feet),
            )
        )
        mujoco.mj_step(model, data)
    stands = 1.0 - 2.0 * (data.qpos[4] ** 2 + data.qpos[5] ** 2)
    if not stands > _UPRIGHT:
        raise RuntimeError(f"{draw.robot} falls over: {draw}")
    stacked = [np.array(each) for each in zip(*found, strict=True)]
    time = np.arange(len(found)) / draw.rate
    return Motion(model, joints, feet, time, *stacked)


def log_columns(
    draw: Draw, secret: Secret, motion: Motion, rng: np.random.Generator
) -> Mapping[str, Array]:
    """Return what sensors say of a motion, by the names of columns."""
    noise = draw.noise

    def measured(values: Array, deviation: float | Array) -> Array:
        return values + noise * deviation * rng.normal(size=values.shape)

    columns: dict[str, Array] = {"time": motion.time}
    effort = motion.effort.copy()
    if secret.gain is not None:
        effort[:, motion.joints.index(secret.gain[0])] *= secret.gain[1]
    effort = measured(effort, _EFFORT * np.ptp(effort, axis=0))
    q, v = measured(motion.q[:, 7:], _ENCODER), measured(motion.v[:, 6:], _TACHO)
    for k, joint in enumerate(motion.joints):
        columns[f"{joint}.position"] = q[:, k]
        columns[f"{joint}.velocity"] = v[:, k]
        if draw.efforts:
            columns[f"{joint}.effort"] = effort[:, k]
    columns |= _base_columns(draw, motion, rng)
    return columns | _foot_columns(draw, secret, motion, rng)


def _base_columns(draw: Draw, motion: Motion, rng: np.random.Generator) -> dict[str, Array]:
    """Columns of the base's estimator and of the IMU."""
    size, noise = len(motion.time), draw.noise
    place = motion.q[:, :3] + noise * _PLACE * _drift(draw, size, rng)
    turn = noise * _TURN * _drift(draw, size, rng)
    quaternion = np.empty((size, 4))
    force, along = np.empty((size, 3)), np.empty((size, 3))
    gravity = motion.model.opt.gravity
    for k in range(size):
        quaternion[k] = motion.q[k, 3:7]
        axes = np.empty(9)
        mujoco.mju_quat2Mat(axes, quaternion[k])
        axes = axes.reshape(3, 3)
        force[k] = axes.T @ (motion.a[k, :3] - gravity)
        along[k] = axes.T @ motion.v[k, :3]
        mujoco.mju_quatIntegrate(quaternion[k], turn[k], 1.0)
    about = motion.v[:, 3:6]

    def measured(values: Array, deviation: float) -> Array:
        return values + noise * deviation * rng.normal(size=values.shape)

    return {
        **_axes("base.position", place),
        **{f"base.orientation.{n}": quaternion[:, i] for i, n in enumerate("wxyz")},
        **_axes("base.linear_velocity", measured(along, _VELOCITY)),
        **_axes("base.angular_velocity", measured(about, _GYRO)),
        **_axes("imu.angular_velocity", measured(about, _GYRO)),
        **_axes("imu.linear_acceleration", measured(force, _FORCE)),
    }


def _foot_columns(
    draw: Draw, secret: Secret, motion: Motion, rng: np.random.Generator
) -> dict[str, Array]:
    """Columns of contacts and of the sensors of feet."""
    weight = 9.81 * float(motion.model.body_mass.sum())
    deviation = draw.noise * _WRENCH * weight * np.array([1.0] * 3 + [_ARM] * 3)
    columns: dict[str, Array] = {}
    for k, foot in enumerate(motion.feet):
        if draw.contacts != NO_FLAGS:
            touching = motion.touching[:, k].copy()
            if draw.contacts == WRONG_FLAGS:
                touching ^= rng.random(len(touching)) < _WRONG
            columns[f"{foot}.contact"] = touching.astype(int)
        if draw.wrenches:
            wrench = motion.wrench[:, k] + deviation * rng.normal(size=(len(motion.time), 6))
            if secret.offset is not None and secret.offset[0] == foot:
                wrench = wrench + secret.offset[1]
            columns |= _axes(f"{foot}.force", wrench[:, :3])
            columns |= _axes(f"{foot}.torque", wrench[:, 3:])
    return columns


def _drift(draw: Draw, size: int, rng: np.random.Generator) -> Array:
    """Return (N, 3) noise that varies slowly with deviation one, and a little white noise."""
    memory = np.exp(-1.0 / (draw.rate * _SLOWNESS))
    noise = rng.normal(size=(size, 3))
    slow = noise.copy()
    slow[1:] *= np.sqrt(1.0 - memory**2)
    for k in range(1, size):
        slow[k] += memory * slow[k - 1]
    return np.asarray(slow + _WHITE * rng.normal(size=(size, 3)))


def _axes(name: str, values: Array) -> dict[str, Array]:
    return {f"{name}.{axis}": values[:, i] for i, axis in enumerate(_XYZ)}
