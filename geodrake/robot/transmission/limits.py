"""Limits of joints as limits of their actuators: boxes within which every joint keeps its own.

Joints that each follow one actuator have exact limits. Where several actuators move a joint
together, its limits are no box in their coordinates; the box is one inside them, in which every
actuator may go as far in proportion.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from geodrake.inertia import Array
from geodrake.robot.transmission.actuation import Actuation, Places, middle, seated_at
from geodrake.robot.transmission.drive import Drive

_FAR = 10.0  # rad or m, up to where limits are looked for where the map has none
_POINTS = 4001


def actuator_positions_between(
    actuation: Actuation, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """Least and greatest positions (nq,) of a robot, of those (nq of the tree,) of its joints."""
    low, high = np.full((2, actuation.num_positions), np.nan)
    own, tree = actuation.kept_q
    low[own], high[own] = lower[tree], upper[tree]
    for place in actuation.places:
        at, ends = place.actuator_q, (lower[place.joint_q], upper[place.joint_q])
        low[at], high[at] = _positions(place.drive, *ends)
    return low, high


def actuator_rates(actuation: Actuation, limits: Array, within: tuple[Array, Array]) -> Array:
    """Largest speeds or accelerations (nv,) of a robot, of those (nv of the tree,) of its joints.

    `within` are its least and greatest positions (nq,).
    """
    return _each(actuation, limits, within, lambda J, most: _box(np.abs(J).max(axis=0), most))


def actuator_effort_limits(
    actuation: Actuation, limits: Array, within: tuple[Array, Array]
) -> Array:
    """Largest efforts (nv,) of a robot's actuators, of those of its joints; see `actuator_rates`.

    Free joints of a closed loop have their own: a motor at another joint adds to what is possible.

    Args:
        limits: (nv of the tree,) those of the joints.
        within: Least and greatest positions (nq,) of the robot.
    """
    found = _each(actuation, limits, within, _efforts)
    for place in actuation.places:
        if place.drive.is_loop:
            found[place.actuator_v] = limits[seated_at(place.drive, place.joint_v.tolist())]
    return found


def _each(
    actuation: Actuation,
    limits: Array,
    within: tuple[Array, Array],
    of: Callable[[Array, Array], Array],
) -> Array:
    """Limits (nv,) of a robot, of those (nv of the tree,) of its joints.

    `of` makes those (n,) of a drive's actuators of its J (N, k, n) where they may be, and of the
    limits (k,) of its joints.
    """
    found = np.full(actuation.num_velocities, np.inf)
    own, tree = actuation.kept_v
    found[own] = limits[tree]
    for place in actuation.places:
        found[place.actuator_v] = of(_jacobians(place, within), limits[place.joint_v])
    return found


def _efforts(J: Array, most: Array) -> Array:
    """Largest efforts (n,) of actuators, of J (N, k, n) and the largest (k,) of joints."""
    if J.shape[1] == J.shape[2] > 1:
        return _box(np.abs(np.linalg.inv(J)).max(axis=0).T, most)
    J, shares = np.abs(J), np.full(J.shape, np.inf)
    np.multiply(J, most[:, None], out=shares, where=J > 0.0)
    return np.asarray(shares.min(axis=(0, 1)))


def _jacobians(place: Places, within: tuple[Array, Array]) -> Array:
    """J (N, k, n) where the actuators may be: once, if it is constant."""
    if (J := place.drive.map.constant_jacobian) is not None:
        return J[None]
    low, high = (ends[place.actuator_q] for ends in within)
    few = len(low) == 1
    return place.drive.map.jacobian(_grid(low, high) if few else middle(low, high)[None])


def _positions(drive: Drive, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Least and greatest positions (n,) of the actuators."""
    low, high = (ends.copy() for ends in drive.limits)
    J = drive.map.constant_jacobian
    if J is None:
        return _of_curve(drive, lower, upper) if len(low) == 1 else (low, high)
    shift = drive.map.joint_positions(np.zeros((1, len(low))))[0]
    lower, upper = lower - shift, upper - shift
    if (np.count_nonzero(J, axis=1) <= 1).all():
        for row, ends in zip(J, zip(lower, upper, strict=True), strict=True):
            for i in np.flatnonzero(row):
                first, last = sorted(np.array(ends) / row[i])
                low[i], high[i] = max(low[i], first), min(high[i], last)
        return low, high
    finite = np.isfinite(lower) & np.isfinite(upper)
    center_of = middle(np.where(finite, lower, np.nan), np.where(finite, upper, np.nan))
    center = np.linalg.pinv(J) @ center_of
    off = np.abs(J @ center - center_of)
    room = np.where(finite, np.maximum(0.5 * (upper - lower) - off, 0.0), np.inf)
    half = _box(np.abs(J), room)
    return np.maximum(low, center - half), np.minimum(high, center + half)


def _box(A: Array, most: Array) -> Array:
    """The box (n,) x ≥ 0 with A x ≤ most (k,), A ≥ 0: what each may be alone, by one share."""
    ratios = np.divide(most[:, None], A, out=np.full(A.shape, np.inf), where=A > 0.0)
    alone = ratios.min(axis=0, initial=np.inf)
    rows = np.isfinite(most) & (A[:, np.isfinite(alone)] > 0.0).any(axis=1)
    needed = A[rows] @ np.where(np.isfinite(alone), alone, 0.0)
    share = (most[rows] / np.where(needed > 0.0, needed, 1.0))[needed > 0.0].min(initial=1.0)
    return np.asarray(np.where(np.isfinite(alone), share * alone, np.inf))


def _of_curve(drive: Drive, lower: Array, upper: Array) -> tuple[Array, Array]:
    """The interval around the middle of one actuator's range in which all joints keep limits."""
    low, high = drive.limits
    grid = _grid(low, high)
    theta = drive.map.joint_positions(grid)
    inside = np.asarray(((theta >= lower) & (theta <= upper)).all(axis=1))
    if not inside.any():
        return low, high
    there = np.flatnonzero(inside)
    start = int(there[np.argmin(np.abs(grid[there, 0] - middle(low, high)[0]))])
    outside = np.flatnonzero(~inside)
    before, after = outside[outside < start], outside[outside > start]
    first = low if not len(before) else grid[before[-1] + 1]
    last = high if not len(after) else grid[after[0] - 1]
    return first, last


def _grid(low: Array, high: Array) -> Array:
    """(N, 1) positions through the range of one actuator, its ends left out."""
    ends = max(float(low[0]), -_FAR), min(float(high[0]), _FAR)
    return np.linspace(*ends, _POINTS + 2)[1:-1, None]
