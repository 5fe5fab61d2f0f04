"""Mirror lines and spans: what is straight in the gradient of a barrier.

    ∇h(y(t)) = ∇h(x) + t b,   ∇h(y(λ)) = ∇h(x) + Aᵀ λ

Projections move along them ([Lee2019] Eq. (2.2.11): the optimum differs from x in its gradient by a
combination of rows), and they never leave the manifold.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

Array = NDArray[np.float64]

_LARGEST_CHANGE = 1e6  # what a time may multiply a part of a point by
_LEAST_SPEED = 1e-150  # so that times, and their products with covectors, stay finite
_GROWTH = 8.0
_MOST_BISECTIONS = 60


@dataclass(frozen=True, eq=False)
class MirrorLine:
    """The mirror line from a point x along a covector b."""

    point: Callable[[float], Array]  # maps a time t ≥ 0 to y(t), of the shape of x
    value: Callable[[float], float]  # maps a time to bᵀ y(t), which rises with t
    longest: float  # time at which the line ends at infinity; inf for never
    scale: float  # a time in which the line goes a length of about one in the metric

    def time_of(
        self, target: float, *, most: float = np.inf, enough: tuple[float, float] | None = None
    ) -> float:
        """Return the time at which the value reaches a target, or the end of the line.

        Args:
            enough: How far the value at t = 1 may be from the target, below and above, so that this
                time will do; None to look for the exact one.
        """

        def surplus(t: float) -> float:
            return self.value(t) - target

        end = min(self.longest * (1.0 - 1.0 / _LARGEST_CHANGE), self.scale * _LARGEST_CHANGE, most)
        low, high = 0.0, min(self.scale if enough is None else 1.0, end)
        for _ in range(_MOST_BISECTIONS):
            off = surplus(high)
            if enough and high == 1.0 and enough[0] <= off <= enough[1]:
                return high
            if off >= 0:
                if surplus(low) >= 0:  # as far as rounding tells, at the target from the start
                    return high if enough and high == 1.0 else low
                return float(brentq(surplus, low, high, xtol=1e-300, rtol=1e-14))
            if np.isfinite(off):
                low = high
                if high == end:
                    break
                high = min(_GROWTH * high, end)
            else:  # no such point
                end = high = 0.5 * (low + high)
        return low


class MirrorSpan(NamedTuple):
    """The mirror lines from a point x (n,) along all combinations of covectors A (k, n)."""

    # Pairs of matrices L, R (k, m) with A g(x)⁻¹ Aᵀ = Σ L Rᵀ, one a kind of factors.
    halves: tuple[tuple[Array, Array], ...]
    # Maps multipliers λ (k,) to y(λ) (n,), which is outside of the manifold, or not a number, where
    # there is no such point.
    point: Callable[[Array], Array]

    @property
    def products(self) -> Array:
        """(k, k) inner products A g(x)⁻¹ Aᵀ of the covectors, a new array."""
        (left, right), *others = self.halves
        products = left @ right.T
        for left, right in others:
            products += left @ right.T
        return products

    @property
    def squared_length(self) -> float:
        """tr(A g(x)⁻¹ Aᵀ), of all covectors together."""
        total = 0.0
        for left, right in self.halves:
            total += float(np.vdot(left, right))
        return total


def joined(lines: list[tuple[NDArray[np.intp], float, MirrorLine]], x: Array) -> MirrorLine:
    """Return the line of a product from those of its factors, with their places and weights.

    Args:
        lines: Of each kind of factors: the places of their coordinates, their weight in the
            barrier, and their line.
        x: (n,) point of the product from which the lines start.
    """

    def point(t: float) -> Array:
        y = x.copy()
        for places, _, line in lines:
            y[places] = line.point(t)
        return y

    def value(t: float) -> float:
        return sum(weight * line.value(t) for _, weight, line in lines)

    longest = min((line.longest for _, _, line in lines), default=np.inf)
    scale = min((line.scale for _, _, line in lines), default=scale_of(0.0))
    return MirrorLine(point, value, longest, scale)


def scale_of(speed: float) -> float:
    """Return the time in which a line of a speed ≥ 0 moves about 1; large if it stays."""
    return 1.0 / max(speed, _LEAST_SPEED)
