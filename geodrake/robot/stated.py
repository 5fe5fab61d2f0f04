"""Terms of model files other than rigid bodies: joints, tendons, gravity, closed loops."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant

from geodrake.inertia import Array
from geodrake.inertia.bodies import lumped_bodies
from geodrake.robot.joints import Following, Tie

WORLD = "world"
"""Name of the world among bodies."""

WORLD_LINK = "WorldModelInstance::world"
"""Drake's scoped name of the world."""

_MOST_VELOCITIES = 6  # of a joint
_ROUNDING = 1e-14  # relative size of a sum of coefficients that counts as zero


@dataclass(frozen=True)
class Spring:
    """A spring across a joint: effort = p + k₁ x + k₂ x² + k₃ x³, x = q − center."""

    center: float
    coefficients: tuple[float, float, float, float]  # p, k₁, k₂, k₃, SI

    @classmethod
    def linear(cls, stiffness: float, center: float = 0.0, preload: float = 0.0) -> Spring:
        """Return the spring k (q − center) + preload."""
        return cls(center, (preload, stiffness, 0.0, 0.0))

    def about(self, center: float) -> Spring:
        """Return the same spring with another center."""
        moved = Polynomial(self.coefficients)(Polynomial([center - self.center, 1.0]))
        return Spring(center, _four(moved.coef))

    def through(self, ratio: float, offset: float) -> Spring:
        """Return the spring in terms of a leader q of the joint, at ratio q + offset."""
        powers = ratio ** np.arange(1, 5)
        return Spring((self.center - offset) / ratio, _four(powers * self.coefficients))

    def __add__(self, other: Spring) -> Spring:
        """Return the sum of two springs; linear ones are centered at their common rest."""
        first, second = self.coefficients[1], other.coefficients[1]
        center = self.center if first or not second else other.center
        if first + second and first and second:
            center = (first * self.center + second * other.center) / (first + second)
        parts = (self.about(center).coefficients, other.about(center).coefficients)
        total, size = np.sum(parts, axis=0), np.abs(parts).sum(axis=0)
        return Spring(center, _four(np.where(np.abs(total) > _ROUNDING * size, total, 0.0)))


def _four(values: Any) -> tuple[float, float, float, float]:
    p, k1, k2, k3 = (*np.asarray(values, float).tolist(), 0.0, 0.0, 0.0)[:4]
    return p, k1, k2, k3


_NO_SPRING = Spring.linear(0.0)


@dataclass(frozen=True)
class StatedLength:
    """Forces along a length L = Σ cᵢ qᵢ over joints, such as a joint, a fixed tendon or a motor.

    effort of joint i = cᵢ (spring(L) + d₁ L̇ + d₂ |L̇| L̇ + d₃ L̇³ + F sgn L̇ + I L̈).
    """

    # Joint -> cᵢ, for all velocities of a joint, or `joint[k]` for one of several.
    shares: Mapping[str, float]
    spring: Spring = _NO_SPRING
    damping: tuple[float, float, float] = (0.0, 0.0, 0.0)  # d₁, d₂, d₃
    friction: float = 0.0  # F
    armature: float = 0.0  # I
    name: str = ""  # of a tendon

    def each(self, joints: Collection[str]) -> list[StatedLength]:
        """Return one length per velocity for a joint with several."""
        (joint, share), *others = self.shares.items()
        several = [f"{joint}[{k}]" for k in range(_MOST_VELOCITIES) if f"{joint}[{k}]" in joints]
        if others or not several:
            return [self]
        return [replace(self, shares={name: share}) for name in several]

    def through(self, places: Mapping[str, Following]) -> StatedLength:
        """Return the length over the leaders of its joints."""
        shares, shift = dict[str, float](), 0.0
        for joint, share in self.shares.items():
            place = places[joint]
            shift += share * place.offset
            shares[place.of] = shares.get(place.of, 0.0) + share * place.ratio
        shares = {name: share for name, share in shares.items() if share}
        return replace(self, shares=shares, spring=self.spring.through(1.0, shift))


CUT = ("revolute", "continuous", "prismatic")
CLOSING = (*CUT, "ball", "fixed")
"""Kinds of joints that may close a loop; those in `CUT` have a position."""


@dataclass(frozen=True)
class CutJoint:
    """A joint that closes a loop and is not in the tree."""

    name: str
    scoped_name: str
    axis: Array  # (3,) in the first frame of the closure
    slides: bool
    driven: bool  # by a motor with a limit

    @classmethod
    def of(cls, name: str, axis: Array, kind: str, driven: bool = False) -> CutJoint:
        """Return the joint with a scoped name, an axis (3,) of any length, and a kind in `CUT`."""
        size, short = float(np.linalg.norm(axis)), name.rpartition("::")[2]
        return cls(short, name, axis / (size or np.nan), kind == "prismatic", driven)


@dataclass(frozen=True)
class Closure:
    """Two frames of a robot's bodies that coincide, or whose origins do."""

    name: str  # description
    bodies: tuple[str, str]  # scoped names of the bodies, or `WORLD`
    poses: tuple[RigidTransform, RigidTransform]  # of the frames in the bodies
    turns: bool  # the frames rotate together; otherwise only the origins coincide
    cut: CutJoint | None = None
    # Radius of a ball around the second frame's origin that rolls on the world's x-y plane, m; the
    # frames coincide initially. 0 without rolling.
    radius: float = 0.0

    @classmethod
    def by_joint(
        cls,
        joint: CutJoint,
        kind: str,
        bodies: tuple[str, str],
        poses: tuple[RigidTransform, RigidTransform],
    ) -> Closure:
        """Return the closure by a joint of a kind in `CLOSING`; the frames coincide at 0."""
        cut = joint if kind in CUT else None
        return cls(f"the joint {joint.name}", bodies, poses, kind != "ball", cut)


@dataclass(frozen=True)
class InMedium:
    """A body in a medium, as its inertia's box or as an ellipsoid."""

    body: str  # scoped name
    size: Array  # (3,) edges of the box, or semi-axes, m
    X_BP: RigidTransform  # pose of center and axes in the body
    density: float  # of the medium, kg/m³
    viscosity: float  # of the medium, Pa·s
    wind: Array  # (3,) velocity of the medium in the world, m/s
    coefficients: tuple[float, ...] = ()  # (11,) as in `EllipsoidDrag`; empty for a box


@dataclass(frozen=True)
class Pulley:
    """A sphere, or an infinite cylinder along z, that a tendon may lead around."""

    body: str  # scoped name
    X_BG: RigidTransform  # pose in the body
    radius: float
    is_cylinder: bool
    side: Array  # (3,) point on the side of the tendon, in G; zero if it takes the shorter way


@dataclass(frozen=True)
class TendonPart:
    """A part of a tendon between two points."""

    bodies: tuple[str, str]  # scoped names of two bodies
    points: tuple[Array, Array]  # positions (3,) in their frames, m
    weight: float = 1.0  # share of its length in that of the tendon
    around: Pulley | None = None


@dataclass(frozen=True)
class StatedTendon:
    """A spring and a damper along a tendon."""

    parts: tuple[TendonPart, ...]
    stiffness: float  # N/m
    length: float  # at rest, m
    damping: float  # N·s/m
    slack: float = 0.0  # m by which it may be longer without force


@dataclass(frozen=True)
class StatedBall:
    """A spring of a ball joint."""

    bodies: tuple[str, str]  # scoped names of the child body and the parent body
    rest: RotationMatrix  # of the first body in the second, at rest
    stiffness: float  # N·m/rad


@dataclass(frozen=True)
class Gearbox:
    """Two links that turn at a constant ratio about a third one, θ₂ = −ratio θ₁ (SDF)."""

    name: str  # with its location in the file
    reference: str  # scoped name of the third link
    links: tuple[str, str]
    axes: tuple[tuple[str, Array], tuple[str, Array]]  # scoped name of a frame, and (3,) in it
    ratio: float


@dataclass(eq=False)
class FileTerms:
    """Terms of model files other than rigid bodies, by scoped names, SI units."""

    notes: list[str] = field(default_factory=list)  # sentences on changed interpretations
    # Sentences on ignored elements that affect efforts.
    left_out: list[str] = field(default_factory=list)
    # Sentences on ignored elements that affect only efforts of a free base.
    of_bases: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)  # sentences on unknown inertias
    gravity: Array | None = None  # (3,) acceleration of gravity, m/s²; None for Drake's
    # Link -> (10,) inertial parameters in the file, if the plant has others.
    set_aside: dict[str, Array] = field(default_factory=dict)
    # Terms of joints, fixed tendons and motors.
    lengths: list[StatedLength] = field(default_factory=list)
    start: dict[str, float] = field(default_factory=dict)  # joint -> default position, rad or m
    # Link -> default pose of its joint of six degrees of freedom.
    floating: dict[str, RigidTransform] = field(default_factory=dict)
    # Joint -> position at which a constraint fixes it, rad or m.
    fixed: dict[str, float] = field(default_factory=dict)
    effort: dict[str, float] = field(default_factory=dict)  # joint -> largest effort, N or N·m
    driven: set[str] = field(default_factory=set)
    # Two joints, or one twice, and the entry of the mass matrix by tendons over several joints.
    coupled_inertia: list[tuple[str, str, float]] = field(default_factory=list)
    # Link -> compensated share of its weight.
    carried: dict[str, float] = field(default_factory=dict)
    # Joints whose own motors compensate the weight, so that they bear all of it.
    acting: set[str] = field(default_factory=set)
    in_medium: list[InMedium] = field(default_factory=list)
    # Link -> (6, 6) inertia of the still fluid around it, for its velocity and ω in its frame.
    added_mass: dict[str, Array] = field(default_factory=dict)
    tendons: list[StatedTendon] = field(default_factory=list)
    balls: list[StatedBall] = field(default_factory=list)
    gearboxes: list[Gearbox] = field(default_factory=list)
    followers: dict[str, Tie] = field(default_factory=dict)
    closures: list[Closure] = field(default_factory=list)
    # Massless bodies between several joints of one body.
    between: set[str] = field(default_factory=set)
    static: set[str] = field(default_factory=set)  # SDF models whose joints do not move

    @classmethod
    def joined(cls, parts: Sequence[FileTerms]) -> FileTerms:
        """Return the combined terms of several files."""
        combined = cls()
        for part in parts:
            for name in (each.name for each in fields(cls)):
                own, others = getattr(combined, name), getattr(part, name)
                if isinstance(own, dict):
                    setattr(combined, name, own | others | own)  # keeps order and earlier values
                elif isinstance(own, list):
                    own += others
                elif isinstance(own, set):
                    own |= others
        gravities = [(0.0, 0.0, -9.81) if p.gravity is None else tuple(p.gravity) for p in parts]
        if len(several := set(gravities)) > 1:
            each = ", ".join(" ".join(f"{x:g}" for x in gravity) for gravity in several)
            combined.left_out.append(
                f"The models have several gravities ({each}); only one of them is used."
            )
        stated = [part.gravity for part in parts if part.gravity is not None]
        combined.gravity = stated[-1] if stated else None
        names = Counter(closure.cut.name for closure in combined.closures if closure.cut)
        for k, closure in enumerate(combined.closures):
            if (cut := closure.cut) is not None and names[cut.name] > 1:  # of several robots
                own = replace(cut, name=cut.scoped_name.replace("::", "_"))
                combined.closures[k] = replace(closure, name=f"the joint {own.name}", cut=own)
        return combined


def places_of_links(plant: MultibodyPlant) -> dict[str, tuple[str, RigidTransform]]:
    """Return scoped link name -> its lumped body, or `WORLD`, and the link's pose there."""
    context = plant.CreateDefaultContext()
    places = {
        body.scoped_name().get_full(): (WORLD, plant.EvalBodyPoseInWorld(context, body))
        for body in plant.GetBodiesWeldedTo(plant.world_body())
    }
    for body in lumped_bodies(plant):
        places |= {member.scoped_name: (body.name, member.X_RB) for member in body.members}
    return places
