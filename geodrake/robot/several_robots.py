"""Several robots in one model file: their names, and one of them alone."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint, RigidBody

from geodrake.errors import ModelError

_WORLD = 0


@dataclass(frozen=True)
class OneRobot:
    """A robot of a model file: bodies that joints connect, not by way of the world.

    Attributes:
        name: That of its model in the file, or of its first body where the model has several.
        joints: Scoped names of its joints that move.
    """

    name: str
    bodies: frozenset[int]
    joints: tuple[str, ...]


def robots_of(plant: MultibodyPlant) -> tuple[OneRobot, ...]:
    """The robots of a plant: what moves and is joined together, in order of their bodies."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    groups = sorted(_connected(plant, joints), key=min)
    moving = [
        tuple(scoped(j) for j in joints if j.num_velocities() and _outer(j) in group)
        for group in groups
    ]
    having = [(group, names) for group, names in zip(groups, moving, strict=True) if names]
    models = [_model(plant, min(group)) for group, _ in having]
    count = Counter(models)
    return tuple(
        OneRobot(
            model if count[model] == 1 else plant.get_body(BodyIndex(min(group))).name(),
            frozenset(group),
            names,
        )
        for model, (group, names) in zip(models, having, strict=True)
    )


def chosen_robot(plant: MultibodyPlant, name: str, path: object) -> OneRobot:
    """The robot of a name.

    Raises:
        ModelError: There is none of that name.
    """
    robots = robots_of(plant)
    found = next((robot for robot in robots if robot.name == name), None)
    if found is None:
        raise ModelError(
            f"{path} has no robot {name!r}.",
            advice=f"It has {', '.join(robot.name for robot in robots) or 'none that moves'}.",
            path=path,
        )
    return found


def scoped(joint: Joint) -> str:
    """The name of a joint with that of its model instance before it."""
    instance = joint.GetParentPlant().GetModelInstanceName(joint.model_instance())
    return f"{instance}::{joint.name()}"


def _connected(plant: MultibodyPlant, joints: list[Joint]) -> list[set[int]]:
    """Bodies in groups that joints connect; the world connects none."""
    group = {body: {body} for body in range(1, plant.num_bodies())}
    for joint in joints:
        ends = int(joint.parent_body().index()), int(joint.child_body().index())
        if _WORLD not in ends and group[ends[0]] is not group[ends[1]]:
            joined = group[ends[0]] | group[ends[1]]
            group |= dict.fromkeys(joined, joined)
    return list({id(members): members for members in group.values()}.values())


def _outer(joint: Joint) -> int:
    """A body of the joint that is not the world."""
    child, parent = int(joint.child_body().index()), int(joint.parent_body().index())
    return parent if child == _WORLD else child


def _model(plant: MultibodyPlant, body: int) -> str:
    found: RigidBody = plant.get_body(BodyIndex(body))
    return str(plant.GetModelInstanceName(found.model_instance()))
