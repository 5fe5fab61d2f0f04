"""Further steps from a design: where solvers end that rounding had led different ways."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.excitation import (
    Criterion,
    DesignOptions,
    ExcitationTrajectory,
    MotionFamily,
    MotionLimits,
    Objective,
    Target,
)
from geodrake.excitation.problem import make_problem
from geodrake.excitation.solve import Budget, solve
from geodrake.excitation.starts import within_limits

Array = NDArray[np.float64]

_SHARPNESS = 64.0  # of the smooth form of the criterion: the last stage of a design


def refined(
    target: Target,
    limits: MotionLimits,
    family: MotionFamily,
    coefficients: Array,
    options: DesignOptions,
) -> tuple[ExcitationTrajectory, float, str]:
    """The optimum of geometric E-optimality next to a motion (count, nv) that keeps the limits.

    Returns:
        The motion, the smooth logarithm that was minimized, and what the solver said.
    """
    objective = Objective(target, Criterion("e_optimality", _SHARPNESS))
    problem = make_problem(objective, limits, family, options)
    start = problem.variables(coefficients)
    found = solve(
        problem,
        start,
        budget=Budget.of(options.seconds),
        watch=lambda _value, _variables: None,
    )
    end = within_limits(problem, found.variables.reshape(start.shape), start)
    return problem.trajectory(end), problem.cost(end)[0], found.status
