"""The laws that are compared, with names and colours ([Lee2019] §5.5)."""

from __future__ import annotations

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
