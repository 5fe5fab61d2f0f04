"""The design problem as one of Drake's mathematical programs, with analytic gradients."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.solvers import MathematicalProgram

from geodrake.excitation.budget import UNLIMITED, Budget
from geodrake.excitation.problem import DesignProblem

Array = NDArray[np.float64]
Differentiable = Callable[[Array], tuple[Any, Array]]

_NOTHING = 1e-12  # relative size of what is rounding
_WITHIN = 0.992  # of limits: a sine exceeds its samples by less, 20 a period


def build_program(
    problem: DesignProblem,
    watch: Callable[[float, Array], None] | None = None,
    raised: list[BaseException] | None = None,
    budget: Budget = UNLIMITED,
) -> tuple[MathematicalProgram, NDArray[np.object_]]:
    """The program of a design problem.

    Args:
        watch: Called with every cost and its variables (f nv,), for showing progress.
        raised: Gets what costs, constraints or `watch` raise, which solvers only tell the text of.
        budget: When it is up, costs and constraints raise `OutOfTimeError`: solvers look at the
            clock now and then only.

    Returns:
        The program, and its decision variables (f nv,), which `DesignProblem.trajectory` takes.
    """
    program = MathematicalProgram()
    free, nv = problem.scale.shape
    variables = program.NewContinuousVariables(free, nv, "y")

    def cost(y: Array) -> tuple[float, Array]:
        value, gradient = problem.cost(y)
        if watch is not None:
            watch(value, y)
        return value, gradient

    flat = variables.ravel()
    program.AddCost(_with_autodiff(cost, raised, budget), vars=flat)
    limit_motion(program, problem, variables)
    if np.isfinite(problem.limits.effort).any():
        most = np.ones(problem.effort_basis.shape[1] * nv)
        efforts = _with_autodiff(problem.efforts, raised, budget)
        program.AddConstraint(efforts, lb=-most, ub=most, vars=flat)
    if problem.collisions is not None:
        most = np.ones(problem.collision_basis.shape[1])
        nearness = _with_autodiff(problem.nearness, raised, budget)
        program.AddConstraint(nearness, lb=np.full_like(most, -np.inf), ub=most, vars=flat)
    return program, flat


def limit_motion(
    program: MathematicalProgram, problem: DesignProblem, variables: NDArray[np.object_]
) -> None:
    """Adds linear constraints: positions, velocities and accelerations of every joint.

    Args:
        variables: (f, nv) its variables in the program.
    """
    limits, basis = problem.limits, problem.limit_basis
    for j in range(len(limits.joints)):
        bounds = (
            (limits.lower[j], limits.upper[j]),
            (-_WITHIN * limits.velocity[j], _WITHIN * limits.velocity[j]),
            (-_WITHIN * limits.acceleration[j], _WITHIN * limits.acceleration[j]),
        )
        for Phi, (low, high) in zip(basis, bounds, strict=True):
            if not np.isfinite(high):
                continue
            A = Phi @ problem.free * problem.scale[:, j]
            fixed = Phi @ problem.offset[:, j]
            reach = np.abs(A).max(axis=1)
            moving = reach > _NOTHING * reach.max()  # not so the start, if it is given
            A, fixed, reach = A[moving], fixed[moving], reach[moving]
            program.AddLinearConstraint(
                A / reach[:, None], (low - fixed) / reach, (high - fixed) / reach, variables[:, j]
            )


def _with_autodiff(
    function: Differentiable, raised: list[BaseException] | None, budget: Budget
) -> Callable[[Any], Any]:
    """A function of numbers or of AutoDiffXd, from one that gives its value and Jacobian."""

    def evaluate(y: Array) -> tuple[Any, Array]:
        budget.check()
        return function(y)

    def call(x: Any) -> Any:
        try:
            return differentiated(x)
        except BaseException as error:
            if raised is not None:
                raised.append(error)
            raise

    def differentiated(x: Any) -> Any:
        if x.dtype != object:
            return evaluate(x)[0]
        value, jacobian = evaluate(ExtractValue(x).ravel())
        gradient = np.atleast_2d(jacobian) @ ExtractGradient(x)
        result = InitializeAutoDiff(np.atleast_1d(value), gradient).ravel()
        return result if np.ndim(value) else result[0]

    return call
