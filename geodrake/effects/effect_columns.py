"""Columns of several effects of a robot, along a motion or at one sample.

At one sample, as a controller or a simulation has it, effects of one kind are evaluated together:
the columns of a joint effect are functions of its joint's motion, sample by sample. So joints with
the same effect and the same shape parameters are evaluated as if they were samples of one joint.
Columns that are a signal of their joint as it is, such as the velocity of viscous friction, are
written by a compiled loop.

What columns depend on is declared by the class of an effect, or found by trial. One of a user's own
need not declare it: all that its base class may see is right, but costs simulations and controllers
time if it depends on less. Accelerations and loads are tried, and one that defines `rows` is given
the time; that it depends on the history of the motion or the temperature it must declare.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, contiguous
from geodrake.effects.base import BodyEffect, Effect, JointEffect
from geodrake.effects.column_checks import of_geodrake, rows_of
from geodrake.effects.robot_motion import Array, JointMotion, RobotMotion

Indices = NDArray[np.intp]

_SIGNALS = ("v", "vd", "sign_v")
"""Fields of a `JointMotion` that a column may be."""

_BEHIND = frozenset({"q", "v", "bodies"})
"""Signals that effects of joints behind a transmission also depend on."""

Trial = Callable[[Array, Array, Array], RobotMotion]
"""Function to the motion of a robot with given velocities, accelerations and loads, (N, nv)."""

_SAMPLES = 8

Seen = Callable[[JointMotion], RobotMotion]
"""From the motion of all joints at one sample to that of the robot with its bodies.

Accelerations may be several, (N, nv), of a sample each."""


@dataclass(frozen=True, eq=False)
class EffectColumns:
    """Effects of a robot, ready to be evaluated."""

    joints: tuple[str, ...]  # names of the nv velocities
    effects: tuple[Effect, ...]  # the effects, in the order of their k parameters
    # Gives motions to try users' effects that do not declare what they depend on; without it they
    # depend on all that their base class may see, and are evaluated one by one.
    trial: Trial | None = None

    @cached_property
    def count(self) -> int:
        """Number k of all effects' parameters."""
        return sum(len(effect.parameters) for effect in self.effects)

    @cached_property
    def depends_on(self) -> frozenset[str]:
        """The signals that any of the columns depends on."""
        return frozenset().union(*self._signals)

    def fit_rows(self, motion: RobotMotion) -> list[dict[int, Array]]:
        """Return each effect's columns (N, ·) of fits along N samples, by velocity acted at."""
        return [
            {self._indices[joint]: columns for joint, columns in effect.fit_rows(motion).items()}
            for effect in self.effects
        ]

    def effort(self, motion: RobotMotion, mu: Array) -> Array:
        """Return the effort (N, nv), N·m or N, that the effects with parameters mu (k,) need."""
        total = np.zeros_like(motion.v)
        for effect, part in zip(self.effects, self._parts, strict=True):
            for joint, columns in rows_of(effect, motion).items():
                total[:, self._indices[joint]] += columns @ mu[part]
        return total

    def at(self, motion: JointMotion, seen: Seen) -> Array:
        """Return columns (nv, k) at one sample.

        Args:
            motion: Motion of all joints, each field (nv,), as if they were samples of one joint.
            seen: Makes of it what effects of several joints or of bodies see; called only if there
                are such effects.
        """
        Y = np.zeros((len(self.joints), self.count))
        signals = contiguous(motion.v), contiguous(motion.vd), contiguous(motion.sign_v)
        put_signals(signals, self.signals, 1.0, Y)
        for group in self._together:
            group.put(Y, motion)
        if self._alone:
            _put(Y, self._alone, seen(motion))
        return Y

    def added_mass(self, motion: JointMotion, mu: Array, seen: Seen) -> Array:
        """Return matrix (nv, nv) that the effects with parameters mu (k,) add to the mass matrix.

        Args:
            motion: Motion of all joints at one sample; its accelerations do not matter.
            mu: (k,) parameters.
        """
        rest, moved = (replace(motion, vd=np.full(len(self.joints), x)) for x in (0.0, 1.0))
        change = np.zeros((len(self.joints), self.count))
        put_signals((rest.vd, moved.vd, rest.vd), self.signals, 1.0, change)
        for group in self._together:
            if group.members[0][0] in self._moving:
                before, after = np.zeros_like(change), np.zeros_like(change)
                group.put(before, rest)
                group.put(after, moved)
                change += after - before
        added = np.diag(change @ mu)
        if self._alone_of_acceleration:
            vd = np.vstack([rest.vd, np.eye(len(self.joints))])
            along = seen(replace(motion, vd=vd))
            for effect, part in self._alone_of_acceleration:
                efforts = effect.regressor(along) @ mu[part]
                added += (efforts[1:] - efforts[0]).T
        return added

    @cached_property
    def _indices(self) -> dict[str, int]:
        """Velocity of each joint."""
        return {joint: i for i, joint in enumerate(self.joints)}

    @cached_property
    def _parts(self) -> tuple[slice, ...]:
        """Where the parameters of each effect are among those of all."""
        ends = np.cumsum([0, *(len(effect.parameters) for effect in self.effects)]).tolist()
        return tuple(slice(start, end) for start, end in pairwise(ends))

    @cached_property
    def _signals(self) -> tuple[frozenset[str], ...]:
        """The dependencies of each effect."""
        own = [dependencies(e, self.trial, len(self.joints)) for e in self.effects]
        return tuple(
            names | _BEHIND if e.at_motor and not self._indices.keys() >= {*e.where} else names
            for names, e in zip(own, self.effects, strict=True)
        )

    @cached_property
    def signals(self) -> tuple[Indices, Indices, Indices]:
        """Velocities, columns and signals of the columns that are a signal as it is."""
        found = [place for group in self._groups for place in group.signals]
        rows, columns, signals = np.reshape(np.array(found, np.intp), (-1, 3)).T.copy()
        return rows, columns, signals

    @property
    def only_signals(self) -> bool:
        """Whether these are all columns."""
        return not (self._together or self._alone)

    @cached_property
    def _together(self) -> tuple[_Together, ...]:
        """The groups with other columns than signals."""
        return tuple(group for group in self._groups if not group.signals)

    @cached_property
    def _groups(self) -> tuple[_Together, ...]:
        """Groups of joint effects that may be evaluated together."""
        groups: list[list[tuple[JointEffect, slice]]] = []
        for effect, part in zip(self.effects, self._parts, strict=True):
            if not effect.parameters or not sees_joint_only(effect):
                continue
            if effect.joint not in self._indices:  # behind a transmission, or in a loop
                continue
            for group in groups:
                if replace(effect, joint=group[0][0].joint) == group[0][0]:
                    group.append((effect, part))
                    break
            else:
                groups.append([(effect, part)])
        made = (_Together.of(members, self.joints, self.count) for members in groups)
        return tuple(group for group in made if self._agrees(group))

    @cached_property
    def _alone(self) -> tuple[tuple[Effect, slice], ...]:
        """The other effects, with the places of their parameters."""
        together = {part.start for group in self._groups for _, part in group.members}
        both = zip(self.effects, self._parts, strict=True)
        return tuple((e, part) for e, part in both if e.parameters and part.start not in together)

    @cached_property
    def _moving(self) -> frozenset[Effect]:
        both = zip(self.effects, self._signals, strict=True)
        return frozenset(effect for effect, names in both if "vd" in names)

    @cached_property
    def _alone_of_acceleration(self) -> tuple[tuple[Effect, slice], ...]:
        return tuple((effect, part) for effect, part in self._alone if effect in self._moving)

    def _agrees(self, group: _Together) -> bool:
        """Return whether effects of a group evaluated together equal each alone.

        Those of geodrake do. One of a user's own may see its joint's name or other samples.
        """
        if of_geodrake(type(group.members[0][0])):
            return True
        if self.trial is None:
            return False
        seen = self.trial(*np.random.default_rng(0).normal(size=(3, 1, len(self.joints))))
        sign_v = seen.direction(seen.v, seen.sign_width)
        motion = JointMotion(seen.q[0], seen.v[0], seen.vd[0], seen.load[0], sign_v[0])
        alone, together = np.zeros((2, len(self.joints), self.count))
        _put(alone, group.members, seen)
        try:
            group.put(together, motion)
        except (TypeError, ValueError, IndexError):
            return False
        return np.array_equal(alone, together)


@dataclass(frozen=True, eq=False)
class _Together:
    """Joint effects that differ only in their joint."""

    members: tuple[tuple[JointEffect, slice], ...]  # they, with the places of their parameters
    joints: Indices | None  # (k,) their velocities; None for all velocities in order
    # (m, k) where their values are in the columns (nv, k) of all effects, flattened.
    places: Indices
    count: int  # of the parameters of all effects

    @classmethod
    def of(
        cls, members: Sequence[tuple[JointEffect, slice]], joints: tuple[str, ...], count: int
    ) -> _Together:
        """Return the effects of some joints, which have `count` parameters in total."""
        at = np.array([joints.index(effect.joint) for effect, _ in members])
        columns = np.array([range(part.start, part.stop) for _, part in members]).T
        in_order = np.array_equal(at, np.arange(len(joints)))
        return cls(tuple(members), None if in_order else at, at * count + columns, count)

    @cached_property
    def signals(self) -> list[tuple[int, int, int]]:
        """(velocity, column, signal) of all columns, if each is a signal as it is; else none."""
        effect = self.members[0][0]
        if not of_geodrake(type(effect)):  # one of a user's own may be a signal only at times
            return []
        motion = JointMotion(*np.zeros((len(fields(JointMotion)), 1)))
        signals = [id(getattr(motion, name)) for name in _SIGNALS]
        shown = [id(column) for column in effect.columns(motion)]
        if not set(shown) <= set(signals):
            return []
        rows, columns = np.divmod(self.places, self.count)
        return [
            (row, column, signals.index(which))
            for which, *places in zip(shown, rows.tolist(), columns.tolist(), strict=True)
            for row, column in zip(*places, strict=True)
        ]

    def put(self, Y: Array, motion: JointMotion) -> None:
        """Write their columns at one sample into those of all effects."""
        at = self.joints
        if at is not None:
            fields = motion.q, motion.v, motion.vd, motion.load, motion.sign_v
            motion = JointMotion(*(values[at] for values in fields))
        for place, values in zip(self.places, self.members[0][0].columns(motion), strict=True):
            Y.put(place, values)


@compiled
def put_signals(
    signals: tuple[Array, Array, Array],
    places: tuple[Indices, Indices, Indices],
    share: float,
    Y: Array,
) -> None:
    """Write a share of signals, each (nv,), to their places in columns; see `_SIGNALS`."""
    rows, columns, which = places
    for i in range(len(rows)):
        row = rows[i]
        value = signals[0][row]
        if which[i] == 1:
            value = signals[1][row]
        elif which[i] == 2:
            value = signals[2][row]
        Y[row, columns[i]] = share * value


def _put(Y: Array, effects: Sequence[tuple[Effect, slice]], motion: RobotMotion) -> None:
    """Write columns of effects at one sample into those (nv, k) of all."""
    for effect, part in effects:
        Y[:, part] = effect.regressor(motion)[0]


def sees_joint_only(effect: Effect) -> TypeGuard[JointEffect]:
    """Return whether an effect's columns depend on the motion of its own joint only."""
    return isinstance(effect, JointEffect) and type(effect).rows is JointEffect.rows


def dependencies(effect: Effect, trial: Trial | None, joints: int) -> frozenset[str]:
    """Return the signals that an effect's columns depend on; see `Effect.depends_on`.

    Args:
        trial: To try whether an effect that does not say so depends on accelerations and loads;
            without it, it does.
    """
    names = frozenset(type(effect).depends_on)
    if declares_signals(type(effect)):
        return names
    # No trial shows the time, as what acts during a window is none at other times.
    seen_by_rows = BodyEffect.depends_on | {"time"}
    names |= Effect.depends_on if sees_joint_only(effect) else seen_by_rows
    if trial is None:
        return names
    v, vd, load = 10.0 * np.random.default_rng(0).normal(size=(3, _SAMPLES, joints))
    zero = np.zeros_like(v)
    still = trial(v, zero, zero)
    columns = effect.regressor(still)
    others = {"vd": trial(v, vd, zero), "load": replace(still, load=load)}
    alike = {
        name
        for name, motion in others.items()
        if np.array_equal(columns, effect.regressor(motion), equal_nan=True)
    }
    return names - alike


def declares_signals(kind: type[Effect]) -> bool:
    """Return whether a class declares its dependencies with its columns, or in a subclass."""
    written = ("depends_on", "columns", "rows")
    nearest = next(base for base in kind.__mro__ if any(name in vars(base) for name in written))
    return "depends_on" in vars(nearest)
