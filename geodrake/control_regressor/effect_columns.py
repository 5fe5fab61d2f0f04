"""Columns of effects for one sample, effects of one kind evaluated together.

The columns of a joint effect are functions of its joint's motion, sample by sample. So all joints
with the same effect and the same shape parameters are evaluated at once, as if they were samples
of one joint; where an effect turns out to see more than its own sample, it is evaluated alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import Effect, EffortDelay, JointEffect, JointMotion, RobotMotion
from geodrake.effects.body_motion import RobotBodies
from geodrake.inertia import Array

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class OnlineMotion:
    """Motion of all joints at one sample, each field (nv,) but the last.

    Attributes:
        q: Positions, NaN for joints of several degrees of freedom.
        v: Velocities.
        vd: Accelerations.
        load: Efforts that the rigid bodies need.
        sign_v: Smoothed signs of the velocities.
        bodies: Poses and Jacobians of the bodies; None where nobody computes them.
    """

    q: Array
    v: Array
    vd: Array
    load: Array
    sign_v: Array
    bodies: RobotBodies | None = None


@dataclass(frozen=True, eq=False)
class _Together:
    """Joint effects that differ in nothing but their joint.

    Attributes:
        effect: One of them.
        joints: (k,) their velocities; None for all velocities in order.
        columns: (m, k) where their parameters are among all effects' parameters.
        places: (m, k) where their values are in the columns (nv, k) of all effects, flattened.
    """

    effect: JointEffect
    joints: Indices | None
    columns: Indices
    places: Indices


@dataclass(frozen=True, eq=False)
class EffectColumns:
    """Effects of a robot, ready for one sample at a time.

    Attributes:
        joints: Names of the nv velocities.
        count: Number k of all effects' parameters.
        sign_width: (nv,) speed below which the direction of motion is not known.
        uses_load: Whether a column depends on the load.
        uses_acceleration: Whether a column depends on the acceleration.
    """

    joints: tuple[str, ...]
    count: int
    sign_width: Array
    uses_load: bool
    uses_acceleration: bool
    _together: tuple[_Together, ...]
    _alone: tuple[tuple[Effect, slice], ...]
    _smooth: bool

    @classmethod
    def of(
        cls,
        joints: tuple[str, ...],
        effects: Sequence[Effect],
        *,
        sign_width: Array,
        single: NDArray[np.bool_],
        body_columns: Callable[[str], Array],
        bodies: RobotBodies | None = None,
    ) -> EffectColumns:
        """Sorts effects, by trial at a random motion.

        Args:
            joints: Names of the nv velocities.
            effects: The effects, in the order of their parameters.
            sign_width: (nv,) speed below which the direction of motion is not known.
            single: (nv,) whether a velocity belongs to a joint of one degree of freedom.
            body_columns: Some regressor (1, nv, 10) for each body.
            bodies: The bodies in some configuration, if effects may ask for them.
        """
        ends = np.cumsum([0, *(len(effect.parameters) for effect in effects)]).tolist()
        slices = [slice(a, b) for a, b in pairwise(ends)]
        parts = [
            (effect, part)
            for effect, part in zip(effects, slices, strict=True)
            if not isinstance(effect, EffortDelay)
        ]
        smooth = bool((sign_width > 0).all())
        base = cls(joints, ends[-1], sign_width, False, False, (), tuple(parts), smooth)
        rng = np.random.default_rng(0)
        q, v, vd, load = rng.normal(size=(4, len(joints)))
        trial = OnlineMotion(np.where(single, q, np.nan), v, vd, load, base.direction(v), bodies)
        exact = base.columns(trial, body_columns)
        together, alone = _sorted(joints, parts, ends[-1])
        found = replace(base, _together=(), _alone=tuple(alone))
        for group in together:
            attempt = replace(base, _together=(group,), _alone=())
            try:
                columns = attempt.columns(trial, body_columns)[:, group.columns]
            except (TypeError, ValueError, IndexError):
                columns = np.full(1, np.nan)
            if columns.size > 1 and np.array_equal(columns, exact[:, group.columns]):
                found = replace(found, _together=(*found._together, group))
            else:
                members = [part for part in parts if part[1].start in group.columns[0]]
                found = replace(found, _alone=(*found._alone, *members))
        other_load = found.columns(replace(trial, load=2.0 * load), body_columns)
        other_vd = found.columns(replace(trial, vd=2.0 * vd), body_columns)
        return replace(
            found,
            uses_load=not np.array_equal(exact, other_load),
            uses_acceleration=not np.array_equal(exact, other_vd),
        )

    @property
    def sees_bodies(self) -> bool:
        """Whether an effect may see more than the motion of its own joint."""
        return bool(self._alone)

    @property
    def sees_velocity_only(self) -> bool:
        """Whether columns depend on positions and velocities of their own joints alone."""
        return not (self._alone or self.uses_load or self.uses_acceleration)

    def direction(self, v: Array) -> Array:
        """Smoothed signs (nv,) of velocities (nv,)."""
        if self._smooth:
            return np.tanh(v / self.sign_width)
        return RobotMotion.direction(v, self.sign_width)

    def columns(self, motion: OnlineMotion, body_columns: Callable[[str], Array]) -> Array:
        """Columns (nv, k) of all effects' parameters."""
        Y = np.zeros((len(self.joints), self.count))
        fields = motion.q, motion.v, motion.vd, motion.load, motion.sign_v
        everywhere = JointMotion(*fields)
        for group in self._together:
            at = group.joints
            joint = everywhere if at is None else JointMotion(*(x[at] for x in fields))
            for place, values in zip(group.places, group.effect.columns(joint), strict=True):
                Y.put(place, values)
        if self._alone:
            seen = RobotMotion(
                self.joints,
                motion.q[None],
                motion.v[None],
                motion.vd[None],
                motion.load[None],
                self.sign_width,
                body_columns,
                motion.bodies,
            )
            for effect, part in self._alone:
                Y[:, part] = effect.regressor(seen)[0]
        return Y

    def added_mass(
        self, motion: OnlineMotion, mu: Array, body_columns: Callable[[str], Array]
    ) -> Array:
        """Matrix (nv, nv) that the effects with parameters mu (k,) add to the mass matrix."""
        nv = len(self.joints)
        zero, one = replace(motion, vd=np.zeros(nv)), replace(motion, vd=np.ones(nv))
        apart, coupled = replace(self, _alone=()), replace(self, _together=())
        own = (apart.columns(one, body_columns) - apart.columns(zero, body_columns)) @ mu
        added = np.diag(own)
        if self._alone:
            rest = coupled.columns(zero, body_columns) @ mu
            for k, unit in enumerate(np.eye(nv)):
                moved = coupled.columns(replace(motion, vd=unit), body_columns) @ mu
                added[:, k] += moved - rest
        return added


def _sorted(
    joints: tuple[str, ...], parts: list[tuple[Effect, slice]], count: int
) -> tuple[list[_Together], list[tuple[Effect, slice]]]:
    """Groups of joint effects that may be evaluated together, and the other effects."""
    groups: list[list[tuple[JointEffect, slice]]] = []
    alone: list[tuple[Effect, slice]] = []
    for effect, part in parts:
        own_rows = type(effect).rows is not JointEffect.rows
        if not isinstance(effect, JointEffect) or own_rows or not effect.parameters:
            alone.append((effect, part))
            continue
        for group in groups:
            if replace(effect, joint=group[0][0].joint) == group[0][0]:
                group.append((effect, part))
                break
        else:
            groups.append([(effect, part)])
    together = []
    for group in groups:
        at = np.array([joints.index(effect.joint) for effect, _ in group])
        columns = np.array([range(part.start, part.stop) for _, part in group]).T
        everywhere = np.array_equal(at, np.arange(len(joints)))
        together.append(
            _Together(group[0][0], None if everywhere else at, columns, at * count + columns)
        )
    return together, alone
