"""An assignment of a log's columns to a model's joints: which is whose, in which unit and sign."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from geodrake.model.motor_limit import MotorLimit

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Assignment:
    """What the columns of n joints are, in place of what their names say.

    The joint j is at scale_j q + zero_j of the position in column `position`_j. Velocities belong
    to their positions, and are `rate` times these columns. Its efforts are gain_j times
    those in column `effort`_j.

    Attributes:
        position: (n,) column of the positions of each joint.
        scale: (n,) what they are multiplied by.
        zero: (n,) what is added then, rad or m.
        rate: (n,) what measured velocities of those columns are multiplied by.
        effort: (n,) column of the efforts of each joint.
        gain: (n,) what they are multiplied by.
        time: What time stamps are multiplied by.
        level: Whether efforts are without the weight of the bodies.
        without: Names of what else has been taken out of the efforts; see
            `Effect.taken_out_as`.
        carrying: Indices of bodies that hold a payload, or are otherwise not as in the model.
        tilted: Whether the base may stand on a slope.
        gravity: (3,) by which it does, in the world frame, m/s²; None for the model's.
        unknown: Indices of joints whose efforts have an unknown function of their motion in them.
        apart: Those of which the efforts have nothing to do with what the bodies need.
        signs: By columns of efforts that are magnitudes, the signs (N,) of their samples.
        limits: By some columns of efforts, what the motor can give of them, in their own unit:
            what is found of gains and swaps later is true of limits, too.
    """

    position: Indices
    scale: Array
    zero: Array
    rate: Array
    effort: Indices
    gain: Array
    time: float = 1.0
    level: bool = False
    without: frozenset[str] = frozenset()
    carrying: frozenset[int] = frozenset()
    tilted: bool = False
    gravity: tuple[float, ...] | None = None
    unknown: frozenset[int] = frozenset()
    apart: frozenset[int] = frozenset()
    signs: Mapping[int, Array] = field(default_factory=dict)
    limits: Mapping[int, MotorLimit] = field(default_factory=dict)

    @classmethod
    def as_named(cls, n: int) -> Assignment:
        """What the names of the columns of n joints say."""
        own, ones = np.arange(n), np.ones(n)
        return cls(own, ones, np.zeros(n), ones, own, ones)

    @property
    def motion_key(self) -> tuple[object, ...]:
        """What the motion of the joints depends on."""
        columns = self.position.tobytes(), self.scale.tobytes(), self.zero.tobytes()
        return (*columns, self.time, self.level, self.gravity)

    def limit_of(self, joint: int) -> MotorLimit:
        """What the motor can give of one of the `limited_joints`."""
        return self.limits[int(self.effort[joint])].times(abs(float(self.gain[joint])))

    @property
    def limited_joints(self) -> tuple[int, ...]:
        """Those whose motors have a limit."""
        return tuple(j for j, column in enumerate(self.effort.tolist()) if column in self.limits)

    def limited(self, joint: int, limit: MotorLimit) -> Assignment:
        """With a limit of what a joint's motor can give."""
        own = limit.times(1.0 / abs(float(self.gain[joint])))
        return replace(self, limits={**self.limits, int(self.effort[joint]): own})

    def swapped(self, i: int, j: int, *, positions: bool, efforts: bool) -> Assignment:
        """With the columns of two joints swapped."""
        order = np.arange(len(self.gain))
        order[[i, j]] = j, i
        found = self
        if positions:
            found = replace(found, position=found.position[order], rate=found.rate[order])
            found = replace(found, scale=found.scale[order], zero=found.zero[order])
        if efforts:
            found = replace(found, effort=found.effort[order], gain=found.gain[order])
        return found

    def times(self, quantity: str, joint: int | None, factor: float) -> Assignment:
        """With a column of a joint, or those of all, multiplied.

        Args:
            quantity: "scale", "rate" or "gain".
            joint: The joint; None for all.
            factor: By what.
        """
        values = np.array(getattr(self, quantity))
        values[slice(None) if joint is None else joint] *= factor
        changed: dict[str, Any] = {quantity: values}
        return replace(self, **changed)

    def leaning(self, gravity: Array, angles: Array) -> Assignment:
        """With a base that is turned about the world's x and y axis.

        Args:
            gravity: (3,) gravity of the model, m/s².
            angles: (2,) by which it is turned from where it is, rad.
        """
        down = gravity if self.gravity is None else np.array(self.gravity)
        turned = Rotation.from_rotvec([*-angles, 0.0]).apply(down)
        return replace(self, gravity=tuple(turned.tolist()))

    def moved(self, joint: int, by: float) -> Assignment:
        """With another zero of a joint's position.

        Args:
            joint: The joint.
            by: What is added to its positions, rad or m.
        """
        zero = self.zero.copy()
        zero[joint] += by
        return replace(self, zero=zero)
