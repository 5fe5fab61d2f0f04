"""Run SNOPT or IPOPT on a design problem."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray
from pydrake.solvers import IpoptSolver, SnoptSolver, SolverInterface, SolverOptions

from geodrake.boundary.interrupts import StopSearch, is_stop
from geodrake.errors import ArgumentError
from geodrake.excitation.budget import Budget, OutOfTimeError
from geodrake.excitation.guess import within_limits
from geodrake.excitation.margins import keeps_limits
from geodrake.excitation.problem import DesignProblem
from geodrake.excitation.program import build_program
from geodrake.robot.files.description import drake_messages

Array = NDArray[np.float64]

SOLVERS: dict[str, type[SolverInterface]] = {"snopt": SnoptSolver, "ipopt": IpoptSolver}
_OPTIMAL, _FEASIBLE = 1e-4, 1e-6
_LOOKED_AT = 200  # most of the motions that a solver saw
_COARSE = 0.05  # of the family's shortest time
_FOR_WAY = 0.5  # of what is left of it; the rest is for motions that the solver saw
_FOR_SOLVER = 0.8  # of the time; the rest is for the way back to the limits
_OUT_OF_TIME = "out of time"
INTERRUPTED = "interrupted"
"""What is said of a start that was stopped by `StopSearch`."""
AFTER_STOP = 2.0
"""Time for the way back to the limits of a motion that was stopped, s."""


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

    A solver that is stopped may be beyond limits of efforts or in collision, and the way back long.
    Then the best motion that it saw within them may be better.

    Args:
        guess: (f, nv) variables to start from, within the limits.
        seconds: Most time, s.
        watch: Called with every cost and its variables.

    Returns:
        (f nv,) variables, whether or not the solver was done, and what it said.
    """
    raised: list[BaseException] = []
    seen: list[tuple[float, Array]] = []

    def see(value: float, y: Array) -> None:
        seen.append((value, y.copy()))
        watch(value, y)

    budget = Budget.of(seconds)
    program, variables = build_program(problem, see, raised, budget.part(_FOR_SOLVER))
    engine = SOLVERS[solver]()
    try:
        with drake_messages():  # of iteration limits, which are no news here
            options = _settings(engine, solver, iterations, seconds)
            result = engine.Solve(program, guess.ravel(), options)
    except (RuntimeError, StopSearch) as error:
        cause = raised[0] if raised else error
        last = seen[-1][1] if seen else guess.ravel()
        if isinstance(cause, OutOfTimeError):
            return _back(problem, last, guess, seen, budget), _OUT_OF_TIME
        if is_stop(cause):
            short = Budget.of(min(budget.left, AFTER_STOP))
            return _back(problem, last, guess, seen, short), INTERRUPTED
        if raised:
            raise raised[0] from error
        raise
    found = np.asarray(result.GetSolution(variables), float)
    # Solvers keep linear limits on their way, those of efforts and collisions in the end only.
    bent = problem.collisions is not None or bool(np.isfinite(problem.limits.effort).any())
    is_done = result.is_success() or not bent
    if not is_done and not keeps_limits(problem, found, fine=_COARSE):
        found = _back(problem, found, guess, seen, budget)
    return found, result.get_solution_result().name


def _settings(
    engine: SolverInterface, solver: str, iterations: int, seconds: float
) -> SolverOptions:
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
    options = SolverOptions()
    for name, value in settings.items():
        options.SetOption(engine.solver_id(), name, value)
    return options


def _back(
    problem: DesignProblem,
    found: Array,
    guess: Array,
    seen: list[tuple[float, Array]],
    budget: Budget,
) -> Array:
    """The better of the motion (f nv,) on the way back to the guess, and the best of those seen."""
    nearest = within_limits(
        problem, found.reshape(guess.shape), guess, budget.part(_FOR_WAY), fine=_COARSE
    ).ravel()
    value = problem.cost(nearest)[0]
    better = sorted((one for one in seen if one[0] < value), key=lambda one: one[0])
    with suppress(OutOfTimeError):
        for _, y in better[:_LOOKED_AT]:
            if keeps_limits(problem, y, fine=_COARSE, budget=budget):
                return y
    return nearest
