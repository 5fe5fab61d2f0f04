"""Run one of Drake's conic solvers, and say what is wrong when it fails."""

from __future__ import annotations

from typing import Any

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

from geodrake.errors import ArgumentError, IdentificationError

SOLVERS: dict[str, type[SolverInterface]] = {
    "clarabel": ClarabelSolver,
    "scs": ScsSolver,
    "csdp": CsdpSolver,
    "mosek": MosekSolver,
}
"""SCS and CSDP are there to cross-check; CSDP takes no exponential cones, so no entropic fits."""

_EXACT: dict[str, dict[str, float | int]] = {
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
_GOOD: dict[str, dict[str, float | int]] = {
    "clarabel": {
        "tol_gap_abs": 1e-9,
        "tol_gap_rel": 1e-9,
        "tol_feas": 1e-9,
        "reduced_tol_gap_abs": 1e-6,
        "reduced_tol_gap_rel": 1e-6,
        "reduced_tol_feas": 1e-6,
    },
}
_ROUGH: dict[str, dict[str, float | int]] = {
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


def run_solver(
    program: MathematicalProgram, solver: str, *, rough: bool = False
) -> MathematicalProgramResult:
    """Solve a program.

    Args:
        program: Any program the solver can take.
        solver: A name of `SOLVERS`.
        rough: Whether a solution to about four digits will do.

    Returns:
        The result, a success.

    Raises:
        ArgumentError: There is no such solver here.
        IdentificationError: The solver found no solution; its `evidence` has the status.
    """
    check_solver(solver)
    if solver == "csdp":
        program = _without_squares(program)
    if not SOLVERS[solver]().AreProgramAttributesSatisfied(program):
        raise ArgumentError(
            f"{solver} cannot solve this kind of program: "
            f"{SOLVERS[solver]().ExplainUnsatisfiedProgramAttributes(program)}",
            advice="Use clarabel, or scs as a cross-check.",
        )
    # The last digits may be out of reach of rounding; a little less is good enough then.
    for tolerances in (_ROUGH,) if rough else (_EXACT, _GOOD):
        options = SolverOptions()
        for name, value in tolerances.get(solver, {}).items():
            options.SetOption(SOLVERS[solver].id(), name, value)
        result = SOLVERS[solver]().Solve(program, None, options)
        status = result.get_solution_result()
        if result.is_success():
            return result
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
