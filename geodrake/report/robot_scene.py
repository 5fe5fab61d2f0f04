"""Geometry of a drawn robot: links, poses, joints, colours of errors, and the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
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

FRAMES = 30.0  # frames a second of recordings

COLORS = ("#d3d9e0", "#f2d27a", "#ee9d3d", "#d8492f", "#8f1239")
"""Colours of errors from none to the largest."""

UNKNOWN = 255  # level of a joint in a frame where nothing is compared

GRAYS = np.array([[209, 214, 220, 255], [225, 228, 233, 255]], np.uint8)
"""Colours (RGBA) of links without a joint, and of joints where nothing is compared."""

_AWAY = np.array([0.9, -0.65, 0.4]) / np.linalg.norm([0.9, -0.65, 0.4])
_RIGHT = np.array([0.65, 0.9, 0.0]) / np.linalg.norm([0.65, 0.9])  # to the camera, in the world

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


def top_error(relative: Array, least: float) -> float:
    """Return the error of the last colour, which hardly any exceeds."""
    known = relative[np.isfinite(relative)]
    return max(float(np.quantile(known, 0.99)), least) if len(known) else 1.0


def levels(relative: Array, top: float) -> NDArray[np.uint8]:
    """Return colours of errors as numbers, from 0 for none to 254, or `UNKNOWN`."""
    scaled = np.clip(relative / top, 0.0, 1.0) * 254
    return np.where(np.isfinite(scaled), np.rint(scaled), UNKNOWN).astype(np.uint8)


def error_colors(relative: Array, top: float) -> NDArray[np.uint8]:
    """Return colours (F, nv, 4) of errors (F, nv), RGBA."""
    shades = LinearSegmentedColormap.from_list("error", COLORS, N=UNKNOWN)
    found = levels(relative, top)
    colors = np.asarray(shades(np.minimum(found, UNKNOWN - 1).astype(int), bytes=True))
    return np.where((found == UNKNOWN)[..., None], GRAYS[1], colors).astype(np.uint8)


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


def posed_links(
    model: RobotModel, q: Array, shapes: RobotShapes, p_WR: Array | None = None
) -> list[PosedLink]:
    """Return the links, those without shapes too, in postures (N, nq) of the model.

    A robot that stands elsewhere is moved by (3,) p_WR, m.
    """
    plant, context = model.plant, model.plant.CreateDefaultContext()
    bodies, moving = _bodies(plant), {name for own in _lumps(plant) for name in own}
    movers, X_WR = link_joints(model), RigidTransform(np.zeros(3) if p_WR is None else p_WR)
    poses: list[list[RigidTransform]] = [[] for _ in bodies]
    for posture in model.plant_positions(q):
        plant.SetPositions(context, posture)
        for body, own in zip(bodies, poses, strict=True):
            own.append(X_WR @ plant.EvalBodyPoseInWorld(context, body))
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
    lumps, bases = _lumps(plant), base_joints(plant)
    for joint in joints_of(plant):
        # Of a free base's joints, between which are frames, the root is moved.
        base = next((own for own in bases if joint.index() in [o.index() for o in own]), [joint])
        child = _full(base[-1].child_body())
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
    for joint in joints_of(plant):
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
    size: float  # its largest side in any one posture with a margin for links, m

    @classmethod
    def of(cls, model: RobotModel, q: Array) -> Extent:
        """Return the extent of some postures, (N, nq) positions of the model."""
        links = posed_links(model, q[:: max(1, len(q) // 60)], RobotShapes({}))
        places = np.array([[X.translation() for X in link.X_WB] for link in links])
        cloud = np.concatenate([np.zeros((1, *places.shape[1:])), places])
        size = 1.15 * float(np.ptp(cloud, axis=0).max()) + 0.1
        return cls(cloud.min((0, 1)), cloud.max((0, 1)), size)

    @property
    def beside(self) -> Array:
        """Return where a copy stands (3,), to the right of the camera and clear of the robot, m."""
        return self.size * _RIGHT


def camera_place(extent: Extent, copies: int = 1) -> tuple[Array, Array]:
    """Return where a camera of MeshCat's view stands (3,), and what it looks at (3,), m."""
    side = extent.high - extent.low
    further = (copies - 1) * extent.beside
    middle = extent.low + 0.5 * (side + further)
    margin = 0.12 * extent.size
    width = 0.5 * float(_RIGHT @ (side + further)) + margin
    far = max(0.5 * side[2] + margin, width / _ASPECT) / np.tan(0.5 * VIEW)
    return middle + (far + 0.2 * float(np.abs(_AWAY) @ side)) * _AWAY, middle
