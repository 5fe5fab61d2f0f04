"""Linear parameters of effects."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.arguments import instance, instances, integer, number, positive, real_array
from geodrake.errors import ArgumentError
from geodrake.manifolds import Interval

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """One linear parameter of an effect: its name, SI unit and admissible interval.

    Units are those of a revolute joint; at a prismatic joint read N for N·m and m for rad.

    Attributes:
        spread: How large it may be, as far as anybody knows; a fit holds what the data do not tell.
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf
    spread: float = np.inf

    def __post_init__(self) -> None:
        for field in ("name", "unit"):
            instance(getattr(self, field), f"the {field} of a parameter", str)
        for field in ("lower", "upper", "spread"):
            number(getattr(self, field), f"{field} of {self.name}", finite=False)
        if not (self.lower < self.upper and self.spread > 0):
            raise ArgumentError(
                f"{self.name} needs a lower bound below its upper one, and a spread above zero; it "
                f"has {self.lower}, {self.upper} and {self.spread}."
            )


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
            kind = field.type if isinstance(field.type, str) else field.type.__name__
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


def require_positive(effect: Any, *names: str) -> None:
    """Refuses shape parameters of an effect that are not positive and finite.

    Raises:
        ArgumentError: One of the named fields is not.
    """
    for name in names:
        positive(getattr(effect, name), f"{name} of {effect.name}")


def checked_parameters(effect: Any, values: ArrayLike) -> Array:
    """Linear parameters (k,) of an effect, on its manifold or, where it has bounds, at one.

    Raises:
        ArgumentError: They are something else.
    """
    name = ", ".join(f"{p.name} ({p.unit})" for p in effect.parameters) or "no parameters"
    mu = real_array(values, f"{effect.name} of {effect.place}: {name}", (len(effect.parameters),))
    if isinstance(effect.manifold, Interval):
        good = all(p.lower <= x <= p.upper for p, x in zip(effect.parameters, mu, strict=True))
    else:
        good = bool(effect.manifold.contains(mu))
    if not good:
        raise ArgumentError(
            f"{effect.name} of {effect.place} cannot have {name} = {mu.tolist()}.",
            advice="Friction and inertia are not negative, and a payload is a body that can exist.",
        )
    return mu.copy()
