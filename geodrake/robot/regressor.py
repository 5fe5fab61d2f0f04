"""Rigid-body regressors of inverse dynamics and of base wrenches, for many samples at once.

    M(q) v̇ + C(q, v) v − τ_g(q) = Y(q, v, v̇) φ                                 [Lee2019] Eq. (3.2.2)

Y has a row per velocity and ten columns per body, in the order of the parameters. A row is zero in
the blocks of bodies that its velocity does not move.

The external wrench on a robot is the rate of its momentum less gravity, independent of joint
friction, springs and elasticity. It is linear in φ, too, and identifies as many combinations of a
tree's parameters as all efforts together ([Lee2019] Remark 3.1). A force plate, or a sensor below
an arm's base, is therefore enough to identify a robot. A wrench is (n, f), the moment about the
origin Po of a frame P, N·m, then the force, N, both expressed in P. It is the wrench that the robot
*needs*: at rest, m g upwards.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant

from geodrake.boundary.arguments import Sizes, integer, number, real_array
from geodrake.compiling import contiguous
from geodrake.errors import ArgumentError
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.robot.joints import Features, FrameMotion
from geodrake.robot.kinematics import KinematicTree, actuator_rows
from geodrake.robot.recursion import (
    Mobilizer,
    Samples,
    calc_inverse_dynamics,
    calc_kinematics,
    calc_regressor,
)

_PIECE = 1 << 18  # entries of a piece, two megabytes, for a core's cache


def inverse_dynamics_regressor(
    plant: MultibodyPlant | KinematicTree, q: ArrayLike, v: ArrayLike, vd: ArrayLike
) -> Array:
    """Return the regressor (N, nv, 10 nb) of the effort of a motion, without friction and damping.

    `Y @ inertial_parameters(plant).ravel()` is M v̇ + C v − τ_g, as Drake's `CalcInverseDynamics`
    returns with gravity as the only applied force. The plant is finalized; pass its tree for many
    calls. Positions (N, nq), velocities and accelerations (N, nv) are in Drake's order, bodies in
    that of `geodrake.inertia.bodies.lumped_bodies`.
    """
    tree, samples, J = checked_samples(plant, q, v, vd)
    nv = tree.num_velocities if J is None else J.shape[2]
    regressor = np.zeros((len(samples[0]), nv, PARAMETERS_PER_BODY * len(tree.bodies)))
    if J is None:
        put_regressor(tree, samples, regressor)
    else:
        for part, piece in _pieces(tree, samples, J):
            regressor[part] = piece
    return regressor


def body_regressor(
    plant: MultibodyPlant | KinematicTree, q: ArrayLike, v: ArrayLike, vd: ArrayLike, body: int
) -> Array:
    """Return the columns (N, nv, 10) of `inverse_dynamics_regressor` for one body, by its index."""
    tree, samples, J = checked_samples(plant, q, v, vd)
    integer(body, "body", lower=0, upper=len(tree.bodies) - 1)
    regressor = np.zeros((len(samples[0]), tree.num_velocities, PARAMETERS_PER_BODY))
    calc_regressor(tree.branch(body).records, samples, (0, body), regressor)
    return actuator_rows(J, regressor)


def inverse_dynamics(
    plant: MultibodyPlant | KinematicTree, q: ArrayLike, v: ArrayLike, vd: ArrayLike, phi: ArrayLike
) -> Array:
    """Return the efforts Y φ (N, nv) of a motion for parameters φ (nb, 10), without forming Y."""
    tree, samples, J = checked_samples(plant, q, v, vd)
    phi = contiguous(real_array(phi, "phi", (len(tree.bodies), PARAMETERS_PER_BODY)))
    effort = np.zeros((len(samples[0]), tree.num_velocities))
    calc_inverse_dynamics(tree.records, samples, phi, effort)
    return actuator_rows(J, effort[:, :, None])[:, :, 0]


def regressor_pieces(
    plant: MultibodyPlant | KinematicTree, q: ArrayLike, v: ArrayLike, vd: ArrayLike
) -> Iterator[tuple[slice, Array]]:
    """Yield slices of samples and their Y (n, nv, 10 nb), in pieces that fit a core's cache.

    Each piece overwrites the previous one.
    """
    yield from _pieces(*checked_samples(plant, q, v, vd))


def _pieces(
    tree: KinematicTree, samples: Samples, J: Array | None
) -> Iterator[tuple[slice, Array]]:
    columns = PARAMETERS_PER_BODY * len(tree.bodies)
    most = max(1, _PIECE // max(1, tree.num_velocities * columns))
    room = np.zeros((min(most, len(samples[0])), tree.num_velocities, columns))
    for start in range(0, len(samples[0]), most):
        part = slice(start, min(start + most, len(samples[0])))
        piece = room[: part.stop - start]  # the zeros are the same in all pieces
        q, qd, v, vd = (x[part] for x in samples)
        put_regressor(tree, (q, qd, v, vd), piece)
        yield part, piece if J is None else actuator_rows(J[part], piece)


def put_regressor(tree: KinematicTree, samples: Samples, out: Array) -> None:
    """Write the regressor into zeros (N, nv, 10 nb)."""
    calc_regressor(tree.records, samples, (0, -1), out)


def checked_samples(
    plant: MultibodyPlant | KinematicTree, q: ArrayLike, v: ArrayLike, vd: ArrayLike
) -> tuple[KinematicTree, Samples, Array | None]:
    """Return the result of `KinematicTree.joint_samples`, with checked arrays."""
    tree = checked_tree(plant)
    sizes: Sizes = {}
    nq, nv = tree.num_positions, tree.num_velocities
    q = real_array(q, "q", ("N", nq), sizes)
    v, vd = real_array(v, "v", ("N", nv), sizes), real_array(vd, "vd", ("N", nv), sizes)
    return tree.joint_samples(q, v, vd)


def checked_tree(plant: MultibodyPlant | KinematicTree) -> KinematicTree:
    """Return the tree of a plant; a tree is returned unchanged."""
    return plant if isinstance(plant, KinematicTree) else KinematicTree.from_plant(plant)


_LEAST_FORCE = 1e-9  # relative to the largest entry of all wrenches
_SKEWNESS = 1e-6  # tolerance of rotation matrices


def base_wrench_regressor(
    plant: MultibodyPlant | KinematicTree,
    q: ArrayLike,
    v: ArrayLike,
    vd: ArrayLike,
    *,
    X_WP: RigidTransform | ArrayLike | None = None,
) -> Array:
    """Return the regressor (N, 6, 10 nb) of the external wrench nx … fz that a motion needs.

    For a robot with a floating base, these are the first six rows of inverse dynamics. For a robot
    fixed to the world, this is the wrench of its support.

    The wrench is about a frame P: one for all samples, such as a force plate's; (N, 4, 4) for a
    moving one, such as a base's (`body_poses`); the world if None.
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
    """Return points (N, 2) of the plane z = height of P without tangential moment.

    On the sole of a foot or a force plate, this is the centre of pressure. Wrenches (N, 6) are
    (n, f) about Po, with z of P normal to the ground. Points are NaN without pressure (f_z ≤ 0), or
    where the wrench is NaN.
    """
    wrench = real_array(wrench, "wrench", ("N", 6), finite=False)
    number(height, "height")
    nx, ny, _, fx, fy, fz = wrench.T
    largest = np.max(np.abs(wrench), initial=0.0, where=np.isfinite(wrench))
    pressed = fz > _LEAST_FORCE * largest
    normal = np.where(pressed, fz, np.nan)
    return np.stack([(height * fx - ny) / normal, (height * fy + nx) / normal], -1)


def body_poses(plant: MultibodyPlant | KinematicTree, q: ArrayLike) -> Array:
    """Return poses X_WB (N, nb, 4, 4) of the lumped bodies at positions (N, nq)."""
    tree = checked_tree(plant)
    q = contiguous(real_array(q, "q", ("N", tree.num_positions)))
    poses = np.zeros((len(q), len(tree.bodies), 4, 4))
    none = np.empty((0, 0, 3, 0))
    calc_kinematics(tree.joints.records, tree.joint_positions(q), poses, none, none)
    return poses


def on_a_free_world(tree: KinematicTree) -> KinematicTree:
    """Return the tree on a movable world at rest, with six velocities whose efforts are the wrench.

    The virtual work on a rigid motion of everything is that of the wrench about the world's origin.
    """
    own = slice(tree.num_velocities, tree.num_velocities + 6)
    dofs = tuple(range(own.start, own.stop))
    still, six = np.zeros((3, 0)), np.eye(6)
    motion = FrameMotion(Features.CONSTANT, np.eye(3).reshape(9, 1), still, six[:3], six[3:])
    mobilizers: list[Mobilizer] = []
    indices: list[int] = []
    for mobilizer in tree.mobilizers:
        parent = indices[mobilizer.parent] if mobilizer.parent >= 0 else len(mobilizers)
        if mobilizer.parent < 0:  # one free world for each root, which has its own gravity
            free = Mobilizer(-1, -2, slice(0, 0), own, dofs, motion, np.zeros(3), mobilizer.gravity)
            mobilizers.append(free)
        indices.append(len(mobilizers))
        mobilizers.append(replace(mobilizer, parent=parent, dofs=dofs))
    return replace(tree, mobilizers=tuple(mobilizers), num_velocities=own.stop)


def _poses(X: RigidTransform | ArrayLike, count: int) -> Array:
    """Return a pose, or one per sample, as homogeneous matrices."""
    poses = real_array(X.GetAsMatrix4() if isinstance(X, RigidTransform) else X, "X_WP")
    if poses.shape not in ((4, 4), (count, 4, 4)):
        raise ArgumentError(
            f"The pose has shape {poses.shape}; expected one pose (4, 4), or {count} of them."
        )
    R = poses[..., :3, :3]
    skew = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(initial=0.0)
    if not (skew < _SKEWNESS and (poses[..., 3, :] == (0, 0, 0, 1)).all()):
        raise ArgumentError(
            "A pose must have a rotation and the last row 0, 0, 0, 1; R Rᵀ differs by "
            f"{skew:.2g} from the identity.",
            advice="Pass a RigidTransform, or its GetAsMatrix4().",
        )
    return poses


def wrench_map(X_WP: RigidTransform | ArrayLike, count: int) -> Array:
    """Return maps (6, 6) or (count, 6, 6) of wrenches about Wo in W to wrenches about Po in P."""
    X = _poses(X_WP, count)
    R_PW, p = np.swapaxes(X[..., :3, :3], -1, -2), X[..., :3, 3]
    full = np.zeros((*X.shape[:-2], 6, 6))
    full[..., :3, :3] = full[..., 3:, 3:] = R_PW
    # n_P = R_PW (n − p × f), column by column of f.
    full[..., :3, 3:] = -R_PW @ np.swapaxes(np.cross(p[..., None, :], np.eye(3)), -1, -2)
    return full
