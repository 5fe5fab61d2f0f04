"""Fits by Drake's conic solver, exact to rounding, and where the solver gives up."""

from __future__ import annotations

import time
from dataclasses import replace

from geodrake.errors import ConvergenceError, GeodrakeError, IdentificationError
from geodrake.identification.fit import FitResult, solve_fit
from geodrake.identification.newton import solve_newton
from geodrake.identification.problem import FitProblem

_CONIC = "clarabel"


def solve_surely(problem: FitProblem) -> FitResult:
    """The fit by Drake's conic solver, or by Newton's method where that gives up.

    Args:
        problem: What to fit; every inertia block has an entropic or quadratic prior.

    Raises:
        ArgumentError: No physical bodies inside all constraints reach the residual bound; its
            evidence has the `minimum` that they reach.
        IdentificationError: Neither solver found a solution, most often because there is none.
        ConvergenceError: The conic solver found none in time, and Newton's method none either.
    """
    begin = time.perf_counter()
    try:
        return solve_fit(problem, solver=_CONIC)
    except (IdentificationError, ConvergenceError) as error:
        failure: GeodrakeError = error
    try:
        fit = solve_newton(problem)
    except GeodrakeError as error:
        raise (error if "minimum" in error.evidence else failure) from None
    note = f"By Newton's method, as {_CONIC} gave up: {failure.problem}"
    return replace(fit, note=note, solve_time=time.perf_counter() - begin)


def solve_exactly(problem: FitProblem) -> FitResult:
    """The minimum of a fit to the last digit, whatever the frames and units.

    At the boundary of physical bodies a conic solver is good to some 1e-6 of a body; Newton's
    method from its solution adds the rest. Arguments and errors are those of `solve_surely`.
    """
    begin = time.perf_counter()
    fit = solve_surely(problem)
    if fit.solver != _CONIC:
        return fit
    try:
        exact = solve_newton(problem, start=fit.x, weight=fit.prior_weight)
    except GeodrakeError:  # rounding got in the way of the last digits
        return fit
    elapsed = time.perf_counter() - begin
    return replace(exact, solver=f"{_CONIC}, newton", solve_time=elapsed)
