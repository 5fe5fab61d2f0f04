"""Feasible motions to start a design from, and the way back to one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.excitation.margins import limit_use
from geodrake.excitation.problem import DesignProblem

Array = NDArray[np.float64]

_FILL = (0.6, 0.95)  # share of the limits that a random motion uses
_SHRINK = 0.8
_STEPS = 40
_FINE = 0.05  # of the family's shortest time
_BISECTIONS = 12


def random_guess(
    problem: DesignProblem, postures: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """A random motion within all limits, about a posture that can be held.

    Args:
        problem: The design problem.
        postures: (n, nv) postures to choose from.
        rng: Source of randomness.

    Returns:
        Variables (f, nv) of the motion, and those of staying in the posture.
    """
    posture = postures[int(rng.integers(len(postures)))]
    held = problem.held(posture)
    direction = rng.uniform(-1.0, 1.0, held.shape)
    around = problem.limit_basis @ problem.coefficients(held)
    change = problem.limit_basis @ (problem.free @ (problem.scale * direction))
    limits = problem.limits
    room = np.array(
        [
            _room(change[0], limits.upper - around[0], around[0] - limits.lower),
            _room(change[1], limits.velocity - around[1], limits.velocity + around[1]),
            _room(change[2], limits.acceleration - around[2], limits.acceleration + around[2]),
        ]
    ).min(axis=0)
    moving = held + rng.uniform(*_FILL) * room * direction
    share = 1.0
    for _ in range(_STEPS):
        guess = held + share * (moving - held)
        if limit_use(problem, guess, fine=_FINE).is_within:
            return guess, held
        share *= _SHRINK
    return held, held


def within_limits(problem: DesignProblem, variables: Array, held: Array) -> Array | None:
    """The motion nearest to one on the way to rest that keeps all limits; None if only rest does.

    Args:
        problem: The design problem.
        variables: (f, nv) variables of a motion that keeps the limits, or nearly so.
        held: (f, nv) variables of a posture that can be held.
    """
    if limit_use(problem, variables).is_within:
        return variables
    least, most, found = 0.0, 1.0, None
    for _ in range(_BISECTIONS):
        share = 0.5 * (least + most) if found is not None else most - (most - least) * 0.25
        moved = held + share * (variables - held)
        if limit_use(problem, moved).is_within:
            least, found = share, moved
        else:
            most = share
    return found


def _room(change: Array, above: Array, below: Array) -> Array:
    """(nv,) largest multiple of a change (n, nv) that stays below one bound and above the other."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(change > 0, above / change, np.where(change < 0, -below / change, np.inf))
    return np.asarray(np.maximum(ratio.min(axis=0), 0.0))
