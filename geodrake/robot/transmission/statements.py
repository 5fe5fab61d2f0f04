"""What a transmission file states, part by part: its schema, and the maps that the parts make.

Every part names actuators, which are columns of logs, and joints of the model file. Joints that no
part names are their own actuators.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Literal, get_args, get_type_hints

import msgspec
import numpy as np

from geodrake.boundary.yaml_schema import Schema
from geodrake.errors import ArgumentError
from geodrake.robot.transmission.base import (
    InSequence,
    LinearTransmission,
    SideBySide,
    Transmission,
    rolling_joint,
)
from geodrake.robot.transmission.scalar import (
    Cylinder,
    FourBar,
    PolynomialTransmission,
    ScalarTransmission,
    TableTransmission,
)

Kind = Literal["", "revolute", "prismatic"]
"""How an actuator moves: as the joint does if empty."""

_SLIDES: dict[str, bool | None] = {"": None, "revolute": False, "prismatic": True}


class Statement(Schema):
    """One part of a transmission file."""

    def actuator_names(self) -> tuple[str, ...]:
        """Return the names of the actuators."""
        raise NotImplementedError

    def joint_names(self) -> tuple[str, ...]:
        """Return the names of the joints."""
        raise NotImplementedError

    def transmission(self) -> Transmission:
        """Return θ = T(q)."""
        raise NotImplementedError

    def slides(self) -> bool | None:
        """Return whether the actuators slide; None where they move as the joints do."""
        return _SLIDES[getattr(self, "kind", "")]

    def range(self) -> tuple[float, float] | None:
        """Return positions of one actuator between which it holds, rad or m; None for all."""
        return None


class OneActuator(Statement):
    """A part of one actuator."""

    actuator: str

    def actuator_names(self) -> tuple[str, ...]:
        """Return the one."""
        return (self.actuator,)


class Gear(OneActuator):
    """A gear, belt or screw: θ = q / ratio + offset.

    Attributes:
        joint: The joint that it turns.
        ratio: Turns of the motor for one of the joint; negative where they turn against each other;
            for a screw, rad of the motor for one m.
        offset: θ where q = 0, rad or m.
        rotor: Joint of the model file that the rotor turns on, which turns as the motor does.
        side: `motor` where the log has the motor's position and effort, `joint` where it has the
            joint's, and the ratio says only how the rotor turns.
    """

    joint: str
    ratio: float = 1.0
    offset: float = 0.0
    rotor: str = ""
    side: Literal["motor", "joint"] = "motor"
    kind: Kind = ""

    def joint_names(self) -> tuple[str, ...]:
        """Return the joint, then that of the rotor."""
        return (self.joint, self.rotor) if self.rotor else (self.joint,)

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

    def joint_names(self) -> tuple[str, ...]:
        """Return the joints."""
        return tuple(self.joints)

    def transmission(self) -> Transmission:
        """Return θ = J q + θ₀."""
        for name in self.offsets:
            if name not in self.joints:
                raise ArgumentError(
                    f"offsets has {name!r}, which is none of its joints {', '.join(self.joints)}."
                )
        names = list(self.joints), self.actuator_names()
        J = LinearTransmission.from_ratios(*names, self.joints).matrix
        return LinearTransmission.of(J, [self.offsets.get(j, 0.0) for j in self.joints])


class RollingJoint(OneActuator):
    """Two bodies that roll on each other: two parallel joints, turned by the whole angle.

    Attributes:
        joints: The two joints, the inboard one first.
        share: Share of the first joint, r₂ / (r₁ + r₂).
    """

    joints: list[str]
    share: float = 0.5

    def joint_names(self) -> tuple[str, ...]:
        """Return the two."""
        return tuple(self.joints)

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

    def actuator_names(self) -> tuple[str, ...]:
        """Return the leader."""
        return (self.leader,)

    def joint_names(self) -> tuple[str, ...]:
        """Return the leader, then those that follow it."""
        return (self.leader, *self.joints)

    def transmission(self) -> Transmission:
        """Return θ = q, and the polynomials of q."""
        alike = LinearTransmission.of([[1.0]])
        maps = (alike, *(PolynomialTransmission(np.array(c, float)) for c in self.joints.values()))
        return InSequence((LinearTransmission.of([[1.0]] * len(maps)), SideBySide(maps)))


class OneJoint(OneActuator):
    """One actuator and one joint; further fields but `kind` are those of a map θ = f(q)."""

    map_of: ClassVar[type[ScalarTransmission]]

    joint: str

    def joint_names(self) -> tuple[str, ...]:
        """Return the one."""
        return (self.joint,)

    def transmission(self) -> ScalarTransmission:
        """Return the map."""
        fields = msgspec.structs.asdict(self)
        own = [x for name, x in fields.items() if name not in ("actuator", "joint", "kind")]
        return self.map_of(*(np.array(x, float) if isinstance(x, list) else x for x in own))

    def range(self) -> tuple[float, float] | None:
        """Return where f is known."""
        return self.transmission().range


class Polynomial(OneJoint):
    """θ = c₀ + c₁ q + c₂ q² + …; see `PolynomialTransmission`."""

    map_of = PolynomialTransmission

    coefficients: list[float]

    def range(self) -> None:
        """Return that it holds everywhere."""
        return


class PositionTable(OneJoint):
    """Pairs of positions, rad or m, with a cubic spline between them; see `TableTransmission`."""

    map_of = TableTransmission

    actuator_positions: list[float]
    joint_positions: list[float]
    kind: Kind = ""

    def range(self) -> tuple[float, float]:
        """Return its first and its last position."""
        self.transmission()  # which refuses what has none
        return self.actuator_positions[0], self.actuator_positions[-1]


class FourBarLinkage(OneJoint):
    """A crank that turns a rocker by a coupler; see `FourBar`."""

    map_of = FourBar

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


class LinearActuator(OneJoint):
    """A cylinder, ball screw or cable across a joint; see `Cylinder`."""

    map_of = Cylinder

    base: float
    lever: float
    length: float = 0.0
    angle: float = 0.0
    reversed: bool = False

    def slides(self) -> bool:
        """Return that it does."""
        return True


class Stated(Schema):
    """A transmission file: lists of parts by their kinds.

    Attributes:
        coupled: Groups of joints that several actuators move together.
        rolling_joints: Pairs of joints of bodies that roll on each other.
        followers: Joints that follow a leader by polynomials.
        polynomials: Joints that follow a polynomial of an actuator.
        tables: Joints that follow a table.
        four_bars: Joints that a four-bar linkage turns.
        linear_actuators: Joints that a cylinder or screw across them turns.
    """

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
            for number, part in enumerate(getattr(self, name)):
                yield f"{name}[{number}]", part

    def add(self, part: Statement) -> None:
        """Adds a part to the list of its kind."""
        for name, kind in get_type_hints(type(self)).items():
            if get_args(kind)[0] is type(part):
                getattr(self, name).append(part)
