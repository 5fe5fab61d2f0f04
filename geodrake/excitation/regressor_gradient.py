"""Gradients of regressors with respect to the motion, by reverse-mode recursion.

An excitation criterion needs, for every sample, the derivatives of a regressor summed with weights
W of its size:

    ∂/∂(q, v, v̇)  Σ W ∘ Y(q, v, v̇)

[Lee2019] Appendix B.3 (Algorithms 2 to 4) propagates the derivatives with respect to every
trajectory parameter outwards and wrenches inwards. Reversed, the same chain of products propagates
one covector per body inwards, independent of the number of trajectory parameters. The cost is that
of a few regressors, linear in the samples. A trajectory's parameters enter by a linear map
(`MotionFamily`).

For each body and velocity, the block of W acts as "parameters" c (m, h, I) in an inner product with
the regressor, so with the row τ = t·f + s·n of `geodrake.robot.recursion`

    ∂τ/∂t = m a + α × h + ω × (ω × h),       ∂τ/∂s = I α + ω × I ω + h × a,
    ∂τ/∂a = m t + s × h,                     ∂τ/∂α = h × t + I s,
    ∂τ/∂ω = t (ω·h) + h (ω·t) − 2 ω (t·h) + I (s × ω) + I ω × s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant

from geodrake.boundary.arguments import real_array
from geodrake.compiling import compiled, contiguous, inlined
from geodrake.effects import Effect, RobotMotion
from geodrake.excitation.target import Measurement, Target
from geodrake.identification.logs.dataset import is_payload
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel
from geodrake.robot import transmission
from geodrake.robot.coordinates import DrivenCoordinates
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.recursion import (
    MOTION,
    Record,
    Samples,
    TreeRecords,
    features_of,
    find_subspaces,
    inboard_motion,
    move,
    subspace_room,
)
from geodrake.robot.regressor import (
    checked_samples,
    checked_tree,
    on_a_free_world,
    put_regressor,
    wrench_map,
)
from geodrake.robot.vectors import (
    Vector,
    add,
    column,
    combination,
    cross,
    dot,
    inertia_times,
    put,
    put_row,
    row,
    scale,
    subtract,
    times,
    vector,
)

_STEP = 1e-5  # of finite differences, relative to the largest value
_IMAGINARY_STEP = 1e-30  # its square underflows, so the derivative is exact


class MotionGradient(NamedTuple):
    """Gradient of a scalar with respect to the motion, sample by sample."""

    q: Array  # (N, nq) with respect to the positions
    v: Array  # (N, nv) with respect to the velocities
    vd: Array  # (N, nv) with respect to the accelerations

    def plus(self, *others: MotionGradient) -> MotionGradient:
        """Return the sum of several gradients."""
        return MotionGradient(*(sum(parts) for parts in zip(self, *others, strict=True)))


def inverse_dynamics_regressor_gradient(
    plant: MultibodyPlant | KinematicTree,
    q: ArrayLike,
    v: ArrayLike,
    vd: ArrayLike,
    weights: ArrayLike,
) -> MotionGradient:
    """Return the gradient of Σ W ∘ Y, with Y (N, nv, 10 nb) the regressor of inverse dynamics.

    With W = λ φᵀ it is the gradient of λᵀ τ.
    """
    robot = checked_tree(plant)
    tree, samples, J = checked_samples(robot, q, v, vd)
    shape = (len(samples[0]), robot.num_velocities, PARAMETERS_PER_BODY * len(tree.bodies))
    weights = real_array(weights, "weights", shape)
    if J is None or robot.actuation is None:
        return reverse_recursion(tree, samples, weights)
    inner = J @ weights  # Σ W ∘ (Jᵀ Y) = Σ (J W) ∘ Y
    motion = Motion(*(np.asarray(x, float) for x in (q, v, vd)))
    gradient = at_actuators(robot.actuation, J, motion, reverse_recursion(tree, samples, inner))
    if robot.actuation.constant is None:  # J itself depends on q
        Y = np.zeros_like(inner)
        put_regressor(tree, samples, Y)
        products = Y @ np.swapaxes(weights, 1, 2)
        gradient.q[:] += robot.actuation.bend(motion.q, products)
    return gradient


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
    pose or (N, 4, 4), independent of the motion, such as that of a force plate.
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
    gradient = MotionGradient(gradient.q, gradient.v[:, :nv], gradient.vd[:, :nv])
    if J is None or robot.actuation is None:
        return gradient
    motion = Motion(*(np.asarray(x, float) for x in (q, v, vd)))
    return at_actuators(robot.actuation, J, motion, gradient)


def at_actuators(
    actuation: DrivenCoordinates, J: Array, motion: Motion, gradient: MotionGradient
) -> MotionGradient:
    """Convert a gradient from the motion of joints to that of actuators.

    The chain rule uses θ̇ = J q̇ and θ̈ = J q̈ + J̇ q̇, as in `effort_slopes`.
    """
    JT, q, v, vd = np.swapaxes(J, 1, 2), motion.q, motion.v, motion.vd
    converted = MotionGradient(*(transmission.times(JT, x) for x in gradient))
    if actuation.constant is None:
        rate = np.swapaxes(actuation.jacobian_rate(q, v), 1, 2)
        bent = actuation.jacobian_rate(q, vd) + actuation.jacobian_rate_slope(q, v)
        by_q = transmission.times(rate, gradient.v) + transmission.times(
            np.swapaxes(bent, 1, 2), gradient.vd
        )
        converted.q[:, actuation.driven] += by_q[:, actuation.driven]
        converted.v[:] += transmission.times(2.0 * rate, gradient.vd)
    return converted


def regressor_motion_gradient(
    target: Target, measurement: Measurement, weights: Array
) -> MotionGradient:
    """Return the gradient of Σ W ∘ X, with X (N, m, p) the regressor of a target's unknowns."""
    tree, motion = target.model.tree, measurement.motion
    rows = np.zeros((*weights.shape[:2], PARAMETERS_PER_BODY * len(tree.bodies)))
    for start in range(0, len(target.columns), PARAMETERS_PER_BODY):
        block = slice(target.columns[start], target.columns[start] + PARAMETERS_PER_BODY)
        rows[:, :, block] += weights[:, :, start : start + PARAMETERS_PER_BODY]
    if target.X_WP is not None or measurement.seen is None:
        samples = motion.q, motion.v, motion.vd
        return base_wrench_regressor_gradient(tree, *samples, rows, X_WP=target.X_WP)
    parts = [(fitted.effect, weights[:, :, span]) for fitted, span in target.further_spans]
    return _with_effects(target.model, motion, measurement.seen, rows, parts)


def effort_gradient(
    model: RobotModel, motion: Motion, seen: RobotMotion, weights: Array
) -> MotionGradient:
    """Return the gradient of Σ w ∘ τ, with τ (N, nv) the model's efforts including effects."""
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
    """Return the gradient of Σ rows ∘ Y + Σ weights ∘ Y_e; `rows` is modified in place."""
    index, load = model.single_places, np.zeros(motion.v.shape)
    gradients, remaining = [], []
    for effect, weights in parts:
        gradient = effect.gradient(seen, weights)
        if gradient is None:
            remaining.append((effect, weights))
            continue
        gradients.append(gradient)
        load += gradient.load
        for body, by_columns in gradient.bodies.items():
            first = PARAMETERS_PER_BODY * model.bodies.index(body)
            rows[:, :, first : first + PARAMETERS_PER_BODY] += by_columns
    if load.any():
        rows += load[:, :, None] * model.total_phi.ravel()
    total = inverse_dynamics_regressor_gradient(model.tree, motion.q, motion.v, motion.vd, rows)
    for gradient in gradients:
        total.q[:, index] += gradient.q[:, index]
        total.v[:] += gradient.v
        total.vd[:] += gradient.vd
    if not remaining:
        return total
    return total.plus(_by_differences(model, motion, remaining, seen.sign_width))


def _by_differences(
    model: RobotModel,
    motion: Motion,
    parts: Sequence[tuple[Effect, Array]],
    sign_width: Array,
) -> MotionGradient:
    """Return gradients by central differences, for effects without analytic ones.

    All samples are varied together, since an effect's rows depend on their own sample only.
    """

    def values(moved: Motion) -> Array:
        seen = model.motion(moved, sign_width=sign_width)
        shares = [np.einsum("nik,nik->n", w, effect.regressor(seen)) for effect, w in parts]
        return np.asarray(sum(shares))

    gradients = []
    for name in MotionGradient._fields:
        samples = getattr(motion, name)
        step = _STEP * np.maximum(np.abs(samples).max(axis=0, initial=0.0), 1e-3)
        ahead, behind = (
            [values(replace(motion, **{name: samples + s * delta})) for delta in np.diag(step)]
            for s in (1, -1)
        )
        gradients.append((np.array(ahead) - np.array(behind)).T / (2.0 * step))
    return MotionGradient(*gradients)


def reverse_recursion(tree: KinematicTree, samples: Samples, weights: Array) -> MotionGradient:
    """Return the gradient of Σ W ∘ Y with respect to samples, for weights W (N, nv, 10 nb)."""
    q, _, v, vd = samples
    result = MotionGradient(*(np.zeros(x.shape) for x in (q, v, vd)))
    calc_motion_gradient(tree.records, samples, contiguous(weights), tuple(result))
    return result


@compiled
def calc_motion_gradient(
    tree: TreeRecords, samples: Samples, weights: Array, out: tuple[Array, ...]
) -> None:
    """Write the gradient of Σ W ∘ Y, W (N, nv, 10 nb), into zeros (N, nq), (N, nv), (N, nv)."""
    mobilizers, dofs = tree
    motions, by = np.empty(len(mobilizers), MOTION), np.empty(len(mobilizers), MOTION)
    turn, slide = subspace_room(dofs)
    by_turn, by_slide = subspace_room(dofs)
    features, (q, v, _, _), (by_q, by_v, by_vd) = np.empty(9), samples, out
    for n in range(len(q)):
        move(mobilizers, samples, n, features, motions)
        find_subspaces(mobilizers, motions, turn, slide)
        clear(by, by_turn, by_slide)
        for i in range(len(mobilizers) - 1, -1, -1):
            mobilizer, motion = mobilizers[i], motions[i]
            if mobilizer.body >= 0:
                for k in range(mobilizer.count):
                    place = n, dofs[i, k], PARAMETERS_PER_BODY * mobilizer.body
                    s, t = row(turn, i, k), row(slide, i, k)
                    by_s, by_t = add_block(motion, (s, t), (weights, place), by[i])
                    put_row(by_turn, i, k, add(row(by_turn, i, k), by_s))
                    put_row(by_slide, i, k, add(row(by_slide, i, k), by_t))
            covector = motion, by[i], mobilizer.p_MoBo_B
            spin = shift_back(covector, (turn, slide), (by_turn, by_slide), i, mobilizer.count)
            by_w, by_wd, by_a = vector(by[i].w), vector(by[i].wd), vector(by[i].a)
            w_P, _, wd_P, _ = inboard_motion(mobilizer, motions)
            # The reverse of `geodrake.robot.recursion.move`, in P.
            R, p, span = motion.R_PB, vector(motion.p_PMo), mobilizer.velocities
            by_w, by_wd, by_a = times(R, by_w), times(R, by_wd), times(R, by_a)
            by_p = add(cross(by_a, wd_P), cross(w_P, cross(w_P, by_a)))
            turning, sliding = add(by_w, cross(by_wd, w_P)), scale(2.0, cross(by_a, w_P))
            for k in range(span[1]):
                s, t = column(mobilizer.angular, k), column(mobilizer.linear, k)
                by_v[n, span[0] + k] += dot(s, turning) + dot(t, sliding)
                by_vd[n, span[0] + k] += dot(s, by_wd) + dot(t, by_a)
            parent = mobilizer.parent
            if parent >= 0:
                for k in range(mobilizers[parent].count):
                    by_s, by_t = times(R, row(by_turn, i, k)), times(R, row(by_slide, i, k))
                    by_p = add(by_p, cross(by_t, row(turn, parent, k)))
                    by_s = add(row(by_turn, parent, k), add(by_s, cross(p, by_t)))
                    put_row(by_turn, parent, k, by_s)
                    put_row(by_slide, parent, k, add(row(by_slide, parent, k), by_t))
                rates = combination(mobilizer.angular, v, n, span)
                by_w = add(by_w, add(cross(rates, by_wd), by_turning(by_a, w_P, p)))
                rates = combination(mobilizer.linear, v, n, span)
                by_w = add(by_w, scale(2.0, cross(rates, by_a)))
                put(by[parent].w, add(vector(by[parent].w), by_w))
                by_wd = add(by_wd, cross(p, by_a))
                put(by[parent].wd, add(vector(by[parent].wd), by_wd))
                put(by[parent].a, add(vector(by[parent].a), by_a))
            for j in range(mobilizer.positions[1]):
                place = mobilizer.positions[0] + j
                by_q[n, place] += dot(column(mobilizer.translation, j), by_p)
                if mobilizer.features > 0:
                    by_q[n, place] += dot(turning_rate(mobilizer, motion, q, n, j), spin)


@inlined
def clear(by: Record, by_turn: Array, by_slide: Array) -> None:
    """Set the gradients with respect to motions and subspaces to zero."""
    for i in range(len(by)):
        zero = (0.0, 0.0, 0.0)
        put(by[i].w, zero)
        put(by[i].wd, zero)
        put(by[i].a, zero)
        for k in range(by_turn.shape[1]):
            put_row(by_turn, i, k, zero)
            put_row(by_slide, i, k, zero)


@inlined
def shift_back(
    covector: tuple[Record, Record, Array],
    subspaces: tuple[Array, Array],
    by_subspaces: tuple[Array, Array],
    i: int,
    count: int,
) -> Vector:
    """Shift the gradient with respect to a body's motion from Bo to Mo.

    The covector contains the motion, its gradient, and the position of Bo from Mo. Returns the
    gradient with respect to a rotation of B.
    """
    (turn, slide), (by_turn, by_slide), (motion, by, shift) = subspaces, by_subspaces, covector
    p, by_a, w, wd = vector(shift), vector(by.a), vector(motion.w), vector(motion.wd)
    put(by.w, add(vector(by.w), by_turning(by_a, w, p)))
    put(by.wd, add(vector(by.wd), cross(p, by_a)))
    a = subtract(vector(motion.a), add(cross(wd, p), cross(w, cross(w, p))))
    spin = add(add(cross(vector(by.w), w), cross(vector(by.wd), wd)), cross(by_a, a))
    for k in range(count):
        s, by_t = row(turn, i, k), row(by_slide, i, k)
        by_s, t = add(row(by_turn, i, k), cross(p, by_t)), row(slide, i, k)
        put_row(by_turn, i, k, by_s)
        spin = add(spin, add(cross(by_s, s), cross(by_t, subtract(t, cross(s, p)))))
    return spin


@inlined
def add_block(
    motion: Record,
    subspace: tuple[Vector, Vector],
    weights: tuple[Array, tuple[int, int, int]],
    by: Record,
) -> tuple[Vector, Vector]:
    """Add the gradient of a block's inner product with "parameters" c with respect to the motion.

    The weights (N, nv, 10 nb) come with the index of the first of c. Returns the gradients with
    respect to s and t.
    """
    (s, t), (W, (n, line, first)) = subspace, weights
    c = W[n, line : line + 1, first : first + PARAMETERS_PER_BODY]
    w, wd, a = vector(motion.w), vector(motion.wd), vector(motion.a)
    m, h = c[0, 0], (c[0, 1], c[0, 2], c[0, 3])
    momentum, along = inertia_times(c, 0, w), dot(h, w)
    by_w = add(scale(along, t), scale(dot(t, w), h))
    by_w = add(by_w, add(inertia_times(c, 0, cross(s, w)), cross(momentum, s)))
    by_w = subtract(by_w, scale(2.0 * dot(t, h), w))
    put(by.w, add(vector(by.w), by_w))
    put(by.wd, add(vector(by.wd), add(cross(h, t), inertia_times(c, 0, s))))
    put(by.a, add(vector(by.a), add(scale(m, t), cross(s, h))))
    by_s = add(add(inertia_times(c, 0, wd), cross(w, momentum)), cross(h, a))
    by_t = add(add(scale(m, a), cross(wd, h)), subtract(scale(along, w), scale(dot(w, w), h)))
    return by_s, by_t


@inlined
def turning_rate(mobilizer: Record, motion: Record, q: Array, n: int, j: int) -> Vector:
    """Return the rotation rate of B, in B, per unit change of its joint's position j."""
    moved, slopes = np.empty((1, q.shape[1]), np.complex128), np.empty(9, np.complex128)
    for k in range(q.shape[1]):
        moved[0, k] = q[n, k]
    moved[0, mobilizer.positions[0] + j] += 1j * _IMAGINARY_STEP
    number = features_of(mobilizer, moved, 0, slopes)
    rates, R, C = np.zeros((3, 3)), motion.R_PB, mobilizer.rotation
    for entry in range(9):
        for k in range(number):
            slope = slopes[k].imag / _IMAGINARY_STEP
            rates[entry // 3, entry % 3] += C[entry, k] * slope
    # Rᵀ ∂R/∂q is the cross-product matrix of the rate.
    return (
        dot(column(R, 2), column(rates, 1)),
        dot(column(R, 0), column(rates, 2)),
        dot(column(R, 1), column(rates, 0)),
    )


@inlined
def by_turning(by_a: Vector, w: Vector, p: Vector) -> Vector:
    """Return the gradient of by_a · (ω × (ω × p)) with respect to ω."""
    both = add(scale(dot(w, p), by_a), scale(dot(w, by_a), p))
    return subtract(both, scale(2.0 * dot(by_a, p), w))
