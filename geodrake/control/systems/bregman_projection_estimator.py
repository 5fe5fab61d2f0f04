"""Parameters from streaming measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem, State

from geodrake.boundary.arguments import instance, integer, number, positive
from geodrake.control.online_estimation import FilteredRegressor, Rows, SampleUpdate
from geodrake.control.regressor import ControlModel
from geodrake.control.systems.safeguards import (
    Safeguards,
    Watch,
    checked_estimate,
    require_single_joints,
    usable,
)
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.inertia.bodies import check_context

_SLOTS = 24  # samples in memory


@dataclass
class _Remembered:
    """Samples that are seen again."""

    regressors: Array  # (slots, nv, p) filtered regressors
    efforts: Array  # (slots, nv) their efforts
    kept: int = 0  # how many have been put there
    count: int = 0  # number of samples when the last one was

    def turn(self, number: int, kept: int) -> Rows | None:
        """Return one of the first `kept` samples, turn by turn; None if there are none."""
        kept = min(kept, self.kept, _SLOTS)
        return (self.regressors[number % kept], self.efforts[number % kept]) if kept else None

    def put(self, rows: Rows, count: int) -> None:
        """Put rows in the place of the oldest ones."""
        slot = self.kept % _SLOTS
        self.regressors[slot], self.efforts[slot] = rows
        self.kept, self.count = self.kept + 1, count


class BregmanProjectionEstimator(LeafSystem):
    """Estimates the parameters of a robot while it moves, whatever moves it.

    .. pydrake_system::

        name: BregmanProjectionEstimator
        input_ports:
        - estimated_state
        - effort
        output_ports:
        - parameters
        - residual
        - projection_error

    Every sample adds to filtered rows Y_f p = effort_f, which need no acceleration
    (`FilteredRegressor`). The estimate is projected, in the divergence of its manifold, onto the
    slabs |Y_f p − effort_f| ≤ ε of the sample and of one of those of the last seconds, so that they
    are not forgotten ([Lee2019] Eq. (2.2.11)); then onto a constraint set (§5.4.2). `SampleUpdate`
    says how, and has a nudge that costs less. If the truth is in slabs and set, no sample takes the
    estimate farther from it (unless the update forgets), and it always stays physical.

    `residual` (nv), N·m or N, is effort_f − Y_f p̂ of the last sample, before its projection, and
    `projection_error` the certificate of that: the greatest error of its conditions of optimality,
    in lengths of the metric, at most 1e-8; infinite where no bodies are in its slabs, or for a
    nudge, and before the first one.

    A sample that is not finite, or a state that stands still for `stale_time` while it says that
    the robot moves, is left out of the filter, and the estimate stays; so it does where a
    projection is not found. A sensor may be slower than the time step: its states count when they
    are new.
    """

    def __init__(
        self,
        control: ControlModel,
        update: SampleUpdate,
        *,
        filtered: FilteredRegressor | None = None,
        time_step: float = 1e-3,
        parameters: ArrayLike | None = None,
        memory: float = 2.0,
        stale_time: float = 0.05,
        update_every: int = 1,
    ) -> None:
        """Construct the system.

        Args:
            filtered: The filter, its period the time step; one of 20 1/s if None.
            time_step: Sampling period, s.
            parameters: (p,) first estimate; that of the model if None.
            memory: For how long samples are seen again, s; zero for never. A change of the robot
                shows at once, and is settled after this time.
            stale_time: How long the state may stand still, s.
            update_every: New samples from one projection to the next. The filter takes all of
                them; samples much closer than its bandwidth say nearly the same.

        Raises:
            ArgumentError: The robot has joints of several degrees of freedom, or an argument does
                not fit.
        """
        LeafSystem.__init__(self)
        require_single_joints(control)
        instance(update, "update", SampleUpdate)
        positive(time_step, "time_step")
        integer(update_every, "update_every", lower=1)
        number(memory, "memory", lower=0.0)
        Safeguards(stale_time=stale_time)
        nv = len(control.joints)
        if np.shape(update.tolerance) not in ((), (nv,)):
            raise ArgumentError(
                f"The robot has {nv} joints, but the update a tolerance of shape "
                f"{np.shape(update.tolerance)}."
            )
        filtered = FilteredRegressor(control, time_step) if filtered is None else filtered
        instance(filtered, "filtered", FilteredRegressor).check_robot(control)
        if filtered.period != time_step:
            raise ArgumentError(
                f"The filter has a period of {filtered.period} s, but the time step is "
                f"{time_step} s."
            )
        start = checked_estimate(control, update.manifold, parameters)
        self.control, self._sample_update, self._filter = control, update, filtered
        self._nv, self._time_step = nv, time_step
        self._every = update_every
        self._spacing = max(1, round(memory / (_SLOTS * time_step * update_every)))
        self._watch = Watch(nv, time_step, stale_time)
        self._state_port = self.DeclareVectorInputPort("estimated_state", BasicVector(2 * nv))
        self._effort_port = self.DeclareVectorInputPort("effort", BasicVector(nv))
        self._estimate, self._memory, self._seen, self._residual, self._error = (
            self.DeclareDiscreteState(value)
            for value in (start, filtered.start(), self._watch.start(), np.zeros(nv), [np.inf])
        )
        # (Not discrete state, all of which Drake copies at every update.)
        samples = _Remembered(np.zeros((_SLOTS, *filtered.shape)), np.zeros((_SLOTS, nv)))
        self._samples = self.DeclareAbstractState(AbstractValue.Make(samples))
        if memory > 0:
            # Half a step after an update, where rounding of times makes no difference.
            period = time_step * update_every * self._spacing
            self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.5 * time_step, self._remember)
        self._count = self.DeclareDiscreteState(np.zeros(1))
        self.DeclarePeriodicDiscreteUpdateEvent(time_step, 0.0, self._update)
        self.DeclareStateOutputPort("parameters", self._estimate)
        self.DeclareStateOutputPort("residual", self._residual)
        self.DeclareStateOutputPort("projection_error", self._error)

    def parameters(self, context: Context) -> Array:
        """Return the estimate (p,) in a Context."""
        return np.array(context.get_discrete_state(self._estimate).value())

    def set_parameters(self, context: Context, parameters: ArrayLike | None) -> None:
        """Put an estimate (p,), ordered as `ControlModel.prior`, or None for that, into a Context.

        Raises:
            ArgumentError: It is not in the manifold of the update, or has the wrong length.
        """
        check_context(self, context)
        p = checked_estimate(self.control, self._sample_update.manifold, parameters)
        context.SetDiscreteState(self._estimate, p)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        x, effort = self._state_port.Eval(context), self._effort_port.Eval(context)
        watched = np.array(context.get_discrete_state(self._seen).value())
        measured, new = self._watch.measure(watched, x)
        state.set_value(self._seen, watched)
        memory = context.get_discrete_state(self._memory).value()
        if not (measured and usable(effort)):
            state.set_value(self._memory, self._filter.skipped(memory))
            return
        with np.errstate(all="ignore"):
            memory = self._filter.advanced(
                memory, x[: self._nv], x[self._nv :], effort, repeated=not new
            )
            state.set_value(self._memory, memory)
            if not new:
                return
            p, (Y, known) = self.parameters(context), self._filter.rows(memory)
            state.set_value(self._residual, known - Y @ p)
            count = int(context.get_discrete_state(self._count).value()[0])
            state.set_value(self._count, [count + 1])
            if count % self._every:
                return
            samples: _Remembered = context.get_abstract_state(self._samples).get_value()
            number = count // self._every
            earlier = samples.turn(number, number // self._spacing)
            since = self._time_step * self._every
            following = self._sample_update.updated(p, Y, known, since, earlier=earlier)
            state.set_value(self._estimate, following.point)
            state.set_value(self._error, [following.error])

    def _remember(self, context: Context, state: State) -> None:
        """Put the last sample into memory, if there is a new one."""
        samples: _Remembered = state.get_mutable_abstract_state(self._samples).get_mutable_value()
        count = int(context.get_discrete_state(self._count).value()[0])
        rows = self._filter.rows(context.get_discrete_state(self._memory).value())
        if count > samples.count and all(np.isfinite(part).all() for part in rows):
            samples.put(rows, count)
