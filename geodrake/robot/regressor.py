"""The rigid-body regressor of inverse dynamics, for many samples at once.

    M(q) v̇ + C(q, v) v − τ_g(q) = Y(q, v, v̇) φ                                 [Lee2019] Eq. (3.2.2)

Effort is linear in the inertial parameters φ, and Y does not depend on them. It has a block of ten
columns a body, in the parameters' order, and a row a velocity; a row is zero in the blocks of the
bodies that its velocity does not move.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant

from geodrake.boundary.arguments import Sizes, integer, real_array
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.robot.kinematics import KinematicTree, Mobilizer
from geodrake.robot.newton_euler import efforts
from geodrake.robot.recursion import Samples, piece_size, pieces, sample_pieces


def inverse_dynamics_regressor(
    plant: MultibodyPlant | KinematicTree, q: ArrayLike, v: ArrayLike, vd: ArrayLike
) -> Array:
    """Regressor of the effort that a motion needs, without friction and joint damping.

    `Y @ inertial_parameters(plant).ravel()` is M v̇ + C v − τ_g: what Drake's
    `CalcInverseDynamics` gives with gravity as the only applied force.

    Args:
        plant: A finalized plant, or its tree where the same plant is used many times.
        q: (N, nq) positions in Drake's order.
        v: (N, nv) velocities in Drake's order.
        vd: (N, nv) accelerations v̇ in Drake's order.

    Returns:
        (N, nv, 10 nb) regressor Y; bodies in the order of `geodrake.inertia.bodies.lumped_bodies`.

    Raises:
        ArgumentError: A shape does not fit the plant, or a value is not finite.
        ModelError: The plant has a joint that is not supported.
    """
    tree, samples = checked_samples(plant, q, v, vd)
    shape = len(samples[0]), tree.num_velocities, PARAMETERS_PER_BODY * len(tree.bodies)
    regressor = np.empty(shape)
    for part, piece in regressor_pieces(tree, *samples):
        regressor[part] = piece.transpose(2, 0, 1)
    return regressor


def body_regressor(
    plant: MultibodyPlant | KinematicTree, q: ArrayLike, v: ArrayLike, vd: ArrayLike, body: int
) -> Array:
    """The columns (N, nv, 10) of `inverse_dynamics_regressor` for one body, without the others.

    Args:
        plant: A finalized plant, or its tree where the same plant is used many times.
        q: (N, nq) positions in Drake's order.
        v: (N, nv) velocities in Drake's order.
        vd: (N, nv) accelerations v̇ in Drake's order.
        body: Index of the body in the order of `geodrake.inertia.bodies.lumped_bodies`.
    """
    tree, samples = checked_samples(plant, q, v, vd)
    integer(body, "body", lower=0, upper=len(tree.bodies) - 1)
    regressor = np.zeros((len(samples[0]), tree.num_velocities, PARAMETERS_PER_BODY))
    for part, blocks in pieces(tree.branch(body), samples):
        for mobilizer, block in blocks:
            if mobilizer.body == body:
                regressor[part, mobilizer.dofs] = block.transpose(2, 1, 0)
    return regressor


def inverse_dynamics(
    plant: MultibodyPlant | KinematicTree,
    q: ArrayLike,
    v: ArrayLike,
    vd: ArrayLike,
    phi: ArrayLike,
) -> Array:
    """Efforts (N, nv) that a motion needs, Y φ, without Y.

    Args:
        plant: As in `inverse_dynamics_regressor`.
        q: (N, nq) positions.
        v: (N, nv) velocities.
        vd: (N, nv) accelerations v̇.
        phi: (nb, 10) inertial parameters.
    """
    tree, samples = checked_samples(plant, q, v, vd)
    phi = real_array(phi, "phi", (len(tree.bodies), PARAMETERS_PER_BODY))
    effort = np.empty((len(samples[0]), tree.num_velocities))
    for part, piece in sample_pieces(tree, samples):
        effort[part] = efforts(tree, piece, phi).T
    return effort


def regressor_pieces(
    plant: MultibodyPlant | KinematicTree, q: ArrayLike, v: ArrayLike, vd: ArrayLike
) -> Iterator[tuple[slice, Array]]:
    """The regressor in pieces of about a thousand samples, for reductions over long logs.

    Args:
        plant: A finalized plant, or its tree where the same plant is used many times.
        q: (N, nq) positions in Drake's order.
        v: (N, nv) velocities in Drake's order.
        vd: (N, nv) accelerations v̇ in Drake's order.

    Yields:
        The samples, as a slice, and their Y as (nv, 10 nb, n): the rows of velocity k are
        `Y[k].T`, in the column order that LAPACK works on. The next piece overwrites the array.
    """
    tree, samples = checked_samples(plant, q, v, vd)
    columns = PARAMETERS_PER_BODY * len(tree.bodies)
    regressor = np.zeros((tree.num_velocities, columns, piece_size(tree)))
    for part, blocks in pieces(tree, samples):
        piece = regressor[:, :, : part.stop - part.start]
        for mobilizer, block in blocks:
            piece[mobilizer.dofs, _columns(mobilizer)] = block.transpose(1, 0, 2)
        yield part, piece


def checked_samples(
    plant: MultibodyPlant | KinematicTree, q: ArrayLike, v: ArrayLike, vd: ArrayLike
) -> tuple[KinematicTree, Samples]:
    """The tree, and samples q (N, nq), v and vd (N, nv) as arrays that fit it.

    Args:
        plant: A finalized plant, or its tree.
        q: (N, nq) positions in Drake's order.
        v: (N, nv) velocities in Drake's order.
        vd: (N, nv) accelerations v̇ in Drake's order.

    Raises:
        ArgumentError: A shape does not fit the plant, or a value is not finite.
    """
    tree = checked_tree(plant)
    sizes: Sizes = {}
    nq, nv = tree.num_positions, tree.num_velocities
    q = real_array(q, "q", ("N", nq), sizes)
    v, vd = real_array(v, "v", ("N", nv), sizes), real_array(vd, "vd", ("N", nv), sizes)
    return tree, (q, v, vd)


def checked_tree(plant: MultibodyPlant | KinematicTree) -> KinematicTree:
    """The tree of a plant, or the tree that it is.

    Raises:
        ArgumentError: It is something else.
        ModelError: The plant is not finalized, or has a joint that is not supported.
    """
    return plant if isinstance(plant, KinematicTree) else KinematicTree.from_plant(plant)


def _columns(mobilizer: Mobilizer) -> slice:
    first = PARAMETERS_PER_BODY * mobilizer.body
    return slice(first, first + PARAMETERS_PER_BODY)
