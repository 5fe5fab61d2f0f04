"""How much of its limits a motion uses, looked at far more closely than in the design."""

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
"""Every how many of them collisions are looked for during a search."""

_TOLERANCE = 1e-6  # share of a limit by which it may be exceeded
_AT_ONCE = 20  # postures that are looked at between two looks at the clock
_STRIDES = (32, 8, 2, 1)  # of instants at which collisions are looked for, the coarsest first
_SHARES = ("position", "velocity", "acceleration", "jerk", "effort")


@dataclass(frozen=True, eq=False)
class LimitUse:
    """Largest shares of the limits that a motion uses, each (nv,); more than one is too much."""

    position: Array  # of the range's half, from its middle
    velocity: Array
    acceleration: Array
    effort: Array
    jerk: Array
    # "itself" or an obstacle's name -> least distance, m, and between what it is, of all that ever
    # came near.
    clearances: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    # The distance to be kept, m; infinite distances without collision geometry.
    clearance: float = 0.0
    # "velocity", "acceleration", "jerk" or "effort" -> (nv,) largest sizes, SI units.
    peaks: Mapping[str, Array] = field(default_factory=dict)
    # Of a robot on its feet: shares of their polygon that the zero-moment point goes to, of the
    # friction there is, and of the range in which its base was looked at. Zero otherwise.
    polygon: float = 0.0
    friction: float = 0.0
    reach: float = 0.0
    # Share of the polygon that is allowed.
    margin: float = 1.0

    @property
    def distance(self) -> float:
        """Smallest distance of bodies, m; infinite if nothing came near."""
        return min((distance for distance, _ in self.clearances.values()), default=np.inf)

    @property
    def nearest(self) -> str:
        """Bodies with the smallest distance; "" if nothing came near."""
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
    """Return a motion's use of its limits, with all distances on the way as it is executed.

    Its ramps take half of the other limits.
    """
    use, world = joint_use(problem, trajectory)[0], problem.collisions
    if world is None:
        return use
    q = executed.motion(executed.family.limit_times(FINE)).q
    return replace(use, clearances=world.nearest(q), clearance=world.clearance)


def keeps_limits(
    problem: DesignProblem, variables: Array, *, stride: int = 1, budget: Budget = UNLIMITED
) -> bool:
    """Return whether a motion keeps all limits, as `limit_use` sees it; ends where one is not kept.

    Collisions are looked for at one of so many instants, the stride.
    """
    use, motion = joint_use(problem, problem.trajectory(variables))
    if problem.collisions is None or not use.is_within:
        return use.is_within
    return stays_clear(problem.collisions, motion.q[::stride], budget)


def stays_clear(world: CollisionWorld, q: Array, budget: Budget = UNLIMITED) -> bool:
    """Return whether postures (n, nq) keep the clearance; ends where it is not kept."""
    first = np.argmax([np.arange(len(q)) % stride == 0 for stride in _STRIDES], axis=0)
    order = np.argsort(first, kind="stable")
    for at in range(0, len(q), _AT_ONCE):
        budget.check()
        postures = q[order[at : at + _AT_ONCE]]
        if world.distances(postures)[0].min() < world.clearance - _TOLERANCE:
            return False
    return True


def joint_use(problem: DesignProblem, trajectory: ExcitationTrajectory) -> tuple[LimitUse, Motion]:
    """Return the use of all limits but those of distances, and the motion that was looked at."""
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
        of_balance = {"polygon": polygon[:, None], "friction": friction[:, None], "reach": reach}
        balance = {name: float(_peak(x, timed).max()) for name, x in of_balance.items()}
        balance["margin"] = stance.margin
    signals = {"velocity": v, "acceleration": vd, "effort": effort, "jerk": jerk}
    peaks = {name: _peak(signal, timed) for name, signal in signals.items()}
    shares = {name: peak / getattr(limits, name) for name, peak in peaks.items()}
    position = _peak((q - limits.middle) / limits.reach, timed)
    return LimitUse(position=position, peaks=peaks, **shares, **balance), motion


def _peak(signals: Array, timed: bool) -> Array:
    """Return (nv,) largest size of signals (n, nv), between instants too, by their curvature."""
    sizes = np.abs(signals)
    if timed and len(signals) > 2 and np.isfinite(sizes).all():
        sizes[1:-1] += np.abs(np.diff(signals, 2, axis=0)) / 8.0
    return np.asarray(sizes.max(axis=0))
