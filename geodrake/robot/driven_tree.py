"""A kinematic tree behind a transmission: evaluated for the motion of its actuators.

    θ = T(q),   θ̇ = J q̇,   θ̈ = J q̈ + J̇ q̇,   τ_q = Jᵀ τ_θ,   Y_q = Jᵀ Y_θ     [Lee2019] Eq. (3.6.57)

Whatever is computed of a robot's bodies goes through here, once in and once out: `joint_samples`
and `actuator_rows`. (Joints that follow another one by a constant ratio are in the tree itself,
whose recursion applies J for nothing; see `geodrake.robot.followers`.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geodrake.boundary.showing import Short
from geodrake.compiling import contiguous
from geodrake.inertia import Array
from geodrake.robot.followers import OwnCoordinates
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.recursion import Samples
from geodrake.robot.transmission.actuation import Actuation


@dataclass(frozen=True)
class DrivenTree(Short):
    """A tree, and how its positions and velocities follow from those of actuators.

    Attributes:
        joint_tree: The tree of the joints.
    """

    joint_tree: KinematicTree
    actuation: Actuation

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the (nb) lumped bodies."""
        return self.joint_tree.bodies

    @property
    def num_positions(self) -> int:
        """nq, of the actuators and of joints without any."""
        return self.actuation.num_positions

    @property
    def num_velocities(self) -> int:
        """nv, likewise."""
        return self.actuation.num_velocities

    @property
    def gravity(self) -> Array:
        """(3,) gravity in the world frame, m/s²."""
        return self.joint_tree.gravity

    def branch(self, body: int) -> DrivenTree:
        """The same with only the mobilizers between the world and a body."""
        return replace(self, joint_tree=self.joint_tree.branch(body))


RobotTree = KinematicTree | DrivenTree
"""What bodies are computed with: a tree of joints, or one behind a transmission."""


def joint_samples(
    tree: RobotTree, q: Array, v: Array, vd: Array
) -> tuple[KinematicTree, Samples, Array | None]:
    """The tree of the joints, their motion, and J if there is one; values are not checked.

    Returns:
        The tree; positions, velocities twice and accelerations of its joints; and, behind a
        transmission, (N, nv of the tree, nv) J, with which `actuator_rows` leads back.
    """
    J = None
    if isinstance(tree, DrivenTree):
        q, v, vd, J = tree.actuation.tree_samples(q, v, vd)
    q, v, vd = contiguous(q), contiguous(v), contiguous(vd)
    return joint_tree(tree), (q, v, v, vd), J


def actuator_rows(J: Array | None, rows: Array) -> Array:
    """Jᵀ Y (N, nv, p), of rows Y (N, nv of the tree, p) of the joints; Y itself without J."""
    return rows if J is None else np.asarray(np.swapaxes(J, 1, 2) @ rows)


def with_gravity(tree: RobotTree, gravity: Array) -> RobotTree:
    """Return a tree under another gravity (3,) in the world frame, m/s²."""
    own = replace(joint_tree(tree), gravity=gravity)
    return replace(tree, joint_tree=own) if isinstance(tree, DrivenTree) else own


def joint_tree(tree: RobotTree) -> KinematicTree:
    """The tree of the joints, without a transmission."""
    return tree.joint_tree if isinstance(tree, DrivenTree) else tree


def moving_velocities(tree: RobotTree, velocities: tuple[int, ...]) -> tuple[int, ...]:
    """The robot's velocities that move some of the joints' velocities."""
    if isinstance(tree, DrivenTree):
        return tree.actuation.moved_by(velocities)
    return tuple(dict.fromkeys(velocities))  # a leader moves a body and its follower


def joint_positions(tree: RobotTree, q: Array) -> Array:
    """(N, ·) positions of the tree's joints, of positions (N, nq)."""
    return tree.actuation.tree_positions(q) if isinstance(tree, DrivenTree) else q


def inside(tree: RobotTree, q: Array) -> Array:
    """Positions (N, nq), those of actuators moved to where their maps are known."""
    return tree.actuation.inside(q) if isinstance(tree, DrivenTree) else q


def plant_jacobians(
    tree: RobotTree, coordinates: OwnCoordinates, q: Array, v: Array
) -> tuple[Array, Array]:
    """J and J̇ (N, nv of the plant, nv), with the plant's velocities J v, at q and v (N, ·)."""
    F = coordinates.plant_velocities(np.eye(len(coordinates.own_velocities))).T
    if isinstance(tree, DrivenTree):
        return F @ tree.actuation.jacobian(q), F @ tree.actuation.jacobian_rate(q, v)
    J = np.repeat(F[None], len(q), axis=0)
    return J, np.zeros_like(J)


def through(tree: RobotTree, q: Array, jacobian: Array) -> Array:
    """Jacobians (N, m, nv) of what has the Jacobians (N, m, ·) with the joints' velocities."""
    if isinstance(tree, DrivenTree):
        return np.asarray(jacobian @ tree.actuation.jacobian(q))
    return jacobian
