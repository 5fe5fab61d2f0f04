"""Links as they are drawn, sticks where the file has no shapes, and where motion puts them."""

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
from geodrake.robot.base_joints import base_joints
from geodrake.robot.shapes import GRAY, LinkShape, RobotShapes, robot_shapes

_STICK, _JOINT = 0.012, 0.03  # radii, over the size of the robot
_LONGEST = 0.3  # of a stick to a centre of mass, over the size of the robot


@dataclass(frozen=True, eq=False)
class PosedLink:
    """A link that is drawn, and its poses.

    Attributes:
        shapes: Its shapes, in its own frame.
        joint: Place, among the model's joints, of the one that moves it; None if none does.
        X_WB: Its pose in the world at each instant.
    """

    name: str
    shapes: tuple[LinkShape, ...]
    joint: int | None
    X_WB: tuple[RigidTransform, ...]


def drawn_shapes(model: RobotModel) -> RobotShapes:
    """Return the shapes of a model's links; sticks and joints where its file has none to show."""
    plant, found = model.plant, robot_shapes(model.path, model.given)
    names = {body.scoped_name().get_full() for body in _bodies(plant)}
    links = {name: shapes for name, shapes in found.links.items() if name in names}
    if links and not found.notes:
        return RobotShapes(links)
    drawn = {
        name
        for lump in lumped_bodies(plant)
        for members in [[_name(plant, member.index) for member in lump.members]]
        if not links.keys().isdisjoint(members)
        for name in members
    }
    sticks = {name: own for name, own in _sticks(plant).items() if name not in drawn}
    notes = found.notes or ("the file has no shapes: links are drawn as sticks",)
    return RobotShapes({**sticks, **links}, notes)


def posed_links(model: RobotModel, q: Array, shapes: RobotShapes) -> list[PosedLink]:
    """Return the links that are drawn, in postures (N, nq) of the model."""
    plant, context = model.plant, model.plant.CreateDefaultContext()
    movers = link_joints(model)
    shown = [(body, own) for body in _bodies(plant) if (own := shapes.links.get(_full(body)))]
    poses: list[list[RigidTransform]] = [[] for _ in shown]
    for posture in model.plant_positions(q):
        plant.SetPositions(context, posture)
        for (body, _), found in zip(shown, poses, strict=True):
            found.append(plant.EvalBodyPoseInWorld(context, body))
    return [
        PosedLink(_full(body), own, movers.get(_full(body)), tuple(found))
        for (body, own), found in zip(shown, poses, strict=True)
    ]


def link_joints(model: RobotModel) -> dict[str, int]:
    """Return, by scoped link name, the place of the model's joint that moves a link."""
    plant, found = model.plant, {}
    lumps = [{int(m.index) for m in lump.members} for lump in lumped_bodies(plant)]
    for joint in _joints(plant):
        at = model.place_of(joint) if joint.num_velocities() == 1 else None
        child = int(moved_body(plant, joint).index())
        if at is not None:
            (own,) = (lump for lump in lumps if child in lump)
            found.update({_name(plant, BodyIndex(index)): at for index in own})
    return found


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
        own = found[_full(child)]
        if joint.num_velocities():
            X_BJ = joint.frame_on_child().GetFixedPoseInBodyFrame()
            R_BJ = RotationMatrix.MakeFromOneVector(X_BJ.rotation() @ joint_axis(joint), 2)
            side = _JOINT * size
            slides = hasattr(joint, "translation_axis")
            mark = Box(side, side, 3 * side) if slides else Cylinder(side, 3 * side)
            own.append(LinkShape(mark, RigidTransform(R_BJ, X_BJ.translation()), GRAY))
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


def _full(body: RigidBody) -> str:
    return str(body.scoped_name().get_full())


def _name(plant: MultibodyPlant, index: BodyIndex) -> str:
    return _full(plant.get_body(index))
