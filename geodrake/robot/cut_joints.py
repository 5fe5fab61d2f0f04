"""Joints that close loops in a model file, taken out of its plant, which is a tree then.

SDF says of every joint which links it joins, whatever loops that makes. What stays is driven, as
far as an effort limit tells, or near the base; of the others the last ones close the loops.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    Joint,
    JointActuator,
    PrismaticJoint,
    RevoluteJoint,
    WeldJoint,
)

from geodrake.errors import ModelError
from geodrake.robot.closure import Closure, CutJoint
from geodrake.robot.several_robots import scoped


@dataclass(frozen=True, eq=False)
class OpenedLoop:
    """A joint that was taken out of a plant.

    Attributes:
        closure: How it closes a loop.
        damping: N·m·s/rad or N·s/m.
        rotor_inertia: kg·m² or kg.
        driven: Whether a motor with a limit drives it.
    """

    scoped_name: str
    closure: Closure
    damping: float
    rotor_inertia: float
    driven: bool


def open_loops(plant: MultibodyPlant) -> tuple[OpenedLoop, ...]:
    """Take joints out of a plant that is not finalized, so that its bodies are trees.

    Args:
        plant: The plant; changed.

    Raises:
        ModelError: A joint closes a loop that can close none.
    """
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    if not _closing(plant, joints):
        return ()
    actuators, far = _actuators(plant), _steps(plant, joints)

    def rank(joint: Joint) -> tuple[int, int]:
        bodies = joint.parent_body(), joint.child_body()
        return _rank(joint, actuators), sum(far[int(body.index())] for body in bodies)

    ends = _closing(plant, sorted(joints, key=rank))
    ends.sort(key=lambda joint: int(joint.index()))
    counts = Counter(joint.name() for joint in joints)
    names = (j.name() if counts[j.name()] == 1 else scoped(j).replace("::", "_") for j in ends)
    opened = tuple(
        _opened(joint, name, actuators.get(int(joint.index()), []))
        for joint, name in zip(ends, names, strict=True)
    )
    for joint in ends:
        remove_joint(plant, joint)
    return opened


def _closing(plant: MultibodyPlant, joints: list[Joint]) -> list[Joint]:
    """Joints between bodies that those before them connect already."""
    parents, found = list(range(plant.num_bodies())), list[Joint]()

    def root(body: int) -> int:
        while parents[body] != body:
            parents[body] = parents[parents[body]]
            body = parents[body]
        return body

    for joint in joints:
        ends = joint.parent_body(), joint.child_body()
        first, second = (root(int(body.index())) for body in ends)
        if first == second:
            found.append(joint)
        parents[second] = first
    return found


def remove_joint(plant: MultibodyPlant, joint: Joint) -> None:
    """Take a joint out of a plant that is not finalized, and what drives it.

    Args:
        plant: The plant; changed.
    """
    for actuator in _actuators(plant).get(int(joint.index()), []):
        plant.RemoveJointActuator(actuator)
    plant.RemoveJoint(joint)


def _actuators(plant: MultibodyPlant) -> dict[int, list[JointActuator]]:
    found: dict[int, list[JointActuator]] = {}
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        found.setdefault(int(actuator.joint().index()), []).append(actuator)
    return found


def _rank(joint: Joint, actuators: dict[int, list[JointActuator]]) -> int:
    """Return how gladly a joint closes a loop."""
    if isinstance(joint, WeldJoint):
        return 0
    if not isinstance(joint, RevoluteJoint | PrismaticJoint):
        return 3
    return 1 if _is_driven(actuators.get(int(joint.index()), [])) else 2


def _steps(plant: MultibodyPlant, joints: list[Joint]) -> list[int]:
    """Return how many joints lie between each body and the world, or a body that hangs on none."""
    ends = [(int(j.parent_body().index()), int(j.child_body().index())) for j in joints]
    count = plant.num_bodies()
    found = [0 if body not in {child for _, child in ends} else count for body in range(count)]
    for _ in range(count):
        before = list(found)
        for first, second in ends:
            found[first] = min(found[first], found[second] + 1)
            found[second] = min(found[second], found[first] + 1)
        if found == before:
            break
    return found


def _is_driven(actuators: list[JointActuator]) -> bool:
    return any(np.isfinite(actuator.effort_limit()) for actuator in actuators)


def _opened(joint: Joint, name: str, actuators: list[JointActuator]) -> OpenedLoop:
    X_BF, cut, turns = RigidTransform(), None, True
    axis_of = list[Callable[[], np.ndarray]]()
    match joint:
        case RevoluteJoint():
            axis_of.append(joint.revolute_axis)
        case PrismaticJoint():
            axis_of.append(joint.translation_axis)
        case BallRpyJoint():
            turns = False
        case WeldJoint():
            X_BF = joint.X_FM()
        case _:
            raise ModelError(
                f"The joint {name!r} of type {joint.type_name()} closes a loop of links.",
                advice="Loops close at revolute, prismatic, ball or fixed joints: let another one "
                "of the loop be none.",
                joint=name,
            )
    if axis_of:
        cut = CutJoint(name, np.array(axis_of[0]()), isinstance(joint, PrismaticJoint))
    frames = joint.frame_on_parent(), joint.frame_on_child()
    poses = [frame.GetFixedPoseInBodyFrame() for frame in frames]
    closure = Closure(
        f"the joint {name}",
        (
            joint.parent_body().scoped_name().get_full(),
            joint.child_body().scoped_name().get_full(),
        ),
        (poses[0].multiply(X_BF), poses[1]),
        turns,
        cut,
    )
    damping = joint.default_damping_vector()
    return OpenedLoop(
        scoped(joint),
        closure,
        float(damping[0]) if cut is not None else 0.0,
        sum(float(actuator.default_reflected_inertia()) for actuator in actuators),
        _is_driven(actuators),
    )
