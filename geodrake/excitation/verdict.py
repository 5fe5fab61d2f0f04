"""What a designed motion amounts to, as numbers and in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geodrake.excitation.design_results import ExcitationResult
from geodrake.excitation.separation import Pair, Separation

CLEAR = 5.0
"""Standard deviations by which effects must differ for a log to tell them apart reliably."""

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


@dataclass(frozen=True)
class Told:
    """A pair of effects on a designed motion.

    Attributes:
        pair: Who is told from whom.
        deviations: √Δ, by how many standard deviations of the noise of all samples together.
        effort: RMS of what the rival does not explain, at the joint where that is most, N·m or N.
    """

    pair: Pair
    deviations: float
    effort: float


def told_apart(result: ExcitationResult) -> tuple[Told, ...]:
    """The pairs of a motion that is to tell effects apart, the hardest first; else none."""
    objective, motion = result.objective, result.motion
    if not isinstance(objective, Separation):
        return ()
    values = np.sqrt(objective.separations(motion)).tolist(), objective.efforts(motion).tolist()
    found = [Told(*entry) for entry in zip(objective.pairs, *values, strict=True)]
    return tuple(sorted(found, key=lambda told: told.deviations))


def verdict(result: ExcitationResult) -> str:
    """What the design amounts to, in a few sentences."""
    pairs = told_apart(result)
    if pairs:
        return _separation_verdict(result, pairs)
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


def _separation_verdict(result: ExcitationResult, pairs: Sequence[Told]) -> str:
    hardest, gained = pairs[0], np.sqrt(improvement(result))
    place = "/".join(hardest.pair.where) or "the robot"
    unit = "N·m or N" if result.objective.target.model.sliding_joints else "N·m"
    words = (
        f"Every pair differs by at least {hardest.deviations:.3g} standard deviations of the noise "
        f"of all {result.samples} samples together, {_times(gained)} what the best random motion "
        f"makes of it. Hardest to tell is {hardest.pair.truth} of {place} from "
        f"{hardest.pair.rival}, which leaves an effort of {hardest.effort:.3g} {unit} RMS "
        "unexplained."
    )
    if hardest.deviations < CLEAR:
        words += " That is little: such a log will hardly tell them apart."
    return words


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 1.0 else f"{share:.3g} times its size"


def _times(factor: float) -> str:
    return f"{factor:.3g} times" if np.isfinite(factor) else "infinitely"
