"""Gradients of effects' regressors with respect to the motion, for excitation design."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.effects.robot_motion import JointMotion, RobotMotion

Array = NDArray[np.float64]

_FIELDS = ("q", "v", "vd", "load", "sign_v")
_STEP = 3e-5  # of fourth-order differences, relative to the largest value


@dataclass(frozen=True, eq=False)
class RobotGradient:
    """Gradient of a scalar with respect to a `RobotMotion` of N samples."""

    q: Array  # (N, nv) with respect to the position belonging to each velocity
    v: Array  # (N, nv) with respect to the velocities
    vd: Array  # (N, nv) with respect to the accelerations
    load: Array  # (N, nv) with respect to the efforts that the rigid bodies need
    # Body name -> (N, nv, 10) with respect to its inertial regressor.
    bodies: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def zero(cls, motion: RobotMotion) -> RobotGradient:
        """Return a zero gradient, to be accumulated into."""
        q, v, vd, load = np.zeros((4, *motion.v.shape))
        return cls(q, v, vd, load)


def joint_gradient(
    motion: RobotMotion, joint: str, slopes: Sequence[Mapping[str, ArrayLike]], weights: Array
) -> RobotGradient:
    """Return the gradient of Σ weights ∘ regressor of an effect of one joint.

    Args:
        slopes: Derivatives of each of the k columns by field of `JointMotion`.
        weights: (N, nv, k).
    """
    i, sign_v = motion.index(joint), motion.joint(joint).sign_v
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
    gradient.v[:, i] = total["v"] + total["sign_v"] * sign_slope(sign_v, motion.sign_width[i])
    return gradient


def sign_slope(sign_v: Array, width: float | Array) -> Array:
    """Return the derivative of `RobotMotion.direction` by v, for smoothed signs (...) and widths.

    It is zero where the width is 0.
    """
    width = np.asarray(width, float)
    return np.asarray(np.where(width > 0, (1.0 - sign_v**2) / np.where(width > 0, width, 1.0), 0.0))


def difference_slopes(
    columns: Callable[[JointMotion], Sequence[ArrayLike]],
    joint: JointMotion,
    depends_on: Collection[str],
) -> list[dict[str, Array]]:
    """Return the columns' derivatives by `JointMotion` field, computed by finite differences."""
    slopes: list[dict[str, Array]] = [{} for _ in columns(joint)]
    for name in _FIELDS:
        if (name if name != "sign_v" else "v") not in depends_on:
            continue
        values = getattr(joint, name)
        finite = np.abs(values[np.isfinite(values)])
        step = _STEP * max(float(finite.max(initial=0.0)), 1e-3)
        for share, weight in ((1.0, 8.0), (-1.0, -8.0), (2.0, -1.0), (-2.0, 1.0)):
            shifted = columns(replace(joint, **{name: values + share * step}))
            for by_field, column in zip(slopes, shifted, strict=True):
                change = weight / (12.0 * step) * np.broadcast_to(column, values.shape)
                by_field[name] = by_field.get(name, 0.0) + change
    return slopes
