"""What the ground feels of a moving robot: base wrenches, their regressor, zero-moment points.

The external wrench on a robot is the rate of its momentum less gravity, whatever happens inside:
joint friction, springs and elasticity do not enter. It is linear in the inertial parameters, and
of a tree it identifies as many of their combinations as all efforts together ([Lee2019] Remark
3.1). So a force plate, or a sensor below an arm's base, is enough to identify a robot.

A wrench is (n, f): moment about the origin Po of a frame P, N·m, then force, N, both expressed
in P; the wrench that the robot *needs* from outside, so that a robot at rest needs m g upwards.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant

from geodrake.boundary.arguments import number, real_array
from geodrake.compiling import contiguous
from geodrake.errors import ArgumentError
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.robot.joints import Features, FrameMotion
from geodrake.robot.kinematics import KinematicTree, Mobilizer
from geodrake.robot.recursion import calc_kinematics, calc_regressor
from geodrake.robot.regressor import checked_samples, checked_tree

_LEAST_FORCE = 1e-9  # of the largest number in a wrench
_SKEWNESS = 1e-6  # of a rotation, beyond rounding


def base_wrench_regressor(
    plant: MultibodyPlant | KinematicTree,
    q: ArrayLike,
    v: ArrayLike,
    vd: ArrayLike,
    *,
    X_WP: RigidTransform | ArrayLike | None = None,
) -> Array:
    """Return the regressor (N, 6, 10 nb) of the wrench nx … fz that a motion needs from outside.

    Of a robot with a floating base, these are the first six rows of inverse dynamics, without the
    work for the others. Of a robot that is fixed to the world, they are its reaction.

    The wrench is about a frame P: one for all samples, such as a force plate's, or (N, 4, 4) for
    one that moves, such as a base's (`body_poses`); the world if None.
    """
    tree, (q, v, _, vd), _ = checked_samples(plant, q, v, vd)
    resting = np.zeros((len(q), 6))
    v = np.hstack([v, resting])
    samples = (q, v, v, np.hstack([vd, resting]))
    regressor = np.zeros((len(q), 6, PARAMETERS_PER_BODY * len(tree.bodies)))
    which = tree.num_velocities, -1
    calc_regressor(on_a_free_world(tree).records, samples, which, regressor)
    return regressor if X_WP is None else wrench_map(X_WP, len(q)) @ regressor


def zero_moment_point(wrench: ArrayLike, *, height: float = 0.0) -> Array:
    """Points (N, 2) of the plane z = height of P in which a wrench has no moment along the plane.

    On the sole of a foot or a force plate, that is the centre of pressure. Wrenches (N, 6) are
    (n, f) about Po, with z of P normal to the ground. Points are NaN where nothing presses on the
    plane (f_z ≤ 0), or where the wrench is NaN.
    """
    wrench = real_array(wrench, "wrench", ("N", 6), finite=False)
    number(height, "height")
    nx, ny, _, fx, fy, fz = wrench.T
    largest = np.max(np.abs(wrench), initial=0.0, where=np.isfinite(wrench))
    pressed = fz > _LEAST_FORCE * largest
    normal = np.where(pressed, fz, np.nan)
    return np.stack([(height * fx - ny) / normal, (height * fy + nx) / normal], -1)


def body_poses(plant: MultibodyPlant | KinematicTree, q: ArrayLike) -> Array:
    """Return poses X_WB (N, nb, 4, 4) of every lumped body at positions (N, nq)."""
    tree = checked_tree(plant)
    q = contiguous(real_array(q, "q", ("N", tree.num_positions)))
    poses = np.zeros((len(q), len(tree.bodies), 4, 4))
    none = np.empty((0, 0, 3, 0))
    calc_kinematics(tree.joints.records, tree.joint_positions(q), poses, none, none)
    return poses


def on_a_free_world(tree: KinematicTree) -> KinematicTree:
    """Return the tree on a movable world at rest; only its six velocities' efforts are used.

    The virtual work of the robot's efforts on a rigid motion of everything is that of the wrench
    about the world's origin.
    """
    own = slice(tree.num_velocities, tree.num_velocities + 6)
    dofs = tuple(range(own.start, own.stop))
    still, six = np.zeros((3, 0)), np.eye(6)
    motion = FrameMotion(Features.CONSTANT, np.eye(3).reshape(9, 1), still, six[:3], six[3:])
    mobilizers: list[Mobilizer] = []
    place: list[int] = []
    for mobilizer in tree.mobilizers:
        parent = place[mobilizer.parent] if mobilizer.parent >= 0 else len(mobilizers)
        if mobilizer.parent < 0:  # one free world for each root, which has its own gravity
            free = Mobilizer(-1, -2, slice(0, 0), own, dofs, motion, np.zeros(3), mobilizer.gravity)
            mobilizers.append(free)
        place.append(len(mobilizers))
        mobilizers.append(replace(mobilizer, parent=parent, dofs=dofs))
    return replace(tree, mobilizers=tuple(mobilizers), num_velocities=own.stop)


def _poses(X: RigidTransform | ArrayLike, count: int) -> Array:
    """Return a pose, or one for each sample, as homogeneous matrices."""
    poses = real_array(X.GetAsMatrix4() if isinstance(X, RigidTransform) else X, "X_WP")
    if poses.shape not in ((4, 4), (count, 4, 4)):
        raise ArgumentError(
            f"The pose has the shape {poses.shape}, expected one pose (4, 4) or {count} of them."
        )
    R = poses[..., :3, :3]
    skew = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(initial=0.0)
    if not (skew < _SKEWNESS and (poses[..., 3, :] == (0, 0, 0, 1)).all()):
        raise ArgumentError(
            f"A pose has a rotation and the last row 0, 0, 0, 1; R Rᵀ is {skew:.2g} off the "
            "identity.",
            advice="Pass a RigidTransform, or its GetAsMatrix4().",
        )
    return poses


def wrench_map(X_WP: RigidTransform | ArrayLike, count: int) -> Array:
    """Return (6, 6) or (count, 6, 6) maps of wrenches about Wo in W to the same about Po in P."""
    X = _poses(X_WP, count)
    R_PW, p = np.swapaxes(X[..., :3, :3], -1, -2), X[..., :3, 3]
    full = np.zeros((*X.shape[:-2], 6, 6))
    full[..., :3, :3] = full[..., 3:, 3:] = R_PW
    # n_P = R_PW (n − p × f), column by column of f.
    full[..., :3, 3:] = -R_PW @ np.swapaxes(np.cross(p[..., None, :], np.eye(3)), -1, -2)
    return full
