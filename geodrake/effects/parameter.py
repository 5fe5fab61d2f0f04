"""Linear parameters of effects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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
