"""References for simulators of exports: the model, its actuators, and logged or random motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geodrake.control.export_proof.joints import exported_joints
from geodrake.control.rollout.passages import Passage
from geodrake.inertia import Array
from geodrake.logs.motion import Motion, Trajectory
from geodrake.model.robot_model import RobotModel

STEP = 1e-3
"""Time step of rollouts, s."""

HORIZON = 0.2
"""Duration of a rollout, s."""

_CHUNK, _CHUNKS = 1000, 12  # samples of a passage, and number of passages
_COMPARED = 400  # samples at which efforts are compared
_STARTS = 4
_RANDOM, _PERIOD = 3000, 0.01  # samples of random motion, and sampling period, s
_WAVES, _FREQUENCIES = 4, (0.1, 1.0)  # Hz
_MODULATION, _MODULATION_FREQUENCY = 0.3, 7.0  # relative to the efforts of random starts, and Hz
_LARGEST, _FASTEST = np.pi, 2.0  # rad or m, and per s


@dataclass(frozen=True, eq=False)
class Start:
    """Initial state and efforts of a rollout."""

    q: Array  # (nv,) positions, rad or m
    v: Array  # (nv,) velocities
    effort: Array  # (K, nv) efforts, each held for a step, N·m or N


@dataclass(frozen=True, eq=False)
class Drives:
    """Servos and motors of n joints; all (n,)."""

    stiffness: Array  # of servos with position commands; 0 for effort commands
    damping: Array  # of servos, on the velocity
    delay: Array  # of control signals, s

    @staticmethod
    def of(model: RobotModel, joints: Sequence[str]) -> Drives:
        """Return the actuators of some joints of a model; others apply efforts directly."""
        exported = exported_joints(model)
        rows = [
            (a.kp, a.kd, a.delay) if joint in joints and (a := exported.get(joint)) else (0, 0, 0)
            for joint in model.joints
        ]
        return Drives(*np.array(rows, float).reshape(-1, 3).T)

    def controls(self, q: Array, effort: Array) -> Array:
        """Return control signals (K, n): efforts, or positions for which servos at q exert them."""
        is_servo = self.stiffness > 0.0
        return np.where(is_servo, q + effort / np.where(is_servo, self.stiffness, 1.0), effort)

    def effort(self, signals: Array, q: Array, v: Array) -> Array:
        """Return efforts (W, n) due to control signals (W, n) at q and v (W, n)."""
        is_servo = self.stiffness > 0.0
        return np.where(is_servo, self.stiffness * (signals - q) - self.damping * v, signals)

    def delayed(self, controls: Array, k: int, fraction: float, step: float) -> Array:
        """Return the delayed control signals (W, n) at a fraction of step k.

        Delayed signals are interpolated between the starts of steps, and constant before the first.

        Args:
            controls: (W, K, n) control signals, each held for a step.
        """
        position = k + fraction - self.delay / step
        position = np.where(self.delay > 0.0, np.clip(position, 0.0, k), k)
        index, joints = position.astype(int), np.arange(len(position))
        first = controls[:, index, joints]
        second = controls[:, np.minimum(index + 1, k), joints]
        return np.asarray(first + (position - index) * (second - first))


def without(model: RobotModel, properties: Sequence[str]) -> RobotModel:
    """Return a model without some properties of joints, and with unsmoothed dry friction."""
    effects = tuple(f for f in model.effects if f.effect.file_term.joint not in properties)
    return replace(model, effects=effects, information=None, fading_speed=None)


def roll_out_all(
    model: RobotModel, starts: Sequence[Start], step: float, drives: Drives | None = None
) -> Array:
    """Simulate a model without dry friction, all starts at once, by the classic Runge–Kutta method.

    Args:
        model: The model, whose effects depend only on q, v and v̇.
        drives: Actuators with `Drives.controls` as input instead of efforts, if any.

    Returns:
        (W, K + 1, nv) positions, rad or m.
    """
    smooth = without(model, ["friction"])
    drives = Drives.of(model, ()) if drives is None else drives
    q, v = np.array([start.q for start in starts]), np.array([start.v for start in starts])
    controls = np.array([drives.controls(start.q, start.effort) for start in starts])

    def acceleration(q: Array, v: Array, k: int, fraction: float) -> Array:
        signals = drives.delayed(controls, k, fraction, step)
        return _acceleration(smooth, q, v, drives.effort(signals, q, v))

    positions = [q]
    for k in range(controls.shape[1]):
        a1 = acceleration(q, v, k, 0.0)
        a2 = acceleration(q + step / 2 * v, v2 := v + step / 2 * a1, k, 0.5)
        a3 = acceleration(q + step / 2 * v2, v3 := v + step / 2 * a2, k, 0.5)
        a4 = acceleration(q + step * v3, v4 := v + step * a3, k, 1.0)
        q = q + step / 6 * (v + 2 * v2 + 2 * v3 + v4)
        v = v + step / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        positions.append(q)
    return np.array(positions).swapaxes(0, 1)


def _acceleration(model: RobotModel, q: Array, v: Array, effort: Array) -> Array:
    """Return accelerations (W, nv) under efforts (W, nv)."""
    count, nv = v.shape
    units = np.vstack([np.zeros(nv), np.eye(nv)])
    motion = Motion(
        model.positions(np.repeat(q, nv + 1, axis=0)),
        np.repeat(v, nv + 1, axis=0),
        np.tile(units, (count, 1)),
    )
    needed = model.effort(motion).reshape(count, nv + 1, nv)
    mass = (needed[:, 1:] - needed[:, :1]).swapaxes(1, 2)
    try:
        return np.asarray(np.linalg.solve(mass, (effort - needed[:, 0])[..., None])[..., 0])
    except np.linalg.LinAlgError as error:
        least = int(np.abs(np.diagonal(mass, axis1=1, axis2=2)).max(axis=0).argmin())
        raise RuntimeError(f"the bodies moved by {model.joints[least]} have no inertia") from error


def logged_motions(model: RobotModel, trajectories: Sequence[Trajectory]) -> list[Motion]:
    """Return passages of logs, spread evenly."""
    passages = [
        Passage(trajectory.name, trajectory.began, stretch[start : start + _CHUNK], stretch, start)
        for trajectory in trajectories
        for stretch in trajectory.segments
        for start in range(0, max(1, len(stretch) - _CHUNK // 2), _CHUNK)
    ]
    chosen = np.linspace(0, len(passages) - 1, min(_CHUNKS, len(passages))).round().astype(int)
    return [passages[k].motion(model) for k in dict.fromkeys(chosen.tolist())]


def random_motion(model: RobotModel, seed: int = 0) -> Motion:
    """Return a smooth random motion within the robot's limits."""
    rng, nv = np.random.default_rng(seed), len(model.joints)
    low, high = model.position_limits
    low, high = np.maximum(low, -_LARGEST), np.minimum(high, _LARGEST)
    fastest = np.minimum(model.velocity_limits, _FASTEST)
    time: Array = np.arange(_RANDOM, dtype=float) * _PERIOD
    rates = 2 * np.pi * rng.uniform(*_FREQUENCIES, (nv, _WAVES))
    phases = rng.uniform(0.0, 2 * np.pi, (nv, _WAVES))
    angle = time[:, None, None] * rates + phases
    waves = np.sin(angle), rates * np.cos(angle), -(rates**2) * np.sin(angle)
    q, v, vd = (wave.sum(-1) for wave in waves)
    size = np.minimum((high - low) / 2 / np.abs(q).max(0), fastest / np.abs(v).max(0))
    q = model.positions((low + high) / 2 + size * q)
    return Motion(q, size * v, size * vd, time, q[:0])


def compared(motions: Sequence[Motion]) -> Motion:
    """Return samples of motions, spread evenly, at which efforts are compared."""
    q, v, vd = (np.concatenate([getattr(m, name) for m in motions]) for name in ("q", "v", "vd"))
    stride = max(1, len(v) // _COMPARED)
    return Motion(q[::stride], v[::stride], vd[::stride])


def logged_starts(held: RobotModel, trajectories: Sequence[Trajectory]) -> list[Start]:
    """Return starts of rollouts in logs, under the logged efforts minus dry friction."""
    stretches = [s for trajectory in trajectories for s in trajectory.segments]
    longest = sorted(stretches, key=len, reverse=True)[:_STARTS]
    fractions = (np.arange(_STARTS) + 0.5) / _STARTS
    time, starts = np.arange(round(HORIZON / STEP)) * STEP, []
    for stretch, fraction in zip(longest * _STARTS, fractions.tolist(), strict=False):
        count = int(np.ceil(HORIZON / stretch.period)) + 2
        if len(stretch) < count:
            continue
        start = int(fraction * (len(stretch) - count))
        part = stretch[start : start + count]
        effort = part.effort.copy()
        for fitted in held.effects:
            if fitted.effect.file_term.joint == "friction":
                joint = held.joints.index(fitted.effect.where[0])
                effort[:, joint] -= fitted.parameters[0] * np.sign(part.velocity[:, joint])
        columns = [np.interp(time, part.time - part.time[0], column) for column in effort.T]
        starts.append(Start(part.position[0], part.velocity[0], np.array(columns).T))
    return starts


def random_starts(held: RobotModel, motion: Motion) -> list[Start]:
    """Return starts of rollouts along a motion, under modulated static efforts."""
    stride = len(motion.v) // _STARTS
    q, v = motion.q[::stride], motion.v[::stride]
    effort = held.effort(Motion(q, np.zeros_like(v), np.zeros_like(v)))
    time = np.arange(round(HORIZON / STEP)) * STEP
    # Modulated, so that delays make a difference.
    factor = 1.0 + _MODULATION * np.sin(2 * np.pi * _MODULATION_FREQUENCY * time)
    return [Start(q[k], v[k], np.outer(factor, effort[k])) for k in range(len(v))]
