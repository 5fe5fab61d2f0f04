"""Joints that follow another one: θ = r θ_leader + θ₀, as a gripper's fingers do.

A follower is no coordinate of the robot. Its bodies move with the leader's position, so the effort
of the leader is that of both, τ_q = Jᵀ τ_θ ([Lee2019] Eq. (3.6.57)), and the kinematic tree has a
mobilizer for each of them that reads the leader's place in q and v.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint

from geodrake.inertia import Array
from geodrake.robot.transmission.actuation import Actuation

Indices = NDArray[np.intp]

_MOST = 1e12
"""Ratio or offset beyond which no joint follows another."""


def scoped(joint: Joint) -> str:
    """Return the name of a joint with that of its model instance before it."""
    instance = joint.GetParentPlant().GetModelInstanceName(joint.model_instance())
    return f"{instance}::{joint.name()}"


def joints_of(plant: MultibodyPlant) -> list[Joint]:
    """Return the joints of a plant, welds included."""
    return [plant.get_joint(index) for index in plant.GetJointIndices()]


@dataclass(frozen=True)
class Follower:
    """A joint θ of one degree of freedom that follows another one.

    Attributes:
        joint: Scoped name of the joint.
        leader: Scoped name of the joint that it follows.
        ratio: r in θ = r θ_leader + θ₀.
        offset: θ₀, rad or m.
    """

    joint: str
    leader: str
    ratio: float
    offset: float


def resolved(stated: Sequence[Follower], joints: Sequence[str]) -> tuple[Follower, ...]:
    """Followers whose leaders follow none; those that cannot follow are left out.

    Args:
        joints: Scoped names of the joints that there are, of one degree of freedom.
    """
    known = {
        f.joint: f
        for f in stated
        if {f.joint, f.leader} <= set(joints)
        and 0.0 < abs(f.ratio) <= _MOST
        and abs(f.offset) <= _MOST
    }
    found = []
    for first in known.values():
        follower, seen = first, {first.joint}
        while follower.leader in known and follower.leader not in seen:
            inner = known[follower.leader]
            seen.add(inner.joint)
            offset = follower.ratio * inner.offset + follower.offset
            follower = Follower(first.joint, inner.leader, follower.ratio * inner.ratio, offset)
        if follower.leader not in seen:
            found.append(follower)
    return tuple(found)


def leads_back(joint: str, leader: str, leaders: Mapping[str, str]) -> bool:
    """Return whether a joint would follow itself by following another one.

    Args:
        leaders: Joint -> the one that it follows, which lead nowhere back.
    """
    while leader != joint and leader in leaders:
        leader = leaders[leader]
    return leader == joint


@dataclass(frozen=True, eq=False)
class OwnCoordinates:
    """Which positions and velocities of a plant are a robot's own, and how the others follow."""

    plant: MultibodyPlant
    followers: tuple[Follower, ...] = ()

    @cached_property
    def leaders(self) -> Mapping[str, Follower]:
        """Scoped name of a joint that follows -> how."""
        return {follower.joint: follower for follower in self.followers}

    @cached_property
    def own_positions(self) -> Indices:
        """(nq,) where the robot's positions are in those of the plant."""
        following = [to for to, _ in self._places]
        return np.setdiff1d(np.arange(self.plant.num_positions()), following)

    @cached_property
    def own_velocities(self) -> Indices:
        """(nv,) where the robot's velocities are in those of the plant."""
        following = [to for to, _, _ in self.followed]
        return np.setdiff1d(np.arange(self.plant.num_velocities()), following)

    @cached_property
    def followed(self) -> tuple[tuple[int, int, float], ...]:
        """Of each follower, its velocity and its leader's in the plant's, and its ratio."""
        starts = {name: int(joint.velocity_start()) for name, joint in self._joints.items()}
        return tuple((starts[f.joint], starts[f.leader], f.ratio) for f in self.followers)

    def position_of(self, joint: Joint) -> int:
        """Where in q the positions of a joint begin that moves it: its own, or its leader's."""
        return int(np.searchsorted(self.own_positions, self._mover(joint).position_start()))

    def velocity_of(self, joint: Joint) -> int:
        """The same of its velocities in v."""
        return int(np.searchsorted(self.own_velocities, self._mover(joint).velocity_start()))

    def plant_positions(self, q: Array) -> Array:
        """(N, nq of the plant) positions, of those of the robot (N, nq)."""
        whole = np.zeros((len(q), self.plant.num_positions()))
        whole[:, self.own_positions] = q
        for follower, (to, of) in zip(self.followers, self._places, strict=True):
            whole[:, to] = follower.ratio * whole[:, of] + follower.offset
        return whole

    def plant_velocities(self, v: Array) -> Array:
        """(N, nv of the plant) velocities or accelerations, of those of the robot (N, nv)."""
        whole = np.zeros((len(v), self.plant.num_velocities()))
        whole[:, self.own_velocities] = v
        for to, of, ratio in self.followed:
            whole[:, to] = ratio * whole[:, of]
        return whole

    def jacobians(self, actuation: Actuation | None, q: Array, v: Array) -> tuple[Array, Array]:
        """J and J̇ (N, nv of the plant, nv), with the plant's velocities J v, at q and v (N, ·)."""
        F = self.plant_velocities(np.eye(len(self.own_velocities))).T
        if actuation is not None:
            return F @ actuation.jacobian(q), F @ actuation.jacobian_rate(q, v)
        J = np.repeat(F[None], len(q), axis=0)
        return J, np.zeros_like(J)

    def robot_gradient(self, gradient: Array) -> Array:
        """(N, nq) gradient with the robot's positions, of that with the plant's (N, ·)."""
        found = np.array(gradient, float)
        for follower, (to, of) in zip(self.followers, self._places, strict=True):
            found[:, of] += follower.ratio * found[:, to]
        return found[:, self.own_positions]

    def position_limits(self) -> tuple[Array, Array]:
        """Lower and upper limits (nq,) of the positions, those of followers included, rad or m."""
        lower, upper = self.plant.GetPositionLowerLimits(), self.plant.GetPositionUpperLimits()
        for follower, (to, of) in zip(self.followers, self._places, strict=True):
            ends = (np.array([lower[to], upper[to]]) - follower.offset) / follower.ratio
            lower[of], upper[of] = max(lower[of], ends.min()), min(upper[of], ends.max())
        return lower[self.own_positions], upper[self.own_positions]

    def rate_limits(self, limits: Array) -> Array:
        """Largest speeds or accelerations (nv,), of those of all of the plant's velocities."""
        limits = np.array(limits, float)
        for to, of, ratio in self.followed:
            limits[of] = min(limits[of], limits[to] / abs(ratio))
        return limits[self.own_velocities]

    @cached_property
    def _places(self) -> tuple[tuple[int, int], ...]:
        """Of each follower, its position and its leader's in the plant's."""
        starts = {name: int(joint.position_start()) for name, joint in self._joints.items()}
        return tuple((starts[f.joint], starts[f.leader]) for f in self.followers)

    @cached_property
    def _joints(self) -> dict[str, Joint]:
        return {scoped(joint): joint for joint in joints_of(self.plant)}

    def _mover(self, joint: Joint) -> Joint:
        follower = self.leaders.get(scoped(joint))
        return joint if follower is None else self._joints[follower.leader]
