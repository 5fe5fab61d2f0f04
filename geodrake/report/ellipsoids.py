"""Bodies as the uniform ellipsoids that have their inertia, ready to be drawn over the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Cylinder, Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointIndex
from pydrake.systems.framework import Context

from geodrake.errors import ArgumentError
from geodrake.identification.models import ModelIdentification
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.inertia.bodies import lumped_bodies
from geodrake.inertia.ellipsoids import equivalent_ellipsoid

PRIOR, IDENTIFIED, TRUTH = "#8a94a0", "#1b6ca8", "#3f9c6b"
BOUNDARY, AT_BOUNDARY = "#c8322b", "at the boundary of what a body can be"
OTHERS = ("#7a4fa3", "#c78a1e", "#2a8f8f", "#a34f6e", "#5b7a2a")
"""Colours of what is drawn: prior, identified, truth, bodies at the boundary, regularizers."""

_LINE_WIDTH, _SHORTEST = 0.006, 1e-4  # m
LEAST_THICKNESS = 0.002
"""Semi-axis that is drawn at least, m: a body at the boundary may be flat."""


@dataclass(frozen=True, eq=False)
class EllipsoidSet:
    """The bodies of one model of a robot.

    Attributes:
        name: What the model is called, such as "prior" or "truth".
        color: Colour of its bodies, #rrggbb.
        phi: (nb, 10) physical inertial parameters, bodies in the order of `lumped_bodies`.
        at_boundary: (nb,) whether a body is at the boundary of physical consistency.
    """

    name: str
    color: str
    phi: Array
    at_boundary: NDArray[np.bool_]

    @classmethod
    def of(
        cls, name: str, phi: Array, *, color: str = IDENTIFIED, at_boundary: Sequence[int] = ()
    ) -> EllipsoidSet:
        """Return a set in which the bodies of some numbers are at the boundary.

        Raises:
            ArgumentError: phi is not (nb, 10).
        """
        phi = np.asarray(phi, float)
        if phi.ndim != 2 or phi.shape[1] != PARAMETERS_PER_BODY:
            raise ArgumentError(f"phi must have shape (nb, 10); got {phi.shape}.")
        marks = np.zeros(len(phi), bool)
        marks[list(at_boundary)] = True
        return cls(name, color, phi, marks)

    def body_color(self, body: int) -> str:
        """Return the colour of a body: the set's, or that of the boundary."""
        return BOUNDARY if self.at_boundary[body] else self.color


@dataclass(frozen=True, eq=False)
class PlacedEllipsoids:
    """Ellipsoids in the world, ascending semi-axes no less than `LEAST_THICKNESS`.

    Attributes:
        center: (nb, 3) centres, m.
        semi_axes: (nb, 3) semi-axes, m.
        rotation: (nb, 3, 3) rotations R_WE.
    """

    center: Array
    semi_axes: Array
    rotation: Array

    def points(self, around: int = 20) -> Array:
        """Return (nb, around // 2 + 1, around + 1, 3) points of the surfaces, a net of angles."""
        polar = np.linspace(0.0, np.pi, around // 2 + 1)[:, None]
        azimuth = np.linspace(0.0, 2 * np.pi, around + 1)
        sphere = np.stack(
            np.broadcast_arrays(
                np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)
            ),
            -1,
        )
        local = sphere * self.semi_axes[:, None, None]
        return np.asarray(
            self.center[:, None, None] + np.einsum("bij,bklj->bkli", self.rotation, local)
        )


def placed(plant: MultibodyPlant, context: Context, phi: Array) -> PlacedEllipsoids:
    """Return the equivalent ellipsoids of bodies where a plant's configuration puts them.

    Args:
        phi: (nb, 10) physical inertial parameters in the order of `lumped_bodies`.

    Raises:
        ArgumentError: phi has another number of bodies than the plant, or is not physical.
    """
    bodies = lumped_bodies(plant)
    if len(phi) != len(bodies):
        raise ArgumentError(f"phi has {len(phi)} bodies; the plant has {len(bodies)}.")
    poses = [plant.EvalBodyPoseInWorld(context, plant.get_body(b.body_index)) for b in bodies]
    R_WB = np.array([pose.rotation().matrix() for pose in poses])
    p_WB = np.array([pose.translation() for pose in poses])
    own = equivalent_ellipsoid(phi)
    return PlacedEllipsoids(
        p_WB + np.einsum("bij,bj->bi", R_WB, own.center),
        np.maximum(own.semi_axes, LEAST_THICKNESS),
        R_WB @ own.rotation,
    )


def skeleton(plant: MultibodyPlant, context: Context) -> Array:
    """Return the robot as lines: (k, 2, 3) ends in the world, m, from joint to joint."""
    lines = []
    for index in plant.GetJointIndices():
        joint = plant.get_joint(JointIndex(index))
        parent = plant.EvalBodyPoseInWorld(context, joint.parent_body()).translation()
        child = plant.EvalBodyPoseInWorld(context, joint.child_body()).translation()
        middle = joint.frame_on_parent().CalcPoseInWorld(context).translation()
        other = joint.frame_on_child().CalcPoseInWorld(context).translation()
        lines += [(parent, middle), (middle, other), (other, child)]
    found = np.array(lines).reshape(-1, 2, 3)
    return found[np.linalg.norm(found[:, 1] - found[:, 0], axis=-1) > 1e-6]


class SkeletonLines:
    """A robot's lines in a MeshCat, each with a ball at its beginning."""

    def __init__(self, meshcat: Meshcat, path: str, count: int, color: Rgba) -> None:
        self._meshcat, self._path = meshcat, path
        for k in range(count):
            meshcat.SetObject(f"{path}/{k}/shape", Cylinder(_LINE_WIDTH, 1.0), color)
            meshcat.SetObject(f"{path}/{k}/end", Sphere(2 * _LINE_WIDTH), color)

    def move(self, lines: Array, time: float | None = None) -> None:
        """Put lines, (k, 2, 3) ends as `skeleton` gives them, where they are, at a time if any."""
        for k, (start, end) in enumerate(lines):
            length = float(np.linalg.norm(end - start))
            direction = (end - start) / length if length > 0 else np.array([0.0, 0.0, 1.0])
            R_WL = RotationMatrix.MakeFromOneVector(direction, 2)
            path = f"{self._path}/{k}"
            self._meshcat.SetTransform(path, RigidTransform(R_WL, 0.5 * (start + end)), time)
            scale = [1.0, 1.0, max(length, _SHORTEST)]
            self._meshcat.SetProperty(f"{path}/shape", "scale", scale, time)
            half = RigidTransform([0.0, 0.0, -0.5 * length])
            self._meshcat.SetTransform(f"{path}/end", half, time)


def identification_sets(found: ModelIdentification) -> tuple[EllipsoidSet, ...]:
    """Prior and identified bodies, and those of the other regularizers it was compared with."""
    bodies = found.model.bodies

    def numbers(names: Sequence[str]) -> list[int]:
        return [bodies.index(name) for name in names if name in bodies]

    sets = [EllipsoidSet.of("prior", found.prior.phi, color=PRIOR)]
    words = f"identified, {found.regularizer}"
    sets.append(EllipsoidSet.of(words, found.model.phi, at_boundary=numbers(found.at_boundary)))
    others = [other for other in found.alternatives if other.regularizer != found.regularizer]
    for k, other in enumerate(others):
        color = OTHERS[k % len(OTHERS)]
        at = numbers(other.at_boundary)
        sets.append(EllipsoidSet.of(other.regularizer, other.phi, color=color, at_boundary=at))
    return tuple(sets)
