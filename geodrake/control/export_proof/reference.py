"""References for simulators of exports: the model itself, its actuators, and motion.

Motion is that of logs, or random within limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geodrake.control.export_proof.joints import exported_joints
from geodrake.control.rollout.passages import Passage
from geodrake.effects import Effect
from geodrake.effects.file_terms import DryFriction
from geodrake.inertia import Array
from geodrake.logs.motion import Motion, Trajectory
from geodrake.model.robot_model import RobotModel

STEP = 1e-3
"""Length of a step of rollouts, s."""

HORIZON = 0.2
"""Length of a rollout, s."""

_CHUNK, _CHUNKS = 1000, 12  # samples that follow each other, and how many such passages of all logs
_COMPARED = 400  # samples at which efforts are compared
_STARTS = 4
_RANDOM, _PERIOD = 3000, 0.01  # samples where there is no log, and their distance, s
_WAVES, _FREQUENCIES = 4, (0.1, 1.0)  # Hz
_SWING, _SWING_FREQUENCY = 0.3, 7.0  # share of the efforts of random starts, Hz
_LARGEST, _FASTEST = np.pi, 2.0  # rad or m, and per s


@dataclass(frozen=True, eq=False)
class Start:
    """Where a rollout starts, and the efforts that act."""

    q: Array  # (nv,) positions, rad or m
    v: Array  # (nv,) velocities
    effort: Array  # (K, nv) efforts, each held for a step, N·m or N


@dataclass(frozen=True, eq=False)
class Drives:
    """Servos and motors of n joints; all (n,)."""

    stiffness: Array  # of servos that are told positions; 0 at joints that are told efforts
    damping: Array  # of servos, on the velocity
    delay: Array  # by how much what they are told acts late, s

    @staticmethod
    def of(model: RobotModel, joints: Sequence[str]) -> Drives:
        """Return the actuators of some joints of a model; the others are told efforts at once."""
        known = {name: each for name, each in exported_joints(model).items() if name in joints}
        rows = [
            (a.kp, a.kd, a.delay) if (a := known.get(joint)) else (0.0, 0.0, 0.0)
            for joint in model.joints
        ]
        return Drives(*np.array(rows, float).reshape(-1, 3).T)

    def controls(self, q: Array, effort: Array) -> Array:
        """Return control signals (K, n): efforts, or where servos at q (n,) pull with them."""
        servo = self.stiffness > 0.0
        return np.where(servo, q + effort / np.where(servo, self.stiffness, 1.0), effort)

    def effort(self, told: Array, q: Array, v: Array) -> Array:
        """Return efforts (W, n) of positions or efforts (W, n) that are told at q and v (W, n)."""
        servo = self.stiffness > 0.0
        return np.where(servo, self.stiffness * (told - q) - self.damping * v, told)

    def told(self, controls: Array, k: int, share: float, step: float) -> Array:
        """Return what (W, n) has come through at an instant of a step.

        Late signals are straight lines between those at the beginnings of steps; before the first
        one, all are like it.

        Args:
            controls: (W, K, n) control signals, each held for a step.
        """
        at = np.where(self.delay > 0.0, np.clip(k + share - self.delay / step, 0.0, k), k)
        first, joints = at.astype(int), np.arange(len(at))
        after = np.minimum(first + 1, k)
        early, late = controls[:, first, joints], controls[:, after, joints]
        return np.asarray(early + (at - first) * (late - early))


def without(model: RobotModel, kinds: tuple[type[Effect], ...]) -> RobotModel:
    """Return a model less effects of some kinds, whose dry friction is full at any speed."""
    effects = tuple(f for f in model.effects if not isinstance(f.effect, kinds))
    return replace(model, effects=effects, information=None, fading_speed=None)


def roll_out_all(
    model: RobotModel, starts: Sequence[Start], step: float, drives: Drives | None = None
) -> Array:
    """Roll out a model without dry friction, all starts at once, by the classic Runge–Kutta method.

    Args:
        model: The model, whose effects depend on nothing but q, v and v̇.
        drives: Actuators that are told `Drives.controls` in the place of efforts, if any.

    Returns:
        (W, K + 1, nv) positions, rad or m.
    """
    smooth = without(model, (DryFriction,))
    drives = Drives.of(model, ()) if drives is None else drives
    q, v = np.array([start.q for start in starts]), np.array([start.v for start in starts])
    controls = np.array([drives.controls(start.q, start.effort) for start in starts])

    def acceleration(q: Array, v: Array, k: int, share: float) -> Array:
        told = drives.told(controls, k, share, step)
        return _acceleration(smooth, q, v, drives.effort(told, q, v))

    found = [q]
    for k in range(controls.shape[1]):
        a1 = acceleration(q, v, k, 0.0)
        a2 = acceleration(q + step / 2 * v, v2 := v + step / 2 * a1, k, 0.5)
        a3 = acceleration(q + step / 2 * v2, v3 := v + step / 2 * a2, k, 0.5)
        a4 = acceleration(q + step * v3, v4 := v + step * a3, k, 1.0)
        q = q + step / 6 * (v + 2 * v2 + 2 * v3 + v4)
        v = v + step / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        found.append(q)
    return np.array(found).swapaxes(0, 1)


def _acceleration(model: RobotModel, q: Array, v: Array, effort: Array) -> Array:
    """Return accelerations (W, nv) under efforts (W, nv), which are affine in them."""
    count, nv = v.shape
    units = np.vstack([np.zeros(nv), np.eye(nv)])
    tried = Motion(
        model.positions(np.repeat(q, nv + 1, axis=0)),
        np.repeat(v, nv + 1, axis=0),
        np.tile(units, (count, 1)),
    )
    needed = model.effort(tried).reshape(count, nv + 1, nv)
    mass = (needed[:, 1:] - needed[:, :1]).swapaxes(1, 2)
    try:
        return np.asarray(np.linalg.solve(mass, (effort - needed[:, 0])[..., None])[..., 0])
    except np.linalg.LinAlgError as error:
        least = int(np.abs(np.diagonal(mass, axis1=1, axis2=2)).max(axis=0).argmin())
        raise RuntimeError(f"the bodies moved by {model.joints[least]} have no inertia") from error


def logged_motions(model: RobotModel, trajectories: Sequence[Trajectory]) -> list[Motion]:
    """Choose passages of logs, spread evenly."""
    passages = [
        Passage(trajectory.name, trajectory.began, stretch[start : start + _CHUNK], stretch, start)
        for trajectory in trajectories
        for stretch in trajectory.segments
        for start in range(0, max(1, len(stretch) - _CHUNK // 2), _CHUNK)
    ]
    spread = np.linspace(0, len(passages) - 1, min(_CHUNKS, len(passages))).round().astype(int)
    return [passages[k].motion(model) for k in dict.fromkeys(spread.tolist())]


def random_motion(model: RobotModel, seed: int = 0) -> Motion:
    """Return a smooth motion at random, within the limits of the robot."""
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
    """Choose samples of motions, spread evenly, at which efforts are compared."""
    q, v, vd = (np.concatenate([getattr(m, name) for m in motions]) for name in ("q", "v", "vd"))
    every = max(1, len(v) // _COMPARED)
    return Motion(q[::every], v[::every], vd[::every])


def logged_starts(held: RobotModel, trajectories: Sequence[Trajectory]) -> list[Start]:
    """Return starts of rollouts in logs, under the logged efforts less dry friction."""
    stretches = [s for trajectory in trajectories for s in trajectory.segments]
    longest = sorted(stretches, key=len, reverse=True)[:_STARTS]
    shares = (np.arange(_STARTS) + 0.5) / _STARTS
    time, found = np.arange(round(HORIZON / STEP)) * STEP, []
    for stretch, share in zip(longest * _STARTS, shares.tolist(), strict=False):
        count = int(np.ceil(HORIZON / stretch.period)) + 2
        if len(stretch) < count:
            continue
        start = int(share * (len(stretch) - count))
        part = stretch[start : start + count]
        effort = part.effort.copy()
        for fitted in held.effects:
            if isinstance(fitted.effect, DryFriction):
                at = held.joints.index(fitted.effect.joint)
                effort[:, at] -= fitted.parameters[0] * np.sign(part.velocity[:, at])
        acted = [np.interp(time, part.time - part.time[0], column) for column in effort.T]
        found.append(Start(part.position[0], part.velocity[0], np.array(acted).T))
    return found


def random_starts(held: RobotModel, motion: Motion) -> list[Start]:
    """Return starts of rollouts along a motion, under efforts about those of its postures."""
    every = len(motion.v) // _STARTS
    q, v = motion.q[::every], motion.v[::every]
    effort = held.effort(Motion(q, np.zeros_like(v), np.zeros_like(v)))
    time = np.arange(round(HORIZON / STEP)) * STEP
    share = 1.0 + _SWING * np.sin(2 * np.pi * _SWING_FREQUENCY * time)  # so that delays are felt
    return [Start(q[k], v[k], np.outer(share, effort[k])) for k in range(len(v))]
