"""Logs of a robot on its feet: where it is to go, how it moves, and what sensors say."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from diagrams.benchmarks.floating.world import (
    NO_FLAGS,
    ROBOTS,
    STEP,
    TROT,
    WRONG_FLAGS,
    Array,
    Draw,
    Robot,
    Secret,
    by_name,
    compiled,
    foot_wrench,
    joint_names,
    robot_text,
    secret_of,
)
from diagrams.benchmarks.hidden.robots import coloured

_RATE = 100.0  # Hz, of targets
_RAMP = 2.0  # s, until a motion is whole
_WAVES = ((0.15, 0.4), (0.4, 0.9), (0.9, 1.8))  # Hz
_SHARES = (0.5, 0.35, 0.15)
_STANCE = 0.6  # share of a trot's period in which a foot stands
_ITERATIONS = 4
_DAMPING = 1e-8
_ROOM = 0.8  # of the way to the nearer limit of a joint, which a swing takes


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
) -> tuple[Array, Callable[[Array], Array], Callable[[Array], Array]]:
    """Return where a robot starts, and targets of its joints and their rates by time."""
    robot, model = ROBOTS[name], compiled(name, Secret())
    start = standing(model, robot)
    time = np.arange(0.0, duration + 2.0 / _RATE, 1.0 / _RATE)
    ramp = np.clip(time / _RAMP, 0.0, 1.0)
    ramp = ramp**2 * (3.0 - 2.0 * ramp)
    share = 0.5 if motion == TROT else 1.0
    sway = np.column_stack([share * half * _waves(robot.pace * time, rng) for half in robot.sway])
    sway *= ramp[:, None]
    lifts = np.zeros((len(time), len(robot.feet)))
    if motion == TROT:
        lifts = _lifts(robot, time, rng) * ramp[:, None]
    legs = _Legs(model, robot, start)
    swing = np.zeros((len(time), model.nv))
    for k in sorted({*range(6, model.nv)} - {k for leg in legs.columns for k in leg}):
        room = _ROOM * np.abs(model.jnt_range[k - 5] - start[k + 1]).min()
        swing[:, k] = min(robot.swing, room) * ramp * _waves(robot.pace * time, rng)
    wanted = np.array(
        [
            legs.reach(place, other, lift)
            for place, other, lift in zip(sway, swing[:, 6:], lifts, strict=True)
        ]
    )
    spline = CubicSpline(time, wanted)
    return start, spline, spline.derivative()


class _Legs:
    """Joints of legs for places of the trunk and the feet, each from those before."""

    def __init__(self, model: mujoco.MjModel, robot: Robot, start: Array) -> None:
        self._model, self._data, self._start = model, mujoco.MjData(model), start
        self._data.qpos[:] = start
        mujoco.mj_kinematics(model, self._data)
        self._feet = [model.body(foot).id for foot in robot.feet]
        self._places = self._data.xpos[self._feet].copy()
        self._turns = self._data.xmat[self._feet].reshape(-1, 3, 3).copy()
        self._has_soles = any(robot.sole)
        self.columns = [
            [int(model.joint(joint).dofadr[0]) for joint in leg] for leg in robot.feet.values()
        ]

    def reach(self, sway: Array, other: Array, lift: Array) -> Array:
        """Return positions of all joints.

        Args:
            sway: (6,) way of the trunk from where it stands, and its angles.
            other: Ways of all joints; those of legs do not count.
            lift: Height of each foot.
        """
        data, start = self._data, self._start
        legs = np.concatenate([np.add(leg, 1) for leg in self.columns])
        before = data.qpos[legs].copy()
        data.qpos[:3] = start[:3] + sway[:3]
        mujoco.mju_euler2Quat(data.qpos[3:7], sway[3:], "xyz")
        data.qpos[7:] = start[7:] + other
        data.qpos[legs] = before
        for _ in range(_ITERATIONS):
            self._step(lift)
        return np.asarray(data.qpos[7:].copy())

    def _step(self, lift: Array) -> None:
        """Bring each foot nearer to its place."""
        model, data = self._model, self._data
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        along, about = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        for k, (foot, leg) in enumerate(zip(self._feet, self.columns, strict=True)):
            mujoco.mj_jacBody(model, data, along, about, foot)
            away = self._places[k] + [0.0, 0.0, lift[k]] - data.xpos[foot]
            jacobian = along[:, leg]
            if self._has_soles:
                quaternion, angle = np.zeros(4), np.zeros(3)
                turn = self._turns[k] @ data.xmat[foot].reshape(3, 3).T
                mujoco.mju_mat2Quat(quaternion, turn.ravel())
                mujoco.mju_quat2Vel(angle, quaternion, 1.0)
                away = np.concatenate([away, angle])
                jacobian = np.vstack([jacobian, about[:, leg]])
            damped = jacobian.T @ jacobian + _DAMPING * np.eye(len(leg))
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
    """What happened, exactly."""

    model: mujoco.MjModel
    # joints, feet: Their names.
    joints: tuple[str, ...]
    feet: tuple[str, ...]
    time: Array  # (N,) s
    # q, v, a: Positions, rates and accelerations of MuJoCo.
    q: Array
    v: Array
    a: Array
    effort: Array  # (N, n) efforts of the motors
    touching: Array  # (N, F) whether a foot touches the ground
    wrench: Array  # (N, F, 6) of the ground on it

    @property
    def rate(self) -> Array:
        """Rates of the positions: MuJoCo's own are those of half a step before."""
        return self.v + 0.5 * STEP * self.a


@dataclass(frozen=True, eq=False)
class Recording:
    """Files of a draw, and what is true of them."""

    # model, logs: Paths of the URDF and of the tables.
    model: Path
    logs: tuple[Path, ...]
    secret: Secret  # what the file has not
    # Deviation of each joint's logged effort in all logs, N·m; empty without.
    deviations: Mapping[str, float]
    same: tuple[str, ...]  # links that are welded to the trunk
    # How far MuJoCo's inverse dynamics are from the logged efforts before noise, with the feet's
    # wrenches, as a share of the largest effort.
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
    q, v = measured(motion.q[:, 7:], _ENCODER), measured(motion.rate[:, 6:], _TACHO)
    for k, joint in enumerate(motion.joints):
        columns[f"{joint}.position"] = q[:, k]
        columns[f"{joint}.velocity"] = v[:, k]
        if draw.efforts:
            columns[f"{joint}.effort"] = effort[:, k]
    columns |= _base_columns(draw, motion, rng)
    return columns | _foot_columns(draw, secret, motion, rng)


def _base_columns(draw: Draw, motion: Motion, rng: np.random.Generator) -> dict[str, Array]:
    """Return columns of the base's estimator and of the IMU."""
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
        along[k] = axes.T @ motion.rate[k, :3]
        mujoco.mju_quatIntegrate(quaternion[k], turn[k], 1.0)
    about = motion.rate[:, 3:6]

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
    """Return columns of contacts and of the sensors of feet."""
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
    slow = coloured(rng.normal(size=(size, 3)), memory)
    return slow + _WHITE * rng.normal(size=(size, 3))


def _axes(name: str, values: Array) -> dict[str, Array]:
    return {f"{name}.{axis}": values[:, i] for i, axis in enumerate(_XYZ)}
