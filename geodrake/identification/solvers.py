"""Run one of Drake's conic solvers, and say what is wrong when it fails."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
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
from geodrake.identification.own_process import (
    LateProcessError,
    LostProcessError,
    in_own_process,
)

T = TypeVar("T")
Tolerances = Mapping[str, Mapping[str, float | int]]
"""Options of each solver that say how exact a solution is to be."""

SOLVERS: dict[str, type[SolverInterface]] = {
    "clarabel": ClarabelSolver,
    "scs": ScsSolver,
    "csdp": CsdpSolver,
    "mosek": MosekSolver,
}
"""SCS and CSDP are there to cross-check; CSDP takes no exponential cones, so no entropic fits."""

_EXACT: Tolerances = {
    "clarabel": {
        "tol_gap_abs": 1e-10,
        "tol_gap_rel": 1e-10,
        "tol_feas": 1e-10,
        # "Almost solved" counts as success in Drake, so it must be good enough too.
        "reduced_tol_gap_abs": 1e-7,
        "reduced_tol_gap_rel": 1e-7,
        "reduced_tol_feas": 1e-7,
    },
    "scs": {"eps_abs": 1e-8, "eps_rel": 1e-8, "max_iters": 100_000},
}
_GOOD: Tolerances = {
    "clarabel": {
        "tol_gap_abs": 1e-9,
        "tol_gap_rel": 1e-9,
        "tol_feas": 1e-9,
        "reduced_tol_gap_abs": 1e-6,
        "reduced_tol_gap_rel": 1e-6,
        "reduced_tol_feas": 1e-6,
    },
}
_ROUGH: Tolerances = {
    "clarabel": {
        "tol_gap_abs": 1e-7,
        "tol_gap_rel": 1e-6,
        "tol_feas": 1e-7,
        "reduced_tol_gap_abs": 1e-3,
        "reduced_tol_gap_rel": 1e-3,
        "max_iter": 100,
    },
    "scs": {"eps_abs": 1e-5, "eps_rel": 1e-5, "max_iters": 100_000},
}

ROUGHLY = (_ROUGH,)
"""Accuracies to try in turn, for about four digits."""
EXACTLY = (_EXACT, _GOOD)
"""The same, for all digits: the last may be out of reach of rounding, and a little less will do."""
NEARLY = (_GOOD,)
"""The same, short of where a step can have no digits left."""

_SECONDS = 20.0
"""Time that a fit by a conic solver may take."""

_CAUSES = {
    SolutionResult.kInfeasibleConstraints: (
        "The bounds, constraints and residual bound contradict each other for physical bodies.",
        "Widen the bounds, check the ellipsoids' sign ([x;1]ᵀQ[x;1] ≥ 0 inside) and the total "
        "mass, or raise the residual bound.",
    ),
    SolutionResult.kUnbounded: (
        "Some parameters have neither data nor a prior that hold them.",
        "Add prior information for them, or leave their columns out.",
    ),
}
_OTHER_CAUSE = (
    "Most often the data and the prior differ by very many orders of magnitude.",
    "Check units and noise levels, raise gamma, or try another solver.",
)


def check_solver(solver: str) -> None:
    """Refuse a solver that there is not, or not here.

    Raises:
        ArgumentError: There is no such solver here.
    """
    if isinstance(solver, str) and solver in SOLVERS and _is_usable(solver):
        return
    advice = "MOSEK needs a licence: set MOSEKLM_LICENSE_FILE." if solver == "mosek" else ""
    usable = ", ".join(filter(_is_usable, SOLVERS))
    raise ArgumentError(f"No conic solver '{solver}' here; there are {usable}.", advice=advice)


def _is_usable(solver: str) -> bool:
    kind = SOLVERS[solver]()
    return bool(kind.available() and kind.enabled())


def solved_apart(solve: Callable[[Sequence[Tolerances]], T], solver: str) -> T:
    """What `solve` makes of a solver's solutions, in a process of its own.

    Where rounding has left no digit of a step, Clarabel panics on the numbers that are none, and
    that ends the process it is in. No check before the call can tell, as it takes the last digits
    of an iterate; a little less accuracy often ends before that.

    Args:
        solve: Called with the accuracies that are to be tried.
        solver: Name of the solver.

    Raises:
        GeodrakeError: What `solve` raised.
        IdentificationError: The solver ended its process.
        ConvergenceError: It found nothing in time.
    """
    over = time.monotonic() + _SECONDS
    for accuracies in (EXACTLY, NEARLY):
        seconds = max(over - time.monotonic(), 0.0)
        try:
            return in_own_process(partial(solve, accuracies), seconds=seconds)
        except LateProcessError as error:
            raise ConvergenceError(
                f"{solver} {error}, which is all that a fit has.",
                advice="Use the default solver, or raise gamma.",
                solver=solver,
            ) from None
        except LostProcessError as error:
            lost = str(error)
    cause, advice = _OTHER_CAUSE
    raise IdentificationError(
        f"{solver} found no parameters: its process {lost}. {cause}",
        advice=advice,
        solver=solver,
        status=lost,
    )


def run_solver(
    program: MathematicalProgram, solver: str, accuracies: Sequence[Tolerances] = EXACTLY
) -> MathematicalProgramResult:
    """Solve a program, in this process; `solved_apart` is safe where its solver is not.

    Args:
        program: Any program the solver can take.
        solver: A name of `SOLVERS`.
        accuracies: What to try in turn.

    Returns:
        The result, a success.

    Raises:
        ArgumentError: There is no such solver here.
        IdentificationError: The solver found no solution; its `evidence` has the status.
    """
    return _run(program, solver, accuracies)[0]


def run_to_gap(
    program: MathematicalProgram, solver: str, accuracies: Sequence[Tolerances]
) -> tuple[MathematicalProgramResult, float]:
    """As `run_solver`, with the duality gap that the solver may have left, in the unit of the cost.

    Args:
        program: Any program the solver can take.
        solver: Clarabel, whose tolerances are those of gaps.
        accuracies: What to try in turn.
    """
    result, tolerances = _run(program, solver, accuracies)
    exact = result.get_solver_details().status == "Solved"
    share = tolerances[solver]["tol_gap_rel" if exact else "reduced_tol_gap_rel"]
    return result, float(share) * max(1.0, abs(result.get_optimal_cost()))


def _run(
    program: MathematicalProgram, solver: str, accuracies: Sequence[Tolerances]
) -> tuple[MathematicalProgramResult, Tolerances]:
    """The first success, and the accuracy that was asked for."""
    check_solver(solver)
    if solver == "csdp":
        program = _without_squares(program)
    if not SOLVERS[solver]().AreProgramAttributesSatisfied(program):
        raise ArgumentError(
            f"{solver} cannot solve this kind of program: "
            f"{SOLVERS[solver]().ExplainUnsatisfiedProgramAttributes(program)}",
            advice="Use clarabel, or scs as a cross-check.",
        )
    for tolerances in accuracies:
        options = SolverOptions()
        for name, value in tolerances.get(solver, {}).items():
            options.SetOption(SOLVERS[solver].id(), name, value)
        result = SOLVERS[solver]().Solve(program, None, options)
        status = result.get_solution_result()
        if result.is_success():
            return result, tolerances
        if status != SolutionResult.kSolverSpecificError:
            break
    cause, advice = _CAUSES.get(status, _OTHER_CAUSE)
    raise IdentificationError(
        f"{solver} found no parameters ({status.name}). {cause}",
        advice=advice,
        solver=solver,
        status=status.name,
    )


def cone_multiplier(result: MathematicalProgramResult, cone: Any) -> float:
    """Multiplier of a Lorentz cone's bound, of which residual bounds need one for their γ.

    Args:
        result: A solution.
        cone: The binding of the Lorentz cone.

    Raises:
        ArgumentError: The solver gives none.
    """
    try:
        return abs(float(result.GetDualSolution(cone)[0]))
    except ValueError:
        raise ArgumentError(
            f"{result.get_solver_id().name()} gives no multipliers, which a residual bound needs.",
            advice="Use gamma with this solver, or clarabel with residual_bound.",
        ) from None


def _without_squares(program: MathematicalProgram) -> MathematicalProgram:
    """The same program with a cone t ≥ ½ zᵀQz and the cost t for each quadratic cost."""
    program = program.Clone()
    for binding in program.quadratic_costs():
        cost, z = binding.evaluator(), binding.variables()
        values, vectors = np.linalg.eigh(cost.Q())
        root = vectors[:, values > 0] * np.sqrt(values[values > 0])
        t = program.NewContinuousVariables(1, "t")
        # (t, 1, u/√2) in the rotated cone means t ≥ ½ uᵀu.
        matrix = np.zeros((2 + root.shape[1], len(z) + 1))
        matrix[0, -1], matrix[2:, :-1] = 1.0, np.sqrt(0.5) * root.T
        offset = np.eye(len(matrix))[1]
        program.AddRotatedLorentzConeConstraint(matrix, offset, np.append(z, t))
        program.AddLinearCost(np.append(cost.b(), 1.0), cost.c(), np.append(z, t))
        program.RemoveCost(binding)
    return program
