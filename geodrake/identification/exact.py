"""Fits exact to rounding: Drake's conic solver first, Newton's method from its solution."""

from __future__ import annotations

import time
from dataclasses import replace

from geodrake.errors import GeodrakeError, IdentificationError
from geodrake.identification.fit import FitResult, solve_fit
from geodrake.identification.newton import solve_newton
from geodrake.identification.problem import FitProblem

_CONIC = "clarabel"


def solve_exactly(problem: FitProblem) -> FitResult:
    """The minimum of a fit, whatever the frames and units, and where the conic solver gives up.

    At the boundary of physical bodies a conic solver is good to some 1e-6 of a body, and it can
    take a residual bound that bodies reach for one that they do not.

    Args:
        problem: What to fit; every inertia block has an entropic or quadratic prior.

    Raises:
        ArgumentError: No physical bodies inside all constraints reach the residual bound; its
            evidence has the `minimum` that they reach.
        IdentificationError: Neither solver found a solution, most often because there is none.
    """
    begin = time.perf_counter()
    try:
        fit = solve_fit(problem, solver=_CONIC)
    except IdentificationError as failure:
        try:
            return solve_newton(problem)
        except IdentificationError:
            raise failure from None
    if fit.solver != _CONIC:
        return fit
    try:
        exact = solve_newton(problem, start=fit.x, weight=fit.prior_weight)
    except GeodrakeError:  # rounding got in the way of the last digits
        return fit
    elapsed = time.perf_counter() - begin
    return replace(exact, solver=f"{_CONIC}, newton", solve_time=elapsed)
