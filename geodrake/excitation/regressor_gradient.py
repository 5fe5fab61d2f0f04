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

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant

from geodrake.boundary.arguments import real_array
from geodrake.errors import ModelError
from geodrake.excitation.reverse_recursion import MotionGradient, reverse_recursion
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.logs.motion import Motion
from geodrake.robot.driven_tree import DrivenTree, RobotTree
from geodrake.robot.floating_base import on_a_free_world, wrench_map
from geodrake.robot.regressor import checked_samples, checked_tree, put_regressor
from geodrake.robot.transmission.actuation import Actuation
from geodrake.robot.transmission.base import times


def inverse_dynamics_regressor_gradient(
    plant: MultibodyPlant | RobotTree,
    q: ArrayLike,
    v: ArrayLike,
    vd: ArrayLike,
    weights: ArrayLike,
) -> MotionGradient:
    """Gradient of Σ W ∘ Y, with Y the regressor of inverse dynamics.

    Args:
        q: (N, nq) positions.
        v: (N, nv) velocities.
        vd: (N, nv) accelerations v̇.
        weights: (N, nv, 10 nb) W. With W = λ φᵀ it is the gradient of λᵀ τ, of efforts.

    Raises:
        ArgumentError: A shape does not fit the plant, or a value is not finite.
        ModelError: The plant has a joint that is not supported.
    """
    robot = checked_tree(plant)
    tree, samples, J = checked_samples(robot, q, v, vd)
    weights = _checked_weights(
        weights, (len(samples[0]), robot.num_velocities, PARAMETERS_PER_BODY * len(tree.bodies))
    )
    if J is None or not isinstance(robot, DrivenTree):
        return reverse_recursion(tree, samples, weights)
    inner = J @ weights  # Σ W ∘ (Jᵀ Y) = Σ (J W) ∘ Y
    motion = Motion(*(np.asarray(x, float) for x in (q, v, vd)))
    found = _at_actuators(robot.actuation, J, motion, reverse_recursion(tree, samples, inner))
    if robot.actuation.constant is None:  # and J itself depends on q
        Y = np.zeros_like(inner)
        put_regressor(tree, samples, Y)
        products = Y @ np.swapaxes(weights, 1, 2)
        found.q[:] += robot.actuation.bend(motion.q, products)
    return found


def base_wrench_regressor_gradient(
    plant: MultibodyPlant | RobotTree,
    q: ArrayLike,
    v: ArrayLike,
    vd: ArrayLike,
    weights: ArrayLike,
    *,
    X_WP: RigidTransform | ArrayLike | None = None,
) -> MotionGradient:
    """Gradient of Σ W ∘ Y, with Y the regressor of the base wrench.

    Args:
        plant: A finalized plant with any base, or its tree.
        q: (N, nq) positions.
        v: (N, nv) velocities.
        vd: (N, nv) accelerations v̇.
        weights: (N, 6, 10 nb) W.
        X_WP: Frame of the wrench as in `base_wrench_regressor`, one pose or (N, 4, 4), which does
            not depend on the motion, such as a force plate's.

    Raises:
        ArgumentError: A shape does not fit the plant, a value is not finite, or X_WP is no pose.
        ModelError: The plant has a joint that is not supported.
    """
    robot = checked_tree(plant)
    tree, (theta, rate, _, rated), J = checked_samples(robot, q, v, vd)
    weights = _checked_weights(weights, (len(theta), 6, PARAMETERS_PER_BODY * len(tree.bodies)))
    if X_WP is not None:
        weights = np.swapaxes(wrench_map(X_WP, len(theta)), -1, -2) @ weights
    nv, resting = tree.num_velocities, np.zeros((len(theta), 6))
    rate = np.hstack([rate, resting])
    samples = (theta, rate, rate, np.hstack([rated, resting]))
    rows = np.concatenate([np.zeros((len(theta), nv, weights.shape[-1])), weights], axis=1)
    gradient = reverse_recursion(on_a_free_world(tree), samples, rows)
    own = MotionGradient(gradient.q, gradient.v[:, :nv], gradient.vd[:, :nv])
    if J is None or not isinstance(robot, DrivenTree):
        return own
    motion = Motion(*(np.asarray(x, float) for x in (q, v, vd)))
    return _at_actuators(robot.actuation, J, motion, own)


def regressor_jacobian(
    plant: MultibodyPlant | RobotTree, q: ArrayLike, v: ArrayLike, vd: ArrayLike
) -> tuple[Array, Array, Array]:
    """All derivatives of the regressor of inverse dynamics, one sample after the other.

    This is the form of [Lee2019] Algorithm 3, and needs its memory: for a criterion use
    `inverse_dynamics_regressor_gradient`.

    Args:
        q: (N, nq) positions.
        v: (N, nv) velocities.
        vd: (N, nv) accelerations v̇.

    Returns:
        ∂Y/∂q (N, nv, 10 nb, nq), ∂Y/∂v (N, nv, 10 nb, nv) and ∂Y/∂v̇ (N, nv, 10 nb, nv).

    Raises:
        ArgumentError: A shape does not fit the plant, or a value is not finite.
        ModelError: The plant has a joint that is not supported.
    """
    tree, samples, J = checked_samples(plant, q, v, vd)
    if J is not None:
        raise ModelError(
            "The derivatives of a regressor one by one are those of joints.",
            advice="Give it the tree without its transmission, `model.joint_tree`.",
        )
    shape = tree.num_velocities, PARAMETERS_PER_BODY * len(tree.bodies)
    entries = np.eye(shape[0] * shape[1]).reshape(-1, *shape)
    rows = [
        reverse_recursion(tree, tuple(np.repeat(x[None], len(entries), 0) for x in sample), entries)  # type: ignore[arg-type]
        for sample in zip(*samples, strict=True)
    ]
    return tuple(  # type: ignore[return-value]
        np.stack([getattr(row, name).reshape(*shape, -1) for row in rows])
        for name in ("q", "v", "vd")
    )


def _at_actuators(
    actuation: Actuation, J: Array, motion: Motion, gradient: MotionGradient
) -> MotionGradient:
    """The gradient with the motion of actuators, of that with the motion of joints.

    By θ̇ = J q̇ and θ̈ = J q̈ + J̇ q̇, with the slopes that `effort_slopes` has as well.
    """
    JT, q, v, vd = np.swapaxes(J, 1, 2), motion.q, motion.v, motion.vd
    found = MotionGradient(
        actuation.robot_gradient(q, gradient.q), times(JT, gradient.v), times(JT, gradient.vd)
    )
    if actuation.constant is None:
        rate = np.swapaxes(actuation.jacobian_rate(q, v), 1, 2)
        bent = actuation.jacobian_rate(q, vd) + actuation.jacobian_rate_slope(q, v)
        by_q = times(rate, gradient.v) + times(np.swapaxes(bent, 1, 2), gradient.vd)
        for place in actuation.places:
            found.q[:, place.actuator_q] += by_q[:, place.actuator_v]
        found.v[:] += times(2.0 * rate, gradient.vd)
    return found


def _checked_weights(weights: ArrayLike, shape: tuple[int, ...]) -> Array:
    return real_array(weights, "weights", shape)
