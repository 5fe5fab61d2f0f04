"""What of a model file moves: one robot of several, and joints held where they stand, by welds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint, WeldJoint
from scipy.cluster.hierarchy import DisjointSet

from geodrake.errors import ModelError
from geodrake.robot.cut_joints import ends_of, remove_joint
from geodrake.robot.followers import Follower, joints_of, scoped

_SLACK = 1e-9  # rad or m, by which a held joint may be beyond its limits
_ASIDE = " stands"  # after the name of a joint of a robot that is not the one asked for
_WORLD = 0


@dataclass(frozen=True)
class Arrangement:
    """What of a model file moves, and by itself.

    Attributes:
        floating: Whether free roots float instead of being welded to the world.
        held: Scoped names of joints that are held -> their poses X_FM.
        places: Scoped names of joints that are held -> where, rad or m.
        aside: Scoped names of joints of other robots than the one asked for -> their poses X_FM.
        robot: Indices of that robot's bodies; None for all that there are.
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


@dataclass(frozen=True)
class OneRobot:
    """A robot of a model file: bodies that joints connect, not by way of the world.

    Attributes:
        name: That of its model in the file, or of its first body where the model has several.
    """

    name: str
    bodies: frozenset[int]
    joints: tuple[str, ...]


def robots_of(plant: MultibodyPlant) -> tuple[OneRobot, ...]:
    """Return the robots of a plant: what moves and is joined, in order of their bodies."""
    joints, group = joints_of(plant), DisjointSet(range(1, plant.num_bodies()))
    ends = list(map(ends_of, joints))
    for pair in ends:
        if _WORLD not in pair:
            group.merge(*pair)
    found = list[tuple[str, set[int], tuple[str, ...]]]()
    for members in sorted(group.subsets(), key=min):
        moving = tuple(
            scoped(joint)
            for joint, (parent, child) in zip(joints, ends, strict=True)
            if joint.num_velocities() and (parent if child == _WORLD else child) in members
        )
        if moving:
            root = plant.get_body(BodyIndex(min(members)))
            found.append((plant.GetModelInstanceName(root.model_instance()), members, moving))
    count = Counter(model for model, _, _ in found)
    return tuple(
        OneRobot(
            model if count[model] == 1 else plant.get_body(BodyIndex(min(members))).name(),
            frozenset(members),
            moving,
        )
        for model, members, moving in found
    )


def chosen_robot(plant: MultibodyPlant, name: str, path: object) -> OneRobot:
    """Return the robot of a name."""
    robots = robots_of(plant)
    found = next((robot for robot in robots if robot.name == name), None)
    if found is None:
        raise ModelError(
            f"{path} has no robot {name!r}.",
            advice=f"It has {', '.join(robot.name for robot in robots) or 'none that moves'}.",
            path=path,
        )
    return found


def checked_held(
    joints: Mapping[str, Joint],
    followers: Sequence[Follower],
    held: Mapping[str, float],
    path: Path,
) -> dict[str, float]:
    """Return scoped names of joints that are to be held, and of those that follow them -> where.

    Args:
        joints: Joints of one degree of freedom by their names, as users know them.
        held: Such a name -> where it is held, rad or m.
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
    """Return scoped joint name -> pose of the joint's frame M in its frame F.

    Args:
        places: Scoped names of joints of one degree of freedom -> their positions, rad or m; the
            others stand where they do by default.
    """
    context, places = plant.CreateDefaultContext(), places or {}
    q, own = np.array(plant.GetPositions(context)), {scoped(j): j for j in moving_joints(plant)}
    for name in own.keys() & places.keys():
        q[own[name].position_start()] = places[name]
    plant.SetPositions(context, q)
    return {
        name: joint.frame_on_child().CalcPose(context, joint.frame_on_parent())
        for name, joint in own.items()
        if name in joints
    }


def weld_joints(
    plant: MultibodyPlant, poses: Mapping[str, RigidTransform], *, aside: bool = False
) -> None:
    """Put welds in the place of joints, of the same name, in a plant that is not finalized.

    Args:
        poses: Scoped joint name -> pose X_FM that the weld has.
        aside: Whether they get other names, as no robot in question has them.
    """
    for joint in moving_joints(plant):
        if scoped(joint) in poses:
            X_FM, name = poses[scoped(joint)], joint.name() + (_ASIDE if aside else "")
            frames = joint.frame_on_parent(), joint.frame_on_child()
            remove_joint(plant, joint)
            plant.AddJoint(WeldJoint(name, *frames, X_FM))


def welds_of(plant: MultibodyPlant, *, aside: bool = False) -> dict[str, RigidTransform]:
    """Return scoped names of the welded joints of a plant -> their poses X_FM; see `weld_joints`.

    Args:
        aside: Those of other robots than the one in question.
    """
    welds = {scoped(j): j.X_FM() for j in joints_of(plant) if isinstance(j, WeldJoint)}
    wanted = (name for name in welds if name.endswith(_ASIDE) is aside)
    return {name.removesuffix(_ASIDE): welds[name] for name in wanted}


def moving_joints(plant: MultibodyPlant) -> list[Joint]:
    """Return the joints of a plant that are no welds."""
    return [joint for joint in joints_of(plant) if joint.num_velocities()]
