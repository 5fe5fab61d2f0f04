"""Run SNOPT or IPOPT on a design problem until its value stands still or time is up."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.solvers import IpoptSolver, SnoptSolver, SolverInterface, SolverOptions

from geodrake.boundary.interrupts import StopSearch, is_stop
from geodrake.errors import ArgumentError
from geodrake.excitation.problem import DesignOptions, DesignProblem, build_program
from geodrake.inertia import Array
from geodrake.robot.files.description import drake_messages

SOLVERS: dict[str, type[SolverInterface]] = {"snopt": SnoptSolver, "ipopt": IpoptSolver}
INTERRUPTED, OUT_OF_TIME, SETTLED = "interrupted", "out of time", "settled"
"""How a start ends that was stopped, whose time is up, or whose value stands still."""
_OPTIMAL, _FEASIBLE = 1e-4, 1e-6
_STILL, _STILL_FOR = 5e-2, 12  # a value (a logarithm) changes by less in so many evaluations


class OutOfTimeError(Exception):
    """Time is up; what is found by then is what counts. It never leaves a design."""


class _SettledError(Exception):
    """The value stands still: solvers would polish the last digits for minutes."""


@dataclass(frozen=True)
class Budget:
    """Time on the clock of the wall, up at an instant `end` of `time.monotonic`, s."""

    end: float

    @classmethod
    def of(cls, seconds: float) -> Budget:
        """Return so many seconds from now on."""
        return cls(time.monotonic() + seconds)

    @property
    def left(self) -> float:
        """What is left of it, s; negative once it is up."""
        return self.end - time.monotonic()

    def part(self, share: float) -> Budget:
        """Return a share of what is left, from now on."""
        return Budget.of(share * self.left)

    def check(self) -> None:
        """Raise `OutOfTimeError` if the time is up."""
        if self.left <= 0.0:
            raise OutOfTimeError


UNLIMITED = Budget(float("inf"))


@dataclass(frozen=True, eq=False)
class SolverEnd:
    """What a solver made of a motion."""

    variables: Array  # (f nv,) the last that it saw, whether or not limits are kept
    seen: tuple[tuple[float, Array], ...]  # values and variables of all that it saw, the best first
    status: str


def check_solver(solver: str) -> None:
    """Raise if a solver is unknown or unavailable."""
    usable = [name for name, kind in SOLVERS.items() if kind().available() and kind().enabled()]
    if solver not in usable:
        raise ArgumentError(
            f"Nonlinear solver {solver!r} is unknown or not installed; "
            f"available: {', '.join(usable)}."
        )


def solve(
    problem: DesignProblem,
    guess: Array,
    *,
    budget: Budget,
    watch: Callable[[float, Array], None],
    quick: bool = False,
) -> SolverEnd:
    """Improve a motion, from variables (f, nv) within the limits.

    A quick search ends once the value changes by less than 5 % in twelve evaluations.
    """
    options = problem.options
    raised: list[BaseException] = []
    seen: list[tuple[float, Array]] = []

    def see(value: float, y: Array) -> None:
        seen.append((value, y.copy()))
        watch(value, y)
        last = [value for value, _ in seen[-_STILL_FOR:]]
        if quick and len(last) == _STILL_FOR and max(last) - min(last) < _STILL:
            raise _SettledError

    program, variables = build_program(problem, see, raised, budget.check)
    engine = SOLVERS[options.solver]()
    y = guess.ravel()
    try:
        with drake_messages():  # of iteration limits, which are no news here
            settings = _settings(engine, options, max(budget.left, 1e-3))
            result = engine.Solve(program, y, settings)
        y = np.asarray(result.GetSolution(variables), float)
        status = result.get_solution_result().name
    except (RuntimeError, StopSearch, _SettledError, OutOfTimeError) as error:
        cause = raised[0] if raised else error
        y = seen[-1][1] if seen else y
        if is_stop(cause):
            status = INTERRUPTED
        elif isinstance(cause, _SettledError | OutOfTimeError):
            status = SETTLED if isinstance(cause, _SettledError) else OUT_OF_TIME
        elif raised:
            raise raised[0] from error
        else:
            raise
    return SolverEnd(y, tuple(sorted(seen, key=lambda one: one[0])), status)


def _settings(engine: SolverInterface, asked: DesignOptions, seconds: float) -> SolverOptions:
    settings: dict[str, float | int]
    if asked.solver == "snopt":
        settings = {
            "Major iterations limit": asked.iterations,
            "Major optimality tolerance": _OPTIMAL,
            "Major feasibility tolerance": _FEASIBLE,
            "Time limit": seconds,
        }
    else:
        settings = {
            "max_iter": asked.iterations,
            "tol": _OPTIMAL,
            "constr_viol_tol": _FEASIBLE,
            "max_cpu_time": seconds,
            "print_level": 0,
        }
    options = SolverOptions()
    for name, value in settings.items():
        options.SetOption(engine.solver_id(), name, value)
    return options
