"""From weights of a measurement's regressor to the gradient with respect to the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import Effect, RobotMotion
from geodrake.effects.gradient import RobotGradient
from geodrake.excitation.regressor_gradient import (
    base_wrench_regressor_gradient,
    inverse_dynamics_regressor_gradient,
)
from geodrake.excitation.reverse_recursion import MotionGradient
from geodrake.excitation.target import Measurement, Target
from geodrake.identification.logs.dataset import is_payload
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_STEP = 1e-5  # of differences, of the largest value there is


def regressor_motion_gradient(
    target: Target, measurement: Measurement, weights: Array
) -> MotionGradient:
    """Gradient of Σ W ∘ X, with X the regressor of all that a target does not know.

    Args:
        measurement: What `target.measure` made of the (N, ·) motion.
        weights: (N, m, p) W.
    """
    tree, motion = target.model.tree, measurement.motion
    rows = np.zeros((*weights.shape[:2], PARAMETERS_PER_BODY * len(tree.bodies)))
    for start in range(0, len(target.columns), PARAMETERS_PER_BODY):
        block = slice(target.columns[start], target.columns[start] + PARAMETERS_PER_BODY)
        rows[:, :, block] += weights[:, :, start : start + PARAMETERS_PER_BODY]
    if target.X_WP is not None or measurement.seen is None:
        samples = motion.q, motion.v, motion.vd
        return base_wrench_regressor_gradient(tree, *samples, rows, X_WP=target.X_WP)
    parts, start = [], len(target.columns)
    for fitted in target.further:
        stop = start + len(fitted.effect.parameters)
        parts.append((fitted.effect, weights[:, :, start:stop]))
        start = stop
    return _with_effects(target.model, motion, measurement.seen, rows, parts)


def effort_gradient(
    model: RobotModel, motion: Motion, seen: RobotMotion, weights: Array
) -> MotionGradient:
    """Gradient of Σ w ∘ τ, with τ the efforts that the model needs, effects included.

    Args:
        motion: (N, ·) motion.
        weights: (N, nv) w.
    """
    rows = weights[:, :, None] * model.total_phi.ravel()
    parts = [
        (fitted.effect, weights[:, :, None] * fitted.parameters)
        for fitted in model.effects
        if not is_payload(fitted.effect) and len(fitted.parameters)
    ]
    return _with_effects(model, motion, seen, rows, parts)


def _with_effects(
    model: RobotModel,
    motion: Motion,
    seen: RobotMotion,
    rows: Array,
    parts: Sequence[tuple[Effect, Array]],
) -> MotionGradient:
    """Gradient of Σ rows ∘ Y + Σ weights ∘ Y_e; `rows` is changed."""
    at_velocity, at_position = model.single_places
    direct, load = RobotGradient.zero(seen), np.zeros(motion.v.shape)
    unknown = []
    for effect, weights in parts:
        gradient = effect.gradient(seen, weights)
        if gradient is None:
            unknown.append((effect, weights))
            continue
        for name in ("q", "v", "vd"):
            getattr(direct, name)[:] += getattr(gradient, name)
        load += gradient.load
        for body, by_columns in gradient.bodies.items():
            first = PARAMETERS_PER_BODY * model.bodies.index(body)
            rows[:, :, first : first + PARAMETERS_PER_BODY] += by_columns
    if load.any():
        rows += load[:, :, None] * model.total_phi.ravel()
    total = inverse_dynamics_regressor_gradient(model.tree, motion.q, motion.v, motion.vd, rows)
    total.q[:, at_position] += direct.q[:, at_velocity]
    total.v[:] += direct.v
    total.vd[:] += direct.vd
    if unknown:
        rest = _by_differences(model, motion, unknown, seen.sign_width)
        for name in ("q", "v", "vd"):
            getattr(total, name)[:] += getattr(rest, name)
    return total


def _by_differences(
    model: RobotModel,
    motion: Motion,
    parts: Sequence[tuple[Effect, Array]],
    sign_width: Array,
) -> MotionGradient:
    """Central differences for effects that state no gradient, one coordinate of the motion a time.

    Every sample moves at once: an effect's columns depend on their own sample only.
    """

    def values(moved: Motion) -> Array:
        seen = model.motion(moved, sign_width=sign_width)
        shares = [np.einsum("nik,nik->n", w, effect.regressor(seen)) for effect, w in parts]
        return np.asarray(sum(shares))

    result = MotionGradient(*(np.zeros(x.shape) for x in (motion.q, motion.v, motion.vd)))
    for name in ("q", "v", "vd"):
        samples = getattr(motion, name)
        for column in range(samples.shape[1]):
            step = _STEP * max(float(np.abs(samples[:, column]).max(initial=0.0)), 1e-3)
            ends = []
            for by in (step, -step):
                moved = samples.copy()
                moved[:, column] += by
                ends.append(values(replace(motion, **{name: moved})))
            getattr(result, name)[:, column] = (ends[0] - ends[1]) / (2.0 * step)
    return result
