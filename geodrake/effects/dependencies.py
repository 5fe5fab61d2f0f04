"""What the columns of an effect depend on: declared by its class, or found by trial.

Effects that come with geodrake declare it. One of a user's own need not: all that its base class
may see is right, but costs simulations and controllers time if it depends on less. Accelerations
and loads are tried, and one that defines `rows` is given the time; that it depends on the history
of the motion or the temperature it must declare.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeGuard

import numpy as np

from geodrake.effects.base import BodyEffect, Effect, JointEffect
from geodrake.effects.robot_motion import Array, RobotMotion

Trial = Callable[[Array, Array, Array], RobotMotion]
"""Gives a motion of a robot with some velocities, accelerations and loads, each (N, nv)."""

_SAMPLES = 8


def sees_joint_only(effect: Effect) -> TypeGuard[JointEffect]:
    """Whether an effect's columns are functions of the motion of its own joint."""
    return isinstance(effect, JointEffect) and type(effect).rows is JointEffect.rows


def dependencies(effect: Effect, trial: Trial | None, joints: int) -> frozenset[str]:
    """The signals that an effect's columns depend on; see `Effect.depends_on`.

    Args:
        trial: To try whether an effect that does not say so depends on accelerations and loads;
            without it, it does.
    """
    names = frozenset(type(effect).depends_on)
    if declares_signals(type(effect)):
        return names
    # No trial shows the time, as what acts during a window is none at other times.
    seen_by_rows = BodyEffect.depends_on | {"time"}
    names |= Effect.depends_on if sees_joint_only(effect) else seen_by_rows
    if trial is None:
        return names
    v, vd, load = 10.0 * np.random.default_rng(0).normal(size=(3, _SAMPLES, joints))
    zero = np.zeros_like(v)
    still = trial(v, zero, zero)
    columns = effect.regressor(still)
    others = {"vd": trial(v, vd, zero), "load": replace(still, load=load)}
    alike = {
        name
        for name, motion in others.items()
        if np.array_equal(columns, effect.regressor(motion), equal_nan=True)
    }
    return names - alike


def declares_signals(kind: type[Effect]) -> bool:
    """Whether a class says what its columns depend on where these are written, or below."""
    written = ("depends_on", "columns", "rows")
    nearest = next(base for base in kind.__mro__ if any(name in vars(base) for name in written))
    return "depends_on" in vars(nearest)
