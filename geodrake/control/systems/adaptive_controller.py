"""Base class of the adaptive controllers: ports, state, and handling of missing inputs."""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    BasicVector,
    Context,
    ContinuousState,
    DependencyTicket,
    DiscreteValues,
    LeafSystem,
    ValueProducer,
)

from geodrake.boundary.arguments import instance, number, positive
from geodrake.compiling import compiled
from geodrake.control.adaptation import UpdateLaw
from geodrake.control.adaptation.outer_laws import limited
from geodrake.control.regressor import ControlModel, ControlSample
from geodrake.control.systems.prediction_error import Prediction, PredictionError
from geodrake.control.systems.safeguards import (
    SUSPECT,
    InputMonitor,
    Observation,
    Safeguards,
    calc_applied,
    checked_estimate,
    is_usable,
    require_single_joints,
)
from geodrake.errors import ArgumentError, GeodrakeError
from geodrake.inertia import Array
from geodrake.inertia.bodies import check_context

_PARAMETERS, _ACTUATION, _MONITOR, _HISTORY = 0, 1, 2, 3
_GAINS, GAMMA = 0, 1  # numeric parameters
_BRAKING = 0.5  # fraction of the effort limits available for braking, besides gravity etc.
_QUIETLY = np.errstate(all="ignore")  # non-finite values are detected and replaced


class ControlResult(NamedTuple):
    """A controller's output for one sample."""

    effort: Array  # (nv,) effort to apply
    sample: ControlSample  # regressor that the effort is computed from
    # Returns the covector b (p,) for the update law, or None; None while adaptation is paused. Only
    # this function may read ports that are not part of the observation.
    covector: Callable[[Context], Array | None] | None
    limited: bool = False  # whether efforts exceeded their limits


class AdaptiveController(LeafSystem):
    """Base of the adaptive controllers.

    With a time step, actuation and estimate are discrete states, sampled from the inputs at every
    step and held. Without one, the estimate is a continuous state and actuation is a direct
    function of the inputs.

    Actuation is always finite, and the estimate stays in its manifold, if the law has one (in
    continuous time up to integration error):

    - A measured state is invalid if it is not finite, if it is constant for the safeguards'
      `stale_time` although its velocities are nonzero, or if it contradicts the previous ones
      because of outliers, encoder steps or sudden noise (the latter two with a time step only, see
      `InputMonitor`). It is replaced by the desired state, which yields feedforward control by the
      model. Adaptation pauses, also if a state only repeats the previous one.
    - A desired motion that is not finite is replaced by rest at the last desired position (without
      a time step: at the measured one). Adaptation pauses.
    - If both are invalid, or on overflow, the last actuation is held (without a time step: it is
      zero).
    - If efforts exceed their limits, joints far from the desired motion return only as fast as half
      of their limits can brake them, given the model's masses. Remaining excess is clipped.
      Adaptation pauses.
    - A contradiction or saturated effort may be the beginning of a fault, if neither has occurred
      for a quarter of a second. The estimate is then reset to that of a quarter to half a second
      before, and adaptation pauses until neither has occurred for the safeguards' `settling_time`
      (with a time step only).

    With V = V_t + γ D(p‖p̂), the law with covector b keeps V̇ ≤ 0, [Lee2019] Proposition 5.7. So does
    the projection onto limits of plausible parameters (`outer_laws.limited`; none if the law is a
    `ProjectedLaw`), Eq. (5.4.57) and (5.4.59), as long as the truth is within them (Propositions
    5.8 and 5.9). While adaptation is paused, D(p‖p̂) is constant or reset to an earlier value, and V
    may rise through V_t. Leakage may raise V near the truth, see `AdaptationLaw`. Errors that no
    parameters explain, such as weakened actuators, also change the estimate, within the limits.

    Adaptation by prediction error continues at and after saturation, and in the dead zone, as
    efforts are known there. Its filter, whose memory is a discrete state, omits missing data on
    both sides, including measured efforts that are not finite.

    `lyapunov` is the largest float if it is not finite, as for an unphysical estimate.

    Gains and γ are numeric parameters of the Context (`set_gains`, `set_gamma`). Controllers can be
    cloned, and converted to AutoDiffXd. As their kernels use floats, derivatives are central
    differences, accurate to about 1e-9 if no limit is reached.
    """

    _converter: Any = None

    def __init__(
        self,
        control: ControlModel,
        law: UpdateLaw | None,
        *,
        time_step: float,
        parameters: ArrayLike | None,
        truth: ArrayLike | None,
        safeguards: Safeguards | None,
        prediction: PredictionError | None,
        gains: Array,
    ) -> None:
        """Declare the ports, state and parameters of all adaptive controllers."""
        LeafSystem.__init__(self, converter=self._converter)
        require_single_joints(control)
        safeguards = Safeguards() if safeguards is None else safeguards
        instance(safeguards, "safeguards", Safeguards)
        self.control, self.law = control, law
        self._nv = nv = len(control.joints)
        self._size = len(control.prior)
        self._time_step = number(time_step, "time_step", lower=0.0)
        self._prediction: Prediction | None = None
        if prediction is not None:
            instance(prediction, "prediction", PredictionError)
            self._prediction = Prediction(prediction, control, time_step)
        self._indirect = prediction is not None and prediction.alone
        if law is not None:
            instance(law, "law", UpdateLaw)
        self.DeclareNumericParameter(BasicVector(gains))
        self.DeclareNumericParameter(BasicVector([1.0 if law is None else law.slowness]))
        start = checked_estimate(control, law, parameters)
        if law is not None and safeguards.factor < np.inf:
            self.law = limited(law, [control.prior, start], safeguards.factor)
        self._cached_law = self.law
        self._truth = None if truth is None else checked_estimate(control, law, truth)
        self._limits = safeguards.limits(nv)
        self._dead_zone = safeguards.dead_zones(nv)
        self._monitor = InputMonitor(nv)
        if time_step > 0:
            guards = safeguards.stale_time, safeguards.drift, safeguards.settling_time
            self._monitor = InputMonitor(nv, *map(float, (time_step, *guards)))
        self._state_port = self.DeclareVectorInputPort("estimated_state", BasicVector(2 * nv))
        self._desired_port = self.DeclareVectorInputPort("desired_state", BasicVector(2 * nv))
        self._acceleration_port = self.DeclareVectorInputPort(
            "desired_acceleration", BasicVector(nv)
        )
        inputs = self._state_port, self._desired_port, self._acceleration_port
        self._inputs = {port.ticket() for port in inputs}
        declare = self._declare_discrete if time_step > 0 else self._declare_continuous
        estimate = declare(start)
        if self._truth is not None:
            tickets = {*self._inputs, estimate, self.all_parameters_ticket()}
            self.DeclareVectorOutputPort("lyapunov", BasicVector(1), self._calc_lyapunov, tickets)
        if self._prediction is not None:
            self._memory = self.DeclareDiscreteState(self._prediction.start())
            if self._prediction.measured:
                self._effort_port = self.DeclareVectorInputPort("effort", BasicVector(nv))

    def _declare_discrete(self, start: Array) -> DependencyTicket:
        parameters, actuation, *_ = (
            self.DeclareDiscreteState(value)
            for value in (start, np.zeros(self._nv), self._monitor.start(), _initial_history(start))
        )
        self.DeclarePeriodicDiscreteUpdateEvent(self._time_step, 0.0, self._update)
        self.DeclareStateOutputPort("actuation", actuation)
        self.DeclareStateOutputPort("parameters", parameters)
        return self.discrete_state_ticket(parameters)

    def _declare_continuous(self, start: Array) -> DependencyTicket:
        parameters = self.DeclareContinuousState(BasicVector(start))
        producer = ValueProducer(
            allocate=lambda: AbstractValue.Make(object()), calc=self._calc_result
        )
        tickets = {*self._inputs, self.xc_ticket(), self.all_parameters_ticket()}
        self._result = self.DeclareCacheEntry("result", producer, tickets)
        self.DeclareVectorOutputPort(
            "actuation", BasicVector(self._nv), self._calc_actuation, {self._result.ticket()}
        )
        self.DeclareStateOutputPort("parameters", parameters)
        return self.xc_ticket()

    @abc.abstractmethod
    def _result_at(self, p: Array, observed: Observation, gains: Array) -> ControlResult:
        """Return the result before effort limits."""

    @abc.abstractmethod
    def _tracking_energy(self, truth: Array, observed: Observation, gains: Array) -> float:
        """Return the tracking part V_t of the Lyapunov function."""

    def _in_dead_zone(self, observed: Observation, gains: Array) -> bool:
        """Return whether r = q̇ − q̇_d + Λ (q − q_d) is within the dead zone."""
        if not self._dead_zone.all():
            return False
        r = observed.qd - observed.v_d + gains[: self._nv] * (observed.q - observed.q_d)
        return bool((np.abs(r) < self._dead_zone).all())

    @property
    def time_step(self) -> float:
        """Period of control and adaptation, s; zero for continuous time."""
        return self._time_step

    def parameters(self, context: Context) -> Array:
        """Return the estimate (p,) in a Context."""
        if self._time_step > 0:
            return np.array(context.get_discrete_state(_PARAMETERS).value())
        return np.array(context.get_continuous_state_vector().CopyToVector())

    def set_parameters(self, context: Context, parameters: ArrayLike | None) -> None:
        """Put an estimate (p,), or `ControlModel.prior` if None, into a Context."""
        check_context(self, context)
        p = checked_estimate(self.control, self.law, parameters)
        if self._time_step > 0:
            context.SetDiscreteState(_PARAMETERS, p)
            context.SetDiscreteState(_HISTORY, _initial_history(p))
        else:
            context.SetContinuousState(p)

    def set_gamma(self, context: Context, gamma: float) -> None:
        """Change γ > 0 of the law in a Context; the adaptation rate is proportional to 1/γ."""
        positive(gamma, "gamma")
        if self.law is None:
            raise ArgumentError("The controller does not adapt, so it has no γ.")
        check_context(self, context)
        self.law.with_slowness(gamma)
        context.get_mutable_numeric_parameter(GAMMA).SetFromVector([gamma])

    def _set_gains(self, context: Context, gains: Array) -> None:
        check_context(self, context)
        context.get_mutable_numeric_parameter(_GAINS).SetFromVector(gains)

    def _gains(self, context: Context) -> Array:
        """Return the gains (n,) in a Context."""
        return context.get_numeric_parameter(_GAINS).value()

    def _law_in(self, context: Context) -> UpdateLaw | None:
        """Return the law with the γ of a Context."""
        gamma = float(context.get_numeric_parameter(GAMMA).value()[0])
        law = self.law
        if law is None or law.slowness == gamma:
            return law
        if self._cached_law is None or self._cached_law.slowness != gamma:
            self._cached_law = law.with_slowness(gamma)  # may be expensive to construct
        return self._cached_law

    def _observe(self, context: Context, memory: Array) -> tuple[Observation, Array]:
        return self._monitor.observe(memory, *self._inputs_in(context))

    def _inputs_in(self, context: Context) -> tuple[Array, Array, Array]:
        """Return the measured and the desired state, and the desired acceleration."""
        return (
            self._state_port.Eval(context),
            self._desired_port.Eval(context),
            self._acceleration_port.Eval(context),
        )

    def _take_fast_step(self, context: Context, state: DiscreteValues) -> bool:
        """Take a compiled time step; return False, without changes, if that is not possible."""
        return False

    def _controlled(self, p: Array, observed: Observation, gains: Array) -> ControlResult | None:
        """Return the result within limits; None if the effort is not finite."""
        if not observed.known:
            return None
        try:
            result, applied = self._result_at(p, observed, gains), np.empty(self._nv)
            finite, limited = calc_applied(result.effort, self._limits, applied)
            if limited:
                masses = np.diagonal(result.sample.mass_matrix(self.control.prior))
                observed = observed.within_reach(
                    gains[: self._nv], _BRAKING * self._limits / masses
                )
                result = self._result_at(p, observed, gains)
                finite, _ = calc_applied(result.effort, self._limits, applied)
        except (GeodrakeError, np.linalg.LinAlgError):
            return None
        if not finite:
            return None
        is_paused = (
            self.law is None
            or not (observed.trusted and observed.settled)
            or self._indirect
            or limited
            or self._in_dead_zone(observed, gains)
        )
        covector = None if is_paused else result.covector
        return ControlResult(applied, result.sample, covector, limited)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        if not self._take_fast_step(context, state):
            self._step(context, state)

    @_QUIETLY
    def _step(self, context: Context, state: DiscreteValues) -> None:
        p, actuation, monitor, history = map(state.get_mutable_value, range(4))
        observed, memory = self._observe(context, monitor)
        result = self._controlled(p, observed, self._gains(context))
        is_faulty = memory[-2] == 0.0  # a contradiction
        if result is not None:
            actuation[:] = result.effort
            is_faulty = is_faulty or (result.limited and not self._indirect)
        is_new_fault = is_faulty and self._monitor.interrupt(memory)
        monitor[:] = memory
        if (law := self._law_in(context)) is not None:
            next_p = self._next_estimate(context, state, law, observed, result)
            if is_new_fault:
                next_p = history[: len(p)].copy()
                history[:] = _initial_history(next_p)
            elif observed.trusted:
                update_history(history, next_p, self._time_step)
            p[:] = next_p

    def _next_estimate(
        self,
        context: Context,
        state: DiscreteValues,
        law: UpdateLaw,
        observed: Observation,
        result: ControlResult | None,
    ) -> Array:
        """Return the estimate (p,) after a time step; unchanged on failure."""
        p = context.get_discrete_state(_PARAMETERS).value()
        memory = np.zeros(0)
        if (prediction := self._prediction) is not None:
            memory = self._filtered(context, prediction, observed, result)
            state.set_value(self._memory, memory)
        try:
            b = _covector(context, result, len(p))
            if prediction is not None and observed.trusted and result is not None:
                b = b + prediction.covector(law, p, memory)
            has_step = is_usable(b) and b.any()
            next_p = law.calc_step(p, b, self._time_step) if has_step else p
        except (GeodrakeError, np.linalg.LinAlgError):
            return p
        return next_p if is_usable(next_p) else p

    def _filtered(
        self,
        context: Context,
        prediction: Prediction,
        observed: Observation,
        result: ControlResult | None,
    ) -> Array:
        """Return the memory of the filter after a sample."""
        memory = context.get_discrete_state(self._memory).value()
        if not (observed.trusted or observed.repeated) or result is None:
            return prediction.skipped(memory)
        # Saturated efforts are known as well, so prediction continues.
        applied = context.get_discrete_state(_ACTUATION).value()
        effort = self._effort_port.Eval(context) if prediction.measured else applied
        p = context.get_discrete_state(_PARAMETERS).value()
        return prediction.advanced(memory, p, observed, effort, result.sample)

    @_QUIETLY
    def _calc_result(self, context: Context, value: AbstractValue) -> None:
        observed, _ = self._observe(context, self._monitor.start())
        p = context.get_continuous_state_vector().CopyToVector()
        value.set_value(self._controlled(p, observed, self._gains(context)))

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Write the rates (p,) of the estimate by the update law, per second."""
        if self._time_step > 0:  # no continuous state
            return
        p = context.get_continuous_state_vector().CopyToVector()
        derivatives.get_mutable_vector().SetFromVector(self._rate_of(p, context))

    @_QUIETLY
    def _rate_of(self, p: Array, context: Context) -> Array:
        """Return the rate of an estimate (p,); zero on failure."""
        result, law = self._result.Eval(context), self._law_in(context)
        if law is None:
            return np.zeros(len(p))
        try:
            b = _covector(context, result, len(p))
            rate = law.calc_rate(p, b) if is_usable(b) else np.zeros(len(p))
        except (GeodrakeError, np.linalg.LinAlgError):
            return np.zeros(len(p))
        return rate if np.isfinite(rate).all() else np.zeros(len(p))

    def _calc_actuation(self, context: Context, output: BasicVector) -> None:
        result = self._result.Eval(context)
        output.SetFromVector(np.zeros(self._nv) if result is None else result.effort)

    @_QUIETLY
    def _calc_lyapunov(self, context: Context, output: BasicVector) -> None:
        if self._truth is None:
            return
        p, truth, value = self.parameters(context), self._truth, 0.0
        law = self._law_in(context)
        if law is not None:
            value += float(law.calc_parameter_error(truth, p))
        observed, _ = self._observe(context, self._monitor.start())
        if observed.trusted:
            value += self._tracking_energy(truth, observed, self._gains(context))
        output.SetFromVector([value if np.isfinite(value) else np.finfo(float).max])


def _covector(context: Context, result: ControlResult | None, size: int) -> Array:
    """Return the covector (size,) of the tracking error; zero while adaptation is paused."""
    covector = None if result is None or result.covector is None else result.covector(context)
    return np.zeros(size) if covector is None else covector


def _initial_history(p: Array) -> Array:
    """Return the history (2 p + 1,) of a constant estimate; see `update_history`."""
    return np.concatenate([p, p, [0.0]])


@compiled
def update_history(history: Array, p: Array, seconds: float) -> None:
    """Advance the history by a time step: two earlier estimates, and the age of the later one."""
    n = len(p)
    history[2 * n] += seconds
    if history[2 * n] >= SUSPECT:
        history[:n], history[n : 2 * n], history[2 * n] = history[n : 2 * n].copy(), p, 0.0
