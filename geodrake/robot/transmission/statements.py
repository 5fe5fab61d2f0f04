"""Transmission files, as YAML beside the model file.

    gears:
    - {actuator: motor_1, joint: joint_1, ratio: 100}
    coupled:
    - joints:
        joint_5: {motor_5: 0.02}
        joint_6: {motor_5: 0.01, motor_6: 0.01}

`Stated` is their schema. Every part names actuators, which are columns of logs, and joints of the
model file. Joints that no part names are their own actuators. Of parts of one actuator and one
joint,

    θ = f(q),   J = f′(q),   J̇ = f″(q) q̇                             [Lee2019] Eq. (3.6.57)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, get_args, get_type_hints

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from scipy.interpolate import CubicSpline

from geodrake.boundary.arguments import file_path, instance, instances, number, real_array
from geodrake.boundary.showing import Short
from geodrake.boundary.yaml_schema import Schema, as_schema
from geodrake.boundary.yaml_text import yaml_content
from geodrake.errors import ArgumentError, GeodrakeError, ModelError
from geodrake.inertia import Array
from geodrake.robot.transmission import (
    InSequence,
    JointlyEvaluated,
    LinearTransmission,
    SideBySide,
    Transmission,
    rolling_joint,
)
from geodrake.robot.transmission.loop import LoopTransmission

Kind = Literal["", "revolute", "prismatic"]
"""How an actuator moves: as the joint does if empty."""

Law = Callable[[Array, int], Array]
"""f, f′ or f″ (N,) at q (N,), by the order 0, 1 or 2."""

_SLIDES: dict[str, bool | None] = {"": None, "revolute": False, "prismatic": True}
_ACTUATOR, _JOINT = ("actuator", "leader"), ("leader", "joint", "rotor")  # fields of their names
_OFF_THE_END = 1e-3  # of the range, where a linkage still moves
_LEAST_POINTS = 3  # of a table, whose spline has curvature
_EVERYWHERE = -np.inf, np.inf


@dataclass(frozen=True, eq=False)
class ScalarTransmission(JointlyEvaluated, Short):
    """θ = f(q) of one actuator and one joint.

    Attributes:
        law: f and its derivatives.
        range: Between which q f is known.
    """

    law: Law
    range: tuple[float, float] = _EVERYWHERE

    @property
    def shape(self) -> tuple[int, int]:
        """One, and one."""
        return 1, 1

    def along(self, q: Array, v: Array | None = None) -> tuple[Array, Array, Array]:
        """θ = f(q), J = f′(q) and J̇ = f″(q) q̇, of q and q̇ (N, 1)."""
        own, rate = self._q(q)[:, 0], np.zeros(len(q))
        if v is not None:
            rate = self.law(own, 2) * real_array(v, "v", ("N", 1))[:, 0]
        return self.law(own, 0)[:, None], self.law(own, 1)[:, None, None], rate[:, None, None]

    def inside(self, q: Array) -> Array:
        """Return positions moved to where f is known, a little off its ends."""
        low, high = self.range
        if not np.isfinite([low, high]).all():
            return q
        off = _OFF_THE_END * (high - low)
        return np.clip(q, low + off, high - off)


class Statement(Schema):
    """One part of a transmission file."""

    def actuator_names(self) -> tuple[str, ...]:
        """Return the names of the actuators: here of the one."""
        return tuple(filter(None, (getattr(self, field, "") for field in _ACTUATOR)))

    def joint_names(self) -> tuple[str, ...]:
        """Return the names of the joints."""
        single = (getattr(self, field, "") for field in _JOINT)
        return (*filter(None, single), *getattr(self, "joints", ()))

    def transmission(self) -> Transmission:
        """Return θ = T(q)."""
        raise NotImplementedError

    def slides(self) -> bool | None:
        """Return whether the actuators are prismatic; None if they are of the joints' kind."""
        return _SLIDES[getattr(self, "kind", "")]

    def range(self) -> tuple[float, float] | None:
        """Return the range of an actuator's positions, rad or m; None for all."""
        return None


class Gear(Statement):
    """A gear, belt or screw: θ = q / ratio + offset.

    Attributes:
        ratio: Turns of the motor for one of the joint; negative where they turn against each other;
            for a screw, rad of the motor for one m.
        offset: θ where q = 0, rad or m.
        rotor: Joint of the model file that the rotor turns on, which turns as the motor does.
        side: `motor` where the log has the motor's position and effort, `joint` where it has the
            joint's, and the ratio says only how the rotor turns.
    """

    actuator: str
    joint: str
    ratio: float = 1.0
    offset: float = 0.0
    rotor: str = ""
    side: Literal["motor", "joint"] = "motor"
    kind: Kind = ""

    def transmission(self) -> Transmission:
        """Return θ = q / N + θ₀, and N (θ − θ₀) of the rotor."""
        if not self.ratio:
            raise ArgumentError("ratio must not be 0.")
        turn = [1.0 / self.ratio, 1.0] if self.side == "motor" else [1.0, self.ratio]
        rows = [[x] for x in (turn if self.rotor else turn[:1])]
        return LinearTransmission.of(rows, [self.offset, 0.0][: len(rows)])

    @property
    def is_direct(self) -> bool:
        """Whether the actuator moves just as the joint does."""
        return self.ratio == 1.0 and self.offset == 0.0 and not self.rotor


class Coupled(Statement):
    """Joints that several actuators move together: a wrist, a differential, belts over joints.

    Attributes:
        joints: Joint -> actuator -> how far the joint moves when the actuator moves by one.
        offsets: Joint -> θ where all actuators are at zero, rad or m; 0 if absent.
    """

    joints: dict[str, dict[str, float]]
    offsets: dict[str, float] = {}

    def actuator_names(self) -> tuple[str, ...]:
        """Return all that are named, in the order in which they are."""
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


class RollingJoint(Statement):
    """Two bodies that roll on each other: two parallel joints that share an angle.

    Attributes:
        joints: The two joints, the inboard one first.
        share: Share of the first joint, r₂ / (r₁ + r₂).
    """

    actuator: str
    joints: list[str]
    share: float = 0.5

    def transmission(self) -> Transmission:
        """Return θ = (s q, (1 − s) q)."""
        return rolling_joint(self.share)


class Followers(Statement):
    """Joints that follow polynomials of a leader's position, which moves by itself.

    Attributes:
        leader: The joint that leads, whose name the actuator has.
        joints: Joint that follows -> coefficients of its polynomial, the constant first.
    """

    leader: str
    joints: dict[str, list[float]]

    def transmission(self) -> Transmission:
        """Return θ = q, and the polynomials of q."""
        alike = LinearTransmission.of([[1.0]])
        laws = (polynomial(np.array(c, float)) for c in self.joints.values())
        maps = (alike, *map(ScalarTransmission, laws))
        return InSequence((LinearTransmission.of([[1.0]] * len(maps)), SideBySide(maps)))


def polynomial(coefficients: Array) -> Law:
    """Return f = c₀ + c₁ q + c₂ q² + … of c (m,), as MuJoCo's `polycoef` has it."""
    c = real_array(coefficients, "coefficients", ("m",))
    if not c[1:].any():
        raise ArgumentError(f"coefficients need a nonzero one besides c₀; got {c}.")
    return partial(_of_polynomial, c)


def _of_polynomial(c: Array, q: Array, order: int) -> Array:
    return np.asarray(polyval(q, polyder(c, order)))


def _along(spline: CubicSpline, q: Array, order: int) -> Array:
    """Return a spline, or its derivative, with linear extrapolation."""
    inside = np.clip(q, spline.x[0], spline.x[-1])
    found = spline(inside, order)
    return np.asarray(found if order else found + spline(inside, 1) * (q - inside))


class OneJoint(Statement):
    """One actuator and one joint."""

    actuator: str
    joint: str

    def law(self) -> Law:
        """Return f and its derivatives; raise an ArgumentError if undefined."""
        raise NotImplementedError

    def transmission(self) -> ScalarTransmission:
        """Return the map."""
        return ScalarTransmission(self.law(), self._known())

    def range(self) -> tuple[float, float] | None:
        """Return where f is known."""
        self.law()  # which refuses what has none
        return self._known()

    def _known(self) -> tuple[float, float]:
        return _EVERYWHERE


class Polynomial(OneJoint):
    """θ = c₀ + c₁ q + c₂ q² + …."""

    coefficients: list[float]

    def law(self) -> Law:
        """Return the polynomial."""
        return polynomial(np.array(self.coefficients, float))


class PositionTable(OneJoint):
    """θ between pairs, rad or m, by a cubic spline, and straight on beyond its ends."""

    actuator_positions: list[float]
    joint_positions: list[float]
    kind: Kind = ""

    def law(self) -> Law:
        """Return the natural spline, which extrapolates linearly."""
        q = real_array(np.array(self.actuator_positions, float), "actuator_points", ("m",))
        if len(q) < _LEAST_POINTS or not (np.diff(q) > 0.0).all():
            raise ArgumentError(
                f"A table needs at least {_LEAST_POINTS} increasing actuator positions; got "
                f"{q.tolist()}."
            )
        theta = real_array(np.array(self.joint_positions, float), "joint_points", (len(q),))
        return partial(_along, CubicSpline(q, theta, bc_type="natural"))

    def range(self) -> tuple[float, float]:
        """Return its first and its last position."""
        self.law()
        return self.actuator_positions[0], self.actuator_positions[-1]


class FourBarLinkage(OneJoint):
    """A four-bar linkage: q turns the crank, and the rocker turns the joint.

    Crank and rocker turn about parallel axes on the ground link, and the coupler joins their ends.
    Their angles are counted from the line from the crank's pivot to the rocker's.

    Attributes:
        ground: Distance of the two pivots, m; only ratios of the four lengths matter.
        crank_angle: Angle of the crank where q = 0, rad.
        rocker_angle: Angle of the rocker where θ = 0, rad.
        crossed: Whether coupler and ground link cross: the other way to put the bars together.
    """

    ground: float
    crank: float
    coupler: float
    rocker: float
    crank_angle: float = 0.0
    rocker_angle: float = 0.0
    crossed: bool = False

    def slides(self) -> bool:
        """Return that it turns."""
        return False

    def law(self) -> Law:
        """Return the rocker's angle from where θ = 0, within half a turn of it.

        The slope is r_crank sin(φ − κ) / (r_rocker sin(ψ − κ)), with κ the angle of the coupler,
        whose own slope follows from the loop.
        """
        for name in ("ground", "crank", "coupler", "rocker"):
            number(getattr(self, name), name, lower=0.0, strict=True)
        for name in ("crank_angle", "rocker_angle"):
            number(getattr(self, name), name)
        low, high = self._known()
        if not low < 0.0 < high:
            raise ArgumentError(
                "The bars of the four-bar linkage do not reach each other at q = 0 with the "
                f"crank at {self.crank_angle:g} rad.",
                advice="Check its lengths and crank_angle.",
            )
        return self._rocker

    def _known(self) -> tuple[float, float]:
        """Range of q in which the bars meet, rad; infinite if the crank rotates fully.

        The diagonal from the crank's end to the rocker's pivot is between |r − c| and r + c.
        """
        sides = self.crank**2 + self.ground**2
        spans = (self.rocker + self.coupler) ** 2, (self.rocker - self.coupler) ** 2
        least, most = ((sides - span) / (2.0 * self.crank * self.ground) for span in spans)
        if least >= 1.0 or most <= -1.0:
            return 0.0, 0.0
        crank = float(np.mod(self.crank_angle + np.pi, 2.0 * np.pi) - np.pi)
        outer = np.arccos(least) if least > -1.0 else np.pi
        inner = np.arccos(most) if most < 1.0 else 0.0
        if outer == np.pi and inner == 0.0:
            return -np.inf, np.inf
        if inner == 0.0:
            return float(-outer - crank), float(outer - crank)
        if outer == np.pi:
            crank = crank % (2.0 * np.pi)
            return float(inner - crank), float(2.0 * np.pi - inner - crank)
        side = np.sign(crank) if crank else 1.0
        ends = sorted((side * inner - crank, side * outer - crank))
        return float(ends[0]), float(ends[1])

    def _rocker(self, q: Array, order: int) -> Array:
        crank, rocker, coupler = self._angles(q)
        if order == 0:
            return np.asarray(np.mod(rocker - self.rocker_angle + np.pi, 2.0 * np.pi) - np.pi)
        lever = self.rocker * np.sin(rocker - coupler)
        slope = self.crank * np.sin(crank - coupler) / lever
        if order == 1:
            return np.asarray(slope)
        turn = self.crank * np.sin(crank - rocker) / (self.coupler * np.sin(rocker - coupler))
        driven = self.crank * np.cos(crank - coupler) * (1.0 - turn)
        driving = slope * self.rocker * np.cos(rocker - coupler) * (slope - turn)
        return np.asarray((driven - driving) / lever)

    def _angles(self, q: Array) -> tuple[Array, Array, Array]:
        """Return angles (N,) of crank, rocker and coupler."""
        crank = q + self.crank_angle
        x, y = self.crank * np.cos(crank) - self.ground, self.crank * np.sin(crank)
        diagonal = np.hypot(x, y)
        cosine = (diagonal**2 + self.rocker**2 - self.coupler**2) / (2.0 * self.rocker * diagonal)
        if (beyond := ~(np.abs(cosine) < 1.0)).any():
            raise ArgumentError(
                f"The bars of the four-bar linkage do not reach each other at q = "
                f"{q[beyond][0]:.4g} rad.",
                advice="Check its lengths and crank_angle, and that the log is of this actuator.",
            )
        bend = np.arccos(cosine)
        rocker = np.arctan2(y, x) + (bend if self.crossed else -bend)
        ends = self.rocker * np.cos(rocker) - x, self.rocker * np.sin(rocker) - y
        return crank, rocker, np.arctan2(ends[1], ends[0])


class LinearActuator(OneJoint):
    """A cylinder, ball screw or cable across a joint: its length turns the joint.

    Two sides of a triangle, from the joint's axis to the ends of the cylinder, enclose an angle
    γ with L² = a² + b² − 2 a b cos γ.

    Attributes:
        base: a, distance of the joint's axis from the end on its inboard side, m.
        lever: b, distance of the joint's axis from the end on its outboard side, m.
        length: L where q = 0, m.
        angle: γ where θ = 0, rad, between 0 and π.
        reversed: Whether θ falls as the cylinder grows.
    """

    base: float
    lever: float
    length: float = 0.0
    angle: float = 0.0
    reversed: bool = False

    def slides(self) -> bool:
        """Return that it does."""
        return True

    def law(self) -> Law:
        """Return γ less that at θ = 0, with its sign; the slope is L / (a b sin γ)."""
        for name in ("base", "lever"):
            number(getattr(self, name), name, lower=0.0, strict=True)
        number(self.length, "length", lower=0.0)
        number(self.angle, "angle", lower=0.0, upper=float(np.pi))
        return self._opening

    def _known(self) -> tuple[float, float]:
        """Return between which q the triangle closes, m."""
        return abs(self.base - self.lever) - self.length, self.base + self.lever - self.length

    def _opening(self, q: Array, order: int) -> Array:
        sign, cosine = -1.0 if self.reversed else 1.0, self._cosine(q)
        if order == 0:
            return np.asarray(sign * (np.arccos(cosine) - self.angle))
        area, sine = self.base * self.lever, np.sqrt(1.0 - cosine**2)
        if order == 1:
            return np.asarray(sign * (q + self.length) / (area * sine))
        bend = cosine * ((q + self.length) / (area * sine)) ** 2
        return np.asarray(sign * (1.0 / area - bend) / sine)

    def _cosine(self, q: Array) -> Array:
        squares = self.base**2 + self.lever**2 - (q + self.length) ** 2
        cosine = squares / (2.0 * self.base * self.lever)
        if (beyond := ~(np.abs(cosine) < 1.0)).any():
            low, high = self._known()
            raise ArgumentError(
                f"The cylinder cannot reach q = {q[beyond][0]:.4g} m: its range is {low:.4g} "
                f"to {high:.4g} m.",
                advice="Check base, lever and length, and that the log is of this actuator.",
            )
        return np.asarray(cosine)


class Stated(Schema):
    """A transmission file: lists of parts by their kinds."""

    gears: list[Gear] = []
    coupled: list[Coupled] = []
    rolling_joints: list[RollingJoint] = []
    followers: list[Followers] = []
    polynomials: list[Polynomial] = []
    tables: list[PositionTable] = []
    four_bars: list[FourBarLinkage] = []
    linear_actuators: list[LinearActuator] = []

    def parts(self) -> Iterator[tuple[str, Statement]]:
        """Yield every part, with where it is, such as `gears[0]`."""
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
    """Actuators, the joints that they move together, and how.

    Attributes:
        actuators: Names of the n actuators, as logs have them.
        joints: Names of the k joints of the model file, n ≤ k.
        map: θ = T(q) from the actuators to the joints.
        slides: Whether each actuator slides, so that its positions are in m and its efforts in N;
            None for each as the joint in whose place it stands.
        range: Positions (n,) of the actuators between which the map holds, rad or m.
        statement: What it was made of, which is saved; None for one of functions of your own.
    """

    actuators: tuple[str, ...]
    joints: tuple[str, ...]
    map: Transmission
    slides: tuple[bool, ...] | None = None
    range: tuple[Array, Array] | None = None
    statement: Statement | None = None

    def __post_init__(self) -> None:
        instance(self.map, "map", Transmission)
        for what, count in (
            ("actuators", self.map.num_actuators),
            ("joints", self.map.num_joints),
        ):
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
        """Whether it is a closed loop of the model file."""
        return isinstance(self.map, LoopTransmission)

    @classmethod
    def of_loop(cls, loop: LoopTransmission) -> Drive:
        """Return a closed loop as a drive."""
        names = tuple(loop.joints[at] for at in loop.shown)
        return cls(loop.actuators, names, loop, range=loop.range())

    @property
    def limits(self) -> tuple[Array, Array]:
        """Range of positions (n,) of the map, rad or m."""
        if self.range is not None:
            return self.range
        most = np.full(len(self.actuators), np.inf)
        return -most, most

    @classmethod
    def of(cls, statement: Statement) -> Drive:
        """Return the drive that a part of a transmission file states."""
        range_, slides = statement.range(), statement.slides()
        return cls(
            statement.actuator_names(),
            statement.joint_names(),
            statement.transmission(),
            None if slides is None else (slides,) * len(statement.actuator_names()),
            None if range_ is None else (np.array([range_[0]]), np.array([range_[1]])),
            statement,
        )


NONE, OF_FILE = "none", "file"
"""Values other than a transmission file: none, or that in the model file."""

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
            path=path,
        ) from error


def drives_of(parts: Iterable[tuple[str, Statement]]) -> tuple[Drive, ...]:
    """Return the drives of parts, each with its place, such as `gears[0]`."""
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
    """Return the data of drives for saving."""
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
