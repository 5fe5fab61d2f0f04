"""How much of its limits a motion uses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.excitation.budget import UNLIMITED, Budget
from geodrake.excitation.collisions import CollisionWorld
from geodrake.excitation.problem import DesignProblem
from geodrake.logs.motion import Motion

Array = NDArray[np.float64]

_TOLERANCE = 1e-6  # share of a limit by which it may be exceeded
FINE = 0.005  # of the family's shortest time, between instants at which the end result is checked
_AT_ONCE = 20  # postures that are looked at between two looks at the clock
_STRIDES = (32, 8, 2, 1)  # of instants at which collisions are looked for, the coarsest first


@dataclass(frozen=True, eq=False)
class LimitUse:
    """Largest shares of the limits that a motion uses, each (nv,); more than one is too much.

    Attributes:
        position: Of the range's half, from its middle.
        distance: Least distance of bodies, m; infinite without collision geometry.
        clearance: The distance to be kept, m.
        stride: Every how many of the instants that were to be looked at the distance is of; more
            than one if time was up.
    """

    position: Array
    velocity: Array
    acceleration: Array
    effort: Array
    distance: float = np.inf
    nearest: str = ""
    clearance: float = 0.0
    stride: int = 1

    @property
    def is_within(self) -> bool:
        """Whether all limits are kept."""
        shares = (self.position, self.velocity, self.acceleration, self.effort)
        within = all((share <= 1.0 + _TOLERANCE).all() for share in shares)
        return within and self.distance >= self.clearance - _TOLERANCE


def limit_use(
    problem: DesignProblem,
    variables: Array,
    *,
    fine: float = FINE,
    budget: Budget = UNLIMITED,
) -> LimitUse:
    """What a motion uses of its limits, looked at far more closely than in the design.

    Args:
        variables: (f nv,) its variables.
        fine: Time between instants, as a share of the family's shortest time.
        budget: Time for collisions, which are the slow part: what is left out when it is up is
            between instants at which they were looked for.
    """
    motion, use = _use_of_joints(problem, variables, fine)
    if problem.collisions is None:
        return use
    return _with_collisions(problem.collisions, use, motion.q, budget)


def keeps_limits(
    problem: DesignProblem, variables: Array, *, fine: float = FINE, budget: Budget = UNLIMITED
) -> bool:
    """Whether a motion keeps all limits, as `limit_use` sees it; ends where one is not kept.

    Args:
        variables: (f nv,) its variables.

    Raises:
        OutOfTimeError: That is not known yet, and the time is up.
    """
    motion, use = _use_of_joints(problem, variables, fine)
    if problem.collisions is None or not use.is_within:
        return use.is_within
    for _, q in _passes(motion.q):
        budget.check()
        distances, _ = problem.collisions.distances(q)
        if distances.min() < problem.collisions.clearance - _TOLERANCE:
            return False
    return True


def _use_of_joints(
    problem: DesignProblem, variables: Array, fine: float
) -> tuple[Motion, LimitUse]:
    """The motion, and what it uses of limits without those of collisions."""
    trajectory, limits = problem.trajectory(variables), problem.limits
    q, v, vd = states = problem.family.basis(problem.family.limit_times(fine)) @ (
        trajectory.coefficients
    )
    motion = trajectory.motion_of(states)
    effort = problem.model.effort(motion, sign_width=problem.sign_width)
    timed = problem.family.timed
    return motion, LimitUse(
        position=_peak((q - limits.middle) / limits.reach, timed),
        velocity=_peak(v / limits.velocity, timed),
        acceleration=_peak(vd / limits.acceleration, timed),
        effort=_peak(effort / limits.effort, timed),
    )


def _with_collisions(world: CollisionWorld, use: LimitUse, q: Array, budget: Budget) -> LimitUse:
    use = replace(use, clearance=world.clearance)
    for stride, postures in _passes(q):
        if stride and budget.left <= 0.0:
            return replace(use, stride=stride)
        distances, names = world.distances(postures)
        nearest = int(np.argmin(distances))
        if distances[nearest] < use.distance:
            use = replace(use, distance=float(distances[nearest]), nearest=names[nearest])
    return use


def _passes(q: Array) -> Iterator[tuple[int, Array]]:
    """Some postures of (n, nq) at a time, each once, and every how many were there before."""
    seen, before = np.zeros(len(q), bool), 0
    for stride in _STRIDES:
        new = np.arange(0, len(q), stride)
        new = new[~seen[new]]
        seen[new] = True
        for first in range(0, len(new), _AT_ONCE):
            yield before, q[new[first : first + _AT_ONCE]]
        before = stride


def _peak(shares: Array, timed: bool) -> Array:
    """(nv,) largest size of shares (n, nv); between instants too, as their curvature tells."""
    sizes = np.abs(shares)
    if timed and len(shares) > 2:
        sizes[1:-1] += np.abs(np.diff(shares, 2, axis=0)) / 8.0
    return np.asarray(sizes.max(axis=0))
