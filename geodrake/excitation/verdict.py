"""What a designed motion amounts to, as numbers and in words."""

from __future__ import annotations

import numpy as np

from geodrake.excitation.design_results import ExcitationResult

THRESHOLD = 1e-2
"""Largest relative variance of a direction that counts as told, as for given logs."""


def directions_told(result: ExcitationResult, threshold: float = THRESHOLD) -> int:
    """How many directions the motion's samples tell to within a relative variance.

    Meaningful for the geometric normalization, whose variances are relative.
    """
    return int(np.count_nonzero(result.eigenvalues * threshold >= 1.0))


def improvement(result: ExcitationResult) -> float:
    """By what factor the best random motion that a start began with is worse.

    Of D-optimality, the factor of the geometric mean of the variances.
    """
    random = min(outcome.random_value for outcome in result.outcomes)
    if result.objective.criterion.name == "d_optimality":
        return float(np.exp((random - result.value) / len(result.eigenvalues)))
    return random / result.value if np.isfinite(random) else np.inf


def verdict(result: ExcitationResult) -> str:
    """What the design amounts to, in a few sentences."""
    criterion, normalization = result.objective.criterion.name, result.objective.normalization
    words = f"{criterion.replace('_', ' ')} {result.value:.3g}"
    if criterion == "e_optimality" and normalization == "geometric":
        words += f": the worst direction has a deviation of {_percent(np.sqrt(result.value))}"
    words += f"; {_times(improvement(result))} better than the best random motion."
    if normalization == "geometric":
        words += (
            f" Its {result.samples} samples tell {directions_told(result)} of "
            f"{len(result.eigenvalues)} directions to within {_percent(np.sqrt(THRESHOLD))}."
        )
    return words[:1].upper() + words[1:]


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 1.0 else f"{share:.3g} times its size"


def _times(factor: float) -> str:
    return f"{factor:.3g} times" if np.isfinite(factor) else "infinitely"
