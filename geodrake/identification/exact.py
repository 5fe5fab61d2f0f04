"""Fits exact to rounding: Newton's method, or where it gives up a conic solver and then Newton."""

from __future__ import annotations

import time
from dataclasses import replace

from geodrake.errors import ConvergenceError, GeodrakeError, IdentificationError
from geodrake.identification.fit import FitResult, solve_fit, solve_in_closed_form
from geodrake.identification.newton import solve_newton
from geodrake.identification.problem import FitProblem

_CONIC = "clarabel"


def solve_exactly(problem: FitProblem) -> FitResult:
    """The minimum of a fit, whatever the frames and units.

    Newton's method is the faster one, and runs in this process. Where it gives up, the conic solver
    starts far off as well as near; it is good to some 1e-6 of a body at the boundary of physical
    bodies, and can take a residual bound that bodies reach for one that they do not.

    Args:
        problem: What to fit; every inertia block has an entropic or quadratic prior.

    Raises:
        ArgumentError: No physical bodies inside all constraints reach the residual bound; its
            evidence has the `minimum` that they reach.
        IdentificationError: Neither solver found a solution, most often because there is none.
    """
    begin = time.perf_counter()
    quick = solve_in_closed_form(problem)
    if quick is not None:
        return quick
    try:
        return solve_newton(problem)
    except GeodrakeError as error:
        failure = error
    try:
        fit = solve_fit(problem, solver=_CONIC, shortcuts=False)
    except IdentificationError as error:
        raise (failure if "minimum" in failure.evidence else error) from None
    try:
        exact = solve_newton(problem, start=fit.x, weight=fit.prior_weight)
        fit = replace(exact, solver=f"{_CONIC}, newton")
    except GeodrakeError:
        pass  # rounding got in the way of the last digits
    note = f"From {_CONIC}, as Newton's method gave up: {failure.problem}"
    return replace(fit, note=note, solve_time=time.perf_counter() - begin)


def solve_surely(problem: FitProblem) -> FitResult:
    """The fit by `solve_fit`, or by Newton's method where that gives up.

    Args:
        problem: What to fit.

    Raises:
        IdentificationError: Neither solver found a solution, most often because there is none.
    """
    begin = time.perf_counter()
    try:
        return solve_fit(problem, solver=_CONIC)
    except (IdentificationError, ConvergenceError) as error:
        failure = error
    try:
        fit = solve_newton(problem)
    except GeodrakeError:
        raise failure from None
    note = f"By Newton's method, as {_CONIC} gave up: {failure.problem}"
    return replace(fit, note=note, solve_time=time.perf_counter() - begin)
