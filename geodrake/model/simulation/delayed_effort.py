"""Effort commands that arrive late."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from geodrake.boundary.arguments import positive, real_array
from geodrake.errors import ArgumentError
from geodrake.model.simulation.scalar_system import differenced

_MOST_SAMPLES = 1_000_000


@differenced
class DelayedEffort(LeafSystem):
    """Passes efforts on with a delay, as a drive or a bus does.

    .. pydrake_system::

        name: DelayedEffort
        input_ports:
        - effort
        output_ports:
        - delayed_effort

    delayed_effort(t) = effort(t − δ), with a delay of its own for every effort. The input is
    sampled every `period` and interpolated linearly, so the output is continuous. Before t = δ it
    is the first sample.

    The system can be cloned, and converted to AutoDiffXd.

    The state is the time of the last sample, followed by the samples from the oldest to the last.
    """

    def __init__(self, delays: ArrayLike, *, period: float = 1e-3) -> None:
        """Construct the system of delays (n,), s, each zero or at least a sampling period, s."""
        LeafSystem.__init__(self, converter=self._converter)
        delays = np.atleast_1d(real_array(delays, "delays")).copy()
        positive(period, "period")
        usable = (delays == 0) | (delays >= period * (1 - 1e-9))
        if delays.ndim > 1 or not len(delays) or not usable.all():
            raise ArgumentError(
                f"Delays must be zero or at least the period; they are {delays} s, and the "
                f"period is {period} s.",
                advice="Choose a shorter period.",
            )
        if delays.max() / period > _MOST_SAMPLES:
            raise ArgumentError(
                f"Delays are limited to {_MOST_SAMPLES} periods; got {delays.max():g} s with "
                f"a period of {period:g} s.",
                advice="Choose a longer period.",
            )
        self._delays, self._period = delays, period
        self._samples = 2 + int(np.ceil(delays.max() / period - 1e-9))
        self._size, self._columns = len(delays), np.arange(len(delays))
        self._prompt = np.flatnonzero(delays == 0)
        self._input = self.DeclareVectorInputPort("effort", BasicVector(self._size))
        start = np.zeros(1 + self._samples * self._size)
        start[0] = -np.inf
        state = self.DeclareDiscreteState(start)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._sample)
        prerequisites = {self.discrete_state_ticket(state), self.time_ticket()}
        if (delays == 0).any():
            prerequisites.add(self._input.ticket())
        self.DeclareVectorOutputPort(
            "delayed_effort", BasicVector(self._size), self._calc_delayed, prerequisites
        )

    def _history(self, context: Context) -> tuple[float, np.ndarray]:
        """Return the time of the last sample and the samples, (samples, size)."""
        state = context.get_discrete_state_vector().value()
        return state[0], state[1:].reshape(self._samples, self._size)

    def _sample(self, context: Context, state: DiscreteValues) -> None:
        last, history = self._history(context)
        effort = self._input.Eval(context)
        after = np.empty(1 + history.size)
        after[0] = context.get_time()
        after[1 : -self._size] = history[1:].ravel()
        after[-self._size :] = effort
        if last == -np.inf:  # the first sample
            after[1:] = np.tile(effort, self._samples)
        state.set_value(after)

    def _calc_delayed(self, context: Context, output: BasicVector) -> None:
        last, history = self._history(context)
        age = np.zeros(self._size)  # without a sample yet, as all are alike
        if last > -np.inf:
            age = (self._delays + last - context.get_time()) / self._period
        place = (self._samples - 1 - age).clip(0, self._samples - 1)
        i = np.minimum(place.astype(int), self._samples - 2)
        early, late = history[i, self._columns], history[i + 1, self._columns]
        delayed = early + (place - i) * (late - early)
        if len(self._prompt):
            delayed[self._prompt] = self._input.Eval(context)[self._prompt]
        output.SetFromVector(delayed)
