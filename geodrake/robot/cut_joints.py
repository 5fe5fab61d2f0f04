"""Joints that close loops in a model file, taken out of its plant, which is a tree then.

SDF says of every joint which links it joins, whatever loops that makes. What stays is driven, as
far as an effort limit tells, or near the base; of the others the last ones close the loops.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    Joint,
    JointActuator,
    PrismaticJoint,
    RevoluteJoint,
    WeldJoint,
)
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse import coo_array
from scipy.sparse.csgraph import shortest_path

from geodrake.errors import ModelError
from geodrake.robot.followers import joints_of, scoped
from geodrake.robot.stated import Closure, CutJoint


def open_loops(plant: MultibodyPlant) -> tuple[Closure, ...]:
    """Take joints out of a plant that is not finalized, so that its bodies are trees."""
    joints = joints_of(plant)
    if not _closing(plant, joints):
        return ()
    actuators, far = _actuators(plant), _steps(plant, joints)

    def rank(joint: Joint) -> tuple[int, float]:
        """Return how gladly a joint closes a loop, and how far it is from the base."""
        driven = _is_driven(actuators.get(int(joint.index()), []))
        kind = {WeldJoint: 0, RevoluteJoint: 2 - driven, PrismaticJoint: 2 - driven}
        return kind.get(type(joint), 3), sum(far[body] for body in ends_of(joint))

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


def remove_joint(plant: MultibodyPlant, joint: Joint) -> None:
    """Take a joint out of a plant that is not finalized, and what drives it."""
    for actuator in _actuators(plant).get(int(joint.index()), []):
        plant.RemoveJointActuator(actuator)
    plant.RemoveJoint(joint)


def ends_of(joint: Joint) -> tuple[int, int]:
    """Return the indices of the bodies that a joint connects, the parent first."""
    return int(joint.parent_body().index()), int(joint.child_body().index())


def _closing(plant: MultibodyPlant, joints: list[Joint]) -> list[Joint]:
    """Return joints between bodies that those before them connect already."""
    connected = DisjointSet(range(plant.num_bodies()))
    return [joint for joint in joints if not connected.merge(*ends_of(joint))]


def _actuators(plant: MultibodyPlant) -> dict[int, list[JointActuator]]:
    found: dict[int, list[JointActuator]] = {}
    for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices()):
        found.setdefault(int(actuator.joint().index()), []).append(actuator)
    return found


def _steps(plant: MultibodyPlant, joints: list[Joint]) -> NDArray[np.float64]:
    """Return how many joints lie between each body and the world, or a body that hangs on none."""
    count = plant.num_bodies()
    ends = np.array([ends_of(joint) for joint in joints])
    graph = coo_array((np.ones(len(ends)), ends.T), (count, count))
    hanging = np.isin(np.arange(count), ends[:, 1])
    far = shortest_path(graph, directed=False, unweighted=True, indices=np.flatnonzero(~hanging))
    return np.asarray(far.min(axis=0))


def _is_driven(actuators: list[JointActuator]) -> bool:
    return any(np.isfinite(actuator.effort_limit()) for actuator in actuators)


def _opened(joint: Joint, name: str, actuators: list[JointActuator]) -> Closure:
    frames = joint.frame_on_parent(), joint.frame_on_child()
    first, second = (frame.GetFixedPoseInBodyFrame() for frame in frames)
    cut, axis = None, None
    match joint:
        case RevoluteJoint():
            axis = joint.revolute_axis()
        case PrismaticJoint():
            axis = joint.translation_axis()
        case WeldJoint():
            first = first.multiply(joint.X_FM())
        case BallRpyJoint():
            pass
        case _:
            raise ModelError(
                f"The joint {name!r} of type {joint.type_name()} closes a loop of links.",
                advice="Loops close at revolute, prismatic, ball or fixed joints: let another one "
                "of the loop be none.",
                joint=name,
            )
    if axis is not None:
        cut = CutJoint(
            name,
            scoped(joint),
            np.array(axis),
            isinstance(joint, PrismaticJoint),
            _is_driven(actuators),
        )
    bodies = (body.scoped_name().get_full() for body in (joint.parent_body(), joint.child_body()))
    turns = not isinstance(joint, BallRpyJoint)
    one, two = bodies
    return Closure(f"the joint {name}", (one, two), (first, second), turns, cut)
