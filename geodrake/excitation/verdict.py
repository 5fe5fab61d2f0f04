"""What a designed motion amounts to, as numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geodrake.excitation.design_results import ExcitationResult
from geodrake.excitation.separation import Pair, Separation

CLEAR = 5.0
"""Standard deviations by which effects must differ for a log to distinguish them reliably."""

THRESHOLD = 1e-2
"""Largest relative variance of a direction that counts as identifiable, as for given logs."""


def identifiable_directions(result: ExcitationResult, threshold: float = THRESHOLD) -> int:
    """How many directions the motion's samples identify to within a relative variance.

    Meaningful for the geometric normalization, whose variances are relative.

    Args:
        threshold: Largest relative variance of a direction that counts as identified.
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


@dataclass(frozen=True)
class DistinguishedPair:
    """A pair of effects on a designed motion.

    Attributes:
        pair: Who is distinguished from whom.
        deviations: √Δ, by how many standard deviations of the noise of all samples together.
        effort: RMS of what the rival does not explain, at the joint where that is most, N·m or N.
    """

    pair: Pair
    deviations: float
    effort: float


def distinguished_pairs(result: ExcitationResult) -> tuple[DistinguishedPair, ...]:
    """The pairs of a motion that is to distinguish effects, the hardest first; else none."""
    objective, motion = result.objective, result.motion
    if not isinstance(objective, Separation):
        return ()
    values = np.sqrt(objective.separations(motion)).tolist(), objective.efforts(motion).tolist()
    found = [DistinguishedPair(*entry) for entry in zip(objective.pairs, *values, strict=True)]
    return tuple(sorted(found, key=lambda pair: pair.deviations))
