"""Where joints are to go: the trunk sways above planted feet, or the feet trot in place."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from diagrams.benchmarks.floating.draws import TROT
from diagrams.benchmarks.floating.robots import ROBOTS, Robot
from diagrams.benchmarks.floating.world import Array, Secret, compiled, joint_names

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
    """Joints of legs for places of the trunk and the feet, each from those before.

    Attributes:
        columns: Degrees of freedom of each leg.
    """

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
