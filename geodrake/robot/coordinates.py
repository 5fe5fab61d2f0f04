"""Map from a robot's coordinates, those of its actuators, to all joints of its plant.

The actuators of a drive replace its joints in the order of coordinates: an actuator replaces the
joint of its name if all have one, and otherwise the i-th actuator replaces the i-th joint. Other
joints, including those of a floating base, are their own actuators. Following joints are moved by
the drives of their leaders.

Limits of actuators are a box in which all joints respect their limits. It is exact if each joint
has one actuator. If several actuators move a joint together, it is a box inside the limits, scaled
in proportion to the range of each actuator alone.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant

from geodrake.compiling import contiguous
from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.robot.joints import (
    Following,
    Indices,
    Tie,
    joint_names,
    joints_of,
    scoped,
    single_joints,
)
from geodrake.robot.transmission import (
    InSequence,
    JointlyEvaluated,
    LinearTransmission,
    SideBySide,
    Transmission,
    times,
)
from geodrake.robot.transmission.loop import LoopTransmission
from geodrake.robot.transmission.schema import Drive, power_series

_STEP = 1e-4  # rad or m
_FAR = 10.0  # rad or m, search range of limits for maps without a range
_POINTS = 4001


@dataclass(frozen=True, eq=False)
class Places:
    """Indices of a drive's actuators in the robot's coordinates, and of its joints in the tree."""

    drive: Drive
    map: Transmission  # to the joints of the drive, then to their followers
    seats: Indices  # velocities of the tree that the actuators replace
    actuators: Indices
    joints: Indices

    @property
    def own(self) -> Indices:
        """Return the indices of the drive's joints in the tree, without followers."""
        return self.joints[: len(self.drive.joints)]


def _with_followers(drive: Drive, ties: Sequence[Tie], leaders: Sequence[int]) -> Transmission:
    """Return the map of a drive, extended by joints that follow its joints `leaders`."""
    if not ties:
        return drive.map
    unit = np.eye(len(drive.joints))
    copies = LinearTransmission.of(np.vstack([unit, unit[list(leaders)]]))
    laws = [power_series([tie.coefficients]) for tie in ties]
    extended = InSequence((drive.map, copies, SideBySide((LinearTransmission.of(unit), *laws))))
    if (J := extended.constant_jacobian) is None:
        return extended
    return LinearTransmission.of(J, extended.joint_positions(np.zeros((1, J.shape[1])))[0])


class DrivenCoordinates(JointlyEvaluated):
    """A map from a robot's coordinates, some of which are actuators of drives."""

    @property
    def constant(self) -> Array | None:
        """Return J if all ratios are constant; None otherwise."""
        return None

    @property
    @abc.abstractmethod
    def driven(self) -> Indices:
        """Return the robot's velocities that are actuators of drives."""

    def jacobian_rate_slope(self, q: Array, v: Array) -> Array:
        """Return ∂(J̇ v)/∂q (N, joints, nv), by differences of J̇ along v.

        J̇ v is quadratic in v, so that its derivative is the rate of J̇.
        """
        speed = np.abs(v).max(axis=1, initial=0.0)[:, None]
        step = np.zeros_like(q)
        step[:, self.driven] = _STEP * (v / np.where(speed > 0, speed, 1.0))[:, self.driven]
        ahead, behind = self.jacobian_rate(q + step, v), self.jacobian_rate(q - step, v)
        return np.asarray((ahead - behind) / (2.0 * _STEP) * speed[:, :, None])

    def bend(self, q: Array, products: Array) -> Array:
        """Return Σ_ij ∂J_ij/∂q_l P_ij (N, nq) for P (N, joints, nv), at q (N, nq)."""
        bend = np.zeros_like(q)
        for index in self.driven:
            unit = np.zeros_like(q)
            unit[:, index] = 1.0
            # ∂J/∂q_l is the rate of J for unit speed of q_l alone.
            bend[:, index] = (self.jacobian_rate(q, unit) * products).sum((1, 2))
        return bend


@dataclass(frozen=True, eq=False)
class RobotCoordinates(DrivenCoordinates):
    """A map from a robot's q, v and v̇ to those of the tree of its plant.

    Joints have as many positions as velocities, with the same indices.
    """

    names: tuple[str, ...]  # names of the robot's nv velocities
    places: tuple[Places, ...]
    kept: Indices  # (2, ·) indices of joints without a drive, in the robot and in the tree
    joints: tuple[str, ...]  # names of the tree's velocities
    single: frozenset[int]  # velocities of the tree's joints of one degree of freedom
    leaders: Mapping[int, int]  # velocity of a following joint in the tree -> that of its leader

    @classmethod
    def of(
        cls, plant: MultibodyPlant, followers: Mapping[str, Tie], drives: Sequence[Drive] = ()
    ) -> RobotCoordinates:
        """Return the coordinates of a plant with drives and following joints.

        `followers` has scoped names; leaders must be independent.
        """
        for joint in joints_of(plant):
            if joint.num_positions() != joint.num_velocities():
                raise ModelError(
                    f"Joint {joint.name()!r} has {joint.num_positions()} positions for "
                    f"{joint.num_velocities()} velocities.",
                    advice="Load the model from its file: a free base is on six joints there.",
                )
        joints = joint_names(plant)
        by_scoped = {scoped(joint): int(joint.velocity_start()) for joint in single_joints(plant)}
        single, ties = (
            frozenset(by_scoped.values()),
            {by_scoped[x]: t for x, t in followers.items()},
        )
        leaders = {at: by_scoped[tie.leader] for at, tie in ties.items()}
        by_name = {joints[at]: at for at in sorted(single.difference(leaders))}
        _check(drives, by_name)
        moving = {joint for drive in drives for joint in drive.joints}
        undriven = dict.fromkeys(joints[at] for at in leaders.values() if joints[at] not in moving)
        drives = [*drives, *map(Drive.of_joint, undriven)]
        moved = [[by_name[joint] for joint in drive.joints] for drive in drives]
        seated = [seated_at(drive, indices) for drive, indices in zip(drives, moved, strict=True)]
        driven = {at for indices in moved for at in indices}
        gone = driven.difference(*seated).union(leaders)  # joints without an actuator of their own
        coordinates = np.setdiff1d(np.arange(len(joints)), [*gone])
        kept = np.setdiff1d(coordinates, [*driven])
        names, places = dict(enumerate(joints)), []
        for drive, indices, seats in zip(drives, moved, seated, strict=True):
            names |= dict(zip(seats, drive.actuators, strict=True))
            led = [at for at, leader in leaders.items() if leader in indices]
            extended = _with_followers(
                drive, [ties[at] for at in led], [indices.index(leaders[at]) for at in led]
            )
            at = np.searchsorted(coordinates, seats)
            places.append(Places(drive, extended, np.array(seats), at, np.array([*indices, *led])))
        return cls(
            tuple(names[at] for at in coordinates.tolist()),
            tuple(places),
            np.array([np.searchsorted(coordinates, kept), kept]),
            joints,
            single,
            leaders,
        )

    @property
    def size(self) -> int:
        """Return the number of the tree's velocities."""
        return len(self.joints)

    @property
    def shape(self) -> tuple[int, int]:
        """Return the numbers of velocities of the tree and of the robot."""
        return self.size, len(self.names)

    @cached_property
    def constant(self) -> Array | None:
        """Return J (joints, nv) if all ratios are constant; None otherwise."""
        if any(place.map.constant_jacobian is None for place in self.places):
            return None
        return self._along(np.zeros((1, len(self.names))), None)[1][0]

    @cached_property
    def offset(self) -> Array:
        """Return the tree's positions at zero positions of the robot."""
        return self._along(np.zeros((1, len(self.names))), None)[0][0]

    def along(self, q: Array, v: Array | None = None) -> tuple[Array, Array, Array]:
        """Return the tree's positions at those of the robot (N, nq), J and J̇ (N, joints, nv).

        The tree's velocities are J v; v is 0 if None.
        """
        if self.constant is None:
            return self._along(q, v)
        J, shape = self.constant, (len(q), *self.constant.shape)
        return q @ J.T + self.offset, np.broadcast_to(J, shape), np.broadcast_to(0.0, shape)

    def _along(self, q: Array, v: Array | None) -> tuple[Array, Array, Array]:
        shape = len(q), *self.shape
        theta, J, rate = np.zeros((len(q), self.size)), np.zeros(shape), np.zeros(shape)
        robot, tree = self.kept
        theta[:, tree] = q[:, robot]
        J[:, tree, robot] = 1.0
        for place in self.places:
            block = np.ix_(np.arange(len(q)), place.joints, place.actuators)
            rates = None if v is None else v[:, place.actuators]
            parts = place.map.along(q[:, place.actuators], rates)
            theta[:, place.joints], J[block], rate[block] = parts
        return theta, J, rate

    @cached_property
    def driven(self) -> Indices:
        """Return the robot's velocities that are actuators of drives."""
        return np.concatenate([np.zeros(0, np.intp), *(p.actuators for p in self.places)])

    def tree_samples(self, q: Array, v: Array, vd: Array) -> tuple[Array, Array, Array, Array]:
        """Return positions, velocities and accelerations of the tree, and J, for a motion."""
        theta, J, rate = self.along(q, v)
        if self.constant is None:
            samples = theta, times(J, v), times(J, vd) + times(rate, v)
        else:
            samples = theta, v @ self.constant.T, vd @ self.constant.T
        theta, rates, accelerations = (contiguous(x) for x in samples)
        return theta, rates, accelerations, J

    def along_all(self, q: Array, v: Array | None = None) -> tuple[Array, Array, Array]:
        """Return the results of `along`, extended by joints and actuators beyond the tree.

        These close loops, or are actuators that other loops move; see `behind`.
        """
        parts = [self.along(q, v)]
        for place, loop in self._loops:
            cut, actuators = list(loop.cut), place.actuators
            theta, G, rate = loop.of_all(q[:, actuators], None if v is None else v[:, actuators])
            rows = np.zeros((2, len(q), len(cut), len(self.names)))
            rows[0][:, :, actuators], rows[1][:, :, actuators] = G[:, cut], rate[:, cut]
            parts.append((theta[:, cut], *rows))
        theta, J, rate = (np.concatenate(each, axis=1) for each in zip(*parts, strict=True))
        return theta, J, rate

    def all_samples(self, q: Array, v: Array, vd: Array) -> tuple[Array, Array, Array, Array]:
        """Return `tree_samples` of all joints and actuators."""
        if not self._loops:
            return self.tree_samples(q, v, vd)
        theta, J, rate = self.along_all(q, v)
        return theta, times(J, v), times(J, vd) + times(rate, v), J

    @cached_property
    def _loops(self) -> list[tuple[Places, LoopTransmission]]:
        """Return the loops with joints or actuators beyond the tree."""
        maps = ((place, place.drive.map) for place in self.places)
        return [(p, m) for p, m in maps if isinstance(m, LoopTransmission) and m.cut]

    def inside(self, q: Array) -> Array:
        """Return positions (N, nq) of the robot, with actuators in the domains of their maps."""
        q = q.copy()
        for place in self.places:
            low, high = place.drive.map.range
            own = np.clip(q[:, place.actuators], low, high)
            q[:, place.actuators] = place.drive.map.inside(own)
        return q

    def nearest(self, theta: Array) -> Array:
        """Return the robot's positions (N, nq) with joints nearest to the tree's (N, ·)."""
        q = np.zeros((len(theta), len(self.names)))
        robot, tree = self.kept
        q[:, robot] = theta[:, tree]
        for place in self.places:
            J, at = place.drive.map.constant_jacobian, theta[:, place.own]
            if J is None:
                start = middle(*place.drive.map.range)
                q[:, place.actuators] = place.drive.map.actuator_positions(at, start=start)
            else:
                shift = place.drive.map.joint_positions(np.zeros((1, J.shape[1])))
                q[:, place.actuators] = (at - shift) @ np.linalg.pinv(J).T
        return q

    def rates_of(self, q: Array, rates: Array) -> Array:
        """Return the robot's velocities (nv,) at q (nq,) nearest to those of the tree's joints."""
        own = np.setdiff1d(np.arange(self.size), [*self.leaders])
        return np.asarray(np.linalg.pinv(self.jacobian(q[None])[0, own]) @ rates[own])

    @cached_property
    def single_places(self) -> list[int]:
        """Return the robot's indices of joints of one degree of freedom, and of actuators."""
        kept = (own for own, at in zip(*self.kept.tolist(), strict=True) if at in self.single)
        return sorted([*kept, *self.driven.tolist()])

    def moved_by(self, velocities: Sequence[int]) -> tuple[int, ...]:
        """Return the robot's velocities that affect any of some velocities of the tree."""
        return tuple(np.flatnonzero(self._moves[list(velocities)].any(axis=0)).tolist())

    def followed(self, joints: Sequence[str]) -> list[Following]:
        """Return the coordinate that each velocity of the tree follows by a constant ratio.

        With several actuators or a varying ratio, it is that of the joint itself.
        """
        following = [Following(name) for name in joints]
        for to, at in zip(*self.kept.tolist(), strict=True):
            following[at] = Following(self.names[to])
        for place in self.places:
            if (J := place.map.constant_jacobian) is not None:
                offsets = place.map.joint_positions(np.zeros((1, J.shape[1])))[0]
                for at, row, offset in zip(place.joints.tolist(), J, offsets.tolist(), strict=True):
                    if np.count_nonzero(row) == 1:
                        (i,) = np.flatnonzero(row)
                        name = self.names[place.actuators[i]]
                        following[at] = Following(name, float(row[i]), offset)
        return following

    @cached_property
    def behind(self) -> dict[str, int]:
        """Return joint of a drive that is not an actuator -> its index in `along_all`.

        Followers with constant ratios are excluded. Joints that close loops, and dependent
        actuators, come last.
        """
        beyond = [loop.joints[k] for _, loop in self._loops for k in loop.cut]
        tree = {
            self.joints[at]: at
            for place in self.places
            for at in (place.own if place.map.constant_jacobian is not None else place.joints)
            if self.joints[at] not in self.names
        }
        places = {name: self.size + k for k, name in enumerate(beyond) if name not in self.names}
        return tree | places

    @cached_property
    def standing(self) -> dict[int, int]:
        """Return velocity of the tree -> the corresponding one of the robot."""
        velocities = dict(zip(self.kept[1].tolist(), self.kept[0].tolist(), strict=True))
        for place in self.places:
            velocities |= dict(zip(place.seats.tolist(), place.actuators.tolist(), strict=True))
        return velocities

    def positions_between(self, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Return position limits (nq,) of the robot for those of the tree's joints."""
        low, high = np.full((2, len(self.names)), np.nan)
        own, tree = self.kept
        low[own], high[own] = lower[tree], upper[tree]
        for place in self.places:
            at, ends = place.actuators, (lower[place.joints], upper[place.joints])
            low[at], high[at] = _position_limits(place.map, *ends)
        return low + 0.0, high + 0.0  # as NumPy takes -0.0 for less than 0.0

    def rates(self, limits: Array, within: tuple[Array, Array]) -> Array:
        """Return the robot's largest speeds or accelerations (nv,) for those of the tree's joints.

        `within` are the robot's position limits (nq,).
        """
        return self._limits(limits, within, lambda J, most: _box(np.abs(J).max(axis=0), most))

    def effort_limits(self, limits: Array, within: tuple[Array, Array]) -> Array:
        """Return the largest efforts (nv,) of actuators for those of joints; see `rates`.

        Free joints of a closed loop keep their own limits, as further motors only add efforts.
        Following joints have no motors.
        """
        efforts = self._limits(limits, within, _effort_limits, of_drives=True)
        for place in self.places:
            if place.drive.is_loop:
                efforts[place.actuators] = limits[place.seats]
        return efforts

    def _limits(
        self,
        limits: Array,
        within: tuple[Array, Array],
        of: Callable[[Array, Array], Array],
        *,
        of_drives: bool = False,
    ) -> Array:
        """Return limits (nv,) of the robot for those of the tree's joints.

        `of` returns the limits (n,) of a drive's actuators, from J (N, k, n) over their range and
        the limits (k,) of its joints. Followers are included unless `of_drives`.
        """
        result = np.full(len(self.names), np.inf)
        robot, tree = self.kept
        result[robot] = limits[tree]
        for place in self.places:
            motion = place.drive.map if of_drives else place.map
            at, J, most = place.actuators, motion.constant_jacobian, limits[place.joints]
            if J is None:
                low, high = (ends[at] for ends in within)
                q = _grid(low, high) if len(low) == 1 else middle(low, high)[None]
                result[at] = of(motion.jacobian(q), most[: motion.num_joints])
            else:
                result[at] = of(J[None], most[: motion.num_joints])
        return result

    @cached_property
    def _moves(self) -> NDArray[np.bool_]:
        """Return a mask (joints, nv): which velocities of the robot affect which of the tree."""
        moves = np.zeros(self.shape, bool)
        own, tree = self.kept
        moves[tree, own] = True
        for place in self.places:
            J = place.map.constant_jacobian
            block = np.ix_(place.joints, place.actuators)
            moves[block] = True if J is None else J != 0.0
        return moves


def seated_at(drive: Drive, joints: Sequence[int]) -> list[int]:
    """Return the velocities of a drive's joints in the tree that its actuators replace."""
    at = dict(zip(drive.joints, joints, strict=True))
    if set(drive.actuators) <= set(drive.joints):
        return [at[name] for name in drive.actuators]
    return sorted(joints)[: len(drive.actuators)]


def _check(drives: Sequence[Drive], by_name: Mapping[str, int]) -> None:
    """Raise for names of joints and actuators that do not match."""
    joints = [joint for drive in drives for joint in drive.joints]
    actuators = [name for drive in drives for name in drive.actuators]
    for joint in joints:
        if joint not in by_name:
            raise ModelError(
                f"The transmission has joint {joint!r}, which is not an independent joint of "
                "the robot.",
                advice=f"Independent joints are {', '.join(by_name)}.",
            )
    for what, names in (("joint", joints), ("actuator", actuators)):
        for name in names:
            if names.count(name) > 1:
                raise ModelError(
                    f"The transmission has {what} {name!r} in two of its parts.",
                    advice="Put coupled joints and actuators into one part, such as `coupled`.",
                )
    for name in set(actuators).intersection(by_name).difference(joints):
        raise ModelError(
            f"The transmission has an actuator {name!r}, but the robot also has a joint of "
            "this name, which no part of the transmission moves.",
            advice="Name the actuator as its column in logs, and add a part that moves the joint.",
        )


def middle(low: Array, high: Array) -> Array:
    """Return the middle (n,) of ranges of positions; 0 without a range."""
    bounded = np.isfinite(low) & np.isfinite(high)
    return np.asarray(0.5 * (np.where(bounded, low, 0.0) + np.where(bounded, high, 0.0)))


def _effort_limits(J: Array, most: Array) -> Array:
    """Return the largest efforts (n,) of actuators, for J (N, k, n) and those (k,) of joints."""
    if J.shape[1] == J.shape[2] > 1:
        return _box(np.abs(np.linalg.inv(J)).max(axis=0).T, most)
    J, shares = np.abs(J), np.full(J.shape, np.inf)
    np.multiply(J, most[:, None], out=shares, where=J > 0.0)
    return np.asarray(shares.min(axis=(0, 1)))


def _position_limits(motion: Transmission, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return the position limits (n,) of the actuators."""
    low, high = (ends.copy() for ends in motion.range)
    J = motion.constant_jacobian
    if J is None:
        return _curve_limits(motion, lower, upper) if len(low) == 1 else (low, high)
    shift = motion.joint_positions(np.zeros((1, len(low))))[0]
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
    """Return x (n,) ≥ 0 with A x ≤ most (k,), A ≥ 0, as one share of each component's maximum."""
    ratios = np.divide(most[:, None], A, out=np.full(A.shape, np.inf), where=A > 0.0)
    alone = ratios.min(axis=0, initial=np.inf)
    rows = np.isfinite(most) & (A[:, np.isfinite(alone)] > 0.0).any(axis=1)
    needed = A[rows] @ np.where(np.isfinite(alone), alone, 0.0)
    share = (most[rows] / np.where(needed > 0.0, needed, 1.0))[needed > 0.0].min(initial=1.0)
    return np.asarray(np.where(np.isfinite(alone), share * alone, np.inf))


def _curve_limits(motion: Transmission, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return the interval around an actuator's middle in which all joints respect their limits."""
    low, high = motion.range
    grid = _grid(low, high)
    theta = motion.joint_positions(grid)
    inside = np.asarray(((theta >= lower) & (theta <= upper)).all(axis=1))
    if not inside.any():
        return low, high
    candidates = np.flatnonzero(inside)
    start = int(candidates[np.argmin(np.abs(grid[candidates, 0] - middle(low, high)[0]))])
    outside = np.flatnonzero(~inside)
    before, after = outside[outside < start], outside[outside > start]
    first = low if not len(before) else grid[before[-1] + 1]
    last = high if not len(after) else grid[after[0] - 1]
    return first, last


def _grid(low: Array, high: Array) -> Array:
    """Return positions (N, 1) in the interior of one actuator's range."""
    ends = max(float(low[0]), -_FAR), min(float(high[0]), _FAR)
    return np.linspace(*ends, _POINTS + 2)[1:-1, None]
