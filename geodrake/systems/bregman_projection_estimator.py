"""Parameters from streaming measurements."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from geodrake.control_regressor import ControlModel
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.online_estimation import FilteredRegressor, SampleUpdate
from geodrake.systems.requirements import checked_estimate, require_single_joints
from geodrake.systems.safeguards import Watch


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

    Every sample adds to filtered rows Y_f p = effort_f, which need no acceleration
    (`FilteredRegressor`). The estimate is projected, in the divergence of its manifold, onto the
    slab |Y_f p − effort_f| ≤ ε of each sample and onto a constraint set (`SampleUpdate`). If the
    truth is in slab and set, no sample takes the estimate farther from it, and it always stays
    physical.

    `residual` (nv), N·m or N, is effort_f − Y_f p̂ of the last sample, before its projection.

    A sample that is not finite, or a state that stands still for `stale_time` while it says that
    the robot moves, is left out of the filter, and the estimate stays; so does one whose projection
    is not found.
    """

    def __init__(
        self,
        control: ControlModel,
        update: SampleUpdate,
        *,
        filtered: FilteredRegressor | None = None,
        time_step: float = 1e-3,
        parameters: ArrayLike | None = None,
        stale_time: float = 0.05,
    ) -> None:
        """Constructs the system.

        Args:
            control: The robot.
            update: What a filtered sample does to the estimate.
            filtered: The filter, its period the time step; one of 20 1/s if None.
            time_step: Sampling period, s.
            parameters: (p,) first estimate; that of the model if None.
            stale_time: How long the state may stand still, s.

        Raises:
            ArgumentError: The robot has joints of several degrees of freedom, or an argument does
                not fit.
        """
        LeafSystem.__init__(self)
        require_single_joints(control)
        filtered = filtered or FilteredRegressor(control, time_step)
        if filtered.period != time_step or filtered.control is not control:
            raise ArgumentError(
                f"The filter is one for {filtered.period} s; the time step is {time_step} s.",
                advice="Make the filter with the same ControlModel and time step.",
            )
        start = checked_estimate(control, update.manifold, parameters)
        nv = len(control.joints)
        self.control, self._sample_update, self._filter = control, update, filtered
        self._nv, self._time_step = nv, time_step
        self._watch = Watch(nv, max(stale_time / time_step, 1.0))
        self._state_port = self.DeclareVectorInputPort("estimated_state", BasicVector(2 * nv))
        self._effort_port = self.DeclareVectorInputPort("effort", BasicVector(nv))
        self._estimate, self._memory, self._seen, self._residual = (
            self.DeclareDiscreteState(value)
            for value in (start, filtered.start(), self._watch.start()[: 2 * nv + 1], np.zeros(nv))
        )
        self.DeclarePeriodicDiscreteUpdateEvent(time_step, 0.0, self._update)
        self.DeclareStateOutputPort("parameters", self._estimate)
        self.DeclareStateOutputPort("residual", self._residual)

    def parameters(self, context: Context) -> Array:
        """The estimate (p,) in a Context."""
        return np.array(context.get_discrete_state(self._estimate).value())

    def _update(self, context: Context, state: DiscreteValues) -> None:
        x, effort = self._state_port.Eval(context), self._effort_port.Eval(context)
        watched = context.get_discrete_state(self._seen).value()
        usable, _, count = self._watch.fresh(watched, x)
        state.set_value(self._seen, np.concatenate([x if usable else watched[:-1], [count]]))
        memory = context.get_discrete_state(self._memory).value()
        if not (usable and np.isfinite(effort).all()):
            state.set_value(self._memory, self._filter.skipped(memory))
            return
        with np.errstate(all="ignore"):
            memory = self._filter.advanced(memory, x[: self._nv], x[self._nv :], effort)
            state.set_value(self._memory, memory)
            p, (Y, known) = self.parameters(context), self._filter.rows(memory)
            state.set_value(self._residual, known - Y @ p)
            state.set_value(
                self._estimate, self._sample_update.updated(p, Y, known, self._time_step)
            )
