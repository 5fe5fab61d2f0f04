"""How changes go with time: steps that stay, and ramps that go on.

A robot that is one of its type, but for the change, may be so before a step or after it: a payload
is put on, or taken off. A step therefore has two forms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

STEP, RAMP = "step", "ramp"
KINDS = (STEP, RAMP)
UNTIL = "until"
FORMS = (STEP, UNTIL, RAMP)
"""A step, what was there until a step, and a ramp."""


def kind_of(form: str) -> str:
    """The kind of change that a form is of."""
    return STEP if form == UNTIL else form


@dataclass(frozen=True, eq=False)
class Profiles(Short):
    """The steps or ramps that may begin at any of a robot's logs.

    A step is 0 before the log and 1 from it on, or 1 until the log and 0 from it on. A ramp is 0 up
    to the log and then rises in proportion to the days, to 1 at the last log.

    Attributes:
        first: (K,) log at which each begins.
        days: (T,) days of the logs.
    """

    form: str
    first: Indices
    days: Array

    @classmethod
    def of(cls, form: str, days: Array) -> Profiles:
        """All that the days of a robot's logs can show.

        Args:
            days: (T,) days of the logs, ascending.
        """
        starts = np.unique(days, return_index=True)[1]  # logs of one day are not told apart
        return cls(form, starts[:-1] if form == RAMP else starts[1:], days)

    @property
    def values(self) -> Array:
        """(K, T) values."""
        after = np.arange(len(self.days)) >= self.first[:, None]
        if self.form == UNTIL:
            return np.logical_not(after).astype(float)
        if self.form == STEP:
            return after.astype(float)
        begun = self.days[self.first][:, None]
        return np.asarray(after * (self.days - begun) / (self.days[-1] - begun))

    def sums(self, per_log: Array) -> Array:
        """(K, ...) sums Σ_t f_k(t) X_t, of cumulative sums.

        Args:
            per_log: (T, ...) X.
        """
        if self.form == UNTIL:
            return np.asarray(np.cumsum(per_log, axis=0)[self.first - 1])
        zeroth = _from(per_log)[self.first]
        if self.form == STEP:
            return zeroth
        left, span = self._ramp(per_log)
        return np.asarray(zeroth - _from(left * per_log)[self.first] / span)

    def squares(self, per_log: Array) -> Array:
        """(K, ...) sums Σ_t f_k(t)² X_t, of cumulative sums.

        Args:
            per_log: (T, ...) X.
        """
        if self.form != RAMP:
            return self.sums(per_log)
        left, span = self._ramp(per_log)
        zeroth, first, second = (
            _from(each)[self.first] for each in (per_log, left * per_log, left**2 * per_log)
        )
        return np.asarray(zeroth - 2.0 * first / span + second / span**2)

    def _ramp(self, per_log: Array) -> tuple[Array, Array]:
        """Days that are left after logs, and those of whole ramps, shaped to go with X.

        A ramp is 1 − left / span. Counted from the last log, no sum is more than its parts.
        """
        left = (self.days[-1] - self.days).reshape(-1, *(1,) * (per_log.ndim - 1))
        return left, left[self.first]


def _from(per_log: Array) -> Array:
    """(T, ...) sums over each log and all later ones."""
    return np.cumsum(per_log[::-1], axis=0)[::-1]
