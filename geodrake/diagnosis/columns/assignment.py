"""An assignment of a log's columns to a model's joints: which is whose, in which unit and sign."""

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
    """Meaning of the columns of n joints, in place of their names.

    Joint j is at scale_j q + zero_j of the position in column `position`_j. Velocities belong to
    their positions, and are `rate` times these columns. Its efforts are gain_j times those in
    column `effort`_j.
    """

    position: Indices  # (n,) column of the positions of each joint
    scale: Array  # (n,) what they are multiplied by
    zero: Array  # (n,) what is added then, rad or m
    rate: Array  # (n,) what measured velocities of those columns are multiplied by
    effort: Indices  # (n,) column of the efforts of each joint
    gain: Array  # (n,) what they are multiplied by
    time: float = 1.0  # what time stamps are multiplied by
    # (3,) gravity that is in the efforts, in the world frame, m/s²; None for the model's, on a base
    # that is level.
    gravity: tuple[float, ...] | None = None
    without: frozenset[str] = frozenset()  # what is taken out of efforts, by `taken_out_as`
    carrying: frozenset[int] = frozenset()  # bodies that hold a payload
    is_far: bool = False  # whether all bodies may be far from those of the model
    unknown: frozenset[int] = frozenset()  # joints with an unknown function of their motion
    apart: frozenset[int] = frozenset()  # joints whose efforts are not those of the bodies
    # By columns of efforts that are magnitudes, the signs (N,) of their samples.
    signs: Mapping[int, Array] = field(default_factory=dict)
    # By columns of efforts, what the motor gives of them, in their own unit: gains and swaps that
    # are found later are the limits', too.
    limits: Mapping[int, MotorLimit] = field(default_factory=dict)

    @classmethod
    def as_named(cls, n: int) -> Assignment:
        """Return what the names of the columns of n joints say."""
        own, ones = np.arange(n), np.ones(n)
        return cls(own, ones, np.zeros(n), ones, own, ones)

    @property
    def motion_key(self) -> tuple[object, ...]:
        """Return what efforts of bodies and effects depend on."""
        columns = self.position.tobytes(), self.scale.tobytes(), self.zero.tobytes()
        return (*columns, self.time, self.gravity)

    @property
    def effort_key(self) -> tuple[object, ...]:
        """Return what a fit of the efforts depends on: all but the factors of velocities."""
        signs = tuple((source, own.tobytes()) for source, own in self.signs.items())
        columns = self.effort.tobytes(), self.gain.tobytes(), signs, tuple(self.limits.items())
        sets = self.without, self.carrying, self.is_far, self.unknown, self.apart
        return (*self.motion_key, *columns, *sets)

    @property
    def is_weightless(self) -> bool:
        """Return whether efforts are without the weight of the bodies."""
        return self.gravity is not None and not any(self.gravity)

    def limit_of(self, joint: int) -> MotorLimit | None:
        """Return what the motor gives of a joint's efforts, if that has a limit."""
        limit = self.limits.get(int(self.effort[joint]))
        return limit and limit.times(abs(float(self.gain[joint])))

    def limited(self, joint: int, limit: MotorLimit) -> Assignment:
        """Return the assignment with a limit of what a joint's motor gives."""
        own = limit.times(1.0 / abs(float(self.gain[joint])))
        return replace(self, limits={**self.limits, int(self.effort[joint]): own})

    def swapped(self, fields: Iterable[str], i: int, j: int) -> Assignment:
        """Return the assignment with entries of two joints swapped."""
        order = np.arange(len(self.gain))
        order[[i, j]] = j, i
        changed: dict[str, Any] = {name: getattr(self, name)[order] for name in fields}
        return replace(self, **changed)

    def times(self, fields: Iterable[str], joints: Sequence[int], factor: float) -> Assignment:
        """Return the assignment with entries of some joints multiplied, or of all if none."""
        changed: dict[str, Any] = {name: np.array(getattr(self, name)) for name in fields}
        for values in changed.values():
            values[list(joints) or slice(None)] *= factor
        return replace(self, **changed)
