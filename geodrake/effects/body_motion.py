"""Poses and Jacobians of a robot's bodies, for effects that act on bodies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import contiguous
from geodrake.errors import ArgumentError
from geodrake.robot.kinematics import KinematicTree, actuator_rows
from geodrake.robot.recursion import (
    Samples,
    calc_acceleration,
    calc_inverse_dynamics,
    calc_kinematics,
    calc_places,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """Poses and Jacobians of a body B over N samples."""

    rotation: Array  # (N, 3, 3) R_WB
    position: Array  # (N, 3) p_WoBo_W, m
    angular: Array  # (N, 3, nv) Jacobian of the angular velocity, in W
    linear: Array  # (N, 3, nv) Jacobian of the velocity of Bo, in W
    dofs: tuple[int, ...]  # indices of the velocities that move B

    def jacobian_at(self, p_BoP_B: Array) -> Array:
        """Return (N, 3, nv) Jacobian, in W, of the velocity of B's point P at p_BoP_B (3,), m."""
        return self.jacobian_along(self.rotation @ np.asarray(p_BoP_B, float))

    def jacobian_along(self, p_BoP_W: Array) -> Array:
        """Return (N, 3, nv) Jacobian, in W, of the velocity of B's point P at p_BoP_W (N, 3), m."""
        w, (x, y, z) = self.angular, p_BoP_W.T[:, :, None]
        J = self.linear.copy()
        J[:, 0] += w[:, 1] * z - w[:, 2] * y
        J[:, 1] += w[:, 2] * x - w[:, 0] * z
        J[:, 2] += w[:, 0] * y - w[:, 1] * x
        return J


@dataclass(frozen=True, eq=False)
class RobotBodies:
    """The bodies of a robot in N configurations, evaluated lazily."""

    tree: KinematicTree
    q: Array  # (N, nq) positions in Drake's order
    phi: Array  # (nb, 10) inertial parameters of the bodies

    @property
    def gravity(self) -> Array:
        """(3,) gravity in the world frame, m/s²."""
        return self.tree.gravity

    @property
    def joints_behind(self) -> Mapping[str, int]:
        """Joint behind a transmission, or in a loop -> its index in the tree's positions."""
        return {} if self.tree.actuation is None else self.tree.actuation.behind

    def tree_samples(self, v: Array, vd: Array) -> tuple[Array, Array, Array, Array]:
        """Return positions, velocities and accelerations of the joints of the tree, and J."""
        if self.tree.actuation is not None:
            return self.tree.actuation.all_samples(self.q, v, vd)
        return self.q, v, vd, np.eye(self.tree.num_velocities)[None]

    def motion(self, body: str) -> BodyMotion:
        """Return the pose and Jacobian of a body."""
        if body not in self._motions:
            self._motions[body] = self._motion(self.index(body))
        return self._motions[body]

    def acceleration(self, body: str, v: Array, vd: Array) -> tuple[Array, Array]:
        """Return a body's angular acceleration, and that of Bo, each (N, 3), in B."""
        q, v, vd, _ = self.tree_samples(v, vd)
        branch = replace(self.tree.joints.branch(self.index(body)), gravity=np.zeros(3))
        return self.last_acceleration(branch, (q, v, v, vd))

    def index(self, body: str) -> int:
        """Return the index of a body; raise an ArgumentError if it does not exist."""
        if body not in self.tree.bodies:
            raise ArgumentError(
                f"There is no moving body {body!r}.",
                advice=f"Bodies are: {', '.join(self.tree.bodies)}.",
            )
        return self.tree.bodies.index(body)

    @cached_property
    def places(self) -> tuple[Array, Array]:
        """Rotations (m, N, 3, 3) and lines (nv, N, 3, 3) of all joints, from `calc_places`."""
        tree, q = self.tree.joints, contiguous(self.tree.joint_positions(self.q))
        rotations = np.empty((len(tree.mobilizers), len(q), 3, 3))
        lines = np.empty((tree.num_velocities, len(q), 3, 3))
        calc_places(tree.records, q, rotations, lines)
        return rotations, lines

    def mass_center(self, body: str) -> Array:
        """Return (3,) p_BoBcm_B, m; zero for a body without mass."""
        m, *moment = self.phi[self.index(body), :4].tolist()
        return np.array(moment) / m if m > 0.0 else np.zeros(3)

    def gravity_efforts(self, gravities: Array) -> Array:
        """Return the static efforts (N, nv, k) under gravities (3, k), m/s²."""
        zero = np.zeros((len(self.q), self.tree.num_velocities))
        phi = np.where(self.phi[:, :1] > 0.0, self.phi, 0.0)
        tree, samples, J = self.tree.joint_samples(self.q, zero, zero)
        efforts = np.zeros((gravities.shape[1], *samples[1].shape))
        for effort, gravity in zip(efforts, gravities.T, strict=True):
            calc_inverse_dynamics(replace(tree, gravity=gravity).records, samples, phi, effort)
        return actuator_rows(J, np.moveaxis(efforts, 0, -1))

    @cached_property
    def _motions(self) -> dict[str, BodyMotion]:
        return {}

    def _motion(self, body: int) -> BodyMotion:
        """Return the motion of a body from the mobilizers between the world and it."""
        tree = self.tree.joints.branch(body)
        *inboard, last = tree.mobilizers
        mobilizers = *(replace(inner, body=-1) for inner in inboard), replace(last, body=0)
        poses, angular, linear = self.kinematics(replace(tree, mobilizers=mobilizers))
        return BodyMotion(
            poses[:, 0, :3, :3],
            poses[:, 0, :3, 3],
            self.tree.through(self.q, angular[:, 0]),
            self.tree.through(self.q, linear[:, 0]),
            self.tree.moving_velocities(last.dofs),
        )

    def last_acceleration(self, tree: KinematicTree, samples: Samples) -> tuple[Array, Array]:
        """Return the accelerations of a tree's last body, as `acceleration`."""
        q, v, _, vd = map(contiguous, samples)
        angular, linear = np.empty((2, len(q), 3))
        calc_acceleration(tree.records, (q, v, v, vd), angular, linear)
        return angular, linear

    def kinematics(self, tree: KinematicTree) -> tuple[Array, Array, Array]:
        """Return poses (N, 1, 4, 4) of a tree's only body, and its Jacobians (N, 1, 3, ·)."""
        poses = np.zeros((len(self.q), 1, 4, 4))
        angular, linear = np.zeros((2, len(self.q), 1, 3, tree.num_velocities))
        q = contiguous(self.tree.joint_positions(self.q))
        calc_kinematics(tree.records, q, poses, angular, linear)
        return poses, angular, linear
