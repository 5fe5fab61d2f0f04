"""Columns of several effects of a robot, along a motion or at one sample.

At one sample, as in a controller or simulation, effects of one kind are evaluated together. The
columns of a joint effect depend on its joint's motion sample by sample. Joints with the same effect
and shape parameters are therefore evaluated as if they were samples of one joint. Columns that
equal a signal of their joint, such as the velocity for viscous friction, are written by a compiled
loop.

An effect's class declares the signals that its columns depend on. Without a declaration, as in
user-defined effects, all signals available to its base class are assumed, except that dependence on
accelerations and loads is tested. Dependence on history or temperature must be declared.
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
"""Fields of a `JointMotion` that a column may equal."""

_TRANSMITTED = frozenset({"q", "v", "bodies"})
"""Additional signals for effects of joints behind a transmission."""

Trial = Callable[[Array, Array, Array], RobotMotion]
"""Function from velocities, accelerations and loads (N, nv) to the robot's motion."""

_SAMPLES = 8

ToRobotMotion = Callable[[JointMotion], RobotMotion]
"""Function from all joints' motion at one sample to the robot's motion with its bodies.

Accelerations may be (N, nv), for N samples that differ only in them."""


@dataclass(frozen=True, eq=False)
class EffectColumns:
    """Evaluator of the effects of a robot."""

    joints: tuple[str, ...]  # names of the nv velocities
    effects: tuple[Effect, ...]  # in the order of their k parameters
    # Motions for testing undeclared dependencies of users' effects. If None, all signals are
    # assumed, and these effects are evaluated one by one.
    trial: Trial | None = None

    @cached_property
    def count(self) -> int:
        """Number k of parameters of all effects."""
        return sum(len(effect.parameters) for effect in self.effects)

    @cached_property
    def depends_on(self) -> frozenset[str]:
        """Signals that any column depends on."""
        return frozenset().union(*self._signals)

    def fit_rows(self, motion: RobotMotion) -> list[dict[int, Array]]:
        """Return each effect's `fit_rows`, keyed by index of the velocity."""
        return [
            {self._indices[joint]: columns for joint, columns in effect.fit_rows(motion).items()}
            for effect in self.effects
        ]

    def effort(self, motion: RobotMotion, mu: Array) -> Array:
        """Return the effort (N, nv), N·m or N, of the effects with parameters mu (k,)."""
        total = np.zeros_like(motion.v)
        for effect, part in zip(self.effects, self._parts, strict=True):
            for joint, columns in rows_of(effect, motion).items():
                total[:, self._indices[joint]] += columns @ mu[part]
        return total

    def at(self, motion: JointMotion, to_robot_motion: ToRobotMotion) -> Array:
        """Return columns (nv, k) at one sample.

        Args:
            motion: Motion of all joints, each field (nv,), as if they were samples of one joint.
            to_robot_motion: Called only for effects of several joints or of bodies.
        """
        Y = np.zeros((len(self.joints), self.count))
        signals = contiguous(motion.v), contiguous(motion.vd), contiguous(motion.sign_v)
        put_signals(signals, self.signals, 1.0, Y)
        for group in self._other_groups:
            group.put(Y, motion)
        if self._ungrouped:
            _put(Y, self._ungrouped, to_robot_motion(motion))
        return Y

    def added_mass(self, motion: JointMotion, mu: Array, to_robot_motion: ToRobotMotion) -> Array:
        """Return the effects' part (nv, nv) of the mass matrix; accelerations do not matter."""
        zero, unit = (replace(motion, vd=np.full(len(self.joints), x)) for x in (0.0, 1.0))
        change = np.zeros((len(self.joints), self.count))
        put_signals((zero.vd, unit.vd, zero.vd), self.signals, 1.0, change)
        for group in self._other_groups:
            if group.members[0][0] in self._inertial:
                at_zero, at_unit = np.zeros_like(change), np.zeros_like(change)
                group.put(at_zero, zero)
                group.put(at_unit, unit)
                change += at_unit - at_zero
        added = np.diag(change @ mu)
        if self._ungrouped_inertial:
            vd = np.vstack([zero.vd, np.eye(len(self.joints))])
            robot_motion = to_robot_motion(replace(motion, vd=vd))
            for effect, part in self._ungrouped_inertial:
                efforts = effect.regressor(robot_motion) @ mu[part]
                added += (efforts[1:] - efforts[0]).T
        return added

    @cached_property
    def _indices(self) -> dict[str, int]:
        """Index of each joint's velocity."""
        return {joint: i for i, joint in enumerate(self.joints)}

    @cached_property
    def _parts(self) -> tuple[slice, ...]:
        """Slice of each effect's parameters."""
        ends = np.cumsum([0, *(len(effect.parameters) for effect in self.effects)]).tolist()
        return tuple(slice(start, end) for start, end in pairwise(ends))

    @cached_property
    def _signals(self) -> tuple[frozenset[str], ...]:
        """Signals that each effect depends on."""
        direct = [dependencies(e, self.trial, len(self.joints)) for e in self.effects]
        return tuple(
            names | _TRANSMITTED if e.at_motor and not self._indices.keys() >= {*e.where} else names
            for names, e in zip(direct, self.effects, strict=True)
        )

    @cached_property
    def signals(self) -> tuple[Indices, Indices, Indices]:
        """Velocity, column and signal indices of the columns that equal a signal."""
        places = [place for group in self._groups for place in group.signals]
        rows, columns, signals = np.reshape(np.array(places, np.intp), (-1, 3)).T.copy()
        return rows, columns, signals

    @property
    def only_signals(self) -> bool:
        """Whether all columns equal a signal."""
        return not (self._other_groups or self._ungrouped)

    @cached_property
    def _other_groups(self) -> tuple[_EffectGroup, ...]:
        """Groups with columns that do not equal a signal."""
        return tuple(group for group in self._groups if not group.signals)

    @cached_property
    def _groups(self) -> tuple[_EffectGroup, ...]:
        """Groups of joint effects that can be evaluated together."""
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
        candidates = (_EffectGroup.of(members, self.joints, self.count) for members in groups)
        return tuple(group for group in candidates if self._is_valid(group))

    @cached_property
    def _ungrouped(self) -> tuple[tuple[Effect, slice], ...]:
        """Effects outside the groups, with the slices of their parameters."""
        grouped = {part.start for group in self._groups for _, part in group.members}
        pairs = zip(self.effects, self._parts, strict=True)
        return tuple((e, part) for e, part in pairs if e.parameters and part.start not in grouped)

    @cached_property
    def _inertial(self) -> frozenset[Effect]:
        """Effects that depend on accelerations."""
        pairs = zip(self.effects, self._signals, strict=True)
        return frozenset(effect for effect, names in pairs if "vd" in names)

    @cached_property
    def _ungrouped_inertial(self) -> tuple[tuple[Effect, slice], ...]:
        return tuple((effect, part) for effect, part in self._ungrouped if effect in self._inertial)

    def _is_valid(self, group: _EffectGroup) -> bool:
        """Return whether evaluation as a group equals evaluation one by one.

        It does for geodrake's effects. A user's effect may depend on its joint's name or on other
        samples.
        """
        if of_geodrake(type(group.members[0][0])):
            return True
        if self.trial is None:
            return False
        trial = self.trial(*np.random.default_rng(0).normal(size=(3, 1, len(self.joints))))
        sign_v = trial.direction(trial.v, trial.sign_width)
        motion = JointMotion(trial.q[0], trial.v[0], trial.vd[0], trial.load[0], sign_v[0])
        separate, grouped = np.zeros((2, len(self.joints), self.count))
        _put(separate, group.members, trial)
        try:
            group.put(grouped, motion)
        except (TypeError, ValueError, IndexError):
            return False
        return np.array_equal(separate, grouped)


@dataclass(frozen=True, eq=False)
class _EffectGroup:
    """Joint effects that differ only in their joint."""

    members: tuple[tuple[JointEffect, slice], ...]  # effects and slices of their parameters
    joints: Indices | None  # (k,) indices of their velocities; None for all velocities in order
    places: Indices  # (m, k) flat indices of their values in the columns of all effects
    count: int  # number of parameters of all effects

    @classmethod
    def of(
        cls, members: Sequence[tuple[JointEffect, slice]], joints: tuple[str, ...], count: int
    ) -> _EffectGroup:
        """Return the group of some effects, among `count` parameters in total."""
        indices = np.array([joints.index(effect.joint) for effect, _ in members])
        columns = np.array([range(part.start, part.stop) for _, part in members]).T
        in_order = np.array_equal(indices, np.arange(len(joints)))
        places = indices * count + columns
        return cls(tuple(members), None if in_order else indices, places, count)

    @cached_property
    def signals(self) -> list[tuple[int, int, int]]:
        """(velocity, column, signal) of all columns if each equals a signal; otherwise empty."""
        effect = self.members[0][0]
        if not of_geodrake(type(effect)):  # a user's column may equal a signal only sometimes
            return []
        motion = JointMotion(*np.zeros((len(fields(JointMotion)), 1)))
        signals = [id(getattr(motion, name)) for name in _SIGNALS]
        ids = [id(column) for column in effect.columns(motion)]
        if not set(ids) <= set(signals):
            return []
        rows, columns = np.divmod(self.places, self.count)
        return [
            (row, column, signals.index(signal))
            for signal, *places in zip(ids, rows.tolist(), columns.tolist(), strict=True)
            for row, column in zip(*places, strict=True)
        ]

    def put(self, Y: Array, motion: JointMotion) -> None:
        """Write the group's columns at one sample into those of all effects."""
        if self.joints is not None:
            fields = motion.q, motion.v, motion.vd, motion.load, motion.sign_v
            motion = JointMotion(*(values[self.joints] for values in fields))
        for place, values in zip(self.places, self.members[0][0].columns(motion), strict=True):
            Y.put(place, values)


@compiled
def put_signals(
    signals: tuple[Array, Array, Array],
    places: tuple[Indices, Indices, Indices],
    factor: float,
    Y: Array,
) -> None:
    """Write scaled signals, each (nv,), to their places in the columns; see `_SIGNALS`."""
    rows, columns, indices = places
    for i in range(len(rows)):
        row = rows[i]
        value = signals[0][row]
        if indices[i] == 1:
            value = signals[1][row]
        elif indices[i] == 2:
            value = signals[2][row]
        Y[row, columns[i]] = factor * value


def _put(Y: Array, effects: Sequence[tuple[Effect, slice]], motion: RobotMotion) -> None:
    """Write the columns of some effects at one sample into those (nv, k) of all effects."""
    for effect, part in effects:
        Y[:, part] = effect.regressor(motion)[0]


def sees_joint_only(effect: Effect) -> TypeGuard[JointEffect]:
    """Return whether an effect's columns depend on the motion of its own joint only."""
    return isinstance(effect, JointEffect) and type(effect).rows is JointEffect.rows


def dependencies(effect: Effect, trial: Trial | None, joints: int) -> frozenset[str]:
    """Return the signals that an effect's columns depend on; see `Effect.depends_on`.

    Args:
        trial: Tests undeclared dependence on accelerations and loads; None to assume it.
    """
    names = frozenset(type(effect).depends_on)
    if declares_signals(type(effect)):
        return names
    # Dependence on time cannot be tested: an effect may act only during some window.
    names |= Effect.depends_on if sees_joint_only(effect) else BodyEffect.depends_on | {"time"}
    if trial is None:
        return names
    v, vd, load = 10.0 * np.random.default_rng(0).normal(size=(3, _SAMPLES, joints))
    zero = np.zeros_like(v)
    reference = trial(v, zero, zero)
    columns = effect.regressor(reference)
    changes = {"vd": trial(v, vd, zero), "load": replace(reference, load=load)}
    irrelevant = {
        name
        for name, motion in changes.items()
        if np.array_equal(columns, effect.regressor(motion), equal_nan=True)
    }
    return names - irrelevant


def declares_signals(kind: type[Effect]) -> bool:
    """Return whether the class that defines the columns, or a subclass, declares `depends_on`."""
    names = ("depends_on", "columns", "rows")
    definer = next(base for base in kind.__mro__ if any(name in vars(base) for name in names))
    return "depends_on" in vars(definer)
