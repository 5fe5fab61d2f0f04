"""Parameters from streaming measurements."""

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
    Projecting,
    Rows,
    SampleUpdate,
    calc_filtered,
    calc_projected,
    filtered_rows,
)
from geodrake.control.regressor import ControlModel, Plain, calc_plain_momentum
from geodrake.control.systems.safeguards import (
    Safeguards,
    Watch,
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
_ESTIMATE, _MEMORY, _SEEN, _RESIDUAL, _ERROR, _COUNT = range(6)  # discrete states


class _Compiled(NamedTuple):
    """Arguments of `calc_estimated`."""

    robot: Plain
    watch: Watch
    filtered: tuple[float, float, bool]  # `FilteredRegressor.how`
    projecting: Projecting


@dataclass
class _Remembered:
    """Samples that are seen again."""

    regressors: Array  # (slots, nv, p) filtered regressors
    efforts: Array  # (slots, nv) their efforts
    kept: int = 0  # how many have been put there
    count: int = 0  # number of samples when the last one was

    def turn(self, number: int, kept: int) -> Rows:
        """Return one of the first `kept` samples, turn by turn; no rows if there are none."""
        kept = min(kept, self.kept, _SLOTS)
        slot = slice(0) if kept == 0 else slice(number % kept, number % kept + 1)
        size = self.regressors.shape[2]
        return self.regressors[slot].reshape(-1, size), self.efforts[slot].reshape(-1)

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
            memory: For how long samples are seen again, s; zero for never. A change of the robot
                shows at once, and is settled after this time.
            stale_time: How long the state may stand still, s.
            update_every: New samples from one projection to the next. The filter takes all of
                them; samples much closer than its bandwidth say nearly the same.
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
        self._watch = Watch(nv, float(time_step), float(stale_time))
        self._state_port = self.DeclareVectorInputPort("estimated_state", BasicVector(2 * nv))
        self._effort_port = self.DeclareVectorInputPort("effort", BasicVector(nv))
        watch, zero = self._watch.start(), np.zeros(nv)
        for value in (start, filtered.start(), watch, zero, np.array([np.inf]), np.zeros(1)):
            self.DeclareDiscreteState(value)
        self._compiled: _Compiled | None = None
        robot, projecting = getattr(control, "plain", None), update.compiled
        if robot is not None and projecting is not None:
            self._compiled = _Compiled(robot, self._watch, filtered.how, projecting)
        # (Not discrete state, all of which Drake copies at every update.)
        samples = _Remembered(np.zeros((_SLOTS, *filtered.shape)), np.zeros((_SLOTS, nv)))
        self._samples = self.DeclareAbstractState(AbstractValue.Make(samples))
        if memory > 0:
            # Half a step after an update, where rounding of times makes no difference.
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
        # (What is not written stays as it is.)
        x, effort = self._state_port.Eval(context), self._effort_port.Eval(context)
        p, memory, watched, residual, error, counted = map(state.get_mutable_value, range(6))
        number, left = divmod(int(counted[0]), self._every)
        samples: _Remembered = context.get_abstract_state(self._samples).get_value()
        earlier = samples.turn(number, number // self._spacing)
        update, following, found = self._sample_update, p, error[0]
        if self._compiled is not None and not left:
            following, states = np.empty(len(p)), (watched, memory, p, residual)
            new, found, inside = calc_estimated(
                self._compiled, (x, effort), states, earlier, following
            )
            if new and not (inside or update.manifold.calc_contains(following)):
                following, found = p, np.inf
        else:
            with np.errstate(all="ignore"):
                if new := self._filtered(x, effort, watched, memory):
                    Y, known = self._filter.rows(memory)
                    residual[:] = known - Y @ p
                if new and not left:
                    since = self._time_step * self._every
                    following, found, _ = update.updated(p.copy(), Y, known, since, earlier=earlier)
        if new:
            p[:], error[0] = following, found
            counted[0] += 1.0

    def _filtered(self, x: Array, effort: Array, watched: Array, memory: Array) -> bool:
        """Pass a sample through watch and filter, step by step; return whether it is a new one."""
        measured, new = self._watch.measure(watched, x)
        if not (measured and is_usable(effort)):
            memory[0] = 0.0
            return False
        q, qd = x[: self._nv], x[self._nv :]
        memory[:] = self._filter.advanced(memory, q, qd, effort, repeated=not new)
        return new

    def _remember(self, context: Context, state: State) -> None:
        """Put the last sample into memory, if there is a new one."""
        samples: _Remembered = state.get_mutable_abstract_state(self._samples).get_mutable_value()
        count = int(context.get_discrete_state(_COUNT).value()[0])
        rows = self._filter.rows(context.get_discrete_state(_MEMORY).value())
        if count > samples.count and all(np.isfinite(part).all() for part in rows):
            samples.put(rows, count)


@compiled
def calc_estimated(
    how: _Compiled,
    sample: tuple[Array, Array],
    states: tuple[Array, Array, Array, Array],
    earlier: Rows,
    following: Array,
) -> tuple[bool, float, bool]:
    """Update everything with one sample of a plain robot.

    Args:
        sample: (2 nv,) positions and velocities, and (nv,) efforts.
        states: Memories of watch and filter, (n,) estimate, and (nv,) residual; all but the
            estimate become those after the sample.
        earlier: Rows of an earlier sample, or none.
        following: (n,) where the estimate goes.

    Returns:
        Whether the sample is a new one, the error of `calc_projected`, and whether the estimate is
        clearly inside of the manifold; nothing but memories is written if it is no new one.
    """
    (period, share, held), (x, effort), nv = how.filtered, sample, how.watch.size
    watched, memory, p, residual = states
    measured, new = calc_measured(x, how.watch, watched)
    both = np.zeros((2, nv, len(p)))
    if measured:
        calc_plain_momentum(how.robot, x[:nv], x[nv:], both)
    told = period, share, held, not new
    if not (measured and calc_filtered(both, effort, told, memory)):
        memory[0] = 0.0
        return False, np.inf, False
    if new:
        Y, known = filtered_rows(memory, nv, len(p))
        residual[:] = known - np.dot(Y, p)
        error, _ = calc_projected(p, (Y, known), earlier, how.projecting, following)
        return True, error, calc_clearly_inside(following, how.projecting[1])
    return False, np.inf, False
