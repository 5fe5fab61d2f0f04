"""Terms as columns of a dataset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.drafting.formula import Formula
from geodrake.effects import Effect, Parameter, RobotMotion

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TermColumns(Effect):
    """The terms of a formula, each with a coefficient of its own, as an effect of its joint.

    What a search works with; a draft is written out as a class of its own.
    """

    formula: Formula
    name: ClassVar[str] = "draft"
    places: ClassVar[str] = "joint"

    @property
    def parameters(self) -> tuple[Parameter, ...]:  # type: ignore[override]
        """The coefficients."""
        return self.formula.parameters

    @property
    def where(self) -> tuple[str, ...]:
        """The joint."""
        return (self.formula.joint,)

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """Columns at the joint."""
        return {self.formula.joint: self.formula.columns(motion)}
