"""Joints of a plant held where they stand: a weld in the place of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, WeldJoint

from geodrake.errors import ModelError
from geodrake.robot.several_robots import scoped

_SLACK = 1e-9  # rad or m, by which a held joint may be beyond its limits
_ASIDE = " stands"  # after the name of a joint of a robot that is not the one asked for


@dataclass(frozen=True)
class Arrangement:
    """What of a model file moves.

    Attributes:
        floating: Whether free roots float instead of being welded to the world.
        held: Scoped names of joints that are held -> their poses X_FM.
        aside: The same of joints of other robots than the one asked for.
        robot: Indices of that robot's bodies; None for all that there are.
    """

    floating: bool
    held: Mapping[str, RigidTransform] = field(default_factory=dict)
    aside: Mapping[str, RigidTransform] = field(default_factory=dict)
    robot: frozenset[int] | None = None

    def is_of_robot(self, body: int) -> bool:
        """Whether a body belongs to the robot asked for."""
        return self.robot is None or body in self.robot


def checked_held(
    plant: MultibodyPlant, names: Mapping[str, int], held: Mapping[str, float], path: Path
) -> dict[str, RigidTransform]:
    """Scoped joint name -> pose of a joint's frame M in its frame F, for joints to be held.

    Args:
        plant: The finalized plant in which they move.
        names: Names of joints of one degree of freedom, as users know them, with their velocities.
        held: Such a name -> where it is held, rad or m.
        path: The model file, for messages.

    Raises:
        ModelError: There is no such joint, or its limits do not let it stand there.
    """
    context = plant.CreateDefaultContext()
    joints = {j.velocity_start(): j for j in moving_joints(plant)}
    poses = {}
    for name, value in held.items():
        if name not in names:
            raise ModelError(
                f"{path} has no joint {name!r} that could be held.",
                advice=f"Joints are: {', '.join(names)}.",
                joint=name,
            )
        joint = joints[names[name]]
        low, high = joint.position_lower_limits()[0], joint.position_upper_limits()[0]
        if not low - _SLACK <= value <= high + _SLACK:  # NaN is refused too
            raise ModelError(
                f"Joint {name!r} cannot be held at {value:g}: its limits are {low:g} … {high:g}.",
                advice="Hold it within them, or correct the limits.",
                joint=name,
            )
        q = np.array(plant.GetPositions(context))
        q[joint.position_start()] = value
        plant.SetPositions(context, q)
        pose = joint.frame_on_child().CalcPose(context, joint.frame_on_parent())
        poses[scoped(joint)] = pose
    return poses


def standing_poses(plant: MultibodyPlant, joints: frozenset[str]) -> dict[str, RigidTransform]:
    """The poses of some joints' frames M in their frames F, by default.

    Args:
        plant: A finalized plant.
        joints: Scoped names of the joints.
    """
    context = plant.CreateDefaultContext()
    return {
        scoped(joint): joint.frame_on_child().CalcPose(context, joint.frame_on_parent())
        for joint in moving_joints(plant)
        if scoped(joint) in joints
    }


def weld_joints(
    plant: MultibodyPlant, poses: Mapping[str, RigidTransform], *, aside: bool = False
) -> None:
    """Puts welds in the place of joints, of the same name.

    Args:
        plant: A plant that is not finalized; changed.
        poses: Scoped joint name -> pose X_FM that the weld has.
        aside: Whether they get other names, as no robot in question has them.
    """
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    for joint in [plant.get_joint(index) for index in plant.GetJointIndices()]:
        if scoped(joint) not in poses:
            continue
        X_FM, name = poses[scoped(joint)], joint.name() + (_ASIDE if aside else "")
        for actuator in actuators:
            if actuator.joint().index() == joint.index():
                plant.RemoveJointActuator(actuator)
        frames = joint.frame_on_parent(), joint.frame_on_child()
        plant.RemoveJoint(joint)
        plant.AddJoint(WeldJoint(name, *frames, X_FM))


def moving_joints(plant: MultibodyPlant) -> list[Joint]:
    """The joints of a plant that are no welds."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    return [joint for joint in joints if joint.num_velocities()]
