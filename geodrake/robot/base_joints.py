"""Free bases: six joints between the world and the root of a robot that nothing fixes to it.

They slide along x, y and z of the world, then turn by yaw, pitch and roll, with massless frames
between. So the pose of a base is six positions, whose rates are its velocities, and whatever holds
for joints holds for it. At a pitch of ±90° yaw and roll are one.
"""

from __future__ import annotations

import numpy as np
from pydrake.math import RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, PrismaticJoint, RevoluteJoint, RigidBody, SpatialInertia

from geodrake.inertia.bodies import BASE_FRAMES, is_base_frame

COORDINATES = ("x", "y", "z", "yaw", "pitch", "roll")
"""Last words of the names of a base's joints, from the world to the root."""

_AXES = (*np.eye(3), *np.eye(3)[::-1])


def add_base_joints(plant: MultibodyPlant, root: RigidBody) -> None:
    """Put six joints between the world and a root of a plant that is not finalized.

    By default they are where the file has the root. Their names are the root's with the
    coordinate, `trunk_x` … `trunk_roll`.
    """
    X_WB = plant.GetDefaultFloatingBaseBodyPose(root)
    rpy = RollPitchYaw(X_WB.rotation()).vector()
    places = [*X_WB.translation(), *rpy[::-1]]
    name = root.scoped_name().get_full().replace("::", "_")
    instance = plant.AddModelInstance(f"{BASE_FRAMES}{name}")
    joints = {joint.name() for joint in map(plant.get_joint, plant.GetJointIndices())}
    short = root.name()
    if joints & {f"{short}_{each}" for each in COORDINATES}:
        short = f"{short}_base"
    inner = plant.world_frame()
    for coordinate, axis, place in zip(COORDINATES, _AXES, places, strict=True):
        is_last = coordinate == COORDINATES[-1]
        body = root
        if not is_last:
            body = plant.AddRigidBody(coordinate, instance, SpatialInertia.Zero())
        kind = PrismaticJoint if len(coordinate) == 1 else RevoluteJoint
        joint = plant.AddJoint(kind(f"{short}_{coordinate}", inner, body.body_frame(), axis))
        joint.set_default_positions([place])
        inner = body.body_frame()


def base_joints(plant: MultibodyPlant) -> tuple[tuple[Joint, ...], ...]:
    """Return the six joints of every free base of a plant, from the world to the root."""
    found: dict[int, list[Joint]] = {}
    for joint in map(plant.get_joint, plant.GetJointIndices()):
        frames = [b for b in (joint.parent_body(), joint.child_body()) if is_base_frame(plant, b)]
        if frames:
            found.setdefault(int(frames[0].model_instance()), []).append(joint)
    return tuple(tuple(joints) for joints in found.values())
