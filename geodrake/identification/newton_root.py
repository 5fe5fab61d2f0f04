"""Minima for several weights of the prior: each from the one before, up to a wanted residual."""

from __future__ import annotations

import numpy as np

from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification.newton_path import (
    Minimum,
    cold_start,
    continued,
    minimize,
    warm_start,
)
from geodrake.identification.newton_program import NewtonProgram
from geodrake.inertia import Array

_SAME_RESIDUAL = 1e-10
"""Relative difference from the residual bound at which the root is found."""
_LEAP = 6.0
"""Largest change of log γ between two trials."""
_IDLE, _RIGID = 1e10, 1e-12
"""Weights, relative to the cost of the prior, at which data and prior no longer matter."""
_TRIALS = 60


def first_minimum(program: NewtonProgram, weight: float, start: Array | None = None) -> Minimum:
    """The minimum for a weight, from parameters (p,) close to it or from the prior.

    Args:
        program: The program.
        weight: Weight w of the regularizer.
        start: (p,) parameters close to the minimum; None to start from the prior.
    """
    weighted = program.weighted(weight)
    if start is not None:
        try:
            return minimize(weighted, warm_start(weighted, program.coordinates.at(start)))
        except IdentificationError:
            # A start can be too close to a boundary; from the prior there is always a way.
            pass
    return minimize(weighted, cold_start(weighted))


def next_minimum(minimum: Minimum, weight: float) -> Minimum:
    """The minimum for another weight, from the one before it.

    Args:
        minimum: The minimum for the weight before.
        weight: Weight w of the regularizer.
    """
    weighted = minimum.weighted.program.weighted(weight)
    try:
        return minimize(weighted, continued(minimum, weighted))
    except IdentificationError:
        return minimize(weighted, cold_start(weighted))


def bounded_minimum(
    program: NewtonProgram,
    bound: float,
    start: Array | None = None,
    weight: float | None = None,
) -> tuple[Minimum, float]:
    """The minimum whose residual is the bound, and its weight; inf when the data are idle.

    Newton's method on log(residual excess) as a function of log γ, kept inside a bracket: the
    residual grows with γ ([Lee2019] Propositions A.4 and A.5).

    Args:
        program: What to fit.
        bound: Greatest squared residual, above that of any parameters.
        start: (p,) parameters close to the solution; the prior if None.
        weight: A weight close to that of the solution.

    Raises:
        ArgumentError: The bound is below what physical bodies inside all constraints reach; its
            evidence has that `minimum`.
        IdentificationError: The constraints contradict each other, or rounding got in the way.
    """
    wanted = max(bound - program.floor, np.finfo(float).tiny)
    scale = (program.excess(program.middle()) + wanted) / program.strength
    low, high = float(np.log(_RIGID * scale)), float(np.log(_IDLE * scale))
    ends = (low, high)
    guess = wanted / program.strength if weight is None else weight
    u = float(np.clip(np.log(guess), low, high))
    minimum = first_minimum(program, float(np.exp(u)), start)
    for _ in range(_TRIALS):
        miss = minimum.excess - wanted
        if abs(miss) <= _SAME_RESIDUAL * bound:
            return minimum, minimum.weighted.weight
        if miss > 0 and u <= ends[0]:
            raise out_of_reach(bound, program.floor + minimum.excess)
        if miss < 0 and u >= ends[1]:
            return minimum, np.inf
        low, high = (u, high) if miss < 0 else (low, u)
        trial = u + _leap(minimum, wanted)
        if not low < trial < high:
            # An end that was not tried yet is as good as any.
            untried = (trial <= low == ends[0]) or (trial >= high == ends[1])
            trial = float(np.clip(trial, low, high)) if untried else 0.5 * (low + high)
        u = trial
        minimum = next_minimum(minimum, float(np.exp(u)))
    raise IdentificationError(
        f"newton found no weight of the prior with the residual {bound:.6g}; the last residual "
        f"was {program.floor + minimum.excess:.6g}.",
        advice="Check units and noise levels, or use the solver clarabel.",
        solver="newton",
    )


def _leap(minimum: Minimum, wanted: float) -> float:
    """Newton's change of log γ towards the wanted residual, of limited length."""
    if minimum.excess <= 0.0:  # no parameters change the residual, or the prior fits exactly
        return _LEAP
    distance = float(np.log(wanted / minimum.excess))
    slope = minimum.derivative() / minimum.excess
    return float(np.clip(distance / slope if slope > 0 else distance, -_LEAP, _LEAP))


def out_of_reach(bound: float, minimum: float) -> ArgumentError:
    """What is wrong with a residual bound below the minimum that bodies reach.

    Args:
        bound: The residual bound that was asked for.
        minimum: The least squared residual.
    """
    return ArgumentError(
        f"residual_bound is {bound:.10g}, but the least squared residual that physical bodies "
        f"inside all constraints reach is {minimum:.10g}.",
        advice="Take a bound above that.",
        minimum=minimum,
    )
