"""The moving part of a model file's plant: one robot, floating bases, fixed and cut joints.

Free roots get six joints to the world, which slide along x, y and z and then turn by yaw, pitch and
roll, with massless frames between. The pose of a base thus has six positions, whose rates are its
velocities, like any joints. Yaw and roll are singular at a pitch of ±90°.

Joints in SDF may form loops. Joints with an effort limit, which counts as a motor, and those close
to the base stay in the tree; of the others, the last ones close the loops and are removed.
Ball and universal joints in the loops become hinges, with massless frames between.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    BodyIndex,
    Joint,
    JointActuator,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    SpatialInertia,
    UniversalJoint,
    WeldJoint,
)
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse import coo_array
from scipy.sparse.csgraph import shortest_path

from geodrake.errors import ModelError, nearest
from geodrake.inertia import Array
from geodrake.inertia.bodies import BASE_FRAMES, HINGE_FRAMES, is_frame
from geodrake.robot.joints import Tie, joints_of, scoped
from geodrake.robot.stated import CLOSING, Closure, CutJoint, Gearbox

COORDINATES = ("x", "y", "z", "yaw", "pitch", "roll")
"""Suffixes of the names of a base's joints, from the world to the root."""

_AXES = (*np.eye(3), *np.eye(3)[::-1])


def add_base_joints(plant: MultibodyPlant, root: RigidBody) -> None:
    """Add six joints between the world and a root of a plant before finalization.

    Their default positions are the root's pose in the file. Their names are the root's with the
    coordinate, `trunk_x` … `trunk_roll`.
    """
    X_WB = plant.GetDefaultFloatingBaseBodyPose(root)
    rpy = RollPitchYaw(X_WB.rotation()).vector()
    places = [*X_WB.translation(), *rpy[::-1]]
    name = root.scoped_name().get_full().replace("::", "_")
    instance = plant.AddModelInstance(f"{BASE_FRAMES}{name}")
    joints = {joint.name() for joint in joints_of(plant)}
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
    """Return the six joints of each free base of a plant, from the world to the root."""
    joints_of_base = defaultdict[int, list[Joint]](list)
    for joint in joints_of(plant):
        ends = joint.parent_body(), joint.child_body()
        frames = [body for body in ends if is_frame(plant, body, (BASE_FRAMES,))]
        if frames:
            joints_of_base[int(frames[0].model_instance())].append(joint)
    return tuple(tuple(joints) for joints in joints_of_base.values())


class Opened(NamedTuple):
    """Changes of a plant that open its loops."""

    closures: tuple[Closure, ...] = ()
    # Velocity `joint[k]` of a joint of several degrees of freedom -> its hinge, by scoped names.
    hinges: Mapping[str, str] = {}
    notes: tuple[str, ...] = ()  # on these hinges
    left_out: tuple[str, ...] = ()  # on damping that they only approximate


def open_loops(plant: MultibodyPlant) -> Opened:
    """Remove joints that close loops from a plant before finalization.

    Ball and universal joints within the loops are replaced by hinges.
    """
    joints = joints_of(plant)
    if not _closing(plant, joints):
        return Opened()
    actuators, far = _actuators(plant), _steps(plant, joints)

    def rank(joint: Joint) -> tuple[int, float]:
        """Return a sorting key: joints to keep in the tree come first."""
        driven = _is_driven(actuators.get(int(joint.index()), []))
        single = 3 - 2 * driven
        kind = {WeldJoint: 0, RevoluteJoint: single, PrismaticJoint: single}
        kind[UniversalJoint] = 2  # as only the others may close a loop
        return kind.get(type(joint), 4), sum(far[body] for body in ends_of(joint))

    ends = _closing(plant, sorted(joints, key=rank))
    ends.sort(key=lambda joint: int(joint.index()))
    counts, opened = Counter(joint.name() for joint in joints), list[Closure]()
    for joint in ends:
        name = joint.name() if counts[joint.name()] == 1 else scoped(joint).replace("::", "_")
        opened.append(_opened(joint, name, actuators.get(int(joint.index()), [])))
    kept = [joint for joint in joints if joint not in ends]
    several = dict[int, tuple[Joint, Array]]()  # by index, with the vector to the next joint
    for closing in ends:
        one, two = _names_of_ends(closing)
        cycle = [closing, *(joint for joint, _ in _paths_from(kept, one)[two])]
        for k, joint in enumerate(cycle[1:], start=1):
            if isinstance(joint, BallRpyJoint | UniversalJoint):
                beside = cycle[k - 1], cycle[(k + 1) % len(cycle)]
                several.setdefault(int(joint.index()), (joint, _arm(joint, beside)))
    for joint in ends:
        _remove_joint(plant, joint)
    hinges, notes, left_out = dict[str, str](), list[str](), list[str]()
    for joint, arm in several.values():
        is_ball = isinstance(joint, BallRpyJoint)
        what = f"{'ball' if is_ball else 'universal'} joint {joint.name()} of a closed loop"
        if is_ball and joint.default_damping_vector().any():
            left_out.append(f"The damping of {what} is that of each hinge, which is approximate.")
        own = _split(plant, joint, arm)
        names = ", ".join(name.rpartition("::")[2] for name in own.values())
        notes.append(f"The {what} is read as the hinges {names}.")
        hinges |= own
    return Opened(tuple(opened), hinges, tuple(notes), tuple(left_out))


def _arm(joint: Joint, beside: Sequence[Joint]) -> Array:
    """Return the position of the joint beside another one on its child body, in its frame M."""
    child, X_CM = joint.child_body().index(), joint.frame_on_child().GetFixedPoseInBodyFrame()
    for other in beside:
        for frame in (other.frame_on_parent(), other.frame_on_child()):
            if frame.body().index() == child:
                return (X_CM.inverse() @ frame.GetFixedPoseInBodyFrame()).translation()
    return np.zeros(3)


def _split(plant: MultibodyPlant, joint: Joint, arm: Array) -> dict[str, str]:
    """Replace a joint by hinges, as in `Opened.hinges`; the last one of a ball is along `arm`."""
    name, title, inner = joint.name(), scoped(joint), joint.frame_on_parent()
    last, size = joint.frame_on_child(), float(np.linalg.norm(arm))
    limits = zip(joint.position_lower_limits(), joint.position_upper_limits(), strict=True)
    axes = [*np.eye(3)[:2]]
    if isinstance(joint, BallRpyJoint):
        along = arm / size if size > 0.0 else np.eye(3)[2]
        axes = [*np.linalg.svd(along[None])[2][1:], along]
    _remove_joint(plant, joint)
    instance, hinges = plant.AddModelInstance(HINGE_FRAMES + title.replace("::", "_")), list[str]()
    for axis, ends, suffix in zip(axes, limits, ("_1", "_2", "_spin"), strict=False):
        outer = last
        if len(hinges) < len(axes) - 1:
            frame = plant.AddRigidBody(f"{name}{suffix}", instance, SpatialInertia.Zero())
            outer = frame.body_frame()
        hinge = plant.AddJoint(RevoluteJoint(f"{name}{suffix}", inner, outer, axis))
        hinge.set_position_limits(*([end] for end in ends))
        hinges.append(scoped(hinge))
        inner = outer
    return {f"{title}[{k}]": hinge for k, hinge in enumerate(hinges)}


def _remove_joint(plant: MultibodyPlant, joint: Joint) -> None:
    """Remove a joint and its actuators from a plant before finalization."""
    for actuator in _actuators(plant).get(int(joint.index()), []):
        plant.RemoveJointActuator(actuator)
    plant.RemoveJoint(joint)


def ends_of(joint: Joint) -> tuple[int, int]:
    """Return the indices of the bodies that a joint connects, the parent first."""
    return int(joint.parent_body().index()), int(joint.child_body().index())


def _closing(plant: MultibodyPlant, joints: list[Joint]) -> list[Joint]:
    """Return joints between bodies that earlier joints already connect."""
    connected = DisjointSet(range(plant.num_bodies()))
    return [joint for joint in joints if not connected.merge(*ends_of(joint))]


def _actuators(plant: MultibodyPlant) -> dict[int, list[JointActuator]]:
    actuators = defaultdict[int, list[JointActuator]](list)
    for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices()):
        actuators[int(actuator.joint().index())].append(actuator)
    return actuators


def _steps(plant: MultibodyPlant, joints: list[Joint]) -> NDArray[np.float64]:
    """Return the number of joints between each body and the world, or a free root."""
    count = plant.num_bodies()
    ends = np.array([ends_of(joint) for joint in joints])
    graph = coo_array((np.ones(len(ends)), ends.T), (count, count))
    hanging = np.isin(np.arange(count), ends[:, 1])
    far = shortest_path(graph, directed=False, unweighted=True, indices=np.flatnonzero(~hanging))
    return np.asarray(far.min(axis=0))


def _is_driven(actuators: list[JointActuator]) -> bool:
    return any(np.isfinite(actuator.effort_limit()) for actuator in actuators)


_KINDS = {"weld": "fixed", "ball_rpy": "ball"}  # Drake's name -> ours, if different


def _opened(joint: Joint, name: str, actuators: list[JointActuator]) -> Closure:
    frames = joint.frame_on_parent(), joint.frame_on_child()
    first, second = (frame.GetFixedPoseInBodyFrame() for frame in frames)
    kind, axis = _KINDS.get(joint.type_name(), joint.type_name()), np.zeros(3)
    match joint:
        case RevoluteJoint():
            axis = joint.revolute_axis()
        case PrismaticJoint():
            axis = joint.translation_axis()
        case WeldJoint():
            first = first.multiply(joint.X_FM())
    if kind not in CLOSING:
        raise ModelError(
            f"Joint {name!r} of type {kind} closes a kinematic loop.",
            advice="Loops can close at revolute, prismatic, ball or fixed joints: open the "
            "loop at another joint.",
        )
    slides, driven = isinstance(joint, PrismaticJoint), _is_driven(actuators)
    one, two = _names_of_ends(joint)
    cut = CutJoint(name, scoped(joint), np.array(axis), slides, driven)
    return Closure.by_joint(cut, kind, (one, two), (first, second))


def geared(plant: MultibodyPlant, box: Gearbox) -> tuple[str, Tie] | None:
    """Return the joint that follows another one by a gearbox, and its tie; the slower one leads.

    Return None unless only revolute joints about the box's axes connect both links to the
    reference, and the angles of two of them matter.
    """
    context, shares = plant.CreateDefaultContext(), dict[str, float]()
    plant.SetPositions(context, np.zeros(plant.num_positions()))
    paths = _paths_from(joints_of(plant), box.reference)
    factors = box.ratio, 1.0  # ratio θ₁ + θ₂ = 0
    for link, (frame, axis), factor in zip(box.links, box.axes, factors, strict=True):
        scope, _, name = frame.rpartition("::")
        where = plant.GetModelInstanceByName(scope)
        if link not in paths or not plant.HasFrameNamed(name, where):
            return None
        R_WA = plant.GetFrameByName(name, where).CalcRotationMatrixInWorld(context)
        axis_W = R_WA.multiply(axis / np.linalg.norm(axis))
        for joint, sign in paths[link]:
            if not isinstance(joint, RevoluteJoint):
                return None
            R_WF = joint.frame_on_parent().CalcRotationMatrixInWorld(context)
            cosine = float(R_WF.multiply(joint.revolute_axis()) @ axis_W)
            if not abs(cosine) > 1.0 - _SAME:
                return None
            own = scoped(joint)
            shares[own] = shares.get(own, 0.0) + factor * sign * float(np.sign(cosine))
    moving = [(own, share) for own, share in shares.items() if abs(share) > _SAME]
    if len(moving) != 2:
        return None
    (leader, large), (follower, small) = sorted(moving, key=lambda each: -abs(each[1]))
    return follower, Tie(leader, (0.0, -large / small))


def _names_of_ends(joint: Joint) -> list[str]:
    """Return the scoped names of the bodies that a joint connects, the parent first."""
    return [b.scoped_name().get_full() for b in (joint.parent_body(), joint.child_body())]


def _paths_from(joints: Sequence[Joint], start: str) -> dict[str, list[tuple[Joint, float]]]:
    """Return scoped body name -> joints from a body to it, with −1 for those passed backwards."""
    edges = defaultdict[str, list[tuple[str, Joint, float]]](list)
    for joint in joints:
        one, two = _names_of_ends(joint)
        edges[one].append((two, joint, 1.0))
        edges[two].append((one, joint, -1.0))
    paths, waiting = {start: list[tuple[Joint, float]]()}, [start]
    for body in waiting:
        for other, joint, sign in edges[body]:
            if other not in paths:
                moves = [(joint, sign)] if joint.num_velocities() else []
                paths[other] = [*paths[body], *moves]
                waiting.append(other)
    return paths


_SLACK = 1e-9  # rad or m, tolerance of the limits of a fixed joint
_SAME = 1e-6  # rad or m, tolerance of the position of a fixed follower
_ASIDE = " stands"  # suffix of welded joints of other robots
_WORLD = 0


@dataclass(frozen=True)
class Arrangement:
    """The moving and independent parts of a model file."""

    floating: bool  # free roots float instead of being welded to the world
    # Scoped name of a fixed joint -> its pose X_FM.
    held: Mapping[str, RigidTransform] = field(default_factory=dict)
    # Scoped name of a fixed joint -> its position, rad or m.
    places: dict[str, float] = field(default_factory=dict)
    # Scoped name of a joint of another robot than the chosen one -> its pose X_FM.
    aside: Mapping[str, RigidTransform] = field(default_factory=dict)
    robot: frozenset[int] | None = None  # indices of the chosen robot's bodies; None for all
    followers: Mapping[str, Tie] = field(default_factory=dict)  # by scoped names
    # User-visible names of the joints of one degree of freedom, fixed ones and followers included.
    joints: tuple[str, ...] = ()


@dataclass(frozen=True)
class OneRobot:
    """A robot of a model file: bodies that joints connect, not counting those to the world."""

    name: str  # of its model in the file, or of its first body if the model has several robots
    bodies: frozenset[int]
    joints: tuple[str, ...]


def robots_of(plant: MultibodyPlant) -> tuple[OneRobot, ...]:
    """Return the robots of a plant, groups of connected moving bodies."""
    joints, group = joints_of(plant), DisjointSet(range(1, plant.num_bodies()))
    ends = list(map(ends_of, joints))
    for pair in ends:
        if _WORLD not in pair:
            group.merge(*pair)
    robots = dict[RigidBody, OneRobot]()  # by the first body
    for members in sorted(group.subsets(), key=min):
        moving = tuple(
            scoped(joint)
            for joint, (parent, child) in zip(joints, ends, strict=True)
            if joint.num_velocities() and (parent if child == _WORLD else child) in members
        )
        if moving:
            root = plant.get_body(BodyIndex(min(members)))
            model = plant.GetModelInstanceName(root.model_instance())
            robots[root] = OneRobot(model, frozenset(members), moving)
    count = Counter(robot.name for robot in robots.values())
    return tuple(
        robot if count[robot.name] == 1 else replace(robot, name=root.name())
        for root, robot in robots.items()
    )


def chosen_robot(plant: MultibodyPlant, name: str, path: object) -> OneRobot:
    """Return the robot with a name."""
    robots = robots_of(plant)
    found = next((robot for robot in robots if robot.name == name), None)
    if found is None:
        raise ModelError(
            f"{path} has no robot {name!r}.",
            advice=f"It has {', '.join(robot.name for robot in robots) or 'none that moves'}.",
        )
    return found


def checked_held(
    joints: Mapping[str, Joint], followers: Mapping[str, Tie], held: Mapping[str, float], path: Path
) -> dict[str, float]:
    """Return scoped joint name -> position for joints to be fixed and their followers.

    `joints`, of one degree of freedom, and `held`, rad or m, have user-visible names.
    """
    names = {scoped(joint): name for name, joint in joints.items()}
    ties = {names[follower]: tie for follower, tie in followers.items()}
    places: dict[str, float] = {}
    for name, value in held.items():
        if name not in joints:
            raise ModelError(
                f"{path} has no joint {name!r} that can be fixed.",
                advice=f"{nearest(name, joints)}Joints are: {', '.join(joints)}.",
            )
        if (tie := ties.get(name)) is not None:
            leader = names[tie.leader]
            if leader not in held or not abs(tie.at(held[leader]) - value) <= _SAME:
                raise ModelError(
                    f"Joint {name!r} cannot be fixed, as it follows {leader!r}.",
                    advice=f"Fix {leader!r}.",
                )
        joint = joints[name]
        low, high = joint.position_lower_limits()[0], joint.position_upper_limits()[0]
        if not low - _SLACK <= value <= high + _SLACK:  # NaN is refused too
            raise ModelError(
                f"Joint {name!r} cannot be fixed at {value:g}: its limits are {low:g} … {high:g}.",
                advice="Fix it within them, or correct the limits.",
            )
        places[scoped(joint)] = value
    leading = ((follower, tie) for follower, tie in followers.items() if tie.leader in places)
    return {follower: tie.at(places[tie.leader]) for follower, tie in leading} | places


def poses_of(
    plant: MultibodyPlant, joints: Collection[str], places: Mapping[str, float] | None = None
) -> dict[str, RigidTransform]:
    """Return scoped joint name -> pose of the joint's frame M in its frame F.

    Joints of one degree of freedom are at `places`, rad or m, others at their defaults.
    """
    context, places = plant.CreateDefaultContext(), places or {}
    q, moving = np.array(plant.GetPositions(context)), {scoped(j): j for j in moving_joints(plant)}
    for name in moving.keys() & places.keys():
        q[moving[name].position_start()] = places[name]
    plant.SetPositions(context, q)
    return {
        name: joint.frame_on_child().CalcPose(context, joint.frame_on_parent())
        for name, joint in moving.items()
        if name in joints
    }


def weld_joints(
    plant: MultibodyPlant, poses: Mapping[str, RigidTransform], *, aside: bool = False
) -> None:
    """Replace joints by welds with poses X_FM, by scoped name, in a plant before finalization.

    With `aside`, for joints of other robots than the chosen one, welds get another name.
    """
    for joint in moving_joints(plant):
        if scoped(joint) in poses:
            X_FM, name = poses[scoped(joint)], joint.name() + (_ASIDE if aside else "")
            frames = joint.frame_on_parent(), joint.frame_on_child()
            _remove_joint(plant, joint)
            plant.AddJoint(WeldJoint(name, *frames, X_FM))


def welds_of(plant: MultibodyPlant, *, aside: bool = False) -> dict[str, RigidTransform]:
    """Return scoped name -> pose X_FM of welded joints of a plant; see `weld_joints`."""
    welds = {scoped(j): j.X_FM() for j in joints_of(plant) if isinstance(j, WeldJoint)}
    wanted = (name for name in welds if name.endswith(_ASIDE) is aside)
    return {name.removesuffix(_ASIDE): welds[name] for name in wanted}


def moving_joints(plant: MultibodyPlant) -> list[Joint]:
    """Return the joints of a plant that are not welds."""
    return [joint for joint in joints_of(plant) if joint.num_velocities()]
