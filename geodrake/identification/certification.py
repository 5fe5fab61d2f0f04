"""Certify a fit by its MathematicalProgram: solve it, and compare its solution with the fit.

The closed forms and Newton's method that find a fit have no say in this: costs and constraints are
those that Drake evaluates of the program, and the minimum is that of a conic solver.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from geodrake.errors import ConvergenceError, IdentificationError
from geodrake.identification.certificate import TOLERANCE, Certificate, Scope
from geodrake.identification.conic_fit import parameters_of, prior_weight_of
from geodrake.identification.fit import FitResult, fit_result
from geodrake.identification.problem import FitProblem
from geodrake.identification.program import FitProgram, build_fit
from geodrake.identification.solvers import Tolerances, run_to_gap, solved_apart
from geodrake.inertia import Array

SOLVER = "clarabel"


def certified(
    problem: FitProblem,
    fit: FitResult,
    *,
    size: float | None = None,
    scope: Scope = "global",
) -> FitResult:
    """The fit with its certificate; where the program has a better solution, that one.

    Better is a solution inside all constraints whose cost is lower by more than `TOLERANCE` of the
    cost, or any such one where the fit is outside of them.

    Args:
        problem: What was fitted; of a cost that is not convex, its second order at the fit.
        fit: The fit.
        size: Size of the cost; by default that of the program, and the residual.
        scope: See `Certificate`.
    """
    begin = time.perf_counter()
    try:
        program = build_fit(problem, centre=fit.x)
        here = ProgramPoint.of(program, fit.x)
    except np.linalg.LinAlgError:
        return uncertified(fit, "rounding leaves its program no digits", scope=scope)
    if size is None:
        size = program.cost_scale + (fit.residual if problem.residual_bound is None else 0.0)
    try:
        x, weight, accuracy = solved_apart(partial(_solution, problem, fit.x), SOLVER)
        there = ProgramPoint.of(program, x)
    except (IdentificationError, ConvergenceError) as error:
        return uncertified(fit, error.problem, scope=scope, cost=size, violation=here.violation)
    gap = here.cost - there.cost
    worse = gap > TOLERANCE * size or here.violation > TOLERANCE
    replaced = worse and there.violation <= TOLERANCE and scope == "global"
    if replaced:
        outside = f"outside constraints by {here.violation:.1e}"
        above = f"above the least cost by {gap / size:.1e} of it"
        why = outside if here.violation > TOLERANCE else above
        note = f"By {SOLVER}, as the fit of {fit.solver} was {why}"
        elapsed = fit.solve_time + time.perf_counter() - begin
        fit = replace(fit_result(program.coordinates, x, weight, SOLVER, elapsed), note=note)
        gap, here = 0.0, there
    certificate = Certificate(
        solver=SOLVER,
        gap=max(gap, 0.0) + max(accuracy * program.cost_scale, np.finfo(float).eps * size),
        cost=size,
        violation=here.violation,
        scope=scope,
        replaced=replaced,
    )
    return replace(fit, certificate=certificate)


@dataclass(frozen=True)
class ProgramPoint:
    """What a program says of parameters.

    Attributes:
        cost: Its cost, in the unit of the fit's, less a constant.
        violation: How far they are outside its constraints at most, in its variables.
    """

    cost: float
    violation: float

    @classmethod
    def of(cls, fit: FitProgram, x: Array) -> ProgramPoint:
        """The point of some parameters.

        Args:
            fit: The program.
            x: (p,) parameters, their entropic blocks physical.
        """
        program, values = fit.program, fit.point(x)
        costs = [float(program.EvalBinding(c, values)[0]) for c in program.GetAllCosts()]
        beyond = [0.0]
        for constraint in program.GetAllConstraints():
            reached, limits = program.EvalBinding(constraint, values), constraint.evaluator()
            beyond.append(float((limits.lower_bound() - reached).max(initial=0.0)))
            beyond.append(float((reached - limits.upper_bound()).max(initial=0.0)))
        return cls(fit.cost_scale * sum(costs), max(beyond))


def _solution(
    problem: FitProblem, centre: Array, accuracies: Sequence[Tolerances]
) -> tuple[Array, float, float]:
    """The solver's parameters (p,), the weight of their prior, and the duality gap it left."""
    fit = build_fit(problem, centre=centre)
    result, gap = run_to_gap(fit.program, SOLVER, accuracies)
    x = parameters_of(fit, result)
    return x, prior_weight_of(fit, result, x), gap


def uncertified(
    fit: FitResult,
    failure: str,
    *,
    scope: Scope = "global",
    cost: float = np.nan,
    violation: float = np.nan,
) -> FitResult:
    """The fit with a certificate that says why there is none.

    Args:
        fit: The fit.
        failure: Why its program has no solution, in words.
        scope: See `Certificate`.
        cost: Size of the cost, if it is known.
        violation: Greatest violation of a constraint, if it is known.
    """
    certificate = Certificate(
        solver=SOLVER, gap=np.inf, cost=cost, violation=violation, scope=scope, failure=failure
    )
    return replace(fit, certificate=certificate)
