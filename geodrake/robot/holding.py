"""Joints of a plant held where they stand: a weld in the place of each."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, WeldJoint

from geodrake.errors import ModelError
from geodrake.robot.cut_joints import remove_joint
from geodrake.robot.followers import Follower
from geodrake.robot.several_robots import scoped

_SLACK = 1e-9  # rad or m, by which a held joint may be beyond its limits
_ASIDE = " stands"  # after the name of a joint of a robot that is not the one asked for


@dataclass(frozen=True)
class Arrangement:
    """What of a model file moves, and by itself.

    Attributes:
        floating: Whether free roots float instead of being welded to the world.
        held: Scoped names of joints that are held -> their poses X_FM.
        places: Scoped names of joints that are held -> where, rad or m.
        aside: Scoped names of joints of other robots than the one asked for -> their poses X_FM.
        robot: Indices of that robot's bodies; None for all that there are.
        followers: Joints that move as others do.
        joints: Names, as users know them, of the robot's joints of one degree of freedom, held
            ones and followers included.
    """

    floating: bool
    held: Mapping[str, RigidTransform] = field(default_factory=dict)
    places: dict[str, float] = field(default_factory=dict)
    aside: Mapping[str, RigidTransform] = field(default_factory=dict)
    robot: frozenset[int] | None = None
    followers: tuple[Follower, ...] = ()
    joints: tuple[str, ...] = ()

    def is_of_robot(self, body: int) -> bool:
        """Whether a body belongs to the robot asked for."""
        return self.robot is None or body in self.robot


def checked_held(
    joints: Mapping[str, Joint],
    followers: Sequence[Follower],
    held: Mapping[str, float],
    path: Path,
) -> dict[str, float]:
    """Scoped names of joints that are to be held, and of those that follow them -> where.

    Args:
        joints: Joints of one degree of freedom by their names, as users know them.
        held: Such a name -> where it is held, rad or m.

    Raises:
        ModelError: There is no such joint, it follows another one, or its limits do not let it
            stand there.
    """
    names = {scoped(joint): name for name, joint in joints.items()}
    leaders = {names[f.joint]: names[f.leader] for f in followers}
    places: dict[str, float] = {}
    for name, value in held.items():
        if name not in joints:
            raise ModelError(
                f"{path} has no joint {name!r} that could be held.",
                advice=f"Joints are: {', '.join(joints)}.",
                joint=name,
            )
        if name in leaders:
            raise ModelError(
                f"Joint {name!r} cannot be held, as it follows {leaders[name]!r}.",
                advice=f"Hold {leaders[name]!r}.",
                joint=name,
            )
        joint = joints[name]
        low, high = joint.position_lower_limits()[0], joint.position_upper_limits()[0]
        if not low - _SLACK <= value <= high + _SLACK:  # NaN is refused too
            raise ModelError(
                f"Joint {name!r} cannot be held at {value:g}: its limits are {low:g} … {high:g}.",
                advice="Hold it within them, or correct the limits.",
                joint=name,
            )
        places[scoped(joint)] = value
    following = {
        f.joint: f.ratio * places[f.leader] + f.offset for f in followers if f.leader in places
    }
    return places | following


def poses_of(
    plant: MultibodyPlant, joints: Collection[str], places: Mapping[str, float] | None = None
) -> dict[str, RigidTransform]:
    """Scoped joint name -> pose of the joint's frame M in its frame F.

    Args:
        places: Scoped names of joints of one degree of freedom -> their positions, rad or m; the
            others stand where they do by default.
    """
    context = plant.CreateDefaultContext()
    q, moving = np.array(plant.GetPositions(context)), moving_joints(plant)
    for joint in moving:
        if scoped(joint) in (places or {}):
            q[joint.position_start()] = (places or {})[scoped(joint)]
    plant.SetPositions(context, q)
    return {
        scoped(joint): joint.frame_on_child().CalcPose(context, joint.frame_on_parent())
        for joint in moving
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
    for joint in [plant.get_joint(index) for index in plant.GetJointIndices()]:
        if scoped(joint) not in poses or not joint.num_velocities():
            continue
        X_FM, name = poses[scoped(joint)], joint.name() + (_ASIDE if aside else "")
        frames = joint.frame_on_parent(), joint.frame_on_child()
        remove_joint(plant, joint)
        plant.AddJoint(WeldJoint(name, *frames, X_FM))


def welds_of(plant: MultibodyPlant, *, aside: bool = False) -> dict[str, RigidTransform]:
    """Scoped names of the welded joints of a plant -> their poses X_FM; see `weld_joints`.

    Args:
        aside: Those of other robots than the one in question.
    """
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    welds = {scoped(joint): joint.X_FM() for joint in joints if isinstance(joint, WeldJoint)}
    names = {name: name.endswith(_ASIDE) for name in welds}
    return {name.removesuffix(_ASIDE): welds[name] for name in welds if names[name] is aside}


def moving_joints(plant: MultibodyPlant) -> list[Joint]:
    """The joints of a plant that are no welds."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    return [joint for joint in joints if joint.num_velocities()]
