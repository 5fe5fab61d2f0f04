"""The model itself, as simulators of its exports are compared with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.control.export_proof.drives import Drives
from geodrake.effects import Effect
from geodrake.logs.motion import Motion
from geodrake.model.file_terms import DryFriction
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

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


def without(model: RobotModel, kinds: tuple[type[Effect], ...]) -> RobotModel:
    """A model less effects of some kinds, whose dry friction acts in full at any speed."""
    effects = tuple(f for f in model.effects if not isinstance(f.effect, kinds))
    return replace(model, effects=effects, information=None, fading_speed=None)


def roll_out_all(
    model: RobotModel, starts: Sequence[Start], step: float, drives: Drives | None = None
) -> Array:
    """Rollouts of a model without dry friction, all at once, by the classic Runge–Kutta method.

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
    """Accelerations (W, nv) under efforts (W, nv): efforts are affine in accelerations."""
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
    """Where the position of each velocity stands among Drake's."""
    nv = len(model.joints)
    places = model.positions(np.arange(nv, dtype=float)[None])[0]
    return np.argsort(places)
