"""Online parameter estimation by Bregman projections."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteStateIndex,
    DiscreteValues,
    LeafSystem,
    State,
)

from geodrake.boundary.arguments import instance, integer, number, positive
from geodrake.compiling import compiled
from geodrake.control.online_estimation import (
    FilteredRegressor,
    Projector,
    Rows,
    SampleUpdate,
    calc_filtered,
    calc_projected,
    filtered_rows,
)
from geodrake.control.regressor import ControlModel, PlainRobot, calc_plain_momentum
from geodrake.control.systems.safeguards import (
    InputMonitor,
    Safeguards,
    calc_measured,
    checked_estimate,
    is_usable,
    require_single_joints,
)
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.inertia.bodies import check_context
from geodrake.manifolds.robot_kernels import calc_clearly_inside

_SLOTS = 24  # samples in memory
_ESTIMATE, _MEMORY, _MONITOR, _RESIDUAL, _ERROR, _COUNT = range(6)  # discrete states


class _Compiled(NamedTuple):
    """Constant arguments of `calc_estimated`."""

    robot: PlainRobot
    monitor: InputMonitor
    filter_options: tuple[float, float, bool]  # `FilteredRegressor.options`
    projector: Projector


@dataclass
class _SampleMemory:
    """Ring buffer of earlier samples."""

    regressors: Array  # (slots, nv, p) filtered regressors
    efforts: Array  # (slots, nv) their efforts
    stored: int = 0  # number of samples stored so far
    last: int = 0  # number of the sample stored last

    def cycle(self, index: int, count: int) -> Rows:
        """Return sample `index` modulo the number stored, at most `count`; no rows if empty."""
        count = min(count, self.stored, _SLOTS)
        slot = slice(0) if count == 0 else slice(index % count, index % count + 1)
        size = self.regressors.shape[2]
        return self.regressors[slot].reshape(-1, size), self.efforts[slot].reshape(-1)

    def put(self, rows: Rows, number: int) -> None:
        """Replace the oldest sample."""
        slot = self.stored % _SLOTS
        self.regressors[slot], self.efforts[slot] = rows
        self.stored, self.last = self.stored + 1, number


class BregmanProjectionEstimator(LeafSystem):
    """Estimates the parameters of a moving robot, whatever drives it.

    .. pydrake_system::

        name: BregmanProjectionEstimator
        input_ports:
        - estimated_state
        - effort
        output_ports:
        - parameters
        - residual
        - projection_error

    Every sample updates filtered rows Y_f p = effort_f, which need no acceleration
    (`FilteredRegressor`). The estimate is projected, in the divergence of its manifold, onto the
    slabs |Y_f p − effort_f| ≤ ε of the sample and of an earlier one from the last seconds, so that
    these are not forgotten ([Lee2019] Eq. (2.2.11)); then onto a constraint set (§5.4.2). See
    `SampleUpdate`, which also has a cheaper method. If the truth is in slabs and set, no sample
    moves the estimate away from it (unless the update forgets). The estimate is always physical.

    `residual` (nv), N·m or N, is effort_f − Y_f p̂ of the last sample, before its projection.
    `projection_error` certifies the projection: the largest error of its optimality conditions, in
    lengths of the metric, at most 1e-8. It is infinite if the slabs do not intersect, for a nudge,
    and before the first projection.

    A sample is omitted from the filter, and the estimate does not change, if it is not finite or if
    the state is constant for `stale_time` although its velocities are nonzero. The estimate does
    not change either if a projection fails. A sensor may be slower than the time step: only new
    states are used.
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
            filtered: The filter, with the time step as its period; one of 20 1/s if None.
            memory: Duration for which samples are used again, s; zero for none. The estimate
                responds to a change of the robot at once, and converges within this time.
            stale_time: Time for which the state may be constant, s.
            update_every: Number of new samples per projection. The filter uses all of them, but
                samples much closer than its bandwidth contain nearly the same information.
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
        self._monitor = InputMonitor(nv, float(time_step), float(stale_time))
        self._state_port = self.DeclareVectorInputPort("estimated_state", BasicVector(2 * nv))
        self._effort_port = self.DeclareVectorInputPort("effort", BasicVector(nv))
        monitor, zero = self._monitor.start(), np.zeros(nv)
        for value in (start, filtered.start(), monitor, zero, np.array([np.inf]), np.zeros(1)):
            self.DeclareDiscreteState(value)
        self._compiled: _Compiled | None = None
        robot, projector = getattr(control, "plain", None), update.compiled
        if robot is not None and projector is not None:
            self._compiled = _Compiled(robot, self._monitor, filtered.options, projector)
        # Abstract state, as Drake copies all discrete state at every update.
        samples = _SampleMemory(np.zeros((_SLOTS, *filtered.shape)), np.zeros((_SLOTS, nv)))
        self._samples = self.DeclareAbstractState(AbstractValue.Make(samples))
        if memory > 0:
            # Half a step after an update, so that rounding of times does not matter.
            period = time_step * update_every * self._spacing
            self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.5 * time_step, self._remember)
        self.DeclarePeriodicDiscreteUpdateEvent(time_step, 0.0, self._update)
        self.DeclareStateOutputPort("parameters", DiscreteStateIndex(_ESTIMATE))
        self.DeclareStateOutputPort("residual", DiscreteStateIndex(_RESIDUAL))
        self.DeclareStateOutputPort("projection_error", DiscreteStateIndex(_ERROR))

    def parameters(self, context: Context) -> Array:
        """Return the estimate (p,) in a Context."""
        return np.array(context.get_discrete_state(_ESTIMATE).value())

    def set_parameters(self, context: Context, parameters: ArrayLike | None) -> None:
        """Put an estimate (p,), or `ControlModel.prior` if None, into a Context."""
        check_context(self, context)
        p = checked_estimate(self.control, self._sample_update.manifold, parameters)
        context.SetDiscreteState(_ESTIMATE, p)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        x, effort = self._state_port.Eval(context), self._effort_port.Eval(context)
        p, memory, monitor, residual, error, count = map(state.get_mutable_value, range(6))
        index, remainder = divmod(int(count[0]), self._every)
        samples: _SampleMemory = context.get_abstract_state(self._samples).get_value()
        earlier = samples.cycle(index, index // self._spacing)
        update, next_p, next_error = self._sample_update, p, error[0]
        if self._compiled is not None and not remainder:
            next_p, states = np.empty(len(p)), (monitor, memory, p, residual)
            new, next_error, inside = calc_estimated(
                self._compiled, (x, effort), states, earlier, next_p
            )
            if new and not (inside or update.manifold.calc_contains(next_p)):
                next_p, next_error = p, np.inf
        else:
            with np.errstate(all="ignore"):
                if new := self._filtered(x, effort, monitor, memory):
                    Y, measured = self._filter.rows(memory)
                    residual[:] = measured - Y @ p
                if new and not remainder:
                    dt = self._time_step * self._every
                    projection = update.updated(p.copy(), Y, measured, dt, earlier=earlier)
                    next_p, next_error, _ = projection
        if new:
            p[:], error[0] = next_p, next_error
            count[0] += 1.0

    def _filtered(self, x: Array, effort: Array, monitor: Array, memory: Array) -> bool:
        """Pass a sample through monitor and filter; return whether its state is new."""
        measured, new = self._monitor.measure(monitor, x)
        if not (measured and is_usable(effort)):
            memory[0] = 0.0
            return False
        q, qd = x[: self._nv], x[self._nv :]
        memory[:] = self._filter.advanced(memory, q, qd, effort, repeated=not new)
        return new

    def _remember(self, context: Context, state: State) -> None:
        """Store the last sample if it is new."""
        samples: _SampleMemory = state.get_mutable_abstract_state(self._samples).get_mutable_value()
        count = int(context.get_discrete_state(_COUNT).value()[0])
        rows = self._filter.rows(context.get_discrete_state(_MEMORY).value())
        if count > samples.last and all(np.isfinite(part).all() for part in rows):
            samples.put(rows, count)


@compiled
def calc_estimated(
    constants: _Compiled,
    sample: tuple[Array, Array],
    states: tuple[Array, Array, Array, Array],
    earlier: Rows,
    next_p: Array,
) -> tuple[bool, float, bool]:
    """Update monitor, filter and estimate with a sample of a plain robot.

    Args:
        sample: (2 nv,) positions and velocities, and (nv,) efforts.
        states: Memories of monitor and filter, (n,) estimate, and (nv,) residual; all but the
            estimate are updated.
        earlier: Rows of an earlier sample, possibly empty.
        next_p: (n,) output for the new estimate.

    Returns:
        Whether the sample's state is new, the error of `calc_projected`, and whether the estimate
        is clearly inside the manifold. Only memories are written if the state is not new.
    """
    (period, gain, held), (x, effort) = constants.filter_options, sample
    nv = constants.monitor.size
    monitor, memory, p, residual = states
    valid, new = calc_measured(x, constants.monitor, monitor)
    regressors = np.zeros((2, nv, len(p)))
    if valid:
        calc_plain_momentum(constants.robot, x[:nv], x[nv:], regressors)
    options = period, gain, held, not new
    if not (valid and calc_filtered(regressors, effort, options, memory)):
        memory[0] = 0.0
        return False, np.inf, False
    if new:
        rows = filtered_rows(memory, nv, len(p))
        residual[:] = rows[1] - np.dot(rows[0], p)
        error, _ = calc_projected(p, rows, earlier, constants.projector, next_p)
        return True, error, calc_clearly_inside(next_p, constants.projector[1])
    return False, np.inf, False
