"""Certify a fit by its MathematicalProgram: solve it, and compare its solution with the fit.

The closed forms and Newton's method that find a fit have no say in this: costs and constraints are
those that Drake evaluates of the program, and the minimum is that of a conic solver.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

import numpy as np

from geodrake.errors import ArgumentError, ConvergenceError, IdentificationError
from geodrake.identification.conic_fit import conic_solution
from geodrake.identification.fit import TOLERANCE, Certificate, FitResult, Scope, fit_result
from geodrake.identification.problem import FitProblem
from geodrake.identification.program import build_fit
from geodrake.identification.solvers import solved_apart

SOLVER = "clarabel"


def certified(
    problem: FitProblem, fit: FitResult, *, size: float | None = None, scope: Scope = "global"
) -> FitResult:
    """Return the fit with its certificate; where the program has a better solution, that one.

    Better is a solution inside all constraints whose cost is lower by more than `TOLERANCE` of the
    cost, or any such one where the fit is outside of them.

    Of a cost that is not convex, the problem is its second order at the fit, and the scope "local".
    The size of the cost is by default that of the program, and the residual.
    """
    begin = time.perf_counter()
    try:
        program = build_fit(problem, centre=fit.x)
        cost, violation = program.evaluated(fit.x)
    except (np.linalg.LinAlgError, ArgumentError) as error:
        if scope == "local" and isinstance(error, ArgumentError):
            raise  # its second order is no convex program
        return uncertified(fit, "rounding leaves its program no digits", scope)
    if size is None:
        size = program.cost_scale + (fit.residual if problem.residual_bound is None else 0.0)
    told = Certificate(solver=SOLVER, gap=np.inf, cost=size, violation=violation, scope=scope)
    try:
        x, weight, accuracy = solved_apart(partial(conic_solution, problem, SOLVER, fit.x), SOLVER)
        least, beyond = program.evaluated(x)
    except (IdentificationError, ConvergenceError) as error:
        return replace(fit, certificate=replace(told, failure=error.problem))
    gap = cost - least
    worse = gap > TOLERANCE * size or violation > TOLERANCE
    if worse and beyond <= TOLERANCE and scope == "global":
        outside = f"outside constraints by {violation:.1e}"
        above = f"above the least cost by {gap / size:.1e} of it"
        why = outside if violation > TOLERANCE else above
        note = f"By {SOLVER}, as the fit of {fit.solver} was {why}"
        fit = replace(fit_result(problem, x, weight, SOLVER, begin - fit.solve_time), note=note)
        told, gap = replace(told, violation=beyond, replaced=True), 0.0
    left = max(accuracy * program.cost_scale, np.finfo(float).eps * size)
    return replace(fit, certificate=replace(told, gap=max(gap, 0.0) + left))


def uncertified(fit: FitResult, failure: str, scope: Scope = "global") -> FitResult:
    """Return the fit with a certificate that says in words why there is none."""
    none = Certificate(
        solver=SOLVER, gap=np.inf, cost=np.nan, violation=np.nan, scope=scope, failure=failure
    )
    return replace(fit, certificate=none)
