"""Motions for the parameters that are identifiable at all, [Lee2019] §4.5.2."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import instance, integer, number
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.excitation.criteria import Criterion
from geodrake.excitation.design import design_excitation
from geodrake.excitation.design_results import DesignOptions, DesignProgress, ExcitationResult
from geodrake.excitation.families import MotionFamily
from geodrake.excitation.limits import MotionLimits
from geodrake.excitation.target import Target

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ReducedExcitation(Short):
    """The best motion for as many parameters as are identifiable.

    Attributes:
        result: The motion; its criterion has r in `kept`, and its value is at most the threshold.
        kept: r, for `identifiable_parameters(..., kept=r)` of the motion's log (step b.4).
        tried: (r, optimized value) of every design, in the order of trial.
    """

    result: ExcitationResult
    kept: int
    tried: tuple[tuple[int, float], ...]


def design_reduced_excitation(
    target: Target,
    limits: MotionLimits | None = None,
    *,
    threshold: float,
    criterion: str = "e_optimality",
    trajectory: MotionFamily | None = None,
    options: DesignOptions | None = None,
    seeds: int = 1,
    progress: Callable[[DesignProgress], None] | None = None,
) -> ReducedExcitation:
    """The most parameters that a motion identifies well, and that motion, steps b.1 to b.3.

    The source takes off one direction after the other until the optimized criterion is below the
    threshold. The optimized criterion grows with r, and a motion designed for many directions says
    for how few its own value would do; so this halves the range of r in between instead.

    Args:
        limits: What the robot may do; the limits of its model file if None.
        threshold: ε_J for the criterion's value, which has no unit: with E-optimality, the
            variance of the worst direction.
        options: How each design is made.
        seeds: Random starts of each design; the best motion so far is one more.

    Raises:
        ArgumentError: As `design_excitation`; or no single direction is identifiable that well.
    """
    instance(target, "target", Target)
    number(threshold, "threshold")
    integer(seeds, "seeds", lower=0)
    given = DesignOptions() if options is None else options
    options = instance(given, "options", DesignOptions)
    tried: list[tuple[int, float]] = []

    def optimized(count: int, guess: Array | None) -> ExcitationResult:
        result = design_excitation(
            target,
            limits,
            criterion=Criterion(criterion, kept=count),
            trajectory=trajectory,
            options=replace(options, guess=guess),
            seeds=seeds,
            progress=progress,
        )
        tried.append((count, result.value))
        return result

    low, high = 0, target.base.rank + 1  # low is identifiable, high is not
    best, count, guess = None, target.base.rank, options.guess
    start = guess  # by which motion `low` is
    while high - low > 1:
        result = optimized(count, guess)
        guess = result.trajectory.coefficients
        if result.value <= threshold:
            low, best, start = count, result, guess
        else:
            high = count
            enough = _enough(result, criterion, threshold, most=high - 1)
            if enough > low:
                low, best, start = enough, None, guess  # by a motion that was designed for more
        count = (low + high) // 2
    if not low:
        raise ArgumentError(
            f"No motion found identifies even one direction to {threshold:g}: the best has "
            f"{min(value for _, value in tried):.3g}.",
            advice="Raise the threshold, give the robot more room and time, or measure better.",
        )
    return ReducedExcitation(best or optimized(low, start), low, tuple(tried))


def _enough(result: ExcitationResult, criterion: str, threshold: float, *, most: int) -> int:
    """The most directions, of at most so many, for which a motion is good enough as it is."""
    for count in range(most, 0, -1):
        if Criterion(criterion, kept=count).value(result.eigenvalues) <= threshold:
            return count
    return 0
