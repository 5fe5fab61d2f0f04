"""Mirror lines: the curves that are straight in the gradient of a barrier.

    ∇h(y(t)) = ∇h(x) + t b

Projections move along them ([Lee2019] Eq. (2.2.11): the optimum differs from x in its gradient by a
combination of rows), and they never leave the manifold.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MirrorLine:
    """The mirror line from a point x along a covector b.

    Attributes:
        point: Maps a time t ≥ 0 to y(t) (n,).
        value: Maps a time to bᵀ y(t), which rises with t.
        longest: Time at which the line ends at infinity; inf for never.
        scale: A time in which the line goes a length of about one in the metric.
    """

    point: Callable[[float], Array]
    value: Callable[[float], float]
    longest: float
    scale: float


def joined(lines: list[tuple[slice, float, MirrorLine]], x: Array) -> MirrorLine:
    """The line of a product from those of its factors, with their places and weights."""

    def point(t: float) -> Array:
        y = x.copy()
        for place, _, line in lines:
            y[place] = line.point(t)
        return y

    def value(t: float) -> float:
        return sum(weight * line.value(t) for _, weight, line in lines)

    longest = min((line.longest for _, _, line in lines), default=np.inf)
    return MirrorLine(point, value, longest, min(line.scale for _, _, line in lines))
