"""What all robots of a type do together from day to day, such as friction in a season."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.fleet.history import EquationSource

Array = NDArray[np.float64]

LEAST_ROBOTS = 5
"""Robots of a day below which it is not told what all do together; neighbouring days are."""

_WIDE = 1.0  # deviation of a course before logs are seen: friction may double
_FLAT = 1e-12  # share of information that is none


@dataclass(frozen=True, eq=False)
class Course(Short):
    """Shares by which columns of all robots are larger.

    Attributes:
        days: (D,) whole days on which enough robots have logs, ascending.
        values: (D, q) shares on each day, of mean 0.
        slope: (q,) what a degree adds, 1/°C, where logs have temperatures.
        reference: Temperature at which that is nothing, °C.
    """

    days: Array
    values: Array
    slope: Array
    reference: float

    @classmethod
    def begin(cls, logs: Sequence[EquationSource], columns: int) -> Course:
        """A course of zeros."""
        each = [np.unique(np.floor(robot.days)) for robot in logs]
        days, robots = np.unique(np.concatenate(each), return_counts=True)
        days = days[robots >= LEAST_ROBOTS]
        warm = np.concatenate([robot.temperature for robot in logs])
        known = warm[np.isfinite(warm)]
        reference = float(known.mean()) if len(known) else 0.0
        return cls(days, np.zeros((len(days), columns)), np.zeros(columns), reference)

    def of(self, logs: EquationSource) -> Array:
        """(T, q) shares at a robot's logs; between days with too few robots it is linear."""
        values = self._warmer(logs)[:, None] * self.slope
        if self.values.size:
            at = np.floor(logs.days)
            values = values + np.stack([np.interp(at, self.days, c) for c in self.values.T], -1)
        return np.asarray(values)

    def improved(
        self, logs: Sequence[EquationSource], information: Sequence[Array], right: Sequence[Array]
    ) -> Course:
        """The course after a step towards what logs say.

        Args:
            logs: Those of every robot of a type.
            information: (T, q, q) of each robot: what its logs say of shares.
            right: (T, q) of each robot: its right sides, less what the course explains.
        """
        warm = [self._warmer(each) for each in logs]
        if any(each.any() for each in warm):
            slope = _slope(warm, information, right)
            right = [
                r - w[:, None] * (info @ slope)
                for w, info, r in zip(warm, information, right, strict=True)
            ]
            with_slope = replace(self, slope=self.slope + slope)
        else:
            with_slope = self
        return with_slope._day_by_day(logs, information, right)

    def stronger(self, share: Array) -> Course:
        """The course of robots that all follow it more than was thought.

        Args:
            share: (q,) by how much, in the mean.
        """
        return replace(self, values=self.values * (1.0 + share), slope=self.slope * (1.0 + share))

    def _day_by_day(
        self, logs: Sequence[EquationSource], information: Sequence[Array], right: Sequence[Array]
    ) -> Course:
        D, q = self.values.shape
        if not self.values.size:
            return self
        seen, side = np.tile(np.eye(q) / _WIDE**2, (D, 1, 1)), -self.values / _WIDE**2
        for each, info, rest in zip(logs, information, right, strict=True):
            day = np.floor(each.days)
            at = np.minimum(np.searchsorted(self.days, day), D - 1)
            known = self.days[at] == day
            np.add.at(seen, at[known], info[known])
            np.add.at(side, at[known], rest[known])
        values = self.values + np.linalg.solve(seen, side[..., None])[..., 0]
        return replace(self, values=values - values.mean(axis=0))

    def _warmer(self, logs: EquationSource) -> Array:
        """(T,) degrees above the reference; 0 where the temperature is not known."""
        return np.nan_to_num(logs.temperature - self.reference)


def _slope(warm: Sequence[Array], information: Sequence[Array], right: Sequence[Array]) -> Array:
    """(q,) what a degree more adds, by all logs."""
    q = right[0].shape[1]
    seen, side = np.zeros((q, q)), np.zeros(q)
    for w, info, rest in zip(warm, information, right, strict=True):
        seen += np.einsum("t,tab->ab", w**2, info)
        side += w @ rest
    seen[np.arange(q), np.arange(q)] += _FLAT * np.trace(seen) + np.finfo(float).tiny
    return np.asarray(np.linalg.solve(seen, side))
