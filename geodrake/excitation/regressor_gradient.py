"""Gradients of regressors with respect to the motion, by one pass back through the recursion.

What an excitation criterion needs of the derivatives of a regressor is their sum with weights W of
its size, of every sample apart:

    ∂/∂(q, v, v̇)  Σ W ∘ Y(q, v, v̇)

[Lee2019] Appendix B.3 (Algorithms 2 to 4) carries the derivatives with respect to every parameter
of a trajectory outwards and wrenches inwards. Reversed, the same chain of products carries one
covector a body inwards, whatever the number of trajectory parameters is: the cost is that of a few
regressors, linear in samples. What trajectories make of it is a linear map (`MotionFamily`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant

from geodrake.boundary.arguments import real_array
from geodrake.effects import Effect, RobotMotion
from geodrake.effects.gradient import RobotGradient
from geodrake.excitation.reverse_recursion import MotionGradient, reverse_recursion
from geodrake.excitation.target import Measurement, Target
from geodrake.identification.logs.dataset import is_payload
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel
from geodrake.robot.coordinates import RobotCoordinates
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.regressor import (
    checked_samples,
    checked_tree,
    on_a_free_world,
    put_regressor,
    wrench_map,
)
from geodrake.robot.transmission import times

_STEP = 1e-5  # of differences, of the largest value there is


def inverse_dynamics_regressor_gradient(
    plant: MultibodyPlant | KinematicTree,
    q: ArrayLike,
    v: ArrayLike,
    vd: ArrayLike,
    weights: ArrayLike,
) -> MotionGradient:
    """Return the gradient of Σ W ∘ Y, with Y (N, nv, 10 nb) the regressor of inverse dynamics.

    With W = λ φᵀ it is the gradient of λᵀ τ, of efforts.
    """
    robot = checked_tree(plant)
    tree, samples, J = checked_samples(robot, q, v, vd)
    shape = (len(samples[0]), robot.num_velocities, PARAMETERS_PER_BODY * len(tree.bodies))
    weights = real_array(weights, "weights", shape)
    if J is None or robot.actuation is None:
        return reverse_recursion(tree, samples, weights)
    inner = J @ weights  # Σ W ∘ (Jᵀ Y) = Σ (J W) ∘ Y
    motion = Motion(*(np.asarray(x, float) for x in (q, v, vd)))
    found = at_actuators(robot.actuation, J, motion, reverse_recursion(tree, samples, inner))
    if robot.actuation.constant is None:  # and J itself depends on q
        Y = np.zeros_like(inner)
        put_regressor(tree, samples, Y)
        products = Y @ np.swapaxes(weights, 1, 2)
        found.q[:] += robot.actuation.bend(motion.q, products)
    return found


def base_wrench_regressor_gradient(
    plant: MultibodyPlant | KinematicTree,
    q: ArrayLike,
    v: ArrayLike,
    vd: ArrayLike,
    weights: ArrayLike,
    *,
    X_WP: RigidTransform | ArrayLike | None = None,
) -> MotionGradient:
    """Return the gradient of Σ W ∘ Y, with Y (N, 6, 10 nb) the regressor of the base wrench.

    The plant may have any base. X_WP is the frame of the wrench as in `base_wrench_regressor`, one
    pose or (N, 4, 4), which does not depend on the motion, such as a force plate's.
    """
    robot = checked_tree(plant)
    tree, (theta, rate, _, rated), J = checked_samples(robot, q, v, vd)
    shape = (len(theta), 6, PARAMETERS_PER_BODY * len(tree.bodies))
    weights = real_array(weights, "weights", shape)
    if X_WP is not None:
        weights = np.swapaxes(wrench_map(X_WP, len(theta)), -1, -2) @ weights
    nv, resting = tree.num_velocities, np.zeros((len(theta), 6))
    rate = np.hstack([rate, resting])
    samples = (theta, rate, rate, np.hstack([rated, resting]))
    rows = np.concatenate([np.zeros((len(theta), nv, weights.shape[-1])), weights], axis=1)
    gradient = reverse_recursion(on_a_free_world(tree), samples, rows)
    own = MotionGradient(gradient.q, gradient.v[:, :nv], gradient.vd[:, :nv])
    if J is None or robot.actuation is None:
        return own
    motion = Motion(*(np.asarray(x, float) for x in (q, v, vd)))
    return at_actuators(robot.actuation, J, motion, own)


def at_actuators(
    actuation: RobotCoordinates, J: Array, motion: Motion, gradient: MotionGradient
) -> MotionGradient:
    """Return the gradient with the motion of actuators, of that with the motion of joints.

    By θ̇ = J q̇ and θ̈ = J q̈ + J̇ q̇, with the slopes that `effort_slopes` has as well.
    """
    JT, q, v, vd = np.swapaxes(J, 1, 2), motion.q, motion.v, motion.vd
    found = MotionGradient(*(times(JT, x) for x in (gradient.q, gradient.v, gradient.vd)))
    if actuation.constant is None:
        rate = np.swapaxes(actuation.jacobian_rate(q, v), 1, 2)
        bent = actuation.jacobian_rate(q, vd) + actuation.jacobian_rate_slope(q, v)
        by_q = times(rate, gradient.v) + times(np.swapaxes(bent, 1, 2), gradient.vd)
        found.q[:, actuation.driven] += by_q[:, actuation.driven]
        found.v[:] += times(2.0 * rate, gradient.vd)
    return found


def regressor_motion_gradient(
    target: Target, measurement: Measurement, weights: Array
) -> MotionGradient:
    """Return the gradient of Σ W ∘ X, X (N, m, p) the regressor of a target's unknowns."""
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
    """Return the gradient of Σ w ∘ τ, with τ (N, nv) the efforts of the model, effects included."""
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
    """Return the gradient of Σ rows ∘ Y + Σ weights ∘ Y_e; `rows` is changed."""
    at = model.single_places
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
    total.q[:, at] += direct.q[:, at]
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
    """Take central differences for effects without a gradient, one coordinate at a time.

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
