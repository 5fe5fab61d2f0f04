"""Assignment of a log's columns to a model's joints, with units and signs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.model.effort_signal import MotorLimit

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Assignment:
    """Interpretation of a log's columns for n joints.

    Joint j has the position scale_j q + zero_j, where q is column `position`_j, and the effort
    gain_j times column `effort`_j. Measured velocities use the columns of the positions, times
    `rate`.
    """

    position: Indices  # (n,) column of the positions of each joint
    scale: Array  # (n,) factor of the positions
    zero: Array  # (n,) offset of the scaled positions, rad or m
    rate: Array  # (n,) factor of measured velocities
    effort: Indices  # (n,) column of the efforts of each joint
    gain: Array  # (n,) factor of the efforts
    time: float = 1.0  # factor of time stamps
    # (3,) gravity included in the efforts, world frame, m/s²; None: the model's, with a level base
    gravity: tuple[float, ...] | None = None
    subtracted: frozenset[str] = frozenset()  # terms missing from the efforts, by `taken_out_as`
    payload_bodies: frozenset[int] = frozenset()  # bodies with a payload
    is_far: bool = False  # whether all bodies may differ much from the model's
    unknown: frozenset[int] = frozenset()  # joints with an unknown function of the motion
    detached: frozenset[int] = frozenset()  # joints whose efforts are unrelated to the bodies
    # Effort column -> signs (N,) of its samples, for columns of magnitudes.
    signs: Mapping[int, Array] = field(default_factory=dict)
    # Effort column -> motor limit in the column's unit, so that later gains and swaps apply to it.
    limits: Mapping[int, MotorLimit] = field(default_factory=dict)

    @classmethod
    def as_named(cls, n: int) -> Assignment:
        """Return the assignment of n joints that the column names state."""
        columns, ones = np.arange(n), np.ones(n)
        return cls(columns, ones, np.zeros(n), ones, columns, ones)

    @property
    def motion_key(self) -> tuple[object, ...]:
        """Return a key of everything that the columns of bodies and effects depend on."""
        columns = self.position.tobytes(), self.scale.tobytes(), self.zero.tobytes()
        return (*columns, self.time, self.gravity)

    @property
    def effort_key(self) -> tuple[object, ...]:
        """Return a key of everything that an effort fit depends on: all but velocity factors."""
        signs = tuple((source, values.tobytes()) for source, values in self.signs.items())
        columns = self.effort.tobytes(), self.gain.tobytes(), signs, tuple(self.limits.items())
        sets = self.subtracted, self.payload_bodies, self.is_far, self.unknown, self.detached
        return (*self.motion_key, *columns, *sets)

    @property
    def is_weightless(self) -> bool:
        """Return whether the efforts exclude the weight of the bodies."""
        return self.gravity is not None and not any(self.gravity)

    def limit_of(self, joint: int) -> MotorLimit | None:
        """Return the motor limit of a joint's efforts; None if it has none."""
        limit = self.limits.get(int(self.effort[joint]))
        return limit and limit.times(abs(float(self.gain[joint])))

    def limited(self, joint: int, limit: MotorLimit) -> Assignment:
        """Return the assignment with a motor limit at a joint."""
        column_limit = limit.times(1.0 / abs(float(self.gain[joint])))
        return replace(self, limits={**self.limits, int(self.effort[joint]): column_limit})

    def swapped(self, fields: Iterable[str], i: int, j: int) -> Assignment:
        """Return the assignment with the entries of two joints swapped."""
        order = np.arange(len(self.gain))
        order[[i, j]] = j, i
        changed: dict[str, Any] = {name: getattr(self, name)[order] for name in fields}
        return replace(self, **changed)

    def times(self, fields: Iterable[str], joints: Sequence[int], factor: float) -> Assignment:
        """Return the assignment with the entries of `joints`, or of all if empty, multiplied."""
        changed: dict[str, Any] = {name: np.array(getattr(self, name)) for name in fields}
        for values in changed.values():
            values[list(joints) or slice(None)] *= factor
        return replace(self, **changed)
