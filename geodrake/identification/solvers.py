"""Run one of Drake's conic solvers, and say what is wrong when it fails."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
from pydrake.solvers import (
    ClarabelSolver,
    MathematicalProgram,
    MathematicalProgramResult,
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

SOLVERS: dict[str, type[SolverInterface]] = {"clarabel": ClarabelSolver, "scs": ScsSolver}
"""SCS is there to cross-check."""


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
    """Raise an ArgumentError if the solver is unknown."""
    if solver not in SOLVERS:
        raise ArgumentError(
            f"No conic solver '{solver}' here; there are {', '.join(SOLVERS)}.",
            advice="Leave `solver` out for the usual one.",
        )


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
    for share in accuracies:
        almost = 1e3 * share  # "almost solved" counts as success in Drake
        own: dict[str, float | int] = {}
        if solver == "clarabel":
            for name in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
                own |= {name: share, f"reduced_{name}": almost}
        else:
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
