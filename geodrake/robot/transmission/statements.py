"""What a transmission file states, part by part: the schema that Drake's `yaml_load_typed` reads.

Every part names actuators, which are columns of logs, and joints of the model file. Joints that no
part names are their own actuators.
"""

# Drake reads the schema from the annotations themselves, so they must not be strings here.
import abc
import dataclasses as dc
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from geodrake.errors import ArgumentError
from geodrake.robot.transmission.base import Transmission
from geodrake.robot.transmission.linear import LinearTransmission
from geodrake.robot.transmission.parts import InSequence, SideBySide, rolling_joint
from geodrake.robot.transmission.scalar import (
    Cylinder,
    FourBar,
    PolynomialTransmission,
    ScalarTransmission,
    TableTransmission,
)

SIDES = ("motor", "joint")
KINDS = ("", "revolute", "prismatic")


class Statement(abc.ABC):
    """One part of a transmission file."""

    @abc.abstractmethod
    def actuator_names(self) -> tuple[str, ...]:
        """Names of the actuators."""

    @abc.abstractmethod
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""

    @abc.abstractmethod
    def transmission(self) -> Transmission:
        """θ = T(q).

        Raises:
            ArgumentError: The numbers make none.
        """

    def slides(self) -> bool | None:
        """Whether the actuators slide; None where they move as the joints do."""
        return None

    def range(self) -> tuple[float, float] | None:
        """Positions of one actuator between which it holds, rad or m; None for all."""
        return None


class SingleStatement(Statement):
    """One actuator and one joint, its fields `actuator` and `joint`."""

    actuator: str
    joint: str

    def actuator_names(self) -> tuple[str, ...]:
        """The one."""
        return (self.actuator,)

    def joint_names(self) -> tuple[str, ...]:
        """The one."""
        return (self.joint,)


class LinkageStatement(SingleStatement):
    """A mechanism that reaches only so far."""

    @abc.abstractmethod
    def transmission(self) -> ScalarTransmission:
        """θ = f(q).

        Raises:
            ArgumentError: The numbers make none.
        """

    def range(self) -> tuple[float, float]:
        """Where its parts reach each other."""
        return self.transmission().range


@dataclass
class Gear(Statement):
    """A gear, belt or screw: θ = q / ratio + offset.

    Attributes:
        actuator: Column of the log.
        joint: The joint that it turns.
        ratio: Turns of the motor for one of the joint; negative where they turn against each other;
            for a screw, rad of the motor for one m.
        offset: θ where q = 0, rad or m.
        rotor: Joint of the model file that the rotor turns on, which turns as the motor does.
        side: `motor` where the log has the motor's position and effort, `joint` where it has the
            joint's, and the ratio says only how the rotor turns.
        kind: How the actuator moves, `revolute` or `prismatic`; as the joint if empty.
    """

    actuator: str = ""
    joint: str = ""
    ratio: float = 1.0
    offset: float = 0.0
    rotor: str = ""
    side: str = "motor"
    kind: str = ""

    def actuator_names(self) -> tuple[str, ...]:
        """The one."""
        return (self.actuator,)

    def joint_names(self) -> tuple[str, ...]:
        """The joint, then that of the rotor."""
        return (self.joint, self.rotor) if self.rotor else (self.joint,)

    def transmission(self) -> Transmission:
        """θ = q / N + θ₀, and N (θ − θ₀) of the rotor."""
        if self.side not in SIDES or self.kind not in KINDS:
            raise ArgumentError(
                f"side must be motor or joint, and kind revolute or prismatic; they are "
                f"{self.side!r} and {self.kind!r}."
            )
        if not self.ratio:
            raise ArgumentError("ratio must not be 0.")
        at_motor = self.side == "motor"
        turn = [1.0 / self.ratio, 1.0] if at_motor else [1.0, self.ratio]
        rows = [[x] for x in (turn if self.rotor else turn[:1])]
        return LinearTransmission.of(rows, [self.offset, 0.0][: len(rows)])

    def slides(self) -> bool | None:
        """What `kind` says."""
        return self.kind == "prismatic" if self.kind else None

    @property
    def is_direct(self) -> bool:
        """Whether the actuator moves just as the joint does."""
        return self.ratio == 1.0 and self.offset == 0.0 and not self.rotor


@dataclass
class Coupled(Statement):
    """Joints that several actuators move together: a wrist, a differential, belts over joints.

    Attributes:
        joints: Joint -> actuator -> how far the joint moves when the actuator moves by one.
        offsets: Joint -> θ where all actuators are at zero, rad or m; 0 if absent.
    """

    joints: dict[str, dict[str, float]] = dc.field(default_factory=dict)
    offsets: dict[str, float] = dc.field(default_factory=dict)

    def actuator_names(self) -> tuple[str, ...]:
        """All that are named, in the order in which they are."""
        return tuple(dict.fromkeys(name for terms in self.joints.values() for name in terms))

    def joint_names(self) -> tuple[str, ...]:
        """The joints."""
        return tuple(self.joints)

    def transmission(self) -> Transmission:
        """θ = J q + θ₀."""
        for name in self.offsets:
            if name not in self.joints:
                raise ArgumentError(
                    f"offsets has {name!r}, which is none of its joints {', '.join(self.joints)}."
                )
        ratios = LinearTransmission.from_ratios(
            list(self.joints), self.actuator_names(), self.joints
        )
        return LinearTransmission.of(ratios.matrix, [self.offsets.get(j, 0.0) for j in self.joints])


@dataclass
class RollingJoint(Statement):
    """Two bodies that roll on each other: two parallel joints, turned by one actuator.

    Attributes:
        actuator: Column of the log: the whole angle.
        joints: The two joints, the inboard one first.
        share: Share of the first joint, r₂ / (r₁ + r₂).
    """

    actuator: str = ""
    joints: list[str] = dc.field(default_factory=list)
    share: float = 0.5

    def actuator_names(self) -> tuple[str, ...]:
        """The one."""
        return (self.actuator,)

    def joint_names(self) -> tuple[str, ...]:
        """The two."""
        return tuple(self.joints)

    def transmission(self) -> Transmission:
        """θ = (s q, (1 − s) q)."""
        return rolling_joint(self.share)


@dataclass
class Followers(Statement):
    """Joints that follow polynomials of a leader's position, which moves by itself.

    Attributes:
        leader: The joint that leads, whose name the actuator has.
        joints: Joint that follows -> coefficients of its polynomial, the constant first.
    """

    leader: str = ""
    joints: dict[str, list[float]] = dc.field(default_factory=dict)

    def actuator_names(self) -> tuple[str, ...]:
        """The leader."""
        return (self.leader,)

    def joint_names(self) -> tuple[str, ...]:
        """The leader, then those that follow it."""
        return (self.leader, *self.joints)

    def transmission(self) -> Transmission:
        """θ = q, and the polynomials of q."""
        alike = LinearTransmission.of([[1.0]])
        maps = (alike, *(PolynomialTransmission(np.array(c, float)) for c in self.joints.values()))
        return InSequence((LinearTransmission.of([[1.0]] * len(maps)), SideBySide(maps)))


@dataclass
class Polynomial(SingleStatement):
    """θ = c₀ + c₁ q + c₂ q² + ….

    Attributes:
        actuator: Column of the log.
        joint: The joint.
        coefficients: c, the constant first.
    """

    actuator: str = ""
    joint: str = ""
    coefficients: list[float] = dc.field(default_factory=list)

    def transmission(self) -> Transmission:
        """The polynomial."""
        return PolynomialTransmission(np.array(self.coefficients, float))


@dataclass
class PositionTable(SingleStatement):
    """Pairs of positions, with a cubic spline between them.

    Attributes:
        actuator: Column of the log.
        joint: The joint.
        actuator_positions: q, increasing, rad or m.
        joint_positions: θ there, rad or m.
        kind: How the actuator moves, `revolute` or `prismatic`; as the joint if empty.
    """

    actuator: str = ""
    joint: str = ""
    actuator_positions: list[float] = dc.field(default_factory=list)
    joint_positions: list[float] = dc.field(default_factory=list)
    kind: str = ""

    def transmission(self) -> Transmission:
        """The spline."""
        if self.kind not in KINDS:
            raise ArgumentError(f"kind must be revolute or prismatic; it is {self.kind!r}.")
        return TableTransmission(
            np.array(self.actuator_positions, float), np.array(self.joint_positions, float)
        )

    def slides(self) -> bool | None:
        """What `kind` says."""
        return self.kind == "prismatic" if self.kind else None

    def range(self) -> tuple[float, float]:
        """From its first to its last pair."""
        self.transmission()  # which refuses what has none
        return self.actuator_positions[0], self.actuator_positions[-1]


@dataclass
class FourBarLinkage(LinkageStatement):
    """A crank that turns a rocker by a coupler; see `FourBar`.

    Attributes:
        actuator: Column of the log: the crank.
        joint: The joint that the rocker turns.
        ground: Distance of the pivots of crank and rocker, m.
        crank: Length of the crank, m.
        coupler: Length of the coupler, m.
        rocker: Length of the rocker, m.
        crank_angle: Angle from the line of the pivots to the crank where q = 0, rad.
        rocker_angle: The same of the rocker where θ = 0, rad.
        crossed: Whether coupler and ground link cross.
    """

    actuator: str = ""
    joint: str = ""
    ground: float = 0.0
    crank: float = 0.0
    coupler: float = 0.0
    rocker: float = 0.0
    crank_angle: float = 0.0
    rocker_angle: float = 0.0
    crossed: bool = False

    def transmission(self) -> FourBar:
        """The linkage."""
        return FourBar(
            self.ground,
            self.crank,
            self.coupler,
            self.rocker,
            self.crank_angle,
            self.rocker_angle,
            self.crossed,
        )

    def slides(self) -> bool:
        """It turns."""
        return False


@dataclass
class LinearActuator(LinkageStatement):
    """A cylinder, ball screw or cable across a joint; see `Cylinder`.

    Attributes:
        actuator: Column of the log: its length, m, less that where q = 0, and its force, N.
        joint: The joint across which it is.
        base: Distance of the joint's axis from the inboard end, m.
        lever: Distance of the joint's axis from the outboard end, m.
        length: Length where q = 0, m.
        angle: Angle between the two where θ = 0, rad.
        reversed: Whether θ falls as it grows.
    """

    actuator: str = ""
    joint: str = ""
    base: float = 0.0
    lever: float = 0.0
    length: float = 0.0
    angle: float = 0.0
    reversed: bool = False

    def transmission(self) -> Cylinder:
        """The triangle."""
        return Cylinder(self.base, self.lever, self.length, self.angle, self.reversed)

    def slides(self) -> bool:
        """It does."""
        return True


@dataclass
class Stated:
    """Schema of a transmission file: lists of parts by their kinds.

    Attributes:
        gears: Gears, belts and screws.
        coupled: Groups of joints that several actuators move together.
        rolling_joints: Pairs of joints of bodies that roll on each other.
        followers: Joints that follow a leader by polynomials.
        polynomials: Joints that follow a polynomial of an actuator.
        tables: Joints that follow a table.
        four_bars: Joints that a four-bar linkage turns.
        linear_actuators: Joints that a cylinder or screw across them turns.
    """

    gears: list[Gear] = dc.field(default_factory=list)
    coupled: list[Coupled] = dc.field(default_factory=list)
    rolling_joints: list[RollingJoint] = dc.field(default_factory=list)
    followers: list[Followers] = dc.field(default_factory=list)
    polynomials: list[Polynomial] = dc.field(default_factory=list)
    tables: list[PositionTable] = dc.field(default_factory=list)
    four_bars: list[FourBarLinkage] = dc.field(default_factory=list)
    linear_actuators: list[LinearActuator] = dc.field(default_factory=list)

    def parts(self) -> Iterator[tuple[str, Statement]]:
        """Every part, with where it is, such as `gears[0]`."""
        for field in dc.fields(self):
            for number, part in enumerate(getattr(self, field.name)):
                yield f"{field.name}[{number}]", part

    def add(self, part: Statement) -> None:
        """Adds a part to the list of its kind."""
        for field in dc.fields(self):
            if field.type == list[type(part)]:  # type: ignore[misc]
                getattr(self, field.name).append(part)
