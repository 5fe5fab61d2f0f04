"""Solve a fit: in closed form where that is exact, by Newton's method, or as a conic program.

A fit of any kind is certified by its MathematicalProgram. The closed forms and Newton's method have
no say in this: costs and constraints are those that Drake evaluates of the program, and the minimum
is that of a conic solver.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace
from functools import partial

import numpy as np
from pydrake.solvers import MathematicalProgramResult
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from geodrake.boundary.arguments import typed
from geodrake.errors import ArgumentError, ConvergenceError, GeodrakeError, IdentificationError
from geodrake.identification.coordinates import Coordinates
from geodrake.identification.fit import TOLERANCE, Certificate, FitResult, Scope, fit_result
from geodrake.identification.newton import solve_newton
from geodrake.identification.problem import FitProblem, check_residual_bound
from geodrake.identification.program import FitProgram, build_fit
from geodrake.identification.solvers import (
    ROUGHLY,
    Accuracies,
    check_solver,
    run_solver,
    solved_apart,
)
from geodrake.inertia import Array
from geodrake.robot.reduction import triangular_factor

SOLVER = "clarabel"
"""It certifies a fit, and solves one where Newton's method gives up."""


@typed
def solve_fit(problem: FitProblem, *, solver: str = SOLVER, shortcuts: bool = True) -> FitResult:
    """Fit the parameters: the unique minimum, with the information of data and prior together.

    With `shortcuts`, a quadratic problem is first solved in closed form and then as bounded least
    squares; when all bodies come out physical, that is the solution of the full problem too. Else,
    or if they do not, the solver is one of Drake's conic ones.

    Raises:
        ArgumentError: There is no such solver, or the residual bound is below what any parameters
            reach.
        IdentificationError: The solver found no solution.
    """
    begin = time.perf_counter()
    check_solver(solver)
    quick = _in_closed_form(problem) if shortcuts else None
    if quick is not None:
        return quick
    check_residual_bound(problem)
    x, weight, _ = solved_apart(partial(conic_solution, problem, solver, None), solver)
    return fit_result(problem, x, weight, solver, begin)


def solve_with_fallback(problem: FitProblem) -> FitResult:
    """Return the fit in closed form or by Newton's method, or by Clarabel where that gives up.

    The ArgumentError of a residual bound that no physical bodies inside all constraints reach has
    the `minimum` that they do in its evidence.
    """
    begin = time.perf_counter()
    if (quick := _in_closed_form(problem)) is not None:
        return quick
    try:
        return solve_newton(problem)
    except GeodrakeError as failure:
        if "minimum" in failure.evidence:
            raise
        fit, note = solve_fit(problem, shortcuts=False), failure.problem
    note = f"By {fit.solver}, as Newton's method gave up: {note}"
    return replace(fit, note=note, solve_time=time.perf_counter() - begin)


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
    told = Certificate(solver=SOLVER, gap=np.inf, cost=np.nan, violation=np.nan, scope=scope)
    return replace(fit, certificate=replace(told, failure=failure))


def conic_solution(
    problem: FitProblem, solver: str, centre: Array | None, accuracies: Accuracies
) -> tuple[Array, float, float]:
    """Return a conic solver's parameters (p,), the weight of their prior, and the duality gap.

    The program is scaled where the solution is about: at the centre, by Newton's method, or by a
    rough solution of its own.
    """
    entropic = len(problem.entropic) == len(problem.inertia_blocks) > 0
    if centre is None and entropic:
        with contextlib.suppress(IdentificationError):  # the conic solver says why
            centre = solve_newton(problem).x
    if centre is None:
        rough = build_fit(problem)
        centre, _ = solution_of(rough, run_solver(rough.program, solver, ROUGHLY)[0])
    fit = build_fit(problem, centre=centre)
    result, gap = run_solver(fit.program, solver, accuracies)
    return *solution_of(fit, result), gap


def solution_of(fit: FitProgram, result: MathematicalProgramResult) -> tuple[Array, float]:
    """Return parameters (p,) of a conic solution, and the γ of the regularized problem with them.

    They are inside bounds and physical, or an IdentificationError says that the solver was not
    exact enough. γ comes from the residual cone's multiplier μ: at the boundary ‖u‖ = s of the
    cone, d² + μ (‖u‖ − s)/s is stationary, and so is d² + ‖u‖²/γ with γ = 2 s²/μ.
    """
    problem, bound = fit.problem, fit.problem.residual_bound
    x = fit.coordinates.parameters(result.GetSolution(fit.z))
    x = np.clip(x, problem.lower, problem.upper)
    flat = fit.coordinates.smallest_eigenvalues(x) <= 0
    wrong = [start for start, is_so in zip(problem.inertia_blocks, flat, strict=True) if is_so]
    wrong += [column for column in problem.entropic_scalars if x[column] <= 0]
    if wrong:
        raise IdentificationError(
            f"The solver's parameters are not physical at columns {wrong}: it did "
            "not reach the accuracy that the data and prior need.",
            advice="Raise `margin` or gamma, or check units and noise levels.",
            columns=wrong,
        )
    if bound is None:
        return x, 1.0
    if problem.residual(x) < bound * (1.0 - 1e-6):
        return x, np.inf
    multiplier = abs(float(result.GetDualSolution(fit.residual_cone)[0])) * fit.cost_scale
    return x, 2.0 * fit.residual_scale**2 / multiplier if multiplier else np.inf


def _in_closed_form(problem: FitProblem) -> FitResult | None:
    """Return the fit by least squares alone; None where that does not solve the problem."""
    begin = time.perf_counter()
    entropic = problem.entropic or problem.entropic_scalars
    if entropic or problem.constraints is not None or problem.residual_bound is not None:
        return None
    coordinates = Coordinates.of(problem)
    lower, upper = coordinates.bounds()
    bounded = np.isfinite(lower) | np.isfinite(upper)
    order = np.argsort(bounded, kind="stable")
    C = coordinates.prior_root()
    rows = np.vstack([coordinates.data(), np.column_stack([C, np.zeros(len(C))])])
    triangle = triangular_factor([rows[:, [*order, -1]]])[: problem.size]
    F, f = triangle[:, :-1], triangle[:, -1]
    diagonal = np.abs(np.diagonal(F))
    if len(F) < problem.size or diagonal.min() <= 1e-12 * diagonal.max():
        return None
    z, name = np.empty(problem.size), "closed form"
    z[order] = solve_triangular(F, f)
    if np.any((z < lower) | (z > upper)):
        if np.any(lower == upper):
            return None
        # The bounded columns are the last ones of the triangle, so the others drop out.
        free, last = order[~bounded[order]], order[bounded[order]]
        k, box = len(free), (lower[last], upper[last])
        z[last] = lsq_linear(F[k:, k:], f[k:], box, method="bvls", tol=1e-14).x
        z[free] = solve_triangular(F[:k, :k], f[:k] - F[:k, k:] @ z[last])
        name = "bounded least squares"
    x = np.clip(coordinates.parameters(z), problem.lower, problem.upper)
    if np.any(coordinates.smallest_eigenvalues(x) < problem.margin):
        return None
    return fit_result(problem, x, 1.0, name, begin)
