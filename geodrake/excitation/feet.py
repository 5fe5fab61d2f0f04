"""Where the feet of a robot touch the ground, of its collision geometry or as given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, Mesh, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from scipy.spatial import ConvexHull, QhullError

from geodrake.boundary.arguments import instance, number, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.excitation.collisions import Solid, corners_of, solids_of_file
from geodrake.inertia import Array
from geodrake.inertia.bodies import lumped_bodies
from geodrake.model.robot_model import RobotModel

_LOWEST = 0.005  # m over the lowest point of a foot, where it still touches
_FLAT, _TILTED = np.radians(3.0), np.radians(45.0)  # of a face, and of a sole at most
_SAME = 0.002  # m, by which points of a sole are apart
_AROUND = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
_ADVICE = "Say where it does: a Foot with points, or LINK=LENGTHxWIDTH or LINK=point in --feet."


@dataclass(frozen=True, eq=False)
class Foot(Short):
    """What of a robot stands on the ground: a sole, a ball that rolls, or a point.

    Attributes:
        frame: Name of a link, or of another frame of the model file.
        points: (k, 3) corners of the sole in the frame, m; one for a foot that turns about it, or
            for the center of a ball.
        radius: Of the ball, m; 0 without.
    """

    frame: str
    points: ArrayLike
    radius: float = 0.0

    def __post_init__(self) -> None:
        instance(self.frame, "frame", str)
        object.__setattr__(self, "points", real_array(self.points, "points", ("k", 3)))
        count = len(np.asarray(self.points))
        if count not in (1, *range(3, 10_000)):
            raise ArgumentError(
                f"Foot {self.frame!r} has {count} points.",
                advice="A foot is one point, or a sole of at least three corners.",
            )
        if number(self.radius, "radius", lower=0.0) and count > 1:
            raise ArgumentError(
                f"Foot {self.frame!r} has {count} points and a radius of {self.radius:g} m.",
                advice="A ball has one point, its center; a sole has no radius.",
            )

    @classmethod
    def sole(cls, frame: str, length: float, width: float) -> Foot:
        """Return a sole, length along x and width along y of the frame, about its origin."""
        for name, value in (("length", length), ("width", width)):
            number(value, name, lower=0.0, strict=True)
        signs = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
        return cls(frame, np.hstack([0.5 * signs * [length, width], np.zeros((4, 1))]))

    @property
    def is_sole(self) -> bool:
        """Whether moments act on it, too."""
        return len(np.asarray(self.points)) > 1


def frame_of(plant: MultibodyPlant, name: str) -> Frame:
    """Return a link's frame, or another of the model file."""
    if not plant.HasFrameNamed(name):
        links = [member.name for body in lumped_bodies(plant) for member in body.members]
        raise ArgumentError(
            f"The model has no link {name!r} to stand on.", advice=f"Links: {', '.join(links)}."
        )
    return plant.GetFrameByName(name)


def feet_of(robot: RobotModel, feet: Sequence[str | Foot], q: Array) -> tuple[Foot, ...]:
    """Return feet, those that are named from the collision geometry that is lowest at q (nq,)."""
    if all(isinstance(foot, Foot) for foot in feet):
        return tuple(foot for foot in feet if isinstance(foot, Foot))
    solids, plant = solids_of_file(robot.path, robot.given), robot.plant
    context, found = plant.CreateDefaultContext(), []
    plant.SetPositions(context, q)
    for foot in feet:
        if isinstance(foot, Foot):
            found.append(foot)
            continue
        frame = frame_of(plant, foot)
        X_WF = frame.CalcPoseInWorld(context)
        own = solids.get(frame.body().scoped_name().get_full(), [])
        X_FB = frame.GetFixedPoseInBodyFrame().inverse()
        found.append(_lowest(foot, own, X_FB, X_WF))
    return tuple(found)


def _lowest(name: str, solids: Sequence[Solid], X_FB: RigidTransform, X_WF: RigidTransform) -> Foot:
    """Return what of the shapes of a link is lowest."""
    if not solids:
        raise ArgumentError(
            f"Link {name!r} has no collision geometry that says where it touches the ground.",
            advice=_ADVICE,
        )
    parts = [_points(solid) for solid in solids]
    poses = [X_FB @ solid.X_BG for solid in solids]
    points = np.vstack([X.multiply(p.T).T for X, (p, _) in zip(poses, parts, strict=True)])
    radii = np.concatenate([np.full(len(p), r) for p, r in parts])
    down = _downwards(points, -X_WF.rotation().inverse().matrix()[:, 2])
    depths = points @ down + radii
    low = np.flatnonzero(depths > depths.max() - _LOWEST)
    touching, radius = points[low], radii[low]
    apart = np.ptp(touching - np.outer(touching @ down, down), axis=0).max()
    if apart < _SAME:
        return Foot(name, touching[:1], float(radius[0]))
    touching = touching + radius[:, None] * down
    spread = np.linalg.svd(touching - touching.mean(axis=0), compute_uv=False)
    if len(touching) < 3 or spread[1] < _SAME:
        raise ArgumentError(
            f"Link {name!r} touches the ground along an edge in this posture.",
            advice=f"Choose a posture in which it stands flat (--stand). {_ADVICE}",
        )
    return Foot(name, touching)


def _downwards(points: Array, down: Array) -> Array:
    """Return the normal (3,) of the largest face of points that faces down, if there is one."""
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # of few points, or flat ones
        return down
    normals = hull.equations[:, :3]
    first, second, third = np.moveaxis(points[hull.simplices], 1, 0)
    areas = np.linalg.norm(np.cross(second - first, third - first), axis=1)
    faces = (normals @ normals.T > np.cos(_FLAT)) @ areas * (normals @ down > np.cos(_TILTED))
    return np.asarray(normals[np.argmax(faces)]) if faces.any() else down


def _points(solid: Solid) -> tuple[Array, float]:
    """Return points (k, 3) whose balls of a radius have the shape's lowest points, m."""
    points, radius, shape = np.zeros((1, 3)), 0.0, solid.shape
    match shape:
        case Sphere():
            radius = shape.radius()
        case Capsule():
            points = np.array([[0.0, 0.0, x * shape.length()] for x in (0.5, -0.5)])
            radius = shape.radius()
        case Cylinder():
            rim = shape.radius() * np.stack([np.cos(_AROUND), np.sin(_AROUND)], -1)
            ends = [np.full((len(rim), 1), x * shape.length()) for x in (0.5, -0.5)]
            points = np.vstack([np.hstack([rim, end]) for end in ends])
        case Box():
            signs = np.array(np.meshgrid(*3 * [[-0.5, 0.5]])).reshape(3, -1).T
            points = signs * shape.size()
        case Mesh() | Convex():
            points = corners_of(shape)
        case Ellipsoid():
            radius = min(shape.a(), shape.b(), shape.c())
    return points, radius
