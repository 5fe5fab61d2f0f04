"""Run SNOPT or IPOPT on a design problem."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from pydrake.solvers import IpoptSolver, SnoptSolver, SolverInterface, SolverOptions

from geodrake.errors import ArgumentError
from geodrake.excitation.problem import DesignProblem
from geodrake.excitation.program import build_program
from geodrake.model_files.description import drake_messages

Array = NDArray[np.float64]

SOLVERS: dict[str, type[SolverInterface]] = {"snopt": SnoptSolver, "ipopt": IpoptSolver}
_OPTIMAL, _FEASIBLE = 1e-4, 1e-6


def check_solver(solver: str) -> None:
    """Refuse a solver that there is not, or not here.

    Raises:
        ArgumentError: There is no such solver here.
    """
    usable = [name for name, kind in SOLVERS.items() if kind().available() and kind().enabled()]
    if solver not in usable:
        raise ArgumentError(f"No nonlinear solver {solver!r} here; there are {', '.join(usable)}.")


def solve(
    problem: DesignProblem,
    guess: Array,
    *,
    solver: str,
    iterations: int,
    seconds: float,
    watch: Callable[[float, Array], None],
) -> tuple[Array, str]:
    """Improve a motion.

    Args:
        problem: The design problem.
        guess: (f, nv) variables to start from.
        solver: A name of `SOLVERS`.
        iterations: Most iterations.
        seconds: Most time, s.
        watch: Called with every cost and its variables.

    Returns:
        (f nv,) variables, whether or not the solver was done, and what it said.
    """
    raised: list[BaseException] = []
    program, variables = build_program(problem, watch, raised)
    options, engine = SolverOptions(), SOLVERS[solver]()
    settings: dict[str, float | int]
    if solver == "snopt":
        settings = {
            "Major iterations limit": iterations,
            "Major optimality tolerance": _OPTIMAL,
            "Major feasibility tolerance": _FEASIBLE,
            "Time limit": seconds,
        }
    else:
        settings = {
            "max_iter": iterations,
            "tol": _OPTIMAL,
            "constr_viol_tol": _FEASIBLE,
            "max_cpu_time": seconds,
            "print_level": 0,
        }
    for name, value in settings.items():
        options.SetOption(engine.solver_id(), name, value)
    try:
        with drake_messages():  # of iteration limits, which are no news here
            result = engine.Solve(program, guess.ravel(), options)
    except RuntimeError as error:
        if raised:
            raise raised[0] from error
        raise
    return np.asarray(result.GetSolution(variables), float), result.get_solution_result().name
