"""Linear parameters of effects."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from geodrake.errors import ArgumentError


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
        sizes: Any = (self.lower, self.upper, self.spread)
        for what, size in zip(("lower", "upper", "spread"), sizes, strict=True):
            if not isinstance(size, Real):
                raise ArgumentError(f"{self.name} has {what} = {size!r}; it needs a number.")
        if not (self.lower < self.upper and self.lower < np.inf and self.upper > -np.inf):
            raise ArgumentError(
                f"{self.name} has lower = {self.lower:g} and upper = {self.upper:g}, with nothing "
                "between them."
            )
        if not self.spread > 0.0:
            raise ArgumentError(f"{self.name} has spread = {self.spread:g}; it must be above 0.")


def require_positive(effect: Any, *names: str) -> None:
    """Refuses shape parameters of an effect that are not positive and finite.

    Raises:
        ArgumentError: One of the named fields is not.
    """
    for name in names:
        value = getattr(effect, name)
        if not 0.0 < value < np.inf:
            raise ArgumentError(f"{effect.name} needs a positive {name}; it got {value}.")
