"""Feasible motions to start a design from, and the way back to one."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray
from pydrake.solvers import ClpSolver, MathematicalProgram

from geodrake.errors import ArgumentError
from geodrake.excitation.budget import UNLIMITED, Budget, OutOfTimeError
from geodrake.excitation.margins import FINE, keeps_limits
from geodrake.excitation.problem import DesignProblem
from geodrake.excitation.program import limit_motion

Array = NDArray[np.float64]

_FILL = (0.6, 0.95)  # share of the limits that a random motion uses
_CORNERS = 2
_NOTHING = 1e-9  # relative size of a change that is rounding
_POSTURES = 5
_SHRINK = 0.8
_STEPS = 40
_COARSE = 0.05  # of the family's shortest time
_BISECTIONS = 14
_FIRST_STEP_BACK = 0.002


def random_guess(
    problem: DesignProblem,
    postures: Array,
    rng: np.random.Generator,
    budget: Budget = UNLIMITED,
) -> Array:
    """A random motion within all limits, about a posture that can be held.

    Args:
        postures: (n, nv) postures to choose from.

    Returns:
        Variables (f, nv) of the motion.

    Raises:
        OutOfTimeError: There is none when the time is up.
        ArgumentError: About none of a few postures there is such a motion.
    """
    for _ in range(_POSTURES):
        resting = problem.resting(postures[int(rng.integers(len(postures)))])
        if problem.start is None:
            direction = rng.uniform(-1.0, 1.0, resting.shape)
            moving = resting + rng.uniform(*_FILL) * _room(problem, resting, direction) * direction
        else:
            moving = _from_corners(problem, rng)
        share = 1.0
        for _ in range(_STEPS):
            guess = resting + share * (moving - resting)
            if keeps_limits(problem, guess, fine=_COARSE, budget=budget):
                return np.asarray(guess)
            budget.check()
            share *= _SHRINK
    raise ArgumentError(
        "The robot can hold still within its limits, but hardly move: no random motion about "
        f"{_POSTURES} postures keeps them.",
        advice="Widen the limits that are nearly reached at rest, or start elsewhere.",
    )


def _from_corners(problem: DesignProblem, rng: np.random.Generator) -> Array:
    """A random mean (f, nv) of a few motions that go as far as joint limits let them.

    A start may be at a limit, from where most random directions lead out at once. A linear program
    finds motions that do not.
    """
    program = MathematicalProgram()
    variables = program.NewContinuousVariables(*problem.scale.shape)
    limit_motion(program, problem, variables)
    cost = program.AddLinearCost(np.zeros(variables.size), variables.ravel())
    corners = []
    aims = rng.normal(size=(_CORNERS, variables.size))
    for aim in (*aims, *-aims):  # one of the two ways may be none, from a start at a limit
        cost.evaluator().UpdateCoefficients(aim)
        result = ClpSolver().Solve(program)
        if not result.is_success():
            raise ArgumentError(
                "No motion of the family leads from the start and keeps the limits of the joints.",
                advice="Give the family more coefficients or time, or start elsewhere.",
            )
        corners.append(result.GetSolution(variables))
    weights = rng.dirichlet(np.ones(len(corners)), size=problem.scale.shape[1])  # a joint
    return np.asarray(np.einsum("jc,cfj->fj", weights, np.array(corners)))


def _room(problem: DesignProblem, around: Array, direction: Array) -> Array:
    """(nv,) by how much of a direction each joint can leave a motion within its own limits."""
    q, v, vd = problem.limit_basis @ problem.coefficients(around)
    change = problem.limit_basis @ (problem.free @ (problem.scale * direction))
    limits = problem.limits
    rooms = (
        _multiple(change[0], limits.upper - q, q - limits.lower),
        _multiple(change[1], limits.velocity - v, limits.velocity + v),
        _multiple(change[2], limits.acceleration - vd, limits.acceleration + vd),
    )
    return np.asarray(np.min(rooms, axis=0))


def _multiple(change: Array, above: Array, below: Array) -> Array:
    """(nv,) largest multiple of a change (n, nv) that stays within the room on either side."""
    size = np.abs(change)
    moving = size > _NOTHING * size.max(axis=0)
    room = np.where(change > 0, above, below)
    ratio = np.where(moving, room, np.inf) / np.where(moving, size, 1.0)
    return np.asarray(np.maximum(ratio.min(axis=0), 0.0))


def within_limits(
    problem: DesignProblem,
    variables: Array,
    inside: Array,
    budget: Budget = UNLIMITED,
    *,
    fine: float = FINE,
) -> Array:
    """The motion nearest to one, on the way from another that keeps all limits, that does so too.

    Args:
        variables: (f, nv) variables of a motion that keeps the limits, or nearly so.
        inside: (f, nv) variables of a motion that keeps them.
        budget: Time for it; when it is up, the nearest one found by then counts.
    """
    least, step = 0.0, _FIRST_STEP_BACK
    most = 1.0
    with suppress(OutOfTimeError):
        if keeps_limits(problem, variables, fine=fine, budget=budget):
            return variables
        for _ in range(_BISECTIONS):
            share = most - step if most - step > least else 0.5 * (least + most)
            tried = inside + share * (variables - inside)
            if keeps_limits(problem, tried, fine=fine, budget=budget):
                least = share
            else:
                most, step = share, 4.0 * step
    return np.asarray(inside + least * (variables - inside))
