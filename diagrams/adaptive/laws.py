"""The laws that are compared, with names and colours ([Lee2019] §5.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.control import euclidean_adaptation, natural_adaptation, pullback_adaptation
from geodrake.control.adaptation import UpdateLaw
from geodrake.manifolds import Manifold

Array = NDArray[np.float64]

NONE, EUCLIDEAN, PULLBACK, NATURAL = "none", "euclidean", "pullback", "natural"
NATURAL_EULER = "natural_euler"
LAWS = (NONE, EUCLIDEAN, PULLBACK, NATURAL)
LABELS = {
    NONE: "no adaptation",
    EUCLIDEAN: "Euclidean",
    PULLBACK: "constant pullback",
    NATURAL: "natural",
    NATURAL_EULER: "natural, Euler steps",
}
COLORS = {
    NONE: "#6b7683",
    EUCLIDEAN: "#c8442f",
    PULLBACK: "#3f9c6b",
    NATURAL: "#1b6ca8",
    NATURAL_EULER: "#9cc3e0",
}
SOURCE_SPEEDS = {EUCLIDEAN: 5e-5, PULLBACK: 1.0, NATURAL: 1.0, NATURAL_EULER: 1.0}
"""γ⁻¹ of [Lee2019] §5.5."""


def make_law(name: str, manifold: Manifold, start: ArrayLike, speed: float) -> UpdateLaw | None:
    """A law by its name.

    Args:
        name: One of `LAWS`, or NATURAL_EULER.
        manifold: Of the parameters that are adapted.
        start: First estimate of them.
        speed: γ⁻¹.
    """
    if name == NONE:
        return None
    gamma = 1.0 / speed
    if name == EUCLIDEAN:
        return euclidean_adaptation(manifold.dimension, gamma)
    if name == PULLBACK:
        return pullback_adaptation(manifold, start, gamma)
    return natural_adaptation(
        manifold, gamma, integrator="euler" if name == NATURAL_EULER else "geodesic"
    )


@dataclass(frozen=True, eq=False)
class PartialLaw(UpdateLaw):
    """A law of some parameters; the others are known and stay.

    Attributes:
        law: The law.
        part: (p,) which parameters it moves.
    """

    law: UpdateLaw
    part: NDArray[np.bool_]

    def rate(self, parameters: ArrayLike, b: ArrayLike) -> Array:
        """The rate (p,), zero for what is known."""
        rate = np.zeros(len(self.part))
        rate[self.part] = self.law.rate(self._own(parameters), self._own(b))
        return rate

    def step(self, parameters: ArrayLike, b: ArrayLike, dt: float) -> Array:
        """The estimate (p,) after dt seconds."""
        following = np.array(parameters, float)
        following[self.part] = self.law.step(self._own(parameters), self._own(b), dt)
        return following

    def parameter_error(self, truth: ArrayLike, parameters: ArrayLike) -> Array:
        """V_p of what is adapted."""
        return self.law.parameter_error(self._own(truth), self._own(parameters))

    def _own(self, values: ArrayLike) -> Array:
        return np.asarray(values, float)[..., self.part]
