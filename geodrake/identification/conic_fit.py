"""Solve a fit in closed form, by Newton's method, or as a conic program.

Any fit is certified by its MathematicalProgram, independently of how it was solved: Drake evaluates
costs and constraints, and a conic solver finds the minimum.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from pydrake.solvers import MathematicalProgram, MathematicalProgramResult
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear
from scipy.sparse import csc_matrix

from geodrake.boundary.arguments import instance, real_array, typed
from geodrake.errors import ArgumentError, ConvergenceError, GeodrakeError, IdentificationError
from geodrake.identification.coordinates import SYMMETRIC_BASIS, Coordinates, smat
from geodrake.identification.fit import TOLERANCE, Certificate, FitResult, Scope, fit_result
from geodrake.identification.newton import solve_newton
from geodrake.identification.problem import FitProblem, check_residual_bound
from geodrake.identification.solvers import (
    ROUGHLY,
    Accuracies,
    check_solver,
    run_solver,
    solve_in_subprocess,
)
from geodrake.inertia import Array
from geodrake.robot.reduction import triangular_factor

SOLVER = "clarabel"
"""Solver of certificates, and of fits in which Newton's method fails."""

_LOGARITHM = np.array([[0.0, 1.0], [0.0, 0.0], [1.0, 0.0]])
"""Rows of the exponential cone of (t, y) with t ≤ log y."""


@dataclass(eq=False)
class FitProgram:
    """A fit as a conic program for any of Drake's conic solvers."""

    problem: FitProblem
    coordinates: Coordinates  # map between the program's variables and the parameters
    program: MathematicalProgram  # other convex costs and constraints may be added
    z: Any  # (p,) decision variables, the coordinates of the parameters
    cost_scale: float = 1.0  # divisor of the cost
    residual_cone: Any = None  # constraint of the point-to-set form, or None
    residual_scale: float = 1.0  # divisor of the residual in `residual_cone`
    # Auxiliary variables, each with the map from z to their optimal values.
    others: list[tuple[Any, Callable[[Array], Array]]] = field(default_factory=list)

    def point(self, x: Array) -> Array:
        """Return values of all variables at parameters x (p,); a LinAlgError if not physical."""
        z, values = self.coordinates.at(x), np.zeros(self.program.num_vars())
        values[self.program.FindDecisionVariableIndices(self.z)] = z
        for variables, best in self.others:
            values[self.program.FindDecisionVariableIndices(variables)] = best(z)
        return values

    def evaluated(self, x: Array) -> tuple[float, float]:
        """Return the cost and the largest constraint violation at parameters x (p,), by Drake.

        The cost is in units of the fit's, up to a constant; the violation is in the program's
        variables.
        """
        program, values = self.program, self.point(x)
        costs = [float(program.EvalBinding(c, values)[0]) for c in program.GetAllCosts()]
        beyond = [np.zeros(1)]
        for constraint in program.GetAllConstraints():
            reached, limits = program.EvalBinding(constraint, values), constraint.evaluator()
            beyond += [limits.lower_bound() - reached, reached - limits.upper_bound()]
        return self.cost_scale * sum(costs), float(np.concatenate(beyond).max())

    def _add_errors(self, rows: Array) -> Any:
        """Return new variables F z − f for rows [F f].

        A cost with the Hessian FᵀF instead would be about a hundred times less exact.
        """
        errors = self.program.NewContinuousVariables(len(rows), "e")
        matrix = csc_matrix(np.hstack([rows[:, :-1], -np.eye(len(rows))]))
        variables = np.concatenate([self.z, errors])
        self.program.AddLinearEqualityConstraint(matrix, rows[:, -1], variables)
        self.others.append((errors, lambda z: rows @ np.append(z, -1.0)))
        return errors

    def _add_bodies(self) -> None:
        """Keep bodies physical, and add their entropic priors."""
        problem, coordinates = self.problem, self.coordinates
        floors = coordinates.starts - problem.margin * coordinates.references
        for i, start in enumerate(problem.inertia_blocks):
            block = self.z[start : start + 10]
            if start not in problem.entropic:
                self.program.AddLinearMatrixInequalityConstraint(
                    [floors[i], *SYMMETRIC_BASIS], block
                )
                continue
            weight = problem.entropic[start][1] / self.cost_scale
            prior = np.linalg.inv(coordinates.references[i])
            slope = weight * np.einsum("ij,kji->k", prior, SYMMETRIC_BASIS)
            self.program.AddLinearCost(slope, 0.0, block)
            self._maximize_log_determinant(slice(start, start + 10), coordinates.starts[i], weight)

    def _maximize_log_determinant(self, block: slice, begin: Array, weight: float) -> None:
        """Add the cost −weight log|S| with S = begin + smat(z) ([Lee2019] Eq. (3.5.45)).

        log|S| ≥ Σ t_i if and only if [[S, Z], [Zᵀ, diag(Z)]] ⪰ 0 for some lower triangular Z with
        t_i ≤ log Z_ii.
        """
        program = self.program
        Z, t = program.NewContinuousVariables(10, "Z"), program.NewContinuousVariables(4, "t")
        rows, columns = np.tril_indices(4)
        matrices = np.zeros((21, 8, 8))
        matrices[0, :4, :4] = begin
        matrices[1:11, :4, :4] = SYMMETRIC_BASIS
        for matrix, i, j in zip(matrices[11:], rows, columns, strict=True):
            matrix[i, 4 + j] = matrix[4 + j, i] = 1.0
            if i == j:
                matrix[4 + i, 4 + i] = 1.0
        program.AddLinearMatrixInequalityConstraint(
            list(matrices), np.concatenate([self.z[block], Z])
        )
        for pair in zip(t, Z[rows == columns], strict=True):
            program.AddExponentialConeConstraint(_LOGARITHM, np.eye(3)[1], np.array(pair))
        program.AddLinearCost(np.full(4, -weight), 0.0, t)

        def best(z: Array) -> Array:
            root = np.linalg.cholesky(begin + smat(z[block]))
            pivots = np.diagonal(root)
            return np.append((root * pivots)[rows, columns], 2.0 * np.log(pivots))

        self.others.append((np.append(Z, t), best))

    def _add_scalars(self) -> None:
        """Add the cost γ (y − log y) of the entropic scalars."""
        scalars = self.coordinates.scalars(self.problem.entropic_scalars)
        if not len(scalars.columns):
            return
        t = self.program.NewContinuousVariables(len(scalars.columns), "log")
        weights = scalars.weights / self.cost_scale
        parts = zip(t, self.z[scalars.columns], scalars.begin, scalars.slope, strict=True)
        for t_k, z_k, begin, slope in parts:
            cone, offset = _LOGARITHM * [1.0, slope], np.array([begin, 1.0, 0.0])
            self.program.AddExponentialConeConstraint(cone, offset, np.array([t_k, z_k]))
        self.program.AddLinearCost(weights * scalars.slope, 0.0, self.z[scalars.columns])
        self.program.AddLinearCost(-weights, 0.0, t)

        def best(z: Array) -> Array:
            ratios = scalars.ratios(z)
            if not np.all(ratios > 0):
                raise np.linalg.LinAlgError("a scalar with an entropic prior is not positive")
            return np.log(ratios)

        self.others.append((t, best))


def build_fit(
    problem: FitProblem, *, centre: Array | None = None, size: float | None = None
) -> FitProgram:
    """Return the conic program of a problem; `solve_fit` solves it.

    The cost is the excess over unconstrained least squares, for which the solver's relative
    tolerance is meaningful even with a large residual. The program is scaled at a `centre` (p,)
    close to the solution, by default the references, and its cost is divided by `size`, by default
    its value there.
    """
    instance(problem, "problem", FitProblem)
    if centre is not None:
        centre = real_array(centre, "centre", (problem.size,))
    coordinates, program = Coordinates.of(problem, centre=centre), MathematicalProgram()
    fit = FitProgram(
        problem, coordinates, program, program.NewContinuousVariables(problem.size, "z")
    )
    data, C, p = coordinates.data(), coordinates.prior_root(), problem.size
    rows = np.column_stack([C, np.zeros(len(C))])
    if problem.residual_bound is None:
        rows = np.vstack([data, rows])
    else:  # scaled by the part of the bound beyond the least residual
        triangle = _reduced(data)
        least = problem.residual_bound - float(np.square(triangle[p:, p]).sum())
        fit.residual_scale = float(np.sqrt(max(least, np.finfo(float).tiny)))
        errors = fit._add_errors(triangle[:p] / fit.residual_scale)
        cone = np.eye(len(errors) + 1)
        fit.residual_cone = program.AddLorentzConeConstraint(cone[:, 1:], cone[0], errors)
    rows = _reduced(rows)[:p]
    if size is None:  # the value at the centre, not far below the curvature
        z = np.zeros(problem.size) if centre is None else coordinates.at(centre)
        priors = (*problem.entropic.values(), *problem.entropic_scalars.values())
        value = float(np.square(rows @ np.append(z, -1.0)).sum())
        curvature = np.square(rows[:, :-1]).sum(0).max(initial=0.0)
        size = max([value, 1e-8 * curvature, *(gamma for _, gamma in priors)]) or 1.0
    fit.cost_scale = size
    if k := len(rows):
        errors = fit._add_errors(rows / np.sqrt(size))
        program.AddQuadraticCost(2.0 * np.eye(k), np.zeros(k), errors, is_convex=True)
    fit._add_bodies()
    fit._add_scalars()
    (G, h), (E, e) = coordinates.rows()
    if len(h):
        program.AddLinearConstraint(G, h, np.full(len(h), np.inf), fit.z)
    if len(e):
        program.AddLinearEqualityConstraint(E, e, fit.z)
    return fit


def _reduced(rows: Array) -> Array:
    """Return triangular rows [F f] of the same least squares; the last is independent of z."""
    return triangular_factor([rows]) if len(rows) >= rows.shape[1] else rows


@typed
def solve_fit(problem: FitProblem, *, solver: str = SOLVER, shortcuts: bool = True) -> FitResult:
    """Solve a fit for its unique minimum, by one of Drake's conic solvers.

    With `shortcuts`, a quadratic problem is first solved in closed form or as bounded least
    squares, which is exact if all bodies are physical.

    Raises:
        ArgumentError: The solver is unknown, or the residual bound is unreachable.
        IdentificationError: The solver found no solution.
    """
    begin = time.perf_counter()
    check_solver(solver)
    closed_form = _in_closed_form(problem) if shortcuts else None
    if closed_form is not None:
        return closed_form
    check_residual_bound(problem)
    x, weight, _ = solve_in_subprocess(partial(conic_solution, problem, solver, None), solver)
    return fit_result(problem, x, weight, solver, begin)


def solve_with_fallback(problem: FitProblem) -> FitResult:
    """Solve a fit in closed form, by Newton's method, or by Clarabel if that fails.

    The ArgumentError of an unreachable residual bound has the `minimum` in its evidence.
    """
    begin = time.perf_counter()
    if (closed_form := _in_closed_form(problem)) is not None:
        return closed_form
    try:
        return solve_newton(problem)
    except GeodrakeError as failure:
        if "minimum" in failure.evidence:
            raise
        fit, note = solve_fit(problem, shortcuts=False), failure.problem
    note = f"By {fit.solver}, as Newton's method failed: {note}"
    return replace(fit, note=note, solve_time=time.perf_counter() - begin)


def certified(
    problem: FitProblem, fit: FitResult, *, size: float | None = None, scope: Scope = "global"
) -> FitResult:
    """Return the fit with its certificate, or the program's solution if that is better.

    A feasible solution is better if its cost is lower by more than `TOLERANCE` of the cost, or if
    the fit is infeasible.

    For a nonconvex cost, the problem is its second order at the fit, and the scope is "local". The
    `size` of the cost is by default that of the program plus the residual.
    """
    begin = time.perf_counter()
    try:
        program = build_fit(problem, centre=fit.x)
        cost, violation = program.evaluated(fit.x)
    except (np.linalg.LinAlgError, ArgumentError) as error:
        if scope == "local" and isinstance(error, ArgumentError):
            raise  # the second order is not convex
        return uncertified(fit, "its program has no significant digits left after rounding", scope)
    if size is None:
        size = program.cost_scale + (fit.residual if problem.residual_bound is None else 0.0)
    certificate = Certificate(
        solver=SOLVER, gap=np.inf, cost=size, violation=violation, scope=scope
    )
    try:
        solve = partial(conic_solution, problem, SOLVER, fit.x)
        x, weight, accuracy = solve_in_subprocess(solve, SOLVER)
        minimum, solver_violation = program.evaluated(x)
    except (IdentificationError, ConvergenceError) as error:
        return replace(fit, certificate=replace(certificate, failure=error.problem))
    gap = cost - minimum
    worse = gap > TOLERANCE * size or violation > TOLERANCE
    if worse and solver_violation <= TOLERANCE and scope == "global":
        outside = f"violating constraints by {violation:.1e}"
        above = f"above the minimum cost by {gap / size:.1e} of it"
        why = outside if violation > TOLERANCE else above
        note = f"By {SOLVER}, as the fit of {fit.solver} was {why}"
        fit = replace(fit_result(problem, x, weight, SOLVER, begin - fit.solve_time), note=note)
        certificate, gap = replace(certificate, violation=solver_violation, replaced=True), 0.0
    solver_gap = max(accuracy * program.cost_scale, np.finfo(float).eps * size)
    return replace(fit, certificate=replace(certificate, gap=max(gap, 0.0) + solver_gap))


def uncertified(fit: FitResult, failure: str, scope: Scope = "global") -> FitResult:
    """Return the fit with a certificate that states why it is not certified."""
    certificate = Certificate(
        solver=SOLVER, gap=np.inf, cost=np.nan, violation=np.nan, scope=scope, failure=failure
    )
    return replace(fit, certificate=certificate)


def conic_solution(
    problem: FitProblem, solver: str, centre: Array | None, accuracies: Accuracies
) -> tuple[Array, float, float]:
    """Return a conic solver's parameters (p,), the weight of the prior, and the duality gap.

    The program is scaled at `centre`, or by default at a solution of Newton's method or a rough
    conic one.
    """
    entropic = len(problem.entropic) == len(problem.inertia_blocks) > 0
    if centre is None and entropic:
        with contextlib.suppress(IdentificationError):  # the conic solver reports the cause
            centre = solve_newton(problem).x
    if centre is None:
        rough = build_fit(problem)
        centre, _ = solution_of(rough, run_solver(rough.program, solver, ROUGHLY)[0])
    fit = build_fit(problem, centre=centre)
    result, gap = run_solver(fit.program, solver, accuracies)
    return *solution_of(fit, result), gap


def solution_of(fit: FitProgram, result: MathematicalProgramResult) -> tuple[Array, float]:
    """Return the parameters (p,) of a conic solution, and the γ of the equal regularized problem.

    Raise an IdentificationError if the parameters are not physical due to the solver's tolerance. γ
    follows from the residual cone's multiplier μ: at the boundary ‖u‖ = s of the cone,
    d² + μ (‖u‖ − s)/s is stationary, and so is d² + ‖u‖²/γ with γ = 2 s²/μ.
    """
    problem, bound = fit.problem, fit.problem.residual_bound
    x = fit.coordinates.parameters(result.GetSolution(fit.z))
    x = np.clip(x, problem.lower, problem.upper)
    eigenvalues = fit.coordinates.smallest_eigenvalues(x).tolist()
    blocks = zip(problem.inertia_blocks, eigenvalues, strict=True)
    wrong = [start for start, smallest in blocks if smallest <= 0]
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
    """Return the closed-form or bounded least-squares fit; None if it is not the solution."""
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
        # The bounded columns are last in the triangle, so that the others drop out.
        free, last = order[~bounded[order]], order[bounded[order]]
        k, box = len(free), (lower[last], upper[last])
        z[last] = lsq_linear(F[k:, k:], f[k:], box, method="bvls", tol=1e-14).x
        z[free] = solve_triangular(F[:k, :k], f[:k] - F[:k, k:] @ z[last])
        name = "bounded least squares"
    x = np.clip(coordinates.parameters(z), problem.lower, problem.upper)
    if np.any(coordinates.smallest_eigenvalues(x) < problem.margin):
        return None
    return fit_result(problem, x, 1.0, name, begin)
