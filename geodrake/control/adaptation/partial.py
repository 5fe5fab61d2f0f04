"""Update laws of some of the parameters, [Lee2019] §5.5.2."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import instance, mask
from geodrake.boundary.showing import Short
from geodrake.control.adaptation.law import UpdateLaw
from geodrake.errors import ArgumentError
from geodrake.inertia import Array


@dataclass(frozen=True, eq=False)
class PartialLaw(UpdateLaw, Short):
    """A law of some parameters, such as those of a load; the others are known and stay as they are.

    It is the law of the submanifold on which only those parameters vary: V̇_t ≤ (p̂ − p)ᵀ b has no
    part of parameters that are equal to the truth. What is held does not change by a single bit.

    Attributes:
        law: The law of the k parameters that are adapted, on their own manifold.
        adapted: (n,) booleans, true for these k; `adapted_parameters` makes them from names.

    Raises:
        ArgumentError: The law moves another number of parameters, or none is adapted.
    """

    law: UpdateLaw
    adapted: NDArray[np.bool_]

    def __post_init__(self) -> None:
        instance(self.law, "law", UpdateLaw)
        adapted = mask(self.adapted, "adapted")
        if not adapted.any():
            raise ArgumentError("adapted must be booleans (n,), some of them true.")
        if self.law.dimension not in (None, count := int(adapted.sum())):
            raise ArgumentError(
                f"The law moves {self.law.dimension} parameters; {count} are to be adapted.",
                advice="Make its manifold of just these, such as PhysicalInertia() for one body.",
            )
        object.__setattr__(self, "adapted", adapted.copy())

    @cached_property
    def _places(self) -> NDArray[np.intp]:
        return np.flatnonzero(self.adapted)

    @property
    def slowness(self) -> float:
        """That of the law of what is adapted."""
        return self.law.slowness

    def with_slowness(self, gamma: float) -> PartialLaw:
        """Return the same law with another γ."""
        return replace(self, law=self.law.with_slowness(gamma))

    @property
    def dimension(self) -> int:
        """Number n of all parameters."""
        return len(self.adapted)

    def calc_contains(self, parameters: Array) -> bool:
        """Return whether what is adapted of an estimate (n,) is one that its law can move."""
        return self.law.calc_contains(self._own(parameters))

    def calc_reach(self, parameters: Array, rows: Array) -> float:
        """That of what is adapted."""
        return self.law.calc_reach(self._own(parameters), self._own(rows))

    def calc_rate(self, parameters: Array, b: Array) -> Array:
        """Return the rate (n,), zero for what is held."""
        rate = np.zeros(len(self.adapted))
        rate[self._places] = self.law.calc_rate(self._own(parameters), self._own(b))
        return rate

    def calc_step(self, parameters: Array, b: Array, dt: float) -> Array:
        """Return the estimate (n,) after dt seconds, what is held as it was."""
        following = parameters.copy()
        following[self._places] = self.law.calc_step(self._own(parameters), self._own(b), dt)
        return following

    def calc_parameter_error(self, truth: Array, parameters: Array) -> Array:
        """V_p of what is adapted."""
        return self.law.calc_parameter_error(self._own(truth), self._own(parameters))

    def _own(self, values: Array) -> Array:
        return values[..., self._places]
