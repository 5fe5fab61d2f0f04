"""Linear parameters of effects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from geodrake.errors import ArgumentError


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


def require_positive(effect: Any, *names: str) -> None:
    """Refuses shape parameters of an effect that are not positive and finite.

    Raises:
        ArgumentError: One of the named fields is not.
    """
    for name in names:
        value = getattr(effect, name)
        if not 0.0 < value < np.inf:
            raise ArgumentError(f"{effect.name} needs a positive {name}; it got {value}.")
