"""A solver for entropic fits alone: some ten Newton steps on the triangular factor."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import ArrayLike

from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification.fit import FitResult, check_residual_bound, fit_result
from geodrake.identification.newton_path import (
    Minimum,
    cold_start,
    continued,
    minimize,
    warm_start,
)
from geodrake.identification.newton_program import NewtonProgram
from geodrake.identification.problem import FitProblem, checked

_SAME_RESIDUAL = 1e-10
"""Relative difference from the residual bound at which the root is found."""
_LEAP = 6.0
"""Largest change of log γ between two trials."""
_IDLE, _RIGID = 1e10, 1e-12
"""Weights, relative to the cost of the prior, at which data and prior no longer matter."""
_TRIALS = 60


def solve_newton(problem: FitProblem, *, start: ArrayLike | None = None) -> FitResult:
    """Fit parameters whose every inertia block has an entropic prior.

    The divergence keeps P(φ) ≻ 0 by itself, so `margin` plays no part here. In the point-to-set
    form the weight of the prior is the root of residual(γ) = residual_bound; all trials after
    the first start from the one before.

    Args:
        problem: What to fit.
        start: (p,) parameters close to the solution, to save some steps; the prior if None.

    Returns:
        The unique minimum, exact to rounding, with the information of data and prior together.

    Raises:
        ArgumentError: A block has no entropic prior, or the residual bound is below what physical
            bodies inside all constraints reach; its evidence has that `minimum`.
        IdentificationError: The constraints contradict each other.
    """
    begin = time.perf_counter()
    check_residual_bound(problem)
    program = NewtonProgram.of(problem)
    if problem.residual_bound is not None:
        minimum, weight = _bounded(program, problem.residual_bound, start)
    else:
        minimum, weight = _first(program, 1.0, start), 1.0
    return _result(minimum, weight, time.perf_counter() - begin)


def newton_sweep(problem: FitProblem, weights: ArrayLike) -> tuple[FitResult, ...]:
    """Fits with several weights of the whole prior, each started from the one before.

    Args:
        problem: What to fit, without a residual bound.
        weights: (k,) positive factors of the prior information and of every γ, best in order.

    Returns:
        One result for each weight, which is its `prior_weight`.

    Raises:
        ArgumentError: A weight is not positive, there is a residual bound, or a block has no
            entropic prior.
        IdentificationError: The constraints contradict each other.
    """
    weights = checked("weights", weights, (None,))
    if np.any(weights <= 0):
        raise ArgumentError(f"weights must be positive; the smallest is {weights.min():g}.")
    if problem.residual_bound is not None:
        raise ArgumentError(
            "A sweep over weights cannot keep a residual bound too.",
            advice="Solve each bound with `solve_newton`.",
        )
    begin = time.perf_counter()
    program = NewtonProgram.of(problem)
    results: list[FitResult] = []
    minimum: Minimum | None = None
    for weight in weights.tolist():
        minimum = _first(program, weight, None) if minimum is None else _next(minimum, weight)
        now = time.perf_counter()
        results.append(_result(minimum, weight, now - begin))
        begin = now
    return tuple(results)


def _first(program: NewtonProgram, weight: float, start: ArrayLike | None) -> Minimum:
    weighted = program.weighted(weight)
    if start is not None:
        x = checked("start", start, (program.size,))
        try:
            return minimize(weighted, warm_start(weighted, program.coordinates.at(x)))
        except IdentificationError:
            # A start can be too close to a boundary; from the prior there is always a way.
            pass
    return minimize(weighted, cold_start(weighted))


def _next(minimum: Minimum, weight: float) -> Minimum:
    """The minimum for another weight, from the one before it."""
    weighted = minimum.weighted.program.weighted(weight)
    try:
        return minimize(weighted, continued(minimum, weighted))
    except IdentificationError:
        return minimize(weighted, cold_start(weighted))


def _bounded(
    program: NewtonProgram, bound: float, start: ArrayLike | None
) -> tuple[Minimum, float]:
    """The minimum whose residual is the bound, and its weight; inf when the data are idle.

    Newton's method on log(residual excess) as a function of log γ, kept inside a bracket: the
    residual grows with γ.
    """
    wanted = bound - program.floor
    scale = program.excess(cold_start(program.weighted(1.0)).z) + wanted
    low, high = float(np.log(_RIGID * scale)), float(np.log(_IDLE * scale))
    ends = (low, high)
    u = float(np.log(wanted))
    minimum = _first(program, float(np.exp(u)), start)
    for _ in range(_TRIALS):
        miss = minimum.excess - wanted
        if abs(miss) <= _SAME_RESIDUAL * bound:
            return minimum, minimum.weighted.weight
        if miss > 0 and u <= ends[0]:
            raise _out_of_reach(bound, program.floor + minimum.excess)
        if miss < 0 and u >= ends[1]:
            return minimum, np.inf
        low, high = (u, high) if miss < 0 else (low, u)
        trial = u + _leap(minimum, wanted)
        if not low < trial < high:
            # An end that was not tried yet is as good as any.
            untried = (trial <= low == ends[0]) or (trial >= high == ends[1])
            trial = float(np.clip(trial, low, high)) if untried else 0.5 * (low + high)
        u = trial
        minimum = _next(minimum, float(np.exp(u)))
    raise IdentificationError(
        f"newton found no weight of the prior with the residual {bound:.6g}; the last residual "
        f"was {program.floor + minimum.excess:.6g}.",
        advice="Check units and noise levels, or use the solver clarabel.",
        solver="newton",
    )


def _leap(minimum: Minimum, wanted: float) -> float:
    """Newton's change of log γ towards the wanted residual, of limited length."""
    distance = float(np.log(wanted / minimum.excess))
    slope = minimum.derivative() / minimum.excess
    return float(np.clip(distance / slope if slope > 0 else distance, -_LEAP, _LEAP))


def _out_of_reach(bound: float, minimum: float) -> ArgumentError:
    return ArgumentError(
        f"residual_bound is {bound:.6g}, but the least squared residual that physical bodies "
        f"inside all constraints reach is {minimum:.6g}.",
        advice="Take a bound above that.",
        minimum=minimum,
    )


def _result(minimum: Minimum, weight: float, elapsed: float) -> FitResult:
    coordinates = minimum.weighted.program.coordinates
    problem = coordinates.problem
    x = coordinates.parameters(minimum.point.z)
    x = np.clip(x, problem.lower, problem.upper)
    return fit_result(coordinates, x, weight, "newton", elapsed)
