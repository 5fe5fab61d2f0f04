"""Transmission files: YAML files beside the model file.

    gears:
    - {actuator: motor_1, joint: joint_1, ratio: 100}
    coupled:
    - joints:
        joint_5: {motor_5: 0.02}
        joint_6: {motor_5: 0.01, motor_6: 0.01}

`Stated` is their schema. Each part names actuators, which are columns of logs, and joints of the
model file. All other joints are their own actuators. A part with one actuator and one joint is

    θ = f(q),   J = f′(q),   J̇ = f″(q) q̇                             [Lee2019] Eq. (3.6.57)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, get_args, get_type_hints

import numpy as np
from msgspec.structs import replace
from numpy.polynomial.polynomial import polyder, polyval
from pydrake.math import RigidTransform, RotationMatrix
from scipy.interpolate import CubicSpline

from geodrake.boundary.arguments import file_path, instance, instances, number, real_array
from geodrake.boundary.showing import Short
from geodrake.boundary.yaml_schema import Schema, as_schema
from geodrake.boundary.yaml_text import yaml_content
from geodrake.errors import ArgumentError, GeodrakeError, ModelError
from geodrake.inertia import Array
from geodrake.robot.joints import FrameMotion, axis_motion, slide_motion
from geodrake.robot.transmission import (
    JointlyEvaluated,
    LinearTransmission,
    Transmission,
    rolling_joint,
)
from geodrake.robot.transmission.loop import LoopTransmission, linkage

Kind = Literal["", "revolute", "prismatic"]
"""Type of an actuator; that of the joint if empty."""

Law = Callable[[Array, int], Array]
"""Returns f, f′ or f″ (N,) at q (N,) for the order 0, 1 or 2."""

_SLIDES: dict[str, bool | None] = {"": None, "revolute": False, "prismatic": True}
_ACTUATOR, _JOINT = ("actuator", "leader"), ("leader", "joint", "rotor")  # fields with names
_LEAST_POINTS = 3  # of a table
_EVERYWHERE = -np.inf, np.inf
_AXES = np.eye(3)
_TURN = axis_motion(_AXES[2])


def _at(motion: FrameMotion, x: float, angle: float = 0.0) -> FrameMotion:
    """Return a motion displaced along x, m, and rotated about z by an angle, rad."""
    return motion.between(RigidTransform(RotationMatrix.MakeZRotation(angle), [x, 0.0, 0.0]), _AXES)


@dataclass(frozen=True, eq=False)
class Curves(JointlyEvaluated, Short):
    """θ_i = f_i(q) for one actuator and k joints."""

    laws: tuple[Law, ...]  # f_i and their derivatives
    ends: tuple[float, float] = _EVERYWHERE  # limits of q

    @property
    def shape(self) -> tuple[int, int]:
        """Return the number of laws, and one actuator."""
        return len(self.laws), 1

    def along(self, q: Array, v: Array | None = None) -> tuple[Array, Array, Array]:
        """Return θ = f(q), J = f′(q) and J̇ = f″(q) q̇ for q and q̇ (N, 1)."""
        x, rate = self._q(q)[:, 0], np.zeros((len(q), len(self.laws)))
        if v is not None:
            rate = self._of(x, 2) * real_array(v, "v", ("N", 1))
        return self._of(x, 0), self._of(x, 1)[:, :, None], rate[:, :, None]

    def _of(self, q: Array, order: int) -> Array:
        return np.stack([law(q, order) for law in self.laws], axis=1)

    @property
    def range(self) -> tuple[Array, Array]:
        """Return the ends."""
        return np.array(self.ends[:1]), np.array(self.ends[1:])


class Statement(Schema):
    """One part of a transmission file."""

    def actuator_names(self) -> tuple[str, ...]:
        """Return the names of the actuators."""
        return tuple(filter(None, (getattr(self, field, "") for field in _ACTUATOR)))

    def joint_names(self) -> tuple[str, ...]:
        """Return the names of the joints."""
        single = (getattr(self, field, "") for field in _JOINT)
        return (*filter(None, single), *getattr(self, "joints", ()))

    def transmission(self) -> Transmission:
        """Return θ = T(q)."""
        raise NotImplementedError

    def slides(self) -> bool | None:
        """Return whether the actuators are prismatic; None if like the joints."""
        return _SLIDES[getattr(self, "kind", "")]


class Gear(Statement):
    """A gear, belt or screw: θ = q / ratio + offset.

    Attributes:
        ratio: Turns of the motor per turn of the joint, negative for opposite directions; for a
            screw, rad of the motor per m.
        offset: θ at q = 0, rad or m.
        rotor: Joint of the rotor in the model file, which turns like the motor.
        side: `motor` if logs have the motor's position and effort; `joint` if they have the
            joint's, so that the ratio affects only the rotor.
    """

    actuator: str
    joint: str
    ratio: float = 1.0
    offset: float = 0.0
    rotor: str = ""
    side: Literal["motor", "joint"] = "motor"
    kind: Kind = ""

    def transmission(self) -> Transmission:
        """Return θ = q / N + θ₀, and N (θ − θ₀) for the rotor."""
        if not self.ratio:
            raise ArgumentError("ratio must not be 0.")
        turn = [1.0 / self.ratio, 1.0] if self.side == "motor" else [1.0, self.ratio]
        rows = [[x] for x in (turn if self.rotor else turn[:1])]
        return LinearTransmission.of(rows, [self.offset, 0.0][: len(rows)])


class Coupled(Statement):
    """Joints that several actuators move together: a wrist, a differential, belts over joints.

    Attributes:
        joints: Joint -> actuator -> ∂θ/∂q.
        offsets: Joint -> θ with all actuators at zero, rad or m; 0 if missing.
    """

    joints: dict[str, dict[str, float]]
    offsets: dict[str, float] = {}

    def actuator_names(self) -> tuple[str, ...]:
        """Return the names of the actuators, in the order of the file."""
        return tuple(dict.fromkeys(name for terms in self.joints.values() for name in terms))

    def transmission(self) -> Transmission:
        """Return θ = J q + θ₀."""
        for name in self.offsets:
            if name not in self.joints:
                raise ArgumentError(
                    f"offsets has {name!r}, which is none of its joints: {', '.join(self.joints)}."
                )
        names = list(self.joints), self.actuator_names()
        J = LinearTransmission.from_ratios(*names, self.joints).matrix
        return LinearTransmission.of(J, [self.offsets.get(j, 0.0) for j in self.joints])


Names = Callable[[str], str]
"""Maps a name of an actuator or a joint to another one."""


def renamed(part: Gear | Coupled, actuator_of: Names, joint_of: Names) -> Gear | Coupled:
    """Return the part with other names of its actuators and joints."""
    if isinstance(part, Gear):
        return replace(part, actuator=actuator_of(part.actuator), joint=joint_of(part.joint))
    joints = {
        joint_of(joint): {actuator_of(name): ratio for name, ratio in terms.items()}
        for joint, terms in part.joints.items()
    }
    return Coupled(joints, {joint_of(joint): at for joint, at in part.offsets.items()})


class RollingJoint(Statement):
    """Two bodies that roll on each other: two parallel joints that share an angle."""

    actuator: str
    joints: list[str]  # the two joints, the inboard one first
    share: float = 0.5  # share of the first joint, r₂ / (r₁ + r₂)

    def transmission(self) -> Transmission:
        """Return θ = (s q, (1 − s) q)."""
        return rolling_joint(self.share)


class Followers(Statement):
    """Joints that follow polynomials of an independent leader's position."""

    leader: str  # joint that is also the actuator
    # Following joint -> coefficients of its polynomial, the constant first.
    joints: dict[str, list[float]]

    def transmission(self) -> Transmission:
        """Return θ = q and the polynomials of q."""
        return power_series([[0.0, 1.0], *self.joints.values()])


def polynomial(coefficients: Array) -> Law:
    """Return f = c₀ + c₁ q + c₂ q² + … for c (m,), as MuJoCo's `polycoef`."""
    c = real_array(coefficients, "coefficients", ("m",))
    if not c[1:].any():
        raise ArgumentError(f"coefficients need a nonzero one besides c₀; got {c}.")
    return partial(_of_polynomial, c)


def power_series(laws: Sequence[Sequence[float]]) -> Transmission:
    """Return polynomials of one actuator, as a linear transmission if all ratios are constant."""
    curves = Curves(tuple(polynomial(np.array(c, float)) for c in laws))
    if any(any(c[2:]) for c in laws):
        return curves
    return LinearTransmission.of([[c[1]] for c in laws], [c[0] for c in laws])


def _of_polynomial(c: Array, q: Array, order: int) -> Array:
    return np.asarray(polyval(q, polyder(c, order)))


def _along(spline: CubicSpline, q: Array, order: int) -> Array:
    """Return a spline or its derivative, with linear extrapolation."""
    inside = np.clip(q, spline.x[0], spline.x[-1])
    value = spline(inside, order)
    return np.asarray(value if order else value + spline(inside, 1) * (q - inside))


class OneJoint(Statement):
    """A part with one actuator and one joint."""

    actuator: str
    joint: str


class Polynomial(OneJoint):
    """θ = c₀ + c₁ q + c₂ q² + …."""

    coefficients: list[float]

    def transmission(self) -> Transmission:
        """Return the polynomial."""
        return power_series([self.coefficients])


class PositionTable(OneJoint):
    """θ interpolated by a cubic spline, rad or m, with linear extrapolation."""

    actuator_positions: list[float]
    joint_positions: list[float]
    kind: Kind = ""

    def transmission(self) -> Transmission:
        """Return the natural spline, which extrapolates linearly."""
        q = real_array(np.array(self.actuator_positions, float), "actuator_points", ("m",))
        if len(q) < _LEAST_POINTS or not (np.diff(q) > 0.0).all():
            raise ArgumentError(
                f"A table needs at least {_LEAST_POINTS} increasing actuator positions; got "
                f"{q.tolist()}."
            )
        theta = real_array(np.array(self.joint_positions, float), "joint_points", (len(q),))
        law = partial(_along, CubicSpline(q, theta, bc_type="natural"))
        return Curves((law,), (float(q[0]), float(q[-1])))


class FourBarLinkage(OneJoint):
    """A four-bar linkage: q turns the crank, and the rocker turns the joint.

    Crank and rocker turn about parallel axes on the ground link, and the coupler joins their ends.
    Angles are measured from the line from the crank's pivot to the rocker's.
    """

    ground: float  # distance of the two pivots, m; only ratios of the four lengths matter
    crank: float
    coupler: float
    rocker: float
    crank_angle: float = 0.0  # angle of the crank at q = 0, rad
    rocker_angle: float = 0.0  # angle of the rocker at θ = 0, rad
    crossed: bool = False  # the other assembly mode, in which coupler and ground link cross

    def transmission(self) -> Transmission:
        """Return the closed loop of crank, coupler and rocker, assembled at q = 0."""
        lengths = {key: getattr(self, key) for key in ("ground", "crank", "coupler", "rocker")}
        for name, length in lengths.items():
            number(length, name, lower=0.0, strict=True)
        for name in ("crank_angle", "rocker_angle"):
            number(getattr(self, name), name)
        end = self.crank * np.exp(1j * self.crank_angle) - self.ground  # from the rocker's pivot
        sides = abs(end) ** 2 + self.rocker**2 - self.coupler**2
        cosine = sides / (2.0 * self.rocker * abs(end)) if end else np.inf
        if not abs(cosine) < 1.0:
            raise ArgumentError(
                "The bars of the four-bar linkage do not reach each other at q = 0 with the "
                f"crank at {self.crank_angle:g} rad.",
                advice="Check its lengths and crank_angle.",
            )
        rocker = np.angle(end) + np.arccos(cosine) * (1.0 if self.crossed else -1.0)
        coupler = np.angle(self.rocker * np.exp(1j * rocker) - end) - self.crank_angle
        half = np.mod(rocker - self.rocker_angle + np.pi, 2.0 * np.pi) - np.pi
        return linkage(
            f"the four-bar linkage of {self.actuator}",
            [
                (self.actuator, -1, _at(_TURN, 0.0, self.crank_angle)),
                ("coupler", 0, _at(_TURN, self.crank)),
                (self.joint, -1, _at(_TURN, self.ground, self.rocker_angle)),
            ],
            [(1, self.coupler), (2, self.rocker)],
            [0.0, coupler, half],
            free=0,
            size=max(lengths.values()),
        )


class LinearActuator(OneJoint):
    """A cylinder, ball screw or cable across a joint, whose length turns the joint.

    The joint's axis and the ends of the cylinder form a triangle with the angle γ at the joint,
    L² = a² + b² − 2 a b cos γ.
    """

    base: float  # a, distance from the joint's axis to the inboard end, m
    lever: float  # b, distance from the joint's axis to the outboard end, m
    length: float = 0.0  # L at q = 0, m
    angle: float = 0.0  # γ at θ = 0, rad, from 0 to π
    reversed: bool = False  # θ decreases as the cylinder extends

    def transmission(self) -> Transmission:
        """Return the closed loop of base, cylinder and lever, with γ from 0 to π."""
        for name in ("base", "lever"):
            number(getattr(self, name), name, lower=0.0, strict=True)
        number(self.length, "length", lower=0.0)
        number(self.angle, "angle", lower=0.0, upper=float(np.pi))
        side, square = -1.0 if self.reversed else 1.0, np.hypot(self.base, self.lever)
        return linkage(
            f"the cylinder {self.actuator}",
            [
                ("pivot", -1, _at(_TURN, self.base)),
                (self.actuator, 0, _at(slide_motion(_AXES[0]), self.length)),
                (self.joint, -1, _at(axis_motion(side * _AXES[2]), 0.0, self.angle)),
            ],
            [(1, 0.0), (2, self.lever)],
            [
                np.arctan2(self.lever, -self.base),
                square - self.length,
                side * (0.5 * np.pi - self.angle),
            ],
            free=1,
            size=max(self.base, self.lever),
        )


class Stated(Schema):
    """Schema of a transmission file: lists of parts by kind."""

    gears: list[Gear] = []
    coupled: list[Coupled] = []
    rolling_joints: list[RollingJoint] = []
    followers: list[Followers] = []
    polynomials: list[Polynomial] = []
    tables: list[PositionTable] = []
    four_bars: list[FourBarLinkage] = []
    linear_actuators: list[LinearActuator] = []

    def parts(self) -> Iterator[tuple[str, Statement]]:
        """Yield each part with its location, such as `gears[0]`."""
        for name in self.__struct_fields__:
            for k, part in enumerate(getattr(self, name)):
                yield f"{name}[{k}]", part

    def add(self, part: Statement) -> None:
        """Add a part to the list of its kind."""
        for name, kind in get_type_hints(type(self)).items():
            if get_args(kind)[0] is type(part):
                getattr(self, name).append(part)


@dataclass(frozen=True, eq=False)
class Drive(Short):
    """A transmission with the names of its actuators and joints."""

    actuators: tuple[str, ...]  # names of the n actuators in logs
    joints: tuple[str, ...]  # names of the k joints in the model file, n ≤ k
    map: Transmission  # θ = T(q) from the actuators to the joints
    slides: tuple[bool, ...] | None = None  # prismatic actuators (m, N); None if like the joints
    statement: Statement | None = None  # for saving; None for user-defined functions and loops

    def __post_init__(self) -> None:
        instance(self.map, "map", Transmission)
        for what, count in (("actuators", self.map.num_actuators), ("joints", self.map.num_joints)):
            names = instances(getattr(self, what), what, str)
            object.__setattr__(self, what, names)
            if len(names) != count or len(set(names)) < len(names):
                raise ArgumentError(
                    f"A drive of {self.map.num_actuators} actuators and "
                    f"{self.map.num_joints} joints needs as many different {what}; got "
                    f"{', '.join(names)}."
                )

    @property
    def is_loop(self) -> bool:
        """Return whether this is a closed loop of the model file."""
        return isinstance(self.map, LoopTransmission) and self.statement is None

    @classmethod
    def of_joint(cls, joint: str) -> Drive:
        """Return the drive of an independent joint."""
        return cls((joint,), (joint,), LinearTransmission.of([[1.0]]))

    @classmethod
    def of_loop(cls, loop: LoopTransmission) -> Drive:
        """Return a closed loop as a drive."""
        names = tuple(loop.joints[k] for k in loop.shown)
        return cls(loop.actuators, names, loop)

    @classmethod
    def of(cls, statement: Statement) -> Drive:
        """Return the drive of a part of a transmission file."""
        transmission, slides = statement.transmission(), statement.slides()
        if isinstance(transmission, LoopTransmission):
            (slides,) = (transmission.slides[k] for k in transmission.free)
        return cls(
            statement.actuator_names(),
            statement.joint_names(),
            transmission,
            None if slides is None else (slides,) * len(statement.actuator_names()),
            statement=statement,
        )


NONE, OF_FILE = "none", "file"
"""Values in place of a transmission file: none, or the transmission in the model file."""

_SUFFIX = ".transmission.yaml"
_MODEL_SUFFIXES = (".xacro", ".urdf", ".sdf", ".xml", ".mjcf", ".yaml", ".yml", ".world")


def file_beside(model: Path) -> Path:
    """Return the path of a model's transmission file: `arm.transmission.yaml` beside `arm.urdf`."""
    name = model.name
    while (suffix := Path(name).suffix.lower()) in _MODEL_SUFFIXES:
        name = name[: -len(suffix)]
    return model.with_name(f"{name}{_SUFFIX}")


def read_transmission(path: str | Path) -> tuple[Drive, ...]:
    """Return the parts of a transmission file."""
    path = file_path(path)
    content = yaml_content(path, "transmission file", ModelError, advice="Correct the file there.")
    try:
        stated = as_schema(content, Stated)
        order = list(content) if isinstance(content, dict) else []
        parts = sorted(stated.parts(), key=lambda part: order.index(part[0].partition("[")[0]))
        drives = drives_of(parts)
        if not drives:
            lists = ", ".join(Stated.__struct_fields__)
            raise ModelError("it has no parts.", advice=f"Its lists are {lists}.")
        return drives
    except GeodrakeError as error:
        raise ModelError(
            f"{path} is not a transmission file: {error.problem}",
            advice=error.advice or "Correct the file there.",
        ) from error


def drives_of(parts: Iterable[tuple[str, Statement]]) -> tuple[Drive, ...]:
    """Return the drives of parts with locations, such as `gears[0]`."""
    drives = []
    for place, part in parts:
        for what, names in (("actuator", part.actuator_names()), ("joint", part.joint_names())):
            if not names or not all(names):
                raise ModelError(f"{place} has no {what}.", advice="Add it.")
        try:
            drives.append(Drive.of(part))
        except ArgumentError as error:
            raise ModelError(f"{place}: {error.problem}", advice=error.advice) from error
    return tuple(drives)


def stated_of(drives: Sequence[Drive]) -> Stated:
    """Return drives as data for saving."""
    stated = Stated()
    for drive in drives:
        if drive.statement is None:
            raise ModelError(
                f"The transmission of {', '.join(drive.actuators)} is a user-defined "
                "function, which cannot be saved.",
                advice="Write it as a table of a transmission file, or omit it.",
            )
        stated.add(drive.statement)
    return stated
