"""What model files state beside rigid bodies and numbers of joints: springs, tendons, weights.

All is effort that is needed beside that of the bodies, at velocities of a plant or of a robot.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.polynomial import Polynomial
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant

from geodrake.inertia import Array
from geodrake.inertia.bodies import lumped_bodies

_ROUNDING = 1e-14  # of what two springs have, where they have nothing together


@dataclass(frozen=True)
class Spring:
    """A spring across a joint: effort = p + k₁ x + k₂ x² + k₃ x³, x = q − center.

    Attributes:
        coefficients: p, k₁, k₂, k₃, SI.
    """

    center: float
    coefficients: tuple[float, float, float, float]

    @classmethod
    def linear(cls, stiffness: float, center: float = 0.0, preload: float = 0.0) -> Spring:
        """Return the spring k (q − center) + preload."""
        return cls(center, (preload, stiffness, 0.0, 0.0))

    def effort(self, q: Any) -> Any:
        """Return the effort at positions, N·m or N."""
        return Polynomial(self.coefficients)(q - self.center)

    def about(self, center: float) -> Spring:
        """Return the same spring, written about another position."""
        moved = Polynomial(self.coefficients)(Polynomial([center - self.center, 1.0]))
        return Spring(center, _four(moved.coef))

    def through(self, ratio: float, offset: float) -> Spring:
        """Return what it is at a joint q that its own, ratio q + offset, follows."""
        powers = ratio ** np.arange(1, 5)
        return Spring((self.center - offset) / ratio, _four(powers * self.coefficients))

    def __add__(self, other: Spring) -> Spring:
        """Return both together: of two linear springs, one about where they are at rest."""
        own, more = self.coefficients[1], other.coefficients[1]
        center = self.center if own or not more else other.center
        if own + more and own and more:
            center = (own * self.center + more * other.center) / (own + more)
        parts = (self.about(center).coefficients, other.about(center).coefficients)
        total, size = np.sum(parts, axis=0), np.abs(parts).sum(axis=0)
        return Spring(center, _four(np.where(np.abs(total) > _ROUNDING * size, total, 0.0)))

    @property
    def is_none(self) -> bool:
        """Return whether it never pulls."""
        return not any(self.coefficients)


def _four(values: Any) -> tuple[float, float, float, float]:
    p, k1, k2, k3 = (*np.asarray(values, float).tolist(), 0.0, 0.0, 0.0)[:4]
    return p, k1, k2, k3


@dataclass(frozen=True)
class Tendon:
    """A tendon of length L = Σ cᵢ qᵢ over joints of one degree of freedom.

    effort of joint i = cᵢ (k (L − L₀) + d L̇ + F sgn L̇).

    Attributes:
        name: Its name in the file.
        shares: Joint, or velocity, -> cᵢ.
    """

    name: str
    shares: Mapping[Any, float]
    stiffness: float = 0.0
    length: float = 0.0
    damping: float = 0.0
    friction: float = 0.0

    def scoped(self, scope: str) -> Tendon:
        """Return the tendon with the names that joints of a model have."""
        return replace(self, shares={f"{scope}::{j}": share for j, share in self.shares.items()})

    def through(self, rows: Mapping[Any, Mapping[Any, float]], at: Mapping[Any, float]) -> Tendon:
        """Return the tendon over what its joints follow.

        Args:
            rows: Joint -> what it follows -> ratio; none of a joint that stands still.
            at: Joint -> its position where those are at zero, rad or m.
        """
        shares, shift = dict[Any, float](), 0.0
        for joint, share in self.shares.items():
            shift += share * at.get(joint, 0.0)
            for place, ratio in rows[joint].items():
                shares[place] = shares.get(place, 0.0) + share * ratio
        return replace(self, shares=shares, length=self.length - shift)


Place = TypeVar("Place", int, str)
Entries = dict[tuple[Place, Place], float]
"""Entries of a symmetric matrix of velocities, or joints, i ≤ j."""


def entries_through(
    entries: Iterable[tuple[Any, Any, float]], rows: Mapping[Any, Mapping[Place, float]]
) -> Entries[Place]:
    """Return what entries between two joints each are between what the joints follow.

    Args:
        entries: Two joints, or one twice, and the entry between them.
        rows: Joint -> velocity that it follows -> ratio.
    """
    found: Entries[Place] = {}
    for first, second, value in entries:
        once = 0.5 if first == second else 1.0
        for i, own in rows.get(first, {}).items():
            for j, other in rows.get(second, {}).items():
                pair = (min(i, j), max(i, j))
                found[pair] = found.get(pair, 0.0) + own * other * value * once * (1.0 + (i == j))
    return found


@dataclass(frozen=True)
class BoxInMedium:
    """What a medium acts on: a body as the box that has its inertia.

    Attributes:
        body: Scoped name of the body; then that of the body that it is a part of.
        size: (3,) edges, m.
        X_BP: Pose of the box's middle and axes in the body.
        density: Of the medium, kg/m³.
        viscosity: Of the medium, Pa·s.
        wind: (3,) its velocity in the world, m/s.
    """

    body: str
    size: Array
    X_BP: RigidTransform
    density: float
    viscosity: float
    wind: Array


@dataclass(frozen=True)
class StatedStrut:
    """A spring and a damper between two points.

    Attributes:
        bodies: Scoped names of two bodies; then those of what they are parts of, or "world".
        points: Positions (3,) in their frames, m.
        length: At rest, m.
        damping: N·s/m.
    """

    bodies: tuple[str, str]
    points: tuple[Array, Array]
    stiffness: float
    length: float
    damping: float

    def scoped(self, scope: str) -> StatedStrut:
        """Return the strut with the names that bodies of a model have."""
        first, second = (
            "WorldModelInstance::world" if body == "world" else f"{scope}::{body}"
            for body in self.bodies
        )
        return replace(self, bodies=(first, second))


@dataclass(frozen=True)
class Weight:
    """A weight that something carries: of a mass, kg, at a place (3,) in a body's frame, m."""

    body: str
    mass: float
    place: Array


def weights_of(plant: MultibodyPlant, shares: Mapping[str, float]) -> tuple[Weight, ...]:
    """Return the weights that are carried of the bodies of a robot.

    Args:
        shares: Scoped name of a body -> which share of its weight something carries.
    """
    found = []
    for body in lumped_bodies(plant):
        moments = np.zeros(4)
        for member in body.members:
            link = plant.get_body(member.index)
            share = shares.get(link.scoped_name().get_full(), 0.0)
            mass = link.default_mass()
            if share and mass > 0.0:
                com = link.default_spatial_inertia().get_com()
                moments += share * mass * np.append(1.0, member.X_RB @ com)
        if moments[0]:
            found.append(Weight(body.name, float(moments[0]), moments[1:] / moments[0]))
    return tuple(found)


def _poses(plant: MultibodyPlant) -> dict[str, tuple[str, RigidTransform]]:
    """Return scoped names of links that move -> the body that each is a part of, and its pose."""
    return {
        plant.get_body(member.index).scoped_name().get_full(): (body.name, member.X_RB)
        for body in lumped_bodies(plant)
        for member in body.members
    }


def struts_of(plant: MultibodyPlant, struts: Sequence[StatedStrut]) -> tuple[StatedStrut, ...]:
    """Return struts in the frames of the bodies of a robot, those that anything moves."""
    poses, context = _poses(plant), plant.CreateDefaultContext()
    for body in plant.GetBodiesWeldedTo(plant.world_body()):
        X_WB = plant.EvalBodyPoseInWorld(context, body)
        poses[body.scoped_name().get_full()] = ("world", X_WB)
    found = []
    for strut in struts:
        (one, X), (two, Y) = (poses.get(body, ("", RigidTransform())) for body in strut.bodies)
        if one and two and one != two:
            points = X @ strut.points[0], Y @ strut.points[1]
            found.append(replace(strut, bodies=(one, two), points=points))
    return tuple(found)


def boxes_of(plant: MultibodyPlant, boxes: Sequence[BoxInMedium]) -> tuple[BoxInMedium, ...]:
    """Return boxes in the frames of the bodies of a robot, those that move."""
    poses = _poses(plant)
    return tuple(
        replace(box, body=poses[box.body][0], X_BP=poses[box.body][1] @ box.X_BP)
        for box in boxes
        if box.body in poses
    )
