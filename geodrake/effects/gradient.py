"""Gradients of effects' regressors with respect to the motion, for the design of excitation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.effects.robot_motion import JointMotion, RobotMotion

Array = NDArray[np.float64]

_FIELDS = ("q", "v", "vd", "load", "sign_v")
_STEP = 1e-5  # of differences, of the largest value there is: rounding and curvature weigh alike


@dataclass(frozen=True, eq=False)
class RobotGradient:
    """Gradient of a number with respect to a `RobotMotion` of N samples."""

    q: Array  # (N, nv) with respect to the position belonging to each velocity
    v: Array  # (N, nv) with respect to the velocities
    vd: Array  # (N, nv) with respect to the accelerations
    load: Array  # (N, nv) with respect to the efforts that the rigid bodies need
    # Body name -> (N, nv, 10) with respect to its inertial regressor.
    bodies: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def zero(cls, motion: RobotMotion) -> RobotGradient:
        """Return the gradient of a constant: arrays to add to."""
        q, v, vd, load = np.zeros((4, *motion.v.shape))
        return cls(q, v, vd, load)


def joint_gradient(
    motion: RobotMotion,
    joint: str,
    columns: Callable[[JointMotion], Sequence[ArrayLike]],
    slopes: Sequence[Mapping[str, ArrayLike]] | None,
    weights: Array,
) -> RobotGradient:
    """Return the gradient of Σ weights ∘ regressor of an effect of one joint.

    Args:
        slopes: Derivatives of each column by field, or None to take differences.
        weights: (N, nv, k) weights.
    """
    i, seen = motion.index(joint), motion.joint(joint)
    if slopes is None:
        slopes = difference_slopes(columns, seen)
    total = {name: np.zeros(len(motion.v)) for name in _FIELDS}
    for column, by_field in enumerate(slopes):
        for name, slope in by_field.items():
            total[name] += weights[:, i, column] * np.asarray(slope, float)
    gradient = RobotGradient.zero(motion)
    gradient.q[:, i], gradient.vd[:, i], gradient.load[:, i] = (
        total["q"],
        total["vd"],
        total["load"],
    )
    gradient.v[:, i] = total["v"] + total["sign_v"] * sign_slope(seen.sign_v, motion.sign_width[i])
    return gradient


def sign_slope(sign_v: Array, width: float | Array) -> Array:
    """Derivative of `RobotMotion.direction` with respect to v; zero where the sign is a step.

    Args:
        sign_v: (...) smoothed signs of the velocities.
        width: Speed below which the sign fades, rad/s or m/s; broadcast.
    """
    width = np.asarray(width, float)
    return np.asarray(np.where(width > 0, (1.0 - sign_v**2) / np.where(width > 0, width, 1.0), 0.0))


def difference_slopes(
    columns: Callable[[JointMotion], Sequence[ArrayLike]], joint: JointMotion
) -> list[dict[str, Array]]:
    """Return the central differences of columns with respect to every field of a joint's motion."""
    slopes: list[dict[str, Array]] = [{} for _ in columns(joint)]
    for name in _FIELDS:
        values = getattr(joint, name)
        finite = np.abs(values[np.isfinite(values)])
        step = _STEP * max(float(finite.max(initial=0.0)), 1e-3)
        after, before = (columns(replace(joint, **{name: values + d})) for d in (step, -step))
        for column, (high, low) in enumerate(zip(after, before, strict=True)):
            change = np.asarray(high, float) - np.asarray(low, float)
            slopes[column][name] = np.broadcast_to(change / (2.0 * step), values.shape)
    return slopes
