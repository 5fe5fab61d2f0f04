"""Geometry of drawn robots: links, poses, joints, colours of errors, and the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box, Cylinder, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint, RigidBody

from geodrake.inertia import Array
from geodrake.inertia.bodies import lumped_bodies
from geodrake.model.robot_model import RobotModel
from geodrake.robot.arrangement import base_joints
from geodrake.robot.joints import joint_names, joints_of
from geodrake.robot.shapes import GRAY, LinkShape, RobotShapes, robot_shapes

FRAMES = 30.0  # frames per second of recordings

COLORS = ("#d3d9e0", "#f2d27a", "#ee9d3d", "#d8492f", "#8f1239")
"""Colours of errors from none to the largest."""

UNKNOWN = 255  # level of a joint where nothing is compared

GRAYS = np.array([[209, 214, 220, 255], [225, 228, 233, 255]], np.uint8)
"""Colours (RGBA) of links without a joint, and of joints where nothing is compared."""

# Directions to the camera, and to its right, in the world.
_BACKWARD = np.array([0.9, -0.65, 0.4]) / np.linalg.norm([0.9, -0.65, 0.4])
_RIGHT = np.array([0.65, 0.9, 0.0]) / np.linalg.norm([0.65, 0.9])

VIEW = np.radians(75.0)  # MeshCat's vertical field of view

_ASPECT = 1.4  # smallest width over height of a view in which everything fits
_STICK, _JOINT = 0.012, 0.03  # radii, over the size of the robot
_LONGEST = 0.3  # stick to a centre of mass, over the size of the robot


@dataclass(frozen=True, eq=False)
class PosedLink:
    """A link and its poses."""

    name: str
    shapes: tuple[LinkShape, ...]  # its shapes, in its own frame
    joint: int | None  # index of the model's joint that moves it; None without one
    X_WB: tuple[RigidTransform, ...]  # its pose in the world at each instant
    fixed: bool = False  # whether it never moves


@dataclass(frozen=True, eq=False)
class JointPlace:
    """The pose of a joint of one degree of freedom, and the links it moves."""

    joint: str
    index: int | None  # among the model's joints; None if it follows others
    link: str  # the joint's child
    X_BJ: RigidTransform  # pose of the joint in the link, z along its axis
    moved: tuple[str, ...]  # the link, and others welded to it


def top_error(relative: Array, least: float) -> float:
    """Return the error of the last colour, the 99th percentile."""
    known = relative[np.isfinite(relative)]
    return max(float(np.quantile(known, 0.99)), least) if len(known) else 1.0


def levels(relative: Array, top: float) -> NDArray[np.uint8]:
    """Return colours of errors as numbers, from 0 for none to 254, or `UNKNOWN`."""
    scaled = np.clip(relative / top, 0.0, 1.0) * 254
    return np.where(np.isfinite(scaled), np.rint(scaled), UNKNOWN).astype(np.uint8)


def error_colors(relative: Array, top: float) -> NDArray[np.uint8]:
    """Return colours (F, nv, 4) of errors (F, nv), RGBA."""
    level = levels(relative, top)
    stops = np.array([[*bytes.fromhex(color[1:]), 255] for color in COLORS]).T
    at = level / (UNKNOWN - 1) * (len(COLORS) - 1)
    colors = np.stack([np.interp(at, np.arange(len(COLORS)), channel) for channel in stops], -1)
    return np.where((level == UNKNOWN)[..., None], GRAYS[1], np.rint(colors)).astype(np.uint8)


def drawn_shapes(model: RobotModel) -> RobotShapes:
    """Return the shapes of a model's links; sticks and joints if its file has none to show."""
    plant, shapes = model.plant, robot_shapes(model.path, model.given)
    names = set(map(_full_name, _bodies(plant)))
    links = {name: own for name, own in shapes.links.items() if name in names}
    if links and not shapes.notes:
        return RobotShapes(links)
    drawn = {name for lump in _lumps(plant) if not links.keys().isdisjoint(lump) for name in lump}
    sticks = {name: own for name, own in _sticks(plant).items() if name not in drawn}
    notes = shapes.notes or ("the file has no shapes, so links are drawn as sticks",)
    return RobotShapes({**sticks, **links}, notes)


def posed_links(
    model: RobotModel, q: Array, shapes: RobotShapes, p_WR: Array | None = None
) -> list[PosedLink]:
    """Return all links, with or without shapes, in postures (N, nq) of the model.

    The robot is moved by p_WR (3,), m.
    """
    plant, context = model.plant, model.plant.CreateDefaultContext()
    bodies, moving = _bodies(plant), {name for lump in _lumps(plant) for name in lump}
    joints, X_WR = link_joints(model), RigidTransform(np.zeros(3) if p_WR is None else p_WR)
    poses: list[list[RigidTransform]] = [[] for _ in bodies]
    for posture in model.plant_positions(q):
        plant.SetPositions(context, posture)
        for body, X_WB in zip(bodies, poses, strict=True):
            X_WB.append(X_WR @ plant.EvalBodyPoseInWorld(context, body))
    return [
        PosedLink(
            name, shapes.links.get(name, ()), joints.get(name), tuple(X_WB), name not in moving
        )
        for name, X_WB in zip(map(_full_name, bodies), poses, strict=True)
    ]


def joint_places(model: RobotModel) -> dict[str, JointPlace]:
    """Return the joints of one degree of freedom by name, including those that follow others."""
    plant, names, places = model.plant, joint_names(model.plant), dict[str, JointPlace]()
    lumps, bases = _lumps(plant), base_joints(plant)
    for joint in joints_of(plant):
        # All joints of a free base move the root.
        base = next((b for b in bases if joint.index() in [j.index() for j in b]), [joint])
        child = _full_name(base[-1].child_body())
        moved = next((lump for lump in lumps if child in lump), None)
        if joint.num_velocities() != 1 or moved is None:
            continue
        index = model.coordinates.standing.get(int(joint.velocity_start()))
        name = names[joint.velocity_start()] if index is None else model.joints[index]
        X_BM = joint.frame_on_child().GetFixedPoseInBodyFrame()
        R_BJ = RotationMatrix.MakeFromOneVector(X_BM.rotation() @ joint_axis(joint), 2)
        X_BJ = RigidTransform(R_BJ, X_BM.translation())
        places[name] = JointPlace(name, index, child, X_BJ, moved)
    return places


def own_joints(model: RobotModel) -> list[JointPlace]:
    """Return the model's joints of one degree of freedom, in its order."""
    places = joint_places(model)
    return [places[joint] for joint in model.joints if joint in places]


def link_joints(model: RobotModel) -> dict[str, int]:
    """Return the index of the model's joint that moves each link, by scoped link name."""
    places = joint_places(model).values()
    return {link: p.index for p in places if p.index is not None for link in p.moved}


def body_links(model: RobotModel) -> dict[str, str]:
    """Return the scoped name of the link in whose frame each body of the model is, by body."""
    frames = (lump.body_index for lump in lumped_bodies(model.plant))
    links = (_full_name(model.plant.get_body(index)) for index in frames)
    return dict(zip(model.bodies, links, strict=True))


def joint_axis(joint: Joint) -> Array:
    """Return the axis (3,) of a joint in its frame; z if it has none."""
    for name in ("revolute_axis", "translation_axis", "screw_axis"):
        if hasattr(joint, name):
            return np.asarray(getattr(joint, name)())
    return np.array([0.0, 0.0, 1.0])


def _sticks(plant: MultibodyPlant) -> dict[str, tuple[LinkShape, ...]]:
    """Return sticks from each link's origin to the joints on it, and a mark of its own joint."""
    context = plant.CreateDefaultContext()
    origins = [plant.EvalBodyPoseInWorld(context, body).translation() for body in _bodies(plant)]
    size = max(float(np.linalg.norm(np.ptp(np.array(origins), axis=0))), 0.1)
    sticks: dict[str, list[LinkShape]] = {_full_name(body): [] for body in _bodies(plant)}
    is_end = dict.fromkeys(sticks, True)
    for joint in joints_of(plant):
        parent, child = joint.parent_body(), joint.child_body()
        if joint.num_velocities():
            X_BJ = joint.frame_on_child().GetFixedPoseInBodyFrame()
            R_BJ = RotationMatrix.MakeFromOneVector(X_BJ.rotation() @ joint_axis(joint), 2)
            side = _JOINT * size
            is_prismatic = hasattr(joint, "translation_axis")
            mark = Box(side, side, 3 * side) if is_prismatic else Cylinder(side, 3 * side)
            X_BG = RigidTransform(R_BJ, X_BJ.translation())
            sticks[_full_name(child)].append(LinkShape(mark, X_BG, GRAY))
        if int(parent.index()):
            p_PJ = joint.frame_on_parent().GetFixedPoseInBodyFrame().translation()
            sticks[_full_name(parent)] += _stick(p_PJ, _STICK * size)
            is_end[_full_name(parent)] = False
    for body in _bodies(plant):
        if is_end[_full_name(body)] and body.default_mass() > 0.0:
            center = np.nan_to_num(body.default_com())
            length = float(np.linalg.norm(center))
            tip = center * min(1.0, _LONGEST * size / max(length, 1e-12))
            sticks[_full_name(body)] += _stick(tip, _STICK * size)
    return {name: tuple(shapes) for name, shapes in sticks.items() if shapes}


def _stick(p_BE: Array, radius: float) -> list[LinkShape]:
    """Return a stick from the origin to a point, with a ball at its end; empty if too short."""
    length = float(np.linalg.norm(p_BE))
    if length <= radius:
        return []
    X_BG = RigidTransform(RotationMatrix.MakeFromOneVector(p_BE, 2), 0.5 * p_BE)
    ball = LinkShape(Sphere(radius), RigidTransform(p_BE), GRAY)
    return [LinkShape(Cylinder(radius, length), X_BG, GRAY), ball]


def _bodies(plant: MultibodyPlant) -> list[RigidBody]:
    """Return the links of a plant, without the world."""
    return [plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies())]


def _lumps(plant: MultibodyPlant) -> list[tuple[str, ...]]:
    """Return the moving links, those welded together in one tuple."""
    return [
        tuple(_full_name(plant.get_body(member.index)) for member in lump.members)
        for lump in lumped_bodies(plant)
    ]


def _full_name(body: RigidBody) -> str:
    return str(body.scoped_name().get_full())


@dataclass(frozen=True, eq=False)
class Extent:
    """The region of a robot's motion."""

    low: Array  # (3,) smallest coordinates of its links' origins in the world, m
    high: Array  # (3,) largest coordinates
    size: float  # largest side in any one posture, with a margin for links, m
    floor: Array  # (3,) middle of the floor, m: at the world's origin, or below a free base

    @classmethod
    def of(cls, model: RobotModel, q: Array) -> Extent:
        """Return the extent of a motion, positions (N, nq) of the model."""
        links = posed_links(model, q[:: max(1, len(q) // 60)], RobotShapes({}))
        origins = np.array([[X.translation() for X in link.X_WB] for link in links])
        if not model.base_joints:
            origins = np.concatenate([np.zeros((1, *origins.shape[1:])), origins])
        size = 1.15 * float(np.ptp(origins, axis=0).max()) + 0.1
        low, high = origins.min((0, 1)), origins.max((0, 1))
        middle = np.array([*0.5 * (low + high)[:2], low[2]])
        return cls(low, high, size, middle if model.base_joints else np.zeros(3))

    @property
    def beside(self) -> Array:
        """Return the position (3,) of a copy to the right of the robot, m."""
        return self.size * _RIGHT


def camera_place(extent: Extent, copies: int = 1) -> tuple[Array, Array]:
    """Return the positions of a MeshCat camera (3,) and of its target (3,), m."""
    side = extent.high - extent.low
    shift = (copies - 1) * extent.beside
    target = extent.low + 0.5 * (side + shift)
    margin = 0.12 * extent.size
    width = 0.5 * float(_RIGHT @ (side + shift)) + margin
    distance = max(0.5 * side[2] + margin, width / _ASPECT) / np.tan(0.5 * VIEW)
    return target + (distance + 0.2 * float(np.abs(_BACKWARD) @ side)) * _BACKWARD, target
