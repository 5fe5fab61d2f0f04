"""Run one of Drake's conic solvers, and say what is wrong when it fails."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
from pydrake.solvers import (
    ClarabelSolver,
    CsdpSolver,
    MathematicalProgram,
    MathematicalProgramResult,
    MosekSolver,
    ScsSolver,
    SolutionResult,
    SolverInterface,
    SolverOptions,
)

from geodrake.errors import ArgumentError, ConvergenceError, IdentificationError
from geodrake.identification.subprocess_solver import (
    LateProcessError,
    LostProcessError,
    in_subprocess,
)

T = TypeVar("T")

SOLVERS: dict[str, type[SolverInterface]] = {
    "clarabel": ClarabelSolver,
    "scs": ScsSolver,
    "csdp": CsdpSolver,
    "mosek": MosekSolver,
}
"""SCS and CSDP are there to cross-check; CSDP takes no exponential cones, so no entropic fits."""


Accuracies = Sequence[float]
"""Relative duality gaps and violations to ask for in turn."""
ROUGHLY: Accuracies = (1e-7, 1e-6)
EXACTLY: Accuracies = (1e-10, 1e-9)
"""The last digit may be out of reach of rounding, and a little less will do."""

_SECONDS = 20.0
"""Time that a fit by a conic solver may take."""

CONTRADICTION = (
    "The bounds, constraints and residual bound contradict each other for physical bodies.",
    "Widen the bounds, check the ellipsoids' sign ([x;1]ᵀQ[x;1] ≥ 0 inside) and the total "
    "mass, or raise the residual bound.",
)
OTHER_CAUSE = (
    "Most often the data and the prior differ by very many orders of magnitude.",
    "Check units and noise levels, raise gamma, or try another solver.",
)
_CAUSES = {
    SolutionResult.kInfeasibleConstraints: CONTRADICTION,
    SolutionResult.kUnbounded: (
        "Some parameters have neither data nor a prior that hold them.",
        "Add prior information for them, or leave their columns out.",
    ),
}


def check_solver(solver: str) -> None:
    """Raise an ArgumentError if the solver is unknown or unavailable."""
    engines = {name: kind() for name, kind in SOLVERS.items()}
    usable = [name for name, engine in engines.items() if engine.available() and engine.enabled()]
    if solver not in usable:
        advice = "MOSEK needs a licence: set MOSEKLM_LICENSE_FILE." if solver == "mosek" else ""
        there = ", ".join(usable)
        raise ArgumentError(f"No conic solver '{solver}' here; there are {there}.", advice=advice)


def solved_apart(solve: Callable[[Accuracies], T], solver: str) -> T:
    """Return what `solve`, given accuracies to try, makes of a solver in a process of its own.

    Where rounding has left no digit of a step, Clarabel panics on the numbers that are none, and
    that ends the process it is in. No check before the call can tell, as it takes the last digits
    of an iterate; a little less accuracy often ends before that.
    """
    over = time.monotonic() + _SECONDS
    for accuracies in (EXACTLY, EXACTLY[1:]):
        seconds = max(over - time.monotonic(), 0.0)
        try:
            return in_subprocess(partial(solve, accuracies), seconds=seconds)
        except LateProcessError as error:
            raise ConvergenceError(
                f"{solver} {error}, which is all that a fit has.",
                advice="Use the default solver, or raise gamma.",
                solver=solver,
            ) from None
        except LostProcessError as error:
            lost = str(error)
    raise no_parameters(solver, OTHER_CAUSE, f": its process {lost}", status=lost)


def run_solver(
    program: MathematicalProgram, solver: str, accuracies: Accuracies = EXACTLY
) -> tuple[MathematicalProgramResult, float]:
    """Return the solution of a program, and the duality gap that Clarabel may have left.

    It runs in this process; `solved_apart` is safe where this is not. The gap is in the unit of the
    cost. The IdentificationError of a solver that found no solution has the `status` in its
    evidence.
    """
    check_solver(solver)
    engine = SOLVERS[solver]()
    if solver == "csdp":
        program = _without_squares(program)
    if not engine.AreProgramAttributesSatisfied(program):
        raise ArgumentError(
            f"{solver} cannot solve this kind of program: "
            f"{engine.ExplainUnsatisfiedProgramAttributes(program)}",
            advice="Use clarabel, or scs as a cross-check.",
        )
    for share in accuracies:
        almost = 1e3 * share  # "almost solved" counts as success in Drake
        own: dict[str, float | int] = {}
        if solver == "clarabel":
            for name in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
                own |= {name: share, f"reduced_{name}": almost}
        elif solver == "scs":
            own = {"eps_abs": 1e2 * share, "eps_rel": 1e2 * share, "max_iters": 100_000}
        options = SolverOptions()
        for name, value in own.items():
            options.SetOption(engine.solver_id(), name, value)
        result = engine.Solve(program, None, options)
        status = result.get_solution_result()
        if result.is_success():
            exact = getattr(result.get_solver_details(), "status", "") == "Solved"
            gap = (share if exact else almost) if solver == "clarabel" else np.nan
            return result, gap * max(1.0, abs(result.get_optimal_cost()))
        if status != SolutionResult.kSolverSpecificError:
            break
    why = _CAUSES.get(status, OTHER_CAUSE)
    raise no_parameters(solver, why, f" ({status.name})", status=status.name)


def no_parameters(
    solver: str, why: tuple[str, str], how: str = "", **evidence: Any
) -> IdentificationError:
    """Return the error of a solver that found none, with a likely cause and what to do about it."""
    problem = f"{solver} found no parameters{how}. {why[0]}"
    return IdentificationError(problem, advice=why[1], solver=solver, **evidence)


def cone_multiplier(result: MathematicalProgramResult, cone: Any) -> float:
    """Return the multiplier of a Lorentz cone's bound, of which residual bounds need one."""
    try:
        return abs(float(result.GetDualSolution(cone)[0]))
    except ValueError:
        raise ArgumentError(
            f"{result.get_solver_id().name()} gives no multipliers, which a residual bound needs.",
            advice="Use gamma with this solver, or clarabel with residual_bound.",
        ) from None


def _without_squares(program: MathematicalProgram) -> MathematicalProgram:
    """Return the same program with a cone t ≥ ½ zᵀQz and the cost t for each quadratic cost."""
    program = program.Clone()
    for binding in program.quadratic_costs():
        cost, z = binding.evaluator(), binding.variables()
        values, vectors = np.linalg.eigh(cost.Q())
        root = vectors[:, values > 0] * np.sqrt(values[values > 0])
        t = program.NewContinuousVariables(1, "t")
        # (t, 1, u/√2) in the rotated cone means t ≥ ½ uᵀu.
        matrix = np.zeros((2 + root.shape[1], len(z) + 1))
        matrix[0, -1], matrix[2:, :-1] = 1.0, np.sqrt(0.5) * root.T
        program.AddRotatedLorentzConeConstraint(matrix, np.eye(len(matrix))[1], np.append(z, t))
        program.AddLinearCost(np.append(cost.b(), 1.0), cost.c(), np.append(z, t))
        program.RemoveCost(binding)
    return program
