"""Declarations of effects: role, proposer, places, parameters and shapes."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import instance, instances, integer, number, one_of, positive
from geodrake.errors import ArgumentError

Array = NDArray[np.float64]

_SCALES = ("", "speed", "reach", "duration", "temperature")
_LINEAR = (("kg·m²", "kg"), ("N·m", "N"), ("rad", "m"))


class Role(Enum):
    """Ways in which an effect changes the efforts that a model needs.

    Effects with a role other than FORCE derive from the class that has it: `EffortScale`,
    `EffortDelay`, `Payload`, `WrongInertia`, `DeflectionEffect` or `Episode`.
    """

    FORCE = "adds effort"
    SCALE = "scales the effort of a joint"
    DELAY = "shifts efforts in time"
    BODY = "adds a body to a link"
    DEFLECTION = "deflects a joint, so that motor and link move differently"
    EPISODE = "adds effort during a time window of one log"
    INERTIA = "changes the inertias of the bodies"


class Proposer(Enum):
    """The pattern in a model's residual that proposes an effect.

    BENDING and PLAY propose a `DeflectionEffect`, SHARED_ACTUATOR a `SharedActuatorEffect`, EPISODE
    a `PointEpisode`, HANDLING another `Episode`, the others a `JointEffect`. Under WAVES its only
    shape parameter is the order; under WARMING and BRISTLES it defines `course`.
    """

    BENDING = "efforts of all joints change with the deflection of one joint"
    PLAY = "errors occur where the load of a joint changes sign"
    SHARED_ACTUATOR = "errors of two joints follow the motion of one actuator"
    WAVES = "waves over the position of a joint"
    WARMING = "friction that fades with time"
    BRISTLES = "dry friction that builds up over a distance"
    EPISODE = "errors occur at several joints for a limited time"
    HANDLING = "the load of a body changes at an instant"


class Place(NamedTuple):
    """A kind of place that effects are bound to."""

    field: str  # field of the effect that names the place; empty if there is none
    counts: Collection[int]  # valid numbers of names
    wanted: str  # requirement, for error messages
    words: str  # description


PLACES = {
    "joint": Place("joint", (1,), "one joint", "joint"),
    "joint_pair": Place("joints", (2,), "two joints", "joint pair"),
    "body": Place("body", (1,), "one body", "body"),
    "body_pair": Place("bodies", (2,), "two bodies", "body pair"),
    "body_path": Place("bodies", range(3, 1000), "three bodies or more", "bodies"),
    "bodies": Place("", (0,), "no place, as it is one of all bodies", "bodies"),
    "robot": Place("", (0,), "no place, as it is one of the whole robot", "robot"),
    "log": Place("joint", (0, 1), "one joint or none", "log, or joint"),
}
"""The kinds of places by their name, `Effect.places`."""


class FileTerm(NamedTuple):
    """Names of an effect in model files and fits of servos; empty where it does not occur."""

    words: str = ""  # in notes on a model file, with shape parameters in braces
    joint: str = ""  # property of a joint in files of all formats
    servo: str = ""  # parameter of a `ServoFit`


@dataclass(frozen=True)
class Parameter:
    """One linear parameter of an effect: its name, SI unit and admissible interval.

    Units are those of a revolute joint; at a prismatic joint read N for N·m and m for rad.

    Attributes:
        usual: Prior mean.
        spread: Prior standard deviation, which regularizes fits.

    Raises:
        ArgumentError: Name or unit is not printable text, or the interval is empty.
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf
    spread: float = np.inf
    usual: float = 0.0

    def __post_init__(self) -> None:
        texts: Any = (("name", self.name), ("unit", self.unit))
        for field, text in texts:
            if not (isinstance(text, str) and text.isprintable() and text.strip()):
                raise ArgumentError(f"A parameter's {field} must be printable text; got {text!r}.")
        for field in ("lower", "upper", "spread"):
            number(getattr(self, field), f"{field} of {self.name}", finite=False)
        if not (self.lower < self.upper and self.lower < np.inf and self.upper > -np.inf):
            raise ArgumentError(
                f"{self.name} has lower = {self.lower:g} and upper = {self.upper:g}, an "
                "empty range."
            )
        if not self.spread > 0.0:
            raise ArgumentError(f"{self.name} has spread = {self.spread:g}; it must be above 0.")
        number(self.usual, f"usual of {self.name}")


@dataclass(frozen=True)
class Shape:
    """A shape parameter of an effect: its unit, and the values that a diagnosis tries.

    Attributes:
        name: Name of the field of the effect, or of a value that it reports.
        unit: SI unit at a revolute joint.
        grid: Values to try, relative to `scale` if it is set; empty to try only the default.
        scale: Reference size of the grid: "speed", the joint's peak speed; "reach", its range of
            motion; "duration", that of the longest log; or "temperature", its mean.
        usual: The value to try if that size is unknown.
    """

    name: str
    unit: str = "1"
    grid: tuple[float, ...] = ()
    scale: str = ""
    usual: float | None = None

    @property
    def is_searched(self) -> bool:
        """Return whether a diagnosis tries several values."""
        return len(self.grid) > 1 or (not self.grid and self.usual is not None)

    def __post_init__(self) -> None:
        for field in ("name", "unit"):
            instance(getattr(self, field), field, str)
        for value in instances(self.grid, "grid", (int, float)):
            number(value, "grid")
        one_of(self.scale, "scale", _SCALES)
        if self.usual is not None:
            number(self.usual, "usual")

    def values(self, scales: Mapping[str, float]) -> tuple[float, ...]:
        """Return the values to try, given the known reference sizes."""
        if not self.scale and self.grid:
            return self.grid
        if self.scale in scales:
            return tuple(scales[self.scale] * share for share in self.grid)
        return () if self.usual is None else (self.usual,)


def when_sliding(unit: str) -> str:
    """Return the unit at a prismatic joint for a unit at a revolute one."""
    for angular, linear in _LINEAR:
        unit = unit.replace(angular, linear)
    return re.sub(r"\((\w+)\)", r"\1", unit)  # m/(N) is m/N


class CheckedFields:
    """Base class that checks the fields of an effect against their declared types.

    Subclasses with further checks must call `super().__post_init__()` first.
    """

    def __post_init__(self) -> None:
        effect: Any = self
        for field in fields(effect):
            value, name = getattr(self, field.name), f"{field.name} of {effect.name}"
            kind = _declared(field.type)
            if value is None and kind.endswith("| None"):
                continue
            if kind.startswith("tuple[str"):
                object.__setattr__(self, field.name, instances(value, name, str))
            elif kind.startswith("str"):
                instance(value, name, str)
            elif kind.startswith("float"):
                number(value, name)
            elif kind.startswith("int"):
                integer(value, name)
        require_positive(effect, *effect.positive)


def whole_numbers(effect: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return field values of an effect class, with floats converted for fields of type `int`.

    Saved models contain all numbers as floats.
    """
    integers = {field.name for field in fields(effect) if _declared(field.type) == "int"}
    converted = dict(values)
    for name, value in values.items():
        if name in integers and isinstance(value, float):
            if not value.is_integer():
                raise ArgumentError(f"{effect.name} needs an integer {name}; got {value}.")
            converted[name] = int(value)
    return converted


def _declared(kind: Any) -> str:
    """Return the annotation of a field: `float`, `float | None`, `tuple[str, str]`."""
    words = kind.__name__ if type(kind) is type else str(kind).replace("typing.", "")
    return f"{words[9:-1]} | None" if words.startswith("Optional[") else words


def require_positive(effect: Any, *names: str) -> None:
    """Raise if fields of an effect are not positive and finite."""
    for name in names:
        positive(getattr(effect, name), f"{name} of {effect.name}")
