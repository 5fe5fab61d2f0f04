"""An effect with values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geodrake.boundary.arguments import instance, real_array
from geodrake.boundary.showing import Short
from geodrake.effects.base import Array, Effect
from geodrake.errors import ArgumentError


@dataclass(frozen=True, eq=False)
class FittedEffect(Short):
    """An effect with the values of its linear parameters.

    Attributes:
        effect: The effect at its place.
        parameters: (k,) values, in the order and units of `effect.parameters`.
        deviations: (k,) their standard deviations; None for values that were not fitted.
    """

    effect: Effect
    parameters: Array
    deviations: Array | None = None

    def __post_init__(self) -> None:
        shape = (len(instance(self.effect, "effect", Effect).parameters),)
        name = f"{self.effect.name} of {self.effect.place}"
        values = real_array(self.parameters, f"parameters of {name}", shape)
        object.__setattr__(self, "parameters", values)
        if self.deviations is not None:
            values = real_array(self.deviations, f"deviations of {name}", shape, finite=False)
            if np.isnan(values).any():
                raise ArgumentError(
                    f"deviations of {name} hold NaN; what is not known at all has infinity."
                )
            object.__setattr__(self, "deviations", values)
