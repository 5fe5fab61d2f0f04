"""Regressor rows of inverse dynamics from samples without accelerations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isfinite

import numpy as np

from geodrake.boundary.arguments import integer, positive
from geodrake.compiling import compiled, contiguous
from geodrake.control.regressor import ControlModel, ControlSample, checked_control
from geodrake.errors import ArgumentError, GeodrakeError
from geodrake.inertia import Array

_MOST_FILTERS = 100


@dataclass(frozen=True, eq=False)
class FilteredRegressor:
    """Low-passed inverse dynamics, from positions, velocities and efforts.

    The effort is d/dt (Y_p p) − Y_c p, so over a sampling interval its mean is

        Ȳ p = mean effort,   Ȳ = (Y_p(t) − Y_p(t − h)) / h − mean Y_c,

    which needs no acceleration. Both sides pass through the same low-pass filters λ / (s + λ), so
    that the rows stay true and the noise of velocities does not get through. An interval at whose
    ends something is missing is left out of both sides, which keeps the rows true as well. Where a
    sensor only repeats its last state, the interval goes on to its next one.

    The memory of the filter is one vector, so that a Drake Context can hold it.

    Attributes:
        period: Sampling interval h, s.
        bandwidth: λ, 1/s.
        order: Number of filters after each other.
        held_effort: Whether the effort at an instant is the one that acted since the last instant,
            as that of a sampled controller; else it is a sample of an effort that changes smoothly.
    """

    control: ControlModel
    period: float
    bandwidth: float = 20.0
    order: int = 2
    held_effort: bool = False

    def __post_init__(self) -> None:
        checked_control(self.control)
        positive(self.period, "period")
        positive(self.bandwidth, "bandwidth")
        integer(self.order, "order", lower=1, upper=_MOST_FILTERS)

    def check_robot(self, control: ControlModel) -> None:
        """Check that the filter is one for a robot.

        Raises:
            ArgumentError: It was made with another `ControlModel`.
        """
        if self.control is not control:
            raise ArgumentError(
                "The filter was made with another ControlModel.",
                advice="Make FilteredRegressor and system with the same one.",
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (nv, p) of the regressor."""
        return len(self.control.joints), len(self.control.prior)

    @property
    def size(self) -> int:
        """Length of the memory: a number, and for every filter a regressor and its efforts."""
        return 1 + (self.order + 1) * (self._entries + len(self.control.joints))

    @cached_property
    def _entries(self) -> int:
        rows, columns = self.shape
        return rows * columns

    @cached_property
    def _pass(self) -> float:
        """Share of what is new that one filter lets through."""
        return float(-np.expm1(-self.bandwidth * self.period))

    def start(self) -> Array:
        """Return the memory before the first sample."""
        return np.zeros(self.size)

    def advanced(
        self,
        memory: Array,
        q: Array,
        qd: Array,
        effort: Array,
        *,
        sample: ControlSample | None = None,
        repeated: bool = False,
    ) -> Array:
        """Return the memory after one more sample; whatever is not finite ends an interval.

        Args:
            memory: (size,) of the last sample, not changed.
            q: (nq,) positions.
            qd: (nv,) velocities.
            effort: (nv,) efforts.
            sample: The robot at q, q̇ and v = q̇, if that is known already.
            repeated: Whether positions and velocities are no new measurement but the last one: then
                the effort alone is new.
        """
        if not (_finite(q) and _finite(qd) and _finite(effort)):
            return self.skipped(memory)
        if sample is None:
            sample = self.control.at(q, qd, qd, np.zeros_like(qd))
        try:
            both = sample.momentum_regressors.reshape(2, -1)
        except GeodrakeError:  # of an effect that has no finite columns
            return self.skipped(memory)
        after = memory.copy()
        share = self._pass if memory[0] <= 1 else 1.0 - (1.0 - self._pass) ** memory[0]
        ends = calc_ends(both, contiguous(effort), self.period, self.held_effort)
        stack = after[1:].reshape(self.order + 1, -1)
        if not _finite(ends[0]):
            return self.skipped(memory)
        if repeated and memory[0]:
            stack[-1] += ends[1] - ends[0]
            after[0] += 1.0
        else:
            calc_filtered(ends, float(memory[0]), float(share), stack)
            after[0] = 1.0
        return after

    def skipped(self, memory: Array) -> Array:
        """Return the memory after a sample that is missing."""
        after = memory.copy()
        after[0] = 0.0
        return after

    def rows(self, memory: Array) -> tuple[Array, Array]:
        """Return the filtered regressor Y (nv, p) and efforts (nv,), N·m or N: Y p = effort."""
        last = memory[1:].reshape(self.order + 1, -1)[self.order - 1]
        return last[: self._entries].reshape(self.shape), last[self._entries :]


@compiled
def calc_ends(both: Array, effort: Array, period: float, held: bool) -> Array:
    """Return what a sample adds to the interval that it ends, and takes off the next one: (2, ·).

    Args:
        both: (2, nv p) Y_p and Y_c.
        effort: (nv,) efforts.
        period: h, s.
        held: Whether the effort is the one that acted since the last instant.
    """
    entries, nv = both.shape[1], len(effort)
    ends = np.empty((2, entries + nv))
    for i in range(entries):
        moved, drift = both[0, i] / period, 0.5 * both[1, i]
        ends[0, i], ends[1, i] = moved - drift, moved + drift
    for i in range(nv):
        ends[0, entries + i] = effort[i] if held else 0.5 * effort[i]
        ends[1, entries + i] = 0.0 if held else -0.5 * effort[i]
    return ends


@compiled
def calc_filtered(ends: Array, periods: float, share: float, stack: Array) -> None:
    """Pass the rows of an interval through all filters, and begin the next one.

    The interval's rows are [now] − [before], with the filters linear in both.

    Args:
        ends: (2, ·) from `calc_ends`.
        periods: How many sampling intervals it had; 0 if it is left out.
        stack: (order + 1, ·) states of the filters, and what the interval began with.
    """
    last = len(stack) - 1
    for i in range(ends.shape[1]):
        if periods > 0.0:
            value = (ends[0, i] - stack[last, i]) / periods
            for k in range(last):
                stack[k, i] += share * (value - stack[k, i])
                value = stack[k, i]
        stack[last, i] = ends[1, i]


def _finite(x: Array) -> bool:
    """Return whether all of x are numbers, and not absurdly large: by their sum of squares."""
    return isfinite(np.vdot(x, x))
