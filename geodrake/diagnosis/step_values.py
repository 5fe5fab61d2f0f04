"""Names, values and standard deviations of what was fitted, as steps report them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import FittedEffect

Array = NDArray[np.float64]

_SMALL = 1e-4
"""Share of a change at which what is reported is differentiated."""


def reported_parameters(fitted: FittedEffect) -> tuple[dict[str, float], dict[str, float]]:
    """Values and standard deviations of what an effect reports, by name, SI units."""
    unknown = np.full(len(fitted.parameters), np.nan)
    deviations = unknown if fitted.deviations is None else fitted.deviations
    return fitted.effect.reported(fitted.parameters, deviations)


def systematic_parameters(fitted: FittedEffect, shifts: Array) -> dict[str, float]:
    """Standard deviations of what an effect reports that do not come from noise.

    To first order, as the shifts are; shapes and what else has no deviation are left out.

    `shifts` (s, k) are what its parameters change by with each of s independent causes, such as the
    gain of a joint's efforts that is off by one standard deviation.
    """
    values, deviations = reported_parameters(fitted)
    squares = {name: 0.0 for name in values if name in deviations}
    for shift in _SMALL * shifts:
        moved, _ = reported_parameters(replace(fitted, parameters=fitted.parameters + shift))
        for name in squares:
            squares[name] += ((moved[name] - values[name]) / _SMALL) ** 2
    return {name: float(np.sqrt(square)) for name, square in squares.items()}


def factor_of(covariance: Array) -> Array:
    """(k, k) independent shifts, row by row, that have a covariance (k, k)."""
    values, axes = np.linalg.eigh(covariance)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * axes.T)
