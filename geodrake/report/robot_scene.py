"""A robot in MeshCat as its file shows it, and the calm surroundings of all our scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, MeshcatParams, Rgba
from pydrake.geometry import Ellipsoid as EllipsoidShape
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import BodyIndex, Joint, JointIndex, RigidBody

from geodrake.boundary.escaping import path_part
from geodrake.inertia import Array
from geodrake.inertia.bodies import lumped_bodies
from geodrake.inertia.ellipsoids import equivalent_ellipsoid
from geodrake.model.robot_model import RobotModel
from geodrake.report.ellipsoids import LEAST_THICKNESS
from geodrake.report.posed_links import drawn_shapes, joint_axis, moved_body
from geodrake.robot.followers import joint_names
from geodrake.robot.shapes import LinkShape, RobotShapes

FRAMES = 30.0
"""Frames a second of recordings."""

_AWAY = np.array([0.9, -0.65, 0.4]) / np.linalg.norm([0.9, -0.65, 0.4])
RIGHT = np.array([0.65, 0.9, 0.0]) / np.linalg.norm([0.65, 0.9])
"""What is right to the camera, in the world."""

_FLOOR_THICKNESS = 0.004  # m
VIEW = np.radians(75.0)
"""Angle of MeshCat's view from top to bottom."""

_ASPECT = 1.4  # of the view, width over height, at which everything fits


def clock(frame: int) -> float:
    """Time of a frame in MeshCat's recording, s: in its middle, so that none is counted twice."""
    return (frame + 0.5) / FRAMES


@dataclass(frozen=True, eq=False)
class JointPlace:
    """Where a joint is, and what it moves.

    Attributes:
        link: Path of the link that the joint moves.
        X_BJ: Pose of the joint in the link, z along its axis.
        moved: Paths of the shapes of all links that it moves as one.
    """

    joint: str
    link: str
    X_BJ: RigidTransform
    moved: tuple[str, ...]


class RobotScene:
    """A robot in a MeshCat.

    Links have the visual shapes of the model's file, or its collision shapes. Where the file has
    none, or they cannot be read, links are sticks between their joints.

    Args:
        shapes: Its shapes; those of its file if None.
        p_WR: (3,) where the robot stands, m.
        color: One colour for all links instead of the file's.

    Attributes:
        notes: What is not shown as the file has it, in words.
    """

    def __init__(
        self,
        meshcat: Meshcat,
        model: RobotModel,
        *,
        shapes: RobotShapes | None = None,
        path: str = "robot",
        p_WR: Array | None = None,
        color: Rgba | None = None,
    ) -> None:
        shapes = drawn_shapes(model) if shapes is None else shapes
        self._meshcat, self._model, self.path = meshcat, model, path
        self._context = model.plant.CreateDefaultContext()
        self._lumps = lumped_bodies(model.plant)
        bodies = [model.plant.get_body(BodyIndex(i)) for i in range(model.plant.num_bodies())]
        moving = {int(m.index) for lump in self._lumps for m in lump.members}
        self._moving = [body for body in bodies if int(body.index()) in moving]
        self.notes = shapes.notes
        meshcat.SetTransform(path, RigidTransform([0.0, 0.0, 0.0] if p_WR is None else p_WR))
        by_name = {body.scoped_name().get_full(): body for body in bodies}
        for name, links in shapes.links.items():
            self._draw(by_name[name], links, color)
        for body in bodies:
            if int(body.index()) not in moving:
                X_WB = model.plant.EvalBodyPoseInWorld(self._context, body)
                meshcat.SetTransform(self.link_path(body), X_WB)

    def link_path(self, body: RigidBody) -> str:
        """Return the folder of a link, whose frame is the link's."""
        return f"{self.path}/{path_part(body.scoped_name().get_full())}"

    def body_path(self, name: str) -> str:
        """Return the folder of a body of the model, links welded together counting as one."""
        return self.link_path(self.body(name))

    def body(self, name: str) -> RigidBody:
        """Return the link whose frame is that of a body of the model."""
        lump = self._lumps[self._model.bodies.index(name)]
        return self._model.plant.get_body(lump.body_index)

    def move(self, q: Array, time: float | None = None) -> None:
        """Put the robot into a posture.

        Args:
            q: (nq,) positions of the model.
            time: Time in MeshCat's recording, s; None to move it now.
        """
        plant = self._model.plant
        (whole,) = self._model.plant_positions(np.atleast_2d(q))
        plant.SetPositions(self._context, whole)
        for body in self._moving:
            X_WB = plant.EvalBodyPoseInWorld(self._context, body)
            self._meshcat.SetTransform(self.link_path(body), X_WB, time)

    def place_behind(self, name: str) -> JointPlace:
        """Return the place of a plant joint that follows others, as in a closed loop."""
        plant, names = self._model.plant, joint_names(self._model.plant)
        joints = (plant.get_joint(index) for index in plant.GetJointIndices())
        moving = (joint for joint in joints if joint.num_velocities() == 1)
        return self._place(next(j for j in moving if names[j.velocity_start()] == name), name)

    def joint_places(self) -> tuple[JointPlace, ...]:
        """Return the joints of one degree of freedom, in the model's order."""
        plant, places = self._model.plant, {}
        for index in plant.GetJointIndices():
            joint = plant.get_joint(JointIndex(index))
            at = self._model.place_of(joint) if joint.num_velocities() == 1 else None
            if at is not None:
                places[at] = self._place(joint, self._model.joints[at])
        return tuple(places[i] for i in sorted(places))

    def _place(self, joint: Joint, name: str) -> JointPlace:
        child = moved_body(self._model.plant, joint)
        lump = next(
            one for one in self._lumps if any(m.index == child.index() for m in one.members)
        )
        links = [self._model.plant.get_body(m.index) for m in lump.members]
        X_BM = joint.frame_on_child().GetFixedPoseInBodyFrame()
        axis = X_BM.rotation().matrix() @ joint_axis(joint)
        R_BJ = RotationMatrix.MakeFromOneVector(axis, 2)
        return JointPlace(
            name,
            self.link_path(child),
            RigidTransform(R_BJ, X_BM.translation()),
            tuple(f"{self.link_path(link)}/shapes" for link in links),
        )

    def _draw(self, body: RigidBody, links: Sequence[LinkShape], color: Rgba | None) -> None:
        for k, one in enumerate(links):
            place = f"{self.link_path(body)}/shapes/{k}"
            self._meshcat.SetObject(place, one.shape, color or one.color)
            self._meshcat.SetTransform(place, one.X_BG)


def draw_ellipsoid(meshcat: Meshcat, path: str, phi: Array, color: Rgba) -> None:
    """Draw the uniform ellipsoid that has the inertia of a body.

    Args:
        path: Where in the scene; the folder above has the body's frame.
        phi: (10,) physical inertial parameters.
    """
    own = equivalent_ellipsoid(phi)
    meshcat.SetObject(path, EllipsoidShape(*np.maximum(own.semi_axes, LEAST_THICKNESS)), color)
    meshcat.SetTransform(path, RigidTransform(RotationMatrix(own.rotation), own.center))


def calm_meshcat() -> Meshcat:
    """Return a MeshCat for a page: light, without axes; where it listens does not matter."""
    meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    meshcat.SetProperty("/Background/<object>", "top_color", [1.0, 1.0, 1.0])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [0.93, 0.95, 0.97])
    meshcat.SetProperty("/Axes", "visible", False)
    meshcat.SetProperty("/Grid", "visible", False)
    return meshcat


@dataclass(frozen=True, eq=False)
class Extent:
    """Where a robot goes.

    Attributes:
        low: (3,) least coordinates of its links' origins in the world, m.
        high: (3,) largest ones.
        left: The farthest that it goes to the left of the camera, m.
        right: The farthest that it goes to the right, m.
        widest: Its largest width to the camera in any one posture, m.
        size: Its largest side in any one posture with a margin for links, m.
    """

    low: Array
    high: Array
    left: float
    right: float
    widest: float
    size: float

    @classmethod
    def of(cls, model: RobotModel, q: Array) -> Extent:
        """Return the extent of some postures.

        Args:
            q: (N, nq) positions of the model.
        """
        plant, context, points = model.plant, model.plant.CreateDefaultContext(), []
        bodies = [plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies())]
        for posture in model.plant_positions(q[:: max(1, len(q) // 60)]):
            plant.SetPositions(context, posture)
            origins = [plant.EvalBodyPoseInWorld(context, b).translation() for b in bodies]
            points.append([np.zeros(3), *origins])
        cloud = np.array(points)
        across = cloud @ RIGHT
        low, high = cloud.min((0, 1)), cloud.max((0, 1))
        size = 1.15 * float(np.ptp(cloud, axis=1).max()) + 0.1
        return cls(low, high, -across.min(), across.max(), np.ptp(across, axis=1).max(), size)

    @property
    def gap(self) -> float:
        """Distance at which two copies in one posture are clear of each other, m."""
        return self.widest + 0.3 * self.size


def draw_floor(meshcat: Meshcat, path: str, extent: Extent) -> None:
    """Draw a disc for a robot to stand on."""
    disc = Cylinder(0.3 * extent.size, _FLOOR_THICKNESS)
    meshcat.SetObject(f"{path}/floor", disc, Rgba(0.87, 0.89, 0.92, 1.0))
    meshcat.SetTransform(f"{path}/floor", RigidTransform([0.0, 0.0, -_FLOOR_THICKNESS]))


def place_camera(meshcat: Meshcat, extent: Extent, *, copies: int = 1) -> None:
    """Look at where a robot goes."""
    meshcat.SetCameraPose(*camera_place(extent, copies))


def camera_place(extent: Extent, copies: int) -> tuple[Array, Array]:
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
