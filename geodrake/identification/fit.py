"""Solve a fit: in closed form where that is exact, as a conic program where it is not."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from pydrake.solvers import MathematicalProgramResult
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from geodrake.boundary.arguments import typed
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification.certificate import Certificate
from geodrake.identification.coordinates import Coordinates
from geodrake.identification.newton_program import NewtonProgram
from geodrake.identification.newton_root import bounded_minimum, first_minimum
from geodrake.identification.problem import FitProblem
from geodrake.identification.program import FitProgram, build_fit
from geodrake.identification.solvers import (
    ROUGHLY,
    Tolerances,
    check_solver,
    cone_multiplier,
    run_solver,
    solved_apart,
)
from geodrake.inertia import Array, pullback_metric
from geodrake.robot.reduction import triangular_factor

_NOTHING = 1e-24
"""A parameter is not identifiable up to this share of the largest information: rounding's."""
_BOUNDARY = 1e-5
"""Distance, in scaled units, within which a bound counts as reached."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FitResult(Short):
    """Solution of a `FitProblem`.

    Attributes:
        x: (p,) parameters; every inertia block is physical and every bound is kept exactly.
        information: (p, p) posterior information: half the cost's Hessian at x, so that its
            inverse is the covariance of x while no bound is active.
        residual: Squared residual ‖R x − r‖².
        active_bounds: Indices of parameters at one of their bounds.
        active_blocks: First columns of inertia blocks at the boundary of physical bodies.
        prior_weight: Weight of the prior against the data: 1, and in the point-to-set form the
            γ for which the regularized form has this solution (inf when the data are idle).
        solver: What solved it: "closed form", "bounded least squares", "newton", or the conic
            solver.
        solve_time: Time of the whole solution, s.
        note: Why another solver than usual gave the answer; empty if it was the usual one.
        certificate: What the MathematicalProgram of the fit says of it; None if it was not asked.
    """

    x: Array
    information: Array
    residual: float
    active_bounds: tuple[int, ...]
    active_blocks: tuple[int, ...]
    prior_weight: float
    solver: str
    solve_time: float
    note: str = ""
    certificate: Certificate | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Return what solved it, where that was not the usual, and what certifies it, in words."""
        certificate = self.certificate
        return tuple(filter(None, [self.note, certificate.words if certificate else ""]))

    def standard_deviations(self) -> Array:
        """Standard deviations (p,) of x, in its units; inf where nothing is known.

        They count every row of data as independent: with correlated residuals, scale the
        information by the share of effective samples first.
        """
        known = np.diagonal(self.information)
        size = np.sqrt(np.where(known > _NOTHING * known.max(initial=0.0), known, 1.0))
        values, vectors = np.linalg.eigh(self.information / np.outer(size, size))
        known = values > len(values) * np.finfo(float).eps * values[-1]
        variances = (vectors[:, known] ** 2 / values[known]).sum(1)
        unknown = (vectors[:, ~known] ** 2).sum(1) > np.sqrt(np.finfo(float).eps)
        return np.where(unknown, np.inf, np.sqrt(variances) / size)


@typed
def solve_fit(
    problem: FitProblem, *, solver: str = "clarabel", shortcuts: bool = True
) -> FitResult:
    """Fit the parameters.

    A quadratic problem is first solved in closed form and then as bounded least squares; when all
    bodies come out physical, that is the solution of the full problem too.

    Args:
        problem: What to fit.
        solver: Drake's conic solver, "clarabel" or "scs" (slower, less exact).
        shortcuts: Whether to try the exact solutions without a conic solver first.

    Returns:
        The unique minimum, with the information of data and prior together.

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
    solve = partial(_by_conic_solver, problem, solver)
    coordinates, x, weight = solved_apart(solve, solver)
    return fit_result(coordinates, x, weight, solver, time.perf_counter() - begin)


def _in_closed_form(problem: FitProblem) -> FitResult | None:
    """Return the fit by least squares alone; None where that does not solve the problem."""
    begin = time.perf_counter()
    coordinates = Coordinates.of(problem)
    x, name = _without_solver(coordinates)
    if x is None:
        return None
    return fit_result(coordinates, x, 1.0, name, time.perf_counter() - begin)


def _by_conic_solver(
    problem: FitProblem, solver: str, accuracies: Sequence[Tolerances]
) -> tuple[Coordinates, Array, float]:
    """Coordinates in which a program was solved, parameters (p,), and weight of the prior."""
    # The first solution only says where and how to scale the program for the second.
    fit = build_fit(problem, centre=_centre(problem, solver))
    solution = run_solver(fit.program, solver, accuracies)
    x = parameters_of(fit, solution)
    return fit.coordinates, x, prior_weight_of(fit, solution, x)


def _centre(problem: FitProblem, solver: str) -> Array:
    """Parameters (p,) close to the solution: by Newton's method where it serves, as it is fast."""
    if problem.inertia_blocks and len(problem.entropic) == len(problem.inertia_blocks):
        program = NewtonProgram.of(problem)
        bound = problem.residual_bound
        try:
            minimum = (
                first_minimum(program, 1.0) if bound is None else bounded_minimum(program, bound)[0]
            )
            return program.coordinates.parameters(minimum.point.z)
        except IdentificationError:
            pass  # The conic solver says why.
    rough = build_fit(problem)
    return parameters_of(rough, run_solver(rough.program, solver, ROUGHLY))


def parameters_of(fit: FitProgram, solution: MathematicalProgramResult) -> Array:
    """Parameters (p,) of a conic solution, inside bounds and physical.

    Args:
        fit: The program.
        solution: Its solution.

    Raises:
        IdentificationError: A body is not physical, as the solver was not exact enough.
    """
    x = fit.coordinates.parameters(solution.GetSolution(fit.z))
    x = np.clip(x, fit.problem.lower, fit.problem.upper)
    scalars = np.array(list(fit.problem.entropic_scalars), int)
    if not np.all(x[scalars] > 0):
        raise IdentificationError(
            f"The solver's parameters at columns {scalars[x[scalars] <= 0].tolist()} are not "
            "positive: it did not reach the accuracy that the data and prior need.",
            advice="Raise gamma, or check units and noise levels.",
        )
    smallest = fit.coordinates.smallest_eigenvalues(x)
    if not np.all(smallest > 0):
        wrong = np.array(fit.problem.inertia_blocks)[~(smallest > 0)].tolist()
        raise IdentificationError(
            f"The solver's parameters are not physical in the blocks at columns {wrong}: it did "
            "not reach the accuracy that the data and prior need.",
            advice="Raise `margin` or gamma, or check units and noise levels.",
            columns=wrong,
        )
    return x


def _at_boundary(coordinates: Coordinates, x: Array) -> tuple[int, ...]:
    """First columns of the blocks whose smallest eigenvalue is the margin."""
    smallest = coordinates.smallest_eigenvalues(x)
    near = smallest < 2.0 * coordinates.problem.margin
    return tuple(np.array(coordinates.problem.inertia_blocks, int)[near].tolist())


def _without_solver(coordinates: Coordinates) -> tuple[Array | None, str]:
    """Parameters by least squares alone, or None when they do not solve the problem."""
    problem = coordinates.problem
    entropic = problem.entropic or problem.entropic_scalars
    if entropic or problem.constraints is not None or problem.residual_bound is not None:
        return None, ""
    lower, upper = coordinates.bounds()
    bounded = np.isfinite(lower) | np.isfinite(upper)
    order = np.argsort(bounded, kind="stable")
    M, d = coordinates.data()
    C = coordinates.prior_root()
    rows = np.block([[M[:, order], d[:, None]], [C[:, order], np.zeros((len(C), 1))]])
    triangle = triangular_factor([rows])[: problem.size]
    F, f = triangle[:, :-1], triangle[:, -1]
    diagonal = np.abs(np.diagonal(F))
    if len(F) < problem.size or diagonal.min() <= 1e-12 * diagonal.max():
        return None, ""
    z = np.empty(problem.size)
    z[order] = solve_triangular(F, f)
    name = "closed form"
    if np.any((z < lower) | (z > upper)):
        if np.any(lower == upper):
            return None, ""
        # The bounded columns are the last ones of the triangle, so the others drop out.
        free, last = order[~bounded[order]], order[bounded[order]]
        k, box = len(free), (lower[last], upper[last])
        z[last] = lsq_linear(F[k:, k:], f[k:], box, method="bvls", tol=1e-14).x
        z[free] = solve_triangular(F[:k, :k], f[:k] - F[:k, k:] @ z[last])
        name = "bounded least squares"
    x = np.clip(coordinates.parameters(z), problem.lower, problem.upper)
    if np.any(coordinates.smallest_eigenvalues(x) < problem.margin):
        return None, ""
    return x, name


def check_residual_bound(problem: FitProblem) -> None:
    """Refuse a residual bound below the least squares minimum, which no constraint lowers."""
    bound = problem.residual_bound
    if bound is None:
        return
    R, r = problem.factor[:, :-1], problem.factor[:, -1]
    scale = np.linalg.norm(R, axis=0)
    least = np.linalg.lstsq(R / np.where(scale > 0, scale, 1.0), r)[0]
    minimum = float(np.square(R / np.where(scale > 0, scale, 1.0) @ least - r).sum())
    if not bound > minimum:
        raise ArgumentError(
            f"residual_bound is {bound:.10g}, but the least squared residual that any parameters "
            f"reach is {minimum:.10g}.",
            advice="Take a bound above that.",
            minimum=minimum,
        )


def prior_weight_of(fit: FitProgram, solution: MathematicalProgramResult, x: Array) -> float:
    """γ of the regularized problem with the same solution, from the residual cone's multiplier.

    At the boundary ‖u‖ = s of the cone, d² + μ (‖u‖ − s)/s is stationary, and so is
    d² + ‖u‖²/γ with γ = 2 s²/μ.

    Args:
        fit: The program.
        solution: Its solution.
        x: (p,) the parameters of the solution.
    """
    bound = fit.problem.residual_bound
    if bound is None:
        return 1.0
    if fit.problem.residual(x) < bound * (1.0 - 1e-6):
        return np.inf
    multiplier = cone_multiplier(solution, fit.residual_cone) * fit.cost_scale
    return 2.0 * fit.residual_scale**2 / multiplier if multiplier else np.inf


def fit_result(
    coordinates: Coordinates, x: Array, prior_weight: float, solver: str, elapsed: float
) -> FitResult:
    """Return the result at parameters x (p,), with the information there.

    Args:
        coordinates: Of the problem.
        x: Its solution.
        prior_weight: Weight of the prior against the data.
        solver: What solved it.
        elapsed: Time that took, s.
    """
    problem = coordinates.problem
    R = problem.factor[:, :-1]
    prior = problem.prior_information.copy()
    if problem.entropic:
        places = np.add.outer(np.array(list(problem.entropic)), np.arange(10))
        gammas = np.array([gamma for _, gamma in problem.entropic.values()])
        metric = gammas[:, None, None] * pullback_metric(x[places])
        prior[places[:, :, None], places[:, None, :]] += metric
    for column, (_, gamma) in problem.entropic_scalars.items():
        prior[column, column] += 0.5 * gamma / x[column] ** 2
    information = prior if np.isinf(prior_weight) else R.T @ R + prior_weight * prior
    scale = np.diagonal(coordinates.transform)
    at_bound = np.minimum(x - problem.lower, problem.upper - x) <= _BOUNDARY * scale
    return FitResult(
        x=x,
        information=information,
        residual=problem.residual(x),
        active_bounds=tuple(np.flatnonzero(at_bound).tolist()),
        active_blocks=_at_boundary(coordinates, x),
        prior_weight=prior_weight,
        solver=solver,
        solve_time=elapsed,
    )
