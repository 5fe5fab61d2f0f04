"""What all robots of a type do together from day to day, such as friction in a season."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.fleet.history import RobotHistory

Array = NDArray[np.float64]

LEAST_ROBOTS = 5
"""Robots of a day below which it is not told what all do together; neighbouring days are."""

_WIDE = 1.0  # deviation of a course before logs are seen: friction may double


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
    def begin(cls, histories: Sequence[RobotHistory], columns: int) -> Course:
        """A course of zeros.

        Args:
            histories: All robots of a type.
            columns: Number q of columns that may go together.
        """
        each = [np.unique(np.floor(history.days)) for history in histories]
        days, robots = np.unique(np.concatenate(each), return_counts=True)
        days = days[robots >= LEAST_ROBOTS]
        warm = np.concatenate([history.temperature for history in histories])
        known = warm[np.isfinite(warm)]
        return cls(
            days,
            np.zeros((len(days), columns)),
            np.zeros(columns),
            float(known.mean()) if len(known) else 0.0,
        )

    def of(self, history: RobotHistory) -> Array:
        """(T, q) shares at a robot's logs; between days with too few robots it is linear."""
        values = self.warmer(history)[:, None] * self.slope
        if len(self.days):
            at = np.floor(history.days)
            values = values + np.stack([np.interp(at, self.days, c) for c in self.values.T], -1)
        return np.asarray(values)

    def warmer(self, history: RobotHistory) -> Array:
        """(T,) degrees above the reference; 0 where the temperature is not known."""
        return np.nan_to_num(history.temperature - self.reference)

    def improved(
        self, histories: Sequence[RobotHistory], information: Sequence[Array], right: Sequence[Array]
    ) -> Course:
        """The course after a step towards what logs say.

        Args:
            histories: All robots of a type.
            information: (T, q, q) of each robot: what its logs say of shares.
            right: (T, q) of each robot: its right sides, less what the course explains.
        """
        q = len(self.slope)
        slope, warm = np.zeros(q), [self.warmer(history) for history in histories]
        if any(each.any() for each in warm):
            pairs = list(zip(warm, information, strict=True))
            seen = sum((np.einsum("t,tab->ab", w**2, info) for w, info in pairs), np.zeros((q, q)))
            side = sum((w @ r for w, r in zip(warm, right, strict=True)), np.zeros(q))
            slope = np.linalg.solve(seen + 1e-12 * (np.trace(seen) + 1.0) * np.eye(q), side)
            right = [
                r - w[:, None] * np.einsum("tab,b->ta", info, slope)
                for w, info, r in zip(warm, information, right, strict=True)
            ]
        D = len(self.days)
        seen, side = np.zeros((D, q, q)), np.zeros((D, q))
        for history, info, rest in zip(histories, information, right, strict=True):
            at = np.searchsorted(self.days, np.floor(history.days))
            known = (at < D) & (self.days[np.minimum(at, D - 1)] == np.floor(history.days)) if D else (
                np.zeros(len(at), bool)
            )
            np.add.at(seen, at[known], info[known])
            np.add.at(side, at[known], rest[known])
        weak = np.eye(q) / _WIDE**2
        step = np.linalg.solve(seen + weak, (side - self.values / _WIDE**2)[..., None])[..., 0]
        values = self.values + step
        return Course(
            self.days,
            values - values.mean(axis=0) if D else values,
            self.slope + slope,
            self.reference,
        )
