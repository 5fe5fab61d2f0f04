"""Coordinates: how all positions and velocities of a plant's joints follow from those of a robot.

Joints that a drive moves give their places to its actuators, the i-th joint to the i-th actuator,
or a joint to the actuator of its name where all have such; other joints are their own actuators, a
floating base among them. Joints that follow others are moved by the drives of those, in which a
joint without one is its own actuator.

Limits of joints are limits of their actuators: boxes within which every joint keeps its own. Joints
that each follow one actuator have exact ones. Where several actuators move a joint together, the
box is one inside its limits, in which every actuator may go as far in proportion.
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
from geodrake.robot.transmission.statements import Drive, power_series

_STEP = 1e-4  # rad or m
_FAR = 10.0  # rad or m, up to where limits are looked for where the map has none
_POINTS = 4001


@dataclass(frozen=True, eq=False)
class Places:
    """Where a drive's actuators are in the robot's q and v, and its joints in those of the tree."""

    drive: Drive
    map: Transmission  # that of the drive, and then of the joints that follow its own
    seats: Indices  # velocities of the tree in whose place the actuators are
    actuators: Indices
    joints: Indices

    @property
    def own(self) -> Indices:
        """Where the drive's own joints are in the tree."""
        return self.joints[: len(self.drive.joints)]


def _with_followers(drive: Drive, ties: Sequence[Tie], leaders: Sequence[int]) -> Transmission:
    """Return the map of a drive, and then of joints that follow its joints at some numbers."""
    if not ties:
        return drive.map
    own = np.eye(len(drive.joints))
    copies = LinearTransmission.of(np.vstack([own, own[list(leaders)]]))
    laws = [power_series([tie.coefficients]) for tie in ties]
    whole = InSequence((drive.map, copies, SideBySide((LinearTransmission.of(own), *laws))))
    if (J := whole.constant_jacobian) is None:
        return whole
    return LinearTransmission.of(J, whole.joint_positions(np.zeros((1, J.shape[1])))[0])


class DrivenCoordinates(JointlyEvaluated):
    """A map from a robot's positions that knows which of them are actuators of drives."""

    @property
    def constant(self) -> Array | None:
        """J if all ratios are constant; else None."""
        return None

    @property
    @abc.abstractmethod
    def driven(self) -> Indices:
        """Velocities of the robot that are those of actuators of drives."""

    def jacobian_rate_slope(self, q: Array, v: Array) -> Array:
        """Return ∂(J̇ v)/∂q (N, nv of the tree, nv), by differences of J̇ along v.

        J̇ v has all v twice, so that its slope is the rate of J̇ itself.
        """
        speed = np.abs(v).max(axis=1, initial=0.0)[:, None]
        step = np.zeros_like(q)
        step[:, self.driven] = _STEP * (v / np.where(speed > 0, speed, 1.0))[:, self.driven]
        ahead, behind = self.jacobian_rate(q + step, v), self.jacobian_rate(q - step, v)
        return np.asarray((ahead - behind) / (2.0 * _STEP) * speed[:, :, None])

    def bend(self, q: Array, products: Array) -> Array:
        """Return (N, nq) Σ_ij ∂J_ij/∂q_l P_ij for P (N, nv of the tree, nv), at q (N, nq)."""
        found = np.zeros_like(q)
        for at in self.driven:
            unit = np.zeros_like(q)
            unit[:, at] = 1.0
            # ∂J/∂q_l is the rate of J where only q_l moves, with speed one.
            found[:, at] = (self.jacobian_rate(q, unit) * products).sum((1, 2))
        return found


@dataclass(frozen=True, eq=False)
class RobotCoordinates(DrivenCoordinates):
    """A map from a robot's q, v and v̇ to those of the tree of its plant.

    Its joints have as many positions as velocities, so that both are in the same places.
    """

    names: tuple[str, ...]  # names of the robot's nv velocities
    places: tuple[Places, ...]
    # (2, ·) where joints without a drive are in the robot's q and v, and in the tree's.
    kept: Indices
    joints: tuple[str, ...]  # names of the tree's velocities
    single: frozenset[int]  # velocities of the tree's joints of one degree of freedom
    # Velocity of each of the tree's joints that follow others -> that of its leader.
    leaders: Mapping[int, int]

    @classmethod
    def of(
        cls, plant: MultibodyPlant, followers: Mapping[str, Tie], drives: Sequence[Drive] = ()
    ) -> RobotCoordinates:
        """Return the indices in a plant with drives, and joints that follow others.

        Those are by their scoped names, as are their leaders, which follow none.
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
        alone = dict.fromkeys(joints[at] for at in leaders.values() if joints[at] not in moving)
        drives = [*drives, *map(Drive.of_joint, alone)]
        moved = [[by_name[joint] for joint in drive.joints] for drive in drives]
        seated = [seated_at(drive, own) for drive, own in zip(drives, moved, strict=True)]
        driven = {at for own in moved for at in own}
        gone = driven.difference(*seated).union(leaders)  # joints without an actuator of their own
        there = np.setdiff1d(np.arange(len(joints)), [*gone])
        kept = np.setdiff1d(there, [*driven])
        names, places = dict(enumerate(joints)), []
        for drive, own, seats in zip(drives, moved, seated, strict=True):
            names |= dict(zip(seats, drive.actuators, strict=True))
            led = [at for at, leader in leaders.items() if leader in own]
            whole = _with_followers(
                drive, [ties[at] for at in led], [own.index(leaders[at]) for at in led]
            )
            at = np.searchsorted(there, seats)
            places.append(Places(drive, whole, np.array(seats), at, np.array([*own, *led])))
        return cls(
            tuple(names[at] for at in there.tolist()),
            tuple(places),
            np.array([np.searchsorted(there, kept), kept]),
            joints,
            single,
            leaders,
        )

    @property
    def size(self) -> int:
        """Number of the tree's velocities."""
        return len(self.joints)

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of velocities of the tree, and of the robot."""
        return self.size, len(self.names)

    @cached_property
    def constant(self) -> Array | None:
        """J (nv of the tree, nv) if all ratios are constant; else None."""
        if any(place.map.constant_jacobian is None for place in self.places):
            return None
        return self._along(np.zeros((1, len(self.names))), None)[1][0]

    @cached_property
    def offset(self) -> Array:
        """(nq of the tree,) positions where those of the robot are zero."""
        return self._along(np.zeros((1, len(self.names))), None)[0][0]

    def along(self, q: Array, v: Array | None = None) -> tuple[Array, Array, Array]:
        """Return positions (N, nq of the tree) at those of the robot (N, nq), and J, J̇.

        Those are (N, nv of the tree, nv), with the tree's velocities J v; J̇ of rest without v.
        """
        if self.constant is None:
            return self._along(q, v)
        J, shape = self.constant, (len(q), *self.constant.shape)
        return q @ J.T + self.offset, np.broadcast_to(J, shape), np.broadcast_to(0.0, shape)

    def _along(self, q: Array, v: Array | None) -> tuple[Array, Array, Array]:
        shape = len(q), *self.shape
        whole, J, rate = np.zeros((len(q), self.size)), np.zeros(shape), np.zeros(shape)
        own, tree = self.kept
        whole[:, tree] = q[:, own]
        J[:, tree, own] = 1.0
        for place in self.places:
            block = np.ix_(np.arange(len(q)), place.joints, place.actuators)
            rates = None if v is None else v[:, place.actuators]
            found = place.map.along(q[:, place.actuators], rates)
            whole[:, place.joints], J[block], rate[block] = found
        return whole, J, rate

    @cached_property
    def driven(self) -> Indices:
        """Velocities of the robot that are those of actuators of drives."""
        return np.concatenate([np.zeros(0, np.intp), *(p.actuators for p in self.places)])

    def tree_samples(self, q: Array, v: Array, vd: Array) -> tuple[Array, Array, Array, Array]:
        """Positions, velocities and accelerations of the tree, and J, along a motion (N, ·)."""
        theta, J, rate = self.along(q, v)
        if self.constant is None:
            samples = theta, times(J, v), times(J, vd) + times(rate, v)
        else:
            samples = theta, v @ self.constant.T, vd @ self.constant.T
        theta, rates, accelerations = (contiguous(x) for x in samples)
        return theta, rates, accelerations, J

    def along_all(self, q: Array, v: Array | None = None) -> tuple[Array, Array, Array]:
        """Return what `along` does, and after it that of joints and actuators beyond the tree.

        Those close loops, or are actuators that other loops move; see `behind`.
        """
        parts = [self.along(q, v)]
        for place, loop in self._loops:
            at, own = list(loop.cut), place.actuators
            theta, G, rate = loop.of_all(q[:, own], None if v is None else v[:, own])
            rows = np.zeros((2, len(q), len(at), len(self.names)))
            rows[0][:, :, own], rows[1][:, :, own] = G[:, at], rate[:, at]
            parts.append((theta[:, at], *rows))
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
        """The loops with joints or actuators beyond the tree."""
        maps = ((place, place.drive.map) for place in self.places)
        return [(p, m) for p, m in maps if isinstance(m, LoopTransmission) and m.cut]

    def inside(self, q: Array) -> Array:
        """Return positions (N, nq) of the robot with its actuators where their maps are known."""
        q = q.copy()
        for place in self.places:
            low, high = place.drive.map.range
            own = np.clip(q[:, place.actuators], low, high)
            q[:, place.actuators] = place.drive.map.inside(own)
        return q

    def nearest(self, theta: Array) -> Array:
        """Return (N, nq) positions of the robot whose joints are nearest to the tree's (N, ·)."""
        q = np.zeros((len(theta), len(self.names)))
        own, tree = self.kept
        q[:, own] = theta[:, tree]
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
        """Return velocities (nv,) of the robot at q (nq,), nearest to those (·,) of its joints."""
        own = np.setdiff1d(np.arange(self.size), [*self.leaders])
        return np.asarray(np.linalg.pinv(self.jacobian(q[None])[0, own]) @ rates[own])

    @cached_property
    def single_places(self) -> list[int]:
        """Where joints of one degree of freedom, and actuators, are in the robot's q and v."""
        kept = (own for own, at in zip(*self.kept.tolist(), strict=True) if at in self.single)
        return sorted([*kept, *self.driven.tolist()])

    def moved_by(self, velocities: Sequence[int]) -> tuple[int, ...]:
        """Return the robot's velocities that move some velocities of the tree."""
        return tuple(np.flatnonzero(self._moves[list(velocities)].any(axis=0)).tolist())

    def followed(self, joints: Sequence[str]) -> list[Following]:
        """Return what each velocity of the tree follows by a constant ratio, by names.

        One that follows several actuators, or by a ratio that changes, follows that of its joint.
        """
        found = [Following(name) for name in joints]
        for to, at in zip(*self.kept.tolist(), strict=True):
            found[at] = Following(self.names[to])
        for place in self.places:
            if (J := place.map.constant_jacobian) is not None:
                still = place.map.joint_positions(np.zeros((1, J.shape[1])))[0]
                for at, row, shift in zip(place.joints.tolist(), J, still.tolist(), strict=True):
                    if np.count_nonzero(row) == 1:
                        (i,) = np.flatnonzero(row)
                        name = self.names[place.actuators[i]]
                        found[at] = Following(name, float(row[i]), shift)
        return found

    @cached_property
    def behind(self) -> dict[str, int]:
        """Joint of a drive that is no actuator -> where it is in the tree's positions.

        Joints that follow others by constant ratios are not among them. Those that close loops, and
        actuators that follow others, come after them, as in `along_all`.
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
        """Velocity of the tree -> the corresponding one of the robot."""
        found = dict(zip(self.kept[1].tolist(), self.kept[0].tolist(), strict=True))
        for place in self.places:
            found |= dict(zip(place.seats.tolist(), place.actuators.tolist(), strict=True))
        return found

    def positions_between(self, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Least and greatest positions (nq,) of the robot, of those (nq of the tree,) of joints."""
        low, high = np.full((2, len(self.names)), np.nan)
        own, tree = self.kept
        low[own], high[own] = lower[tree], upper[tree]
        for place in self.places:
            at, ends = place.actuators, (lower[place.joints], upper[place.joints])
            low[at], high[at] = _positions(place.map, *ends)
        return low + 0.0, high + 0.0  # as NumPy takes -0.0 for less than 0.0

    def rates(self, limits: Array, within: tuple[Array, Array]) -> Array:
        """Largest speeds or accelerations (nv,) of the robot, of those (nv of the tree,) of joints.

        `within` are its least and greatest positions (nq,).
        """
        return self._each(limits, within, lambda J, most: _box(np.abs(J).max(axis=0), most))

    def effort_limits(self, limits: Array, within: tuple[Array, Array]) -> Array:
        """Return largest efforts (nv,) of the robot's actuators, of those of joints; see `rates`.

        Free joints of a closed loop have their own: a motor at another joint adds to what is
        possible. Joints that follow others have no motors.
        """
        found = self._each(limits, within, _efforts, of_drives=True)
        for place in self.places:
            if place.drive.is_loop:
                found[place.actuators] = limits[place.seats]
        return found

    def _each(
        self,
        limits: Array,
        within: tuple[Array, Array],
        of: Callable[[Array, Array], Array],
        *,
        of_drives: bool = False,
    ) -> Array:
        """Return limits (nv,) of the robot, of those (nv of the tree,) of its joints.

        `of` makes those (n,) of a drive's actuators of its J (N, k, n) where they may be, and of
        the limits (k,) of its joints; if not `of_drives`, those that follow are among them.
        """
        found = np.full(len(self.names), np.inf)
        own, tree = self.kept
        found[own] = limits[tree]
        for place in self.places:
            motion = place.drive.map if of_drives else place.map
            at, J, most = place.actuators, motion.constant_jacobian, limits[place.joints]
            if J is None:  # where the actuators may be
                low, high = (ends[at] for ends in within)
                q = _grid(low, high) if len(low) == 1 else middle(low, high)[None]
                found[at] = of(motion.jacobian(q), most[: motion.num_joints])
            else:
                found[at] = of(J[None], most[: motion.num_joints])
        return found

    @cached_property
    def _moves(self) -> NDArray[np.bool_]:
        """(nv of the tree, nv) which velocity of the robot can move which of the tree."""
        moves = np.zeros(self.shape, bool)
        own, tree = self.kept
        moves[tree, own] = True
        for place in self.places:
            J = place.map.constant_jacobian
            block = np.ix_(place.joints, place.actuators)
            moves[block] = True if J is None else J != 0.0
        return moves


def seated_at(drive: Drive, joints: Sequence[int]) -> list[int]:
    """Velocities of the tree, among those of a drive's joints, in whose place its actuators are."""
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
    """Return (n,) positions in the middle of their ranges; 0 without a range."""
    bounded = np.isfinite(low) & np.isfinite(high)
    return np.asarray(0.5 * (np.where(bounded, low, 0.0) + np.where(bounded, high, 0.0)))


def _efforts(J: Array, most: Array) -> Array:
    """Return largest efforts (n,) of actuators, of J (N, k, n) and the largest (k,) of joints."""
    if J.shape[1] == J.shape[2] > 1:
        return _box(np.abs(np.linalg.inv(J)).max(axis=0).T, most)
    J, shares = np.abs(J), np.full(J.shape, np.inf)
    np.multiply(J, most[:, None], out=shares, where=J > 0.0)
    return np.asarray(shares.min(axis=(0, 1)))


def _positions(motion: Transmission, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return the least and greatest positions (n,) of the actuators."""
    low, high = (ends.copy() for ends in motion.range)
    J = motion.constant_jacobian
    if J is None:
        return _of_curve(motion, lower, upper) if len(low) == 1 else (low, high)
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
    """Return the box (n,) x ≥ 0 with A x ≤ most (k,), A ≥ 0: one share of each alone."""
    ratios = np.divide(most[:, None], A, out=np.full(A.shape, np.inf), where=A > 0.0)
    alone = ratios.min(axis=0, initial=np.inf)
    rows = np.isfinite(most) & (A[:, np.isfinite(alone)] > 0.0).any(axis=1)
    needed = A[rows] @ np.where(np.isfinite(alone), alone, 0.0)
    share = (most[rows] / np.where(needed > 0.0, needed, 1.0))[needed > 0.0].min(initial=1.0)
    return np.asarray(np.where(np.isfinite(alone), share * alone, np.inf))


def _of_curve(motion: Transmission, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return the interval around an actuator's middle in which all joints keep their limits."""
    low, high = motion.range
    grid = _grid(low, high)
    theta = motion.joint_positions(grid)
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
    """Return (N, 1) positions through the range of one actuator, its ends left out."""
    ends = max(float(low[0]), -_FAR), min(float(high[0]), _FAR)
    return np.linspace(*ends, _POINTS + 2)[1:-1, None]
