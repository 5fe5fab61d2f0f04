"""Solve a design problem with SNOPT or IPOPT until its value settles or time is up."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.solvers import (
    IpoptSolver,
    MathematicalProgram,
    SnoptSolver,
    SolverInterface,
    SolverOptions,
)

from geodrake.boundary.interrupts import StopSearch, is_stop
from geodrake.errors import ArgumentError
from geodrake.excitation.problem import DesignProblem, limit_motion
from geodrake.inertia import Array
from geodrake.robot.files.description import drake_messages

SOLVERS: dict[str, type[SolverInterface]] = {"snopt": SnoptSolver, "ipopt": IpoptSolver}
INTERRUPTED, OUT_OF_TIME, SETTLED = "interrupted", "out of time", "settled"
"""Status of a start that was stopped, ran out of time, or whose value settled."""
_SETTINGS = {
    "snopt": {"Major optimality tolerance": 1e-4, "Major feasibility tolerance": 1e-6},
    "ipopt": {"tol": 1e-4, "constr_viol_tol": 1e-6, "print_level": 0},
}
_MOST = {"snopt": ("Major iterations limit", "Time limit"), "ipopt": ("max_iter", "max_cpu_time")}
_SETTLED_CHANGE, _SETTLED_COUNT = 5e-2, 12  # change of the logarithmic value, evaluations

Seen = list[tuple[float, Array]]
"""Values and variables (f nv,) of the motions that a solver visited."""


class SearchEndError(Exception):
    """End of a search, whose result so far is used. It never leaves a design."""


@dataclass(frozen=True)
class Budget:
    """Wall-clock time until the instant `end` of `time.monotonic`, s."""

    end: float

    @classmethod
    def of(cls, seconds: float) -> Budget:
        """Return a budget of some seconds from now."""
        return cls(time.monotonic() + seconds)

    @property
    def left(self) -> float:
        """Remaining time, s; negative once it is up."""
        return self.end - time.monotonic()

    def part(self, share: float) -> Budget:
        """Return a share of the remaining time, from now."""
        return Budget.of(share * self.left)

    def check(self) -> None:
        """Raise `SearchEndError` if the time is up."""
        if self.left <= 0.0:
            raise SearchEndError(OUT_OF_TIME)


UNLIMITED = Budget(float("inf"))


def check_solver(solver: str) -> None:
    """Raise if a solver is unknown or unavailable."""
    available = [name for name, kind in SOLVERS.items() if kind().available() and kind().enabled()]
    if solver not in available:
        raise ArgumentError(
            f"Nonlinear solver {solver!r} is unknown or not installed; "
            f"available: {', '.join(available)}."
        )


def solve(
    problem: DesignProblem, guess: Array, *, budget: Budget, watch: Callable[[float], None]
) -> tuple[Array, str, Seen]:
    """Improve a motion, from variables (f, nv) within the limits.

    A quick search ends once the value changes by less than 5 % in twelve evaluations.

    Args:
        watch: Called with every cost.

    Returns:
        The last variables (f nv,), which may violate limits; the status; all visited motions.
    """
    raised: list[BaseException] = []  # solvers report only the text of errors
    seen: Seen = []
    options = problem.options

    def cost(y: Array) -> tuple[float, Array]:
        value, gradient = problem.cost(y)
        seen.append((value, y.copy()))
        watch(value)
        last = [value for value, _ in seen[-_SETTLED_COUNT:]]
        is_settled = len(last) == _SETTLED_COUNT and max(last) - min(last) < _SETTLED_CHANGE
        if options.quick and is_settled:
            raise SearchEndError(SETTLED)
        return value, gradient

    def differentiable(function: Callable[[Array], tuple[Any, Array]]) -> Callable[[Any], Any]:
        """Return a function of floats or AutoDiffXd from one that returns value and Jacobian."""

        def call(x: Any) -> Any:
            plain = x.dtype != object
            try:
                budget.check()  # solvers check the time only now and then
                value, jacobian = function(x if plain else ExtractValue(x).ravel())
            except BaseException as error:
                raised.append(error)
                raise
            if plain:
                return value
            gradient = np.atleast_2d(jacobian) @ ExtractGradient(x)
            result = InitializeAutoDiff(np.atleast_1d(value), gradient).ravel()
            return result if np.ndim(value) else result[0]

        return call

    program = MathematicalProgram()
    variables = program.NewContinuousVariables(*problem.scale.shape, "y")
    flat = variables.ravel()
    program.AddCost(differentiable(cost), vars=flat)
    limit_motion(program, problem, variables)
    for function, count, least, most in problem.constraints:
        bounds = np.full(count, least), np.full(count, most)
        program.AddConstraint(differentiable(function), *bounds, vars=flat)
    engine, settings = SOLVERS[options.solver](), SolverOptions()
    values: dict[str, float | int] = dict(_SETTINGS[options.solver])
    values |= zip(_MOST[options.solver], (options.iterations, max(budget.left, 1e-3)), strict=True)
    for name, value in values.items():
        settings.SetOption(engine.solver_id(), name, value)
    try:
        with drake_messages():  # suppress messages on iteration limits
            result = engine.Solve(program, guess.ravel(), settings)
    except (RuntimeError, StopSearch, SearchEndError) as error:
        cause = raised[0] if raised else error
        if not (is_stop(cause) or isinstance(cause, SearchEndError)):
            raise cause from None
        status = INTERRUPTED if is_stop(cause) else str(cause)
        return (seen[-1][1] if seen else guess.ravel()), status, seen
    return result.GetSolution(flat), result.get_solution_result().name, seen
