"""How much of its limits a motion uses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.excitation.problem import DesignProblem

Array = NDArray[np.float64]

_TOLERANCE = 1e-6  # share of a limit by which it may be exceeded
_FINE = 0.005  # of the family's shortest time, between instants at which the end result is checked


@dataclass(frozen=True, eq=False)
class LimitUse:
    """Largest shares of the limits that a motion uses, each (nv,); more than one is too much.

    Attributes:
        position: Of the range's half, from its middle.
        velocity: Of the speed.
        acceleration: Of the acceleration.
        effort: Of the effort.
        distance: Least distance of bodies, m; infinite without collision geometry.
        nearest: Which bodies those are.
        clearance: The distance to be kept, m.
    """

    position: Array
    velocity: Array
    acceleration: Array
    effort: Array
    distance: float = np.inf
    nearest: str = ""
    clearance: float = 0.0

    @property
    def is_within(self) -> bool:
        """Whether all limits are kept."""
        shares = (self.position, self.velocity, self.acceleration, self.effort)
        within = all((share <= 1.0 + _TOLERANCE).all() for share in shares)
        return within and self.distance >= self.clearance - _TOLERANCE


def limit_use(problem: DesignProblem, variables: Array, *, fine: float = _FINE) -> LimitUse:
    """What a motion uses of its limits, looked at far more closely than in the design.

    Args:
        problem: The design problem.
        variables: (f nv,) its variables.
        fine: Time between instants, as a share of the family's shortest time.
    """
    trajectory, limits = problem.trajectory(variables), problem.limits
    q, v, vd = states = problem.family.basis(problem.family.limit_times(fine)) @ (
        trajectory.coefficients
    )
    motion = trajectory.motion_of(states)
    effort = problem.model.effort(motion, sign_width=problem.sign_width)
    timed = problem.family.timed
    use = LimitUse(
        position=_peak((q - limits.middle) / limits.reach, timed),
        velocity=_peak(v / limits.velocity, timed),
        acceleration=_peak(vd / limits.acceleration, timed),
        effort=_peak(effort / limits.effort, timed),
    )
    if problem.collisions is None:
        return use
    distances, names = problem.collisions.distances(motion.q)
    nearest = int(np.argmin(distances))
    return replace(
        use,
        distance=float(distances[nearest]),
        nearest=names[nearest],
        clearance=problem.collisions.clearance,
    )


def _peak(shares: Array, timed: bool) -> Array:
    """(nv,) largest size of shares (n, nv); between instants too, as their curvature tells."""
    sizes = np.abs(shares)
    if timed and len(shares) > 2:
        sizes[1:-1] += np.abs(np.diff(shares, 2, axis=0)) / 8.0
    return np.asarray(sizes.max(axis=0))
