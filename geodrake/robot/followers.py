"""Joints that follow another one: θ = r θ_leader + θ₀, as a gripper's fingers do.

A follower is no coordinate of the robot. Its bodies move with the leader's position, so the effort
of the leader is that of both, τ_q = Jᵀ τ_θ ([Lee2019] Eq. (3.6.57)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint

from geodrake.boundary.arguments import typed

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


@typed
def joint_names(plant: MultibodyPlant) -> tuple[str, ...]:
    """Return names of the velocities (nv): the joint's, with a suffix where it has several.

    A name that several model instances use is preceded by its instance, `left_elbow`; also where
    the joint is held in the others.
    """
    names = plant.GetVelocityNames(add_model_instance_prefix=False, always_add_suffix=False)
    full = plant.GetVelocityNames(add_model_instance_prefix=True, always_add_suffix=False)
    held = [joint.name() for joint in joints_of(plant) if not joint.num_velocities()]
    return tuple(
        long if names.count(short) > 1 or short in held else short
        for short, long in zip(names, full, strict=True)
    )


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
    """Return followers whose leaders follow none; those that cannot follow are left out.

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
