"""Geometry of a drawn robot: links, poses, joints, and the camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Box, Cylinder, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint, RigidBody

from geodrake.inertia import Array
from geodrake.inertia.bodies import lumped_bodies
from geodrake.model.robot_model import RobotModel
from geodrake.robot.arrangement import base_joints
from geodrake.robot.joints import joint_names
from geodrake.robot.shapes import GRAY, LinkShape, RobotShapes, robot_shapes

FRAMES = 30.0  # frames a second of recordings

_AWAY = np.array([0.9, -0.65, 0.4]) / np.linalg.norm([0.9, -0.65, 0.4])
RIGHT = np.array([0.65, 0.9, 0.0]) / np.linalg.norm([0.65, 0.9])
"""What is right to the camera, in the world."""

VIEW = np.radians(75.0)  # angle of MeshCat's view from top to bottom

_ASPECT = 1.4  # of the view, width over height, at which everything fits
_STICK, _JOINT = 0.012, 0.03  # radii, over the size of the robot
_LONGEST = 0.3  # of a stick to a centre of mass, over the size of the robot


@dataclass(frozen=True, eq=False)
class PosedLink:
    """A link and its poses."""

    name: str
    shapes: tuple[LinkShape, ...]  # its shapes, in its own frame
    # Place, among the model's joints, of the one that moves it; None if none does.
    joint: int | None
    X_WB: tuple[RigidTransform, ...]  # its pose in the world at each instant
    fixed: bool = False  # whether it never moves


@dataclass(frozen=True, eq=False)
class JointPlace:
    """Where a joint of one degree of freedom is, and what it moves."""

    joint: str
    at: int | None  # its place among the model's joints; None of one that follows others
    link: str  # the link that the joint moves
    X_BJ: RigidTransform  # pose of the joint in the link, z along its axis
    moved: tuple[str, ...]  # all links that it moves as one


def drawn_shapes(model: RobotModel) -> RobotShapes:
    """Return the shapes of a model's links; sticks and joints where its file has none to show."""
    plant, found = model.plant, robot_shapes(model.path, model.given)
    names = set(map(_full, _bodies(plant)))
    links = {name: shapes for name, shapes in found.links.items() if name in names}
    if links and not found.notes:
        return RobotShapes(links)
    drawn = {name for own in _lumps(plant) if not links.keys().isdisjoint(own) for name in own}
    sticks = {name: own for name, own in _sticks(plant).items() if name not in drawn}
    notes = found.notes or ("the file has no shapes, so links are drawn as sticks",)
    return RobotShapes({**sticks, **links}, notes)


def posed_links(model: RobotModel, q: Array, shapes: RobotShapes) -> list[PosedLink]:
    """Return the links, those without shapes too, in postures (N, nq) of the model."""
    plant, context = model.plant, model.plant.CreateDefaultContext()
    bodies, moving = _bodies(plant), {name for own in _lumps(plant) for name in own}
    movers = link_joints(model)
    poses: list[list[RigidTransform]] = [[] for _ in bodies]
    for posture in model.plant_positions(q):
        plant.SetPositions(context, posture)
        for body, own in zip(bodies, poses, strict=True):
            own.append(plant.EvalBodyPoseInWorld(context, body))
    named = zip(map(_full, bodies), poses, strict=True)
    return [
        PosedLink(
            name, shapes.links.get(name, ()), movers.get(name), tuple(own), name not in moving
        )
        for name, own in named
    ]


def joint_places(model: RobotModel) -> dict[str, JointPlace]:
    """Return the joints of one degree of freedom by name, those that follow others as well."""
    plant, names, found = model.plant, joint_names(model.plant), dict[str, JointPlace]()
    lumps = _lumps(plant)
    for joint in _joints(plant):
        child = _full(moved_body(plant, joint))
        moved = next((own for own in lumps if child in own), None)
        if joint.num_velocities() != 1 or moved is None:
            continue
        at = model.coordinates.standing.get(int(joint.velocity_start()))
        name = names[joint.velocity_start()] if at is None else model.joints[at]
        X_BM = joint.frame_on_child().GetFixedPoseInBodyFrame()
        R_BJ = RotationMatrix.MakeFromOneVector(X_BM.rotation() @ joint_axis(joint), 2)
        X_BJ = RigidTransform(R_BJ, X_BM.translation())
        found[name] = JointPlace(name, at, child, X_BJ, moved)
    return found


def own_joints(model: RobotModel) -> list[JointPlace]:
    """Return the model's joints of one degree of freedom, in its order."""
    places = joint_places(model)
    return [places[joint] for joint in model.joints if joint in places]


def link_joints(model: RobotModel) -> dict[str, int]:
    """Return, by scoped link name, the place of the model's joint that moves a link."""
    places = joint_places(model).values()
    return {link: place.at for place in places if place.at is not None for link in place.moved}


def body_links(model: RobotModel) -> dict[str, str]:
    """Return, by the name of a body of the model, the scoped name of the link in its frame."""
    frames = (lump.body_index for lump in lumped_bodies(model.plant))
    links = (_full(model.plant.get_body(index)) for index in frames)
    return dict(zip(model.bodies, links, strict=True))


def moved_body(plant: MultibodyPlant, joint: Joint) -> RigidBody:
    """Return the body that a joint moves; of a free base's, between which are frames, the root."""
    for base in base_joints(plant):
        if any(own.index() == joint.index() for own in base):
            return base[-1].child_body()
    return joint.child_body()


def joint_axis(joint: Joint) -> Array:
    """Return the axis (3,) of a joint in its own frame; z of a joint without one."""
    for name in ("revolute_axis", "translation_axis", "screw_axis"):
        if hasattr(joint, name):
            return np.asarray(getattr(joint, name)())
    return np.array([0.0, 0.0, 1.0])


def _sticks(plant: MultibodyPlant) -> dict[str, tuple[LinkShape, ...]]:
    """Return a stick from each link's origin to each joint on it, and a mark of its own joint."""
    context = plant.CreateDefaultContext()
    origins = [plant.EvalBodyPoseInWorld(context, body).translation() for body in _bodies(plant)]
    size = max(float(np.linalg.norm(np.ptp(np.array(origins), axis=0))), 0.1)
    found: dict[str, list[LinkShape]] = {_full(body): [] for body in _bodies(plant)}
    ends = dict.fromkeys(found, True)
    for joint in _joints(plant):
        parent, child = joint.parent_body(), joint.child_body()
        if joint.num_velocities():
            X_BJ = joint.frame_on_child().GetFixedPoseInBodyFrame()
            R_BJ = RotationMatrix.MakeFromOneVector(X_BJ.rotation() @ joint_axis(joint), 2)
            side = _JOINT * size
            slides = hasattr(joint, "translation_axis")
            mark = Box(side, side, 3 * side) if slides else Cylinder(side, 3 * side)
            X_BG = RigidTransform(R_BJ, X_BJ.translation())
            found[_full(child)].append(LinkShape(mark, X_BG, GRAY))
        if int(parent.index()):
            p_PJ = joint.frame_on_parent().GetFixedPoseInBodyFrame().translation()
            found[_full(parent)] += _stick(p_PJ, _STICK * size)
            ends[_full(parent)] = False
    for body in _bodies(plant):
        if ends[_full(body)] and body.default_mass() > 0.0:
            center = np.nan_to_num(body.default_com())
            far = float(np.linalg.norm(center))
            tip = center * min(1.0, _LONGEST * size / max(far, 1e-12))
            found[_full(body)] += _stick(tip, _STICK * size)
    return {name: tuple(shapes) for name, shapes in found.items() if shapes}


def _stick(p_BE: Array, radius: float) -> list[LinkShape]:
    """Return a stick from the origin to a point, round at its end; nothing if that is there."""
    length = float(np.linalg.norm(p_BE))
    if length <= radius:
        return []
    turned = RigidTransform(RotationMatrix.MakeFromOneVector(p_BE, 2), 0.5 * p_BE)
    ball = LinkShape(Sphere(radius), RigidTransform(p_BE), GRAY)
    return [LinkShape(Cylinder(radius, length), turned, GRAY), ball]


def _bodies(plant: MultibodyPlant) -> list[RigidBody]:
    """Return the links of a plant, without the world."""
    return [plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies())]


def _joints(plant: MultibodyPlant) -> Sequence[Joint]:
    return [plant.get_joint(index) for index in plant.GetJointIndices()]


def _lumps(plant: MultibodyPlant) -> list[tuple[str, ...]]:
    """Return the links that move, those welded together in one tuple."""
    return [
        tuple(_full(plant.get_body(member.index)) for member in lump.members)
        for lump in lumped_bodies(plant)
    ]


def _full(body: RigidBody) -> str:
    return str(body.scoped_name().get_full())


@dataclass(frozen=True, eq=False)
class Extent:
    """Where a robot goes."""

    low: Array  # (3,) least coordinates of its links' origins in the world, m
    high: Array  # (3,) largest ones
    left: float  # the farthest that it goes to the left of the camera, m
    right: float  # the farthest that it goes to the right, m
    widest: float  # its largest width to the camera in any one posture, m
    size: float  # its largest side in any one posture with a margin for links, m

    @classmethod
    def of(cls, model: RobotModel, q: Array) -> Extent:
        """Return the extent of some postures, (N, nq) positions of the model."""
        links = posed_links(model, q[:: max(1, len(q) // 60)], RobotShapes({}))
        places = np.array([[X.translation() for X in link.X_WB] for link in links])
        cloud = np.concatenate([np.zeros((1, *places.shape[1:])), places])
        across = cloud @ RIGHT
        low, high = cloud.min((0, 1)), cloud.max((0, 1))
        size = 1.15 * float(np.ptp(cloud, axis=0).max()) + 0.1
        return cls(low, high, -across.min(), across.max(), np.ptp(across, axis=0).max(), size)

    @property
    def gap(self) -> float:
        """Distance at which two copies in one posture are clear of each other, m."""
        return self.widest + 0.3 * self.size


def camera_place(extent: Extent, copies: int = 1) -> tuple[Array, Array]:
    """Return where a camera of MeshCat's view stands (3,), and what it looks at (3,), m."""
    margin = 0.12 * extent.size
    left, right = -extent.left, extent.right + (copies - 1) * extent.gap
    height = 0.5 * (extent.high - extent.low)[2] + margin
    width = 0.5 * (right - left) + margin
    middle = 0.5 * (extent.low + extent.high)
    middle += (0.5 * (left + right) - middle @ RIGHT) * RIGHT
    depth = 0.5 * float(np.abs(_AWAY) @ (extent.high - extent.low))
    far = max(height, width / _ASPECT) / np.tan(0.5 * VIEW) + 0.4 * depth
    return middle + far * _AWAY, middle
