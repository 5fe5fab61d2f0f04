"""Linear parameters of effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import instance, instances, integer, number, positive
from geodrake.errors import ArgumentError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """One linear parameter of an effect: its name, SI unit and admissible interval.

    Units are those of a revolute joint; at a prismatic joint read N for N·m and m for rad.

    Attributes:
        spread: How large it may be, as far as anybody knows; a fit holds what the data do not tell.

    Raises:
        ArgumentError: Name or unit are no printable words, or no value lies between the bounds.
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf
    spread: float = np.inf

    def __post_init__(self) -> None:
        named: Any = (("name", self.name), ("unit", self.unit))
        for what, words in named:
            if not (isinstance(words, str) and words.isprintable() and words.strip()):
                raise ArgumentError(f"A parameter's {what} is printable words; got {words!r}.")
        for what in ("lower", "upper", "spread"):
            number(getattr(self, what), f"{what} of {self.name}", finite=False)
        if not (self.lower < self.upper and self.lower < np.inf and self.upper > -np.inf):
            raise ArgumentError(
                f"{self.name} has lower = {self.lower:g} and upper = {self.upper:g}, with nothing "
                "between them."
            )
        if not self.spread > 0.0:
            raise ArgumentError(f"{self.name} has spread = {self.spread:g}; it must be above 0.")


class CheckedFields:
    """Refuses fields of an effect that are not of the type they are declared with.

    A subclass with checks of its own calls this one first.

    Raises:
        ArgumentError: A name is no text, or a shape parameter no finite number.
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


def whole_numbers(effect: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    """Values of fields of a class of effects, those of type `int` whole where they are floats.

    A saved model holds all numbers as floats.

    Raises:
        ArgumentError: One of these is not whole.
    """
    whole = {field.name for field in fields(effect) if _declared(field.type) == "int"}
    found = dict(values)
    for name, value in values.items():
        if name in whole and isinstance(value, float):
            if not value.is_integer():
                raise ArgumentError(
                    f"{effect.name} needs a whole number as {name}; it got {value}."
                )
            found[name] = int(value)
    return found


def _declared(kind: Any) -> str:
    """The type of a field as it is written: `float`, `float | None`, `tuple[str, str]`."""
    words = kind.__name__ if type(kind) is type else str(kind).replace("typing.", "")
    return f"{words[9:-1]} | None" if words.startswith("Optional[") else words


def require_positive(effect: Any, *names: str) -> None:
    """Refuses shape parameters of an effect that are not positive and finite.

    Raises:
        ArgumentError: One of the named fields is not.
    """
    for name in names:
        positive(getattr(effect, name), f"{name} of {effect.name}")
