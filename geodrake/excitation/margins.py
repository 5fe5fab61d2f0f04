"""Use of the limits by a motion, checked at many more instants than in the design."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from geodrake.excitation.collisions import CollisionWorld
from geodrake.excitation.problem import DesignProblem
from geodrake.excitation.solve import UNLIMITED, Budget
from geodrake.excitation.trajectory import ExcitationTrajectory
from geodrake.inertia import Array
from geodrake.logs.motion import Motion

FINE = 0.005
"""Share of the family's shortest time between instants at which a motion is checked."""
COARSE = 10
"""Stride between these instants for collision checks during a search."""

_TOLERANCE = 1e-6  # share of a limit by which it may be exceeded
_BATCH = 20  # postures to check between two looks at the clock
_STRIDES = (32, 8, 2, 1)  # of instants in collision checks, the coarsest first
_SHARES = ("position", "velocity", "acceleration", "jerk", "effort")


@dataclass(frozen=True, eq=False)
class LimitUse:
    """Largest shares of the limits that a motion uses, each (nv,); above one they are violated."""

    position: Array  # relative to half the range, from its middle
    velocity: Array
    acceleration: Array
    effort: Array
    jerk: Array
    # "itself" or a close obstacle's name -> least distance, m, and the names of the pair.
    clearances: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    # The distance to keep, m.
    clearance: float = 0.0
    # "velocity", "acceleration", "jerk" or "effort" -> (nv,) largest sizes, SI units.
    peaks: Mapping[str, Array] = field(default_factory=dict)
    # For a robot on its feet, used shares of the polygon by the zero-moment point, of the friction,
    # and of the range of the free joints. Zero otherwise.
    polygon: float = 0.0
    friction: float = 0.0
    reach: float = 0.0
    margin: float = 1.0  # allowed share of the polygon

    @property
    def distance(self) -> float:
        """Smallest distance of bodies, m; infinite if none came close."""
        return min((distance for distance, _ in self.clearances.values()), default=np.inf)

    @property
    def nearest(self) -> str:
        """Bodies with the smallest distance; "" if none came close."""
        return min(self.clearances.values(), default=(np.inf, ""))[1]

    @property
    def is_within(self) -> bool:
        """Whether all limits are kept."""
        within = all((getattr(self, share) <= 1.0 + _TOLERANCE).all() for share in _SHARES)
        within = within and self.polygon <= self.margin + _TOLERANCE
        within = within and max(self.friction, self.reach) <= 1.0 + _TOLERANCE
        return within and self.distance >= self.clearance - _TOLERANCE


def limit_use(
    problem: DesignProblem, trajectory: ExcitationTrajectory, executed: ExcitationTrajectory
) -> LimitUse:
    """Return a motion's use of its limits, with the distances of the executed motion.

    Ramps affect only the distances, as they use at most half of the other limits.
    """
    use, world = joint_use(problem, trajectory)[0], problem.collisions
    if world is None:
        return use
    q = executed.motion(executed.family.limit_times(FINE)).q
    return replace(use, clearances=world.nearest(q), clearance=world.clearance)


def keeps_limits(
    problem: DesignProblem, variables: Array, *, stride: int = 1, budget: Budget = UNLIMITED
) -> bool:
    """Return whether a motion keeps all limits as in `limit_use`, stopping at the first violation.

    Collisions are checked only at every `stride`-th instant.
    """
    use, motion = joint_use(problem, problem.trajectory(variables))
    if problem.collisions is None or not use.is_within:
        return use.is_within
    return stays_clear(problem.collisions, motion.q[::stride], budget)


def stays_clear(world: CollisionWorld, q: Array, budget: Budget = UNLIMITED) -> bool:
    """Return whether postures (n, nq) keep the clearance, stopping at the first violation."""
    first = np.argmax([np.arange(len(q)) % stride == 0 for stride in _STRIDES], axis=0)
    order = np.argsort(first, kind="stable")
    for start in range(0, len(q), _BATCH):
        budget.check()
        postures = q[order[start : start + _BATCH]]
        if world.distances(postures)[0].min() < world.clearance - _TOLERANCE:
            return False
    return True


def joint_use(problem: DesignProblem, trajectory: ExcitationTrajectory) -> tuple[LimitUse, Motion]:
    """Return the use of all limits except distances, and the motion at the checked instants."""
    limits, stance, family = problem.motor_limits, trajectory.stance, trajectory.family
    timed, times = family.timed, family.limit_times(FINE)
    free = family.basis(times, orders=3 + timed) @ trajectory.coefficients
    motion, balance = Motion(*free[:3]), dict[str, Any]()
    if stance is None:
        (q, v, vd), jerk = free[:3], free[3] if timed else np.zeros_like(free[0])
        effort = problem.model.effort(motion, sign_width=problem.sign_width)
    else:
        q, v, vd = stance.motor_states(free[:3])
        jerk = np.gradient(vd, times, axis=0) if timed else np.zeros_like(vd)
        effort = stance.efforts(motion, problem.sign_width)
        polygon, friction = stance.support(motion)
        reach = (free[0] - problem.limits.middle) / problem.limits.reach
        uses = {"polygon": polygon[:, None], "friction": friction[:, None], "reach": reach}
        balance = {name: float(_peak(x, timed).max()) for name, x in uses.items()}
        balance["margin"] = stance.margin
    signals = {"velocity": v, "acceleration": vd, "effort": effort, "jerk": jerk}
    peaks = {name: _peak(signal, timed) for name, signal in signals.items()}
    shares = {name: peak / getattr(limits, name) for name, peak in peaks.items()}
    position = _peak((q - limits.middle) / limits.reach, timed)
    return LimitUse(position=position, peaks=peaks, **shares, **balance), motion


def _peak(signals: Array, timed: bool) -> Array:
    """Return the largest sizes (nv,) of signals (n, nv), bounded between instants by curvature."""
    sizes = np.abs(signals)
    if timed and len(signals) > 2 and np.isfinite(sizes).all():
        sizes[1:-1] += np.abs(np.diff(signals, 2, axis=0)) / 8.0
    return np.asarray(sizes.max(axis=0))
