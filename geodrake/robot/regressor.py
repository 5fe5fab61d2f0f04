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
from geodrake.compiling import contiguous
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.robot.kinematics import KinematicTree, actuator_rows
from geodrake.robot.recursion import Samples, calc_inverse_dynamics, calc_regressor

_PIECE = 1 << 18  # numbers of a piece: two megabytes stay in a core's cache


def inverse_dynamics_regressor(
    plant: MultibodyPlant | KinematicTree, q: ArrayLike, v: ArrayLike, vd: ArrayLike
) -> Array:
    """Return the regressor (N, nv, 10 nb) of the effort of a motion, without friction and damping.

    `Y @ inertial_parameters(plant).ravel()` is M v̇ + C v − τ_g: what Drake's
    `CalcInverseDynamics` gives with gravity as the only applied force. The plant is finalized, or
    its tree where it is used many times; positions (N, nq), velocities and accelerations (N, nv)
    are in Drake's order, and bodies in that of `geodrake.inertia.bodies.lumped_bodies`.
    """
    tree, samples, J = checked_samples(plant, q, v, vd)
    regressor = np.zeros(
        (len(samples[0]), tree.num_velocities, PARAMETERS_PER_BODY * len(tree.bodies))
    )
    put_regressor(tree, samples, regressor)
    return actuator_rows(J, regressor)


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
    plant: MultibodyPlant | KinematicTree,
    q: ArrayLike,
    v: ArrayLike,
    vd: ArrayLike,
    phi: ArrayLike,
) -> Array:
    """Return efforts (N, nv) that a motion needs, Y φ of parameters φ (nb, 10), without Y."""
    tree, samples, J = checked_samples(plant, q, v, vd)
    phi = contiguous(real_array(phi, "phi", (len(tree.bodies), PARAMETERS_PER_BODY)))
    effort = np.zeros((len(samples[0]), tree.num_velocities))
    calc_inverse_dynamics(tree.records, samples, phi, effort)
    return actuator_rows(J, effort[:, :, None])[:, :, 0]


def regressor_pieces(
    plant: MultibodyPlant | KinematicTree, q: ArrayLike, v: ArrayLike, vd: ArrayLike
) -> Iterator[tuple[slice, Array]]:
    """Yield the regressor in pieces that a core's cache holds, for reductions over long logs.

    Yields:
        The samples, as a slice, and their Y (n, nv, 10 nb). The next piece overwrites the array.
    """
    tree, samples, J = checked_samples(plant, q, v, vd)
    columns = PARAMETERS_PER_BODY * len(tree.bodies)
    most = max(1, _PIECE // max(1, tree.num_velocities * columns))
    room = np.zeros((min(most, len(samples[0])), tree.num_velocities, columns))
    for start in range(0, len(samples[0]), most):
        part = slice(start, min(start + most, len(samples[0])))
        piece = room[: part.stop - start]  # what is zero in one piece is so in all
        q, qd, v, vd = (x[part] for x in samples)
        put_regressor(tree, (q, qd, v, vd), piece)
        yield part, piece if J is None else actuator_rows(J[part], piece)


def put_regressor(tree: KinematicTree, samples: Samples, out: Array) -> None:
    """Write the regressor into zeros (N, nv, 10 nb)."""
    calc_regressor(tree.records, samples, (0, -1), out)


def checked_samples(
    plant: MultibodyPlant | KinematicTree, q: ArrayLike, v: ArrayLike, vd: ArrayLike
) -> tuple[KinematicTree, Samples, Array | None]:
    """Return what `KinematicTree.joint_samples` does, of arrays that fit the plant."""
    tree = checked_tree(plant)
    sizes: Sizes = {}
    nq, nv = tree.num_positions, tree.num_velocities
    q = real_array(q, "q", ("N", nq), sizes)
    v, vd = real_array(v, "v", ("N", nv), sizes), real_array(vd, "vd", ("N", nv), sizes)
    return tree.joint_samples(q, v, vd)


def checked_tree(plant: MultibodyPlant | KinematicTree) -> KinematicTree:
    """Return the tree of a plant, or the tree that it is."""
    return plant if isinstance(plant, KinematicTree) else KinematicTree.from_plant(plant)
