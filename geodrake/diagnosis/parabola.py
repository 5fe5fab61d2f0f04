"""The least error between values of a nonlinear parameter that were tried, such as a delay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Least:
    """The least error near a value of a parameter.

    Attributes:
        step: From that value to where the error is least, within what was tried.
        gain: How much less it is there.
        deviation: Standard deviation of the step where errors are twice log-likelihoods; infinite
            where there is no minimum.
    """

    step: float
    gain: float
    deviation: float


def least_between(offsets: Array, errors: Array) -> Least:
    """The minimum of the parabola through three errors; no step where it has none.

    Args:
        offsets: (3,) values of a parameter, in order, from the middle one on, which is zero.
        errors: (3,) errors there.
    """
    (first, _, last), (low, middle, high) = offsets.tolist(), errors.tolist()
    slopes = (low - middle) / first, (high - middle) / last
    curvature = (slopes[1] - slopes[0]) / (last - first)
    slope = slopes[0] - curvature * first
    if curvature <= 0.0:
        return Least(0.0, 0.0, float("inf"))
    step = float(np.clip(-slope / (2.0 * curvature), offsets[0], offsets[-1]))
    return Least(step, -(slope + curvature * step) * step, curvature**-0.5)
