"""The model itself, as simulators of its exports are compared with it, and its actuators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import Effect
from geodrake.inertia import Array
from geodrake.logs.motion import Motion
from geodrake.model.exporting.joints import exported_joints
from geodrake.model.file_terms import DryFriction
from geodrake.model.robot_model import RobotModel

STEP = 1e-3
"""Length of a step of rollouts, s."""


@dataclass(frozen=True, eq=False)
class Start:
    """Where a rollout starts, and the efforts that act.

    Attributes:
        q: (nv,) positions, rad or m.
        v: (nv,) velocities.
        effort: (K, nv) efforts, each held for a step, N·m or N.
    """

    q: Array
    v: Array
    effort: Array


@dataclass(frozen=True, eq=False)
class Drives:
    """Servos and motors of n joints; all (n,).

    Attributes:
        stiffness: Of servos that are told positions; 0 at joints that are told efforts.
        damping: Of servos, on the velocity.
        delay: By how much what they are told acts late, s.
    """

    stiffness: Array
    damping: Array
    delay: Array

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
            step: Length of a step, s.
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
        starts: Where the W rollouts start, and their K efforts.
        step: Length of a step, s.
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
    return np.asarray(np.linalg.solve(mass, (effort - needed[:, 0])[..., None])[..., 0])


def position_order(model: RobotModel) -> NDArray[np.intp]:
    """Return where the position of each velocity stands among Drake's."""
    nv = len(model.joints)
    places = model.positions(np.arange(nv, dtype=float)[None])[0]
    return np.argsort(places)
