"""Base of the adaptive controllers: ports, state, and what happens when something is missing."""

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
    Safeguards,
    Seen,
    Watch,
    calc_applied,
    checked_estimate,
    is_usable,
    require_single_joints,
)
from geodrake.errors import ArgumentError, GeodrakeError
from geodrake.inertia import Array
from geodrake.inertia.bodies import check_context

_PARAMETERS, _ACTUATION, _WATCH, _BEFORE = 0, 1, 2, 3
_GAINS, GAMMA = 0, 1  # numeric parameters
_BRAKING = 0.5  # of the limits of efforts, what is left for braking beside gravity and the like
_QUIETLY = np.errstate(all="ignore")  # what is not finite is looked for and replaced


class ControlResult(NamedTuple):
    """Output of a controller at one sample."""

    effort: Array  # (nv,) effort to be applied
    sample: ControlSample  # the robot as the effort has it
    # Gives the covector b (p,) for the update law, or None; None where adaptation waits. Only this
    # may read other ports than those of what was seen.
    covector: Callable[[Context], Array | None] | None
    limited: bool = False  # whether efforts would have been beyond their limits


class AdaptiveController(LeafSystem):
    """Base of the adaptive controllers.

    With a time step, actuation and estimate are discrete states: sampled at every step from the
    inputs, and held. Without one, the estimate is a continuous state and actuation follows the
    inputs at once.

    Actuation is always finite, and the estimate stays in its manifold (where the law has one; in
    continuous time as far as the integrator is exact):

    - A measured state that is not finite, that stands still for the safeguards' `stale_time` while
      it says that the robot moves, or that contradicts the last ones, as outliers, steps of an
      encoder and sudden noise do (both with a time step only, see `Watch`), is replaced by the
      desired one: feedforward of the model. Adaptation waits, also where a state only repeats the
      last one.
    - A desired motion that is not finite is replaced by rest at the last desired position (without
      a time step: at the measured one). Adaptation waits.
    - Without any of both, and where numbers overflow, the last actuation is held (without a time
      step: none is applied).
    - Where efforts would be beyond their limits, joints that are far from the desired motion come
      back only as fast as half of their limits can brake them, by the masses of the model. What is
      still too much is cut off. Adaptation waits.
    - A contradiction, or efforts at their limits, in a loop that has gone on without either for a
      quarter of a second may be the beginning of a fault. The estimate is what it was a quarter to
      half a second before, and adaptation waits until there has been neither for the safeguards'
      `settling_time` (with a time step only).

    With V = V_t + γ D(p‖p̂), the law of the covector b keeps V̇ ≤ 0, [Lee2019] Proposition 5.7. So
    does the projection onto limits of plausible parameters (`outer_laws.limited`; none if the law
    is a `ProjectedLaw`), Eq. (5.4.57) and (5.4.59), as long as the truth is within them
    (Propositions 5.8 and 5.9). Where adaptation waits, D(p‖p̂) stays or becomes what it was, and V
    may rise by what the actual state makes of V_t. Leakage may raise V near the truth, see
    `AdaptationLaw`. Errors that no parameters explain, as of actuators that have lost their
    strength, move the estimate as well, within the limits.

    Adaptation by the error of prediction goes on at limits and after them, and in the dead zone, as
    efforts are known there. Of its filter, whose memory is a discrete state, whatever is missing is
    left out on both sides, a measured effort that is not finite too.

    `lyapunov` is the largest float where it is not finite, as where the estimate is not physical.

    Gains and γ are numeric parameters of the Context (`set_gains`, `set_gamma`). Controllers can be
    cloned, and converted to AutoDiffXd: their kernels are of floats, so that derivatives are by
    central differences, exact to some 1e-9 where no limit is reached.
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
        """Declare what all adaptive controllers have; their gains are numeric parameters."""
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
        # Whether the tracking error does not move the estimate.
        self._alone = prediction is not None and prediction.alone
        if law is not None:
            instance(law, "law", UpdateLaw)
        self.DeclareNumericParameter(BasicVector(gains))
        self.DeclareNumericParameter(BasicVector([1.0 if law is None else law.slowness]))
        start = checked_estimate(control, law, parameters)
        if law is not None and safeguards.factor < np.inf:
            self.law = limited(law, [control.prior, start], safeguards.factor)
        self._law_then = self.law
        self._truth = None if truth is None else checked_estimate(control, law, truth)
        self._limits = safeguards.limits(nv)
        self._dead_zone = safeguards.dead_zones(nv)
        self._watch = Watch(nv)
        if time_step > 0:
            guards = safeguards.stale_time, safeguards.drift, safeguards.settling_time
            self._watch = Watch(nv, *map(float, (time_step, *guards)))
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
            known = {*self._inputs, estimate, self.all_parameters_ticket()}
            self.DeclareVectorOutputPort("lyapunov", BasicVector(1), self._calc_lyapunov, known)
        if self._prediction is not None:
            self._memory = self.DeclareDiscreteState(self._prediction.start())
            if self._prediction.measured:
                self._effort_port = self.DeclareVectorInputPort("effort", BasicVector(nv))

    def _declare_discrete(self, start: Array) -> DependencyTicket:
        parameters, actuation, *_ = (
            self.DeclareDiscreteState(value)
            for value in (start, np.zeros(self._nv), self._watch.start(), _before(start))
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
        # Both actuation and derivatives need it.
        known = {*self._inputs, self.xc_ticket(), self.all_parameters_ticket()}
        self._result = self.DeclareCacheEntry("result", producer, known)
        self.DeclareVectorOutputPort(
            "actuation", BasicVector(self._nv), self._calc_actuation, {self._result.ticket()}
        )
        self.DeclareStateOutputPort("parameters", parameters)
        return self.xc_ticket()

    @abc.abstractmethod
    def _result_at(self, p: Array, seen: Seen, gains: Array) -> ControlResult:
        """Return the result without regard to limits."""

    @abc.abstractmethod
    def _tracking_energy(self, truth: Array, seen: Seen, gains: Array) -> float:
        """Return V_t."""

    def _resting(self, seen: Seen, gains: Array) -> bool:
        """Return whether r = q̇ − q̇_d + Λ (q − q_d) is within the dead zone."""
        if not self._dead_zone.all():
            return False
        r = seen.qd - seen.v_d + gains[: self._nv] * (seen.q - seen.q_d)
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
            context.SetDiscreteState(_BEFORE, _before(p))
        else:
            context.SetContinuousState(p)

    def set_gamma(self, context: Context, gamma: float) -> None:
        """Change γ > 0 of the law in a Context: adaptation is as fast as γ⁻¹."""
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
        if self._law_then is None or self._law_then.slowness != gamma:
            self._law_then = law.with_slowness(gamma)  # kept, as it may have much to prepare
        return self._law_then

    def _look(self, context: Context, memory: Array) -> tuple[Seen, Array]:
        return self._watch.look(memory, *self._inputs_in(context))

    def _inputs_in(self, context: Context) -> tuple[Array, Array, Array]:
        """Return the measured and the desired state, and the desired acceleration."""
        return (
            self._state_port.Eval(context),
            self._desired_port.Eval(context),
            self._acceleration_port.Eval(context),
        )

    def _step_as_usual(self, context: Context, state: DiscreteValues) -> bool:
        """Take a time step in one compiled loop; return False, with nothing done, if it cannot."""
        return False

    def _controlled(self, p: Array, seen: Seen, gains: Array) -> ControlResult | None:
        """Return the result at what was seen; None if the effort is not a number."""
        if not seen.known:
            return None
        try:
            result, applied = self._result_at(p, seen, gains), np.empty(self._nv)
            finite, limited = calc_applied(result.effort, self._limits, applied)
            if limited:
                masses = np.diagonal(result.sample.mass_matrix(self.control.prior))
                seen = seen.within_reach(gains[: self._nv], _BRAKING * self._limits / masses)
                result = self._result_at(p, seen, gains)
                finite, _ = calc_applied(result.effort, self._limits, applied)
        except (GeodrakeError, np.linalg.LinAlgError):
            return None
        if not finite:
            return None
        waits = (
            self.law is None
            or not (seen.trusted and seen.settled)
            or self._alone
            or limited
            or self._resting(seen, gains)
        )
        return ControlResult(applied, result.sample, None if waits else result.covector, limited)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        if not self._step_as_usual(context, state):
            self._step(context, state)

    @_QUIETLY
    def _step(self, context: Context, state: DiscreteValues) -> None:
        # (What is not written stays as it is.)
        p, actuation, watch, before = map(state.get_mutable_value, range(4))
        seen, memory = self._look(context, watch)
        result = self._controlled(p, seen, self._gains(context))
        stopped = memory[-2] == 0.0  # by a contradiction
        if result is not None:
            actuation[:] = result.effort
            stopped = stopped or (result.limited and not self._alone)
        surprised = stopped and self._watch.interrupt(memory)
        watch[:] = memory
        if (law := self._law_in(context)) is not None:
            following = self._following(context, state, law, seen, result)
            if surprised:
                following = before[: len(p)].copy()
                before[:] = _before(following)
            elif seen.trusted:
                remember(before, following, self._time_step)
            p[:] = following

    def _following(
        self,
        context: Context,
        state: DiscreteValues,
        law: UpdateLaw,
        seen: Seen,
        result: ControlResult | None,
    ) -> Array:
        """Return the estimate (p,) after a time step; unchanged where it cannot move."""
        p = context.get_discrete_state(_PARAMETERS).value()
        memory = np.zeros(0)
        if (prediction := self._prediction) is not None:
            memory = self._filtered(context, prediction, seen, result)
            state.set_value(self._memory, memory)
        try:
            b = _covector(context, result, len(p))
            if prediction is not None and seen.trusted and result is not None:
                b = b + prediction.covector(law, p, memory)
            moves = is_usable(b) and b.any()
            following = law.calc_step(p, b, self._time_step) if moves else p
        except (GeodrakeError, np.linalg.LinAlgError):
            return p
        return following if is_usable(following) else p

    def _filtered(
        self, context: Context, prediction: Prediction, seen: Seen, result: ControlResult | None
    ) -> Array:
        """Return the memory of the filter after a sample."""
        memory = context.get_discrete_state(self._memory).value()
        if not (seen.trusted or seen.repeated) or result is None:
            return prediction.skipped(memory)
        # (Efforts at their limits are known as well, so prediction need not wait for them.)
        held = context.get_discrete_state(_ACTUATION).value()
        effort = self._effort_port.Eval(context) if prediction.measured else held
        p = context.get_discrete_state(_PARAMETERS).value()
        return prediction.advanced(memory, p, seen, effort, result.sample)

    @_QUIETLY
    def _calc_result(self, context: Context, value: AbstractValue) -> None:
        seen, _ = self._look(context, self._watch.start())
        p = context.get_continuous_state_vector().CopyToVector()
        value.set_value(self._controlled(p, seen, self._gains(context)))

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Rates (p,) of the estimate by the update law, per second; see `LeafSystem`."""
        if self._time_step > 0:  # no continuous state
            return
        p = context.get_continuous_state_vector().CopyToVector()
        derivatives.get_mutable_vector().SetFromVector(self._rate_of(p, context))

    @_QUIETLY
    def _rate_of(self, p: Array, context: Context) -> Array:
        """Return the rate of an estimate (p,); zero where it cannot be moved."""
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
        seen, _ = self._look(context, self._watch.start())
        if seen.trusted:
            value += self._tracking_energy(truth, seen, self._gains(context))
        output.SetFromVector([value if np.isfinite(value) else np.finfo(float).max])


def _covector(context: Context, result: ControlResult | None, size: int) -> Array:
    """Return what the tracking error is to the estimate (size,); zero where adaptation waits."""
    covector = None if result is None or result.covector is None else result.covector(context)
    return np.zeros(size) if covector is None else covector


def _before(p: Array) -> Array:
    """Return what is remembered of earlier estimates, (2 p + 1,): two, and the age of the later."""
    return np.concatenate([p, p, [0.0]])


@compiled
def remember(before: Array, p: Array, seconds: float) -> None:
    """Bring what is remembered of earlier estimates up to date after some more seconds."""
    n = len(p)
    before[2 * n] += seconds
    if before[2 * n] >= SUSPECT:
        before[:n], before[n : 2 * n], before[2 * n] = before[n : 2 * n].copy(), p, 0.0
