"""The passivity-based adaptive controller of Slotine and Li."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, DiscreteValues

from geodrake.boundary.arguments import instance, one_or_each, positive, real_array
from geodrake.boundary.showing import Short
from geodrake.compiling import compiled
from geodrake.control.adaptation import UpdateLaw
from geodrake.control.adaptation.law import Steps, calc_limited_step
from geodrake.control.regressor import (
    ControlModel,
    PlainRobot,
    calc_plain_regressor,
    checked_control,
)
from geodrake.control.systems.adaptive_controller import (
    GAMMA,
    AdaptiveController,
    ControlResult,
    update_history,
)
from geodrake.control.systems.prediction_error import PredictionError
from geodrake.control.systems.safeguards import (
    InputMonitor,
    Observation,
    Safeguards,
    calc_applied,
    calc_observed,
    is_usable,
)
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.model.simulation.scalar_system import differenced


class _FastStep(NamedTuple):
    """Constant arguments of `calc_fast_step`."""

    robot: PlainRobot
    monitor: InputMonitor
    limits: Array  # (nv,) effort limits
    has_varying_gains: bool
    measured_friction: bool
    period: float  # s
    steps: Steps


@dataclass(frozen=True, eq=False)
class FixedGains(Short):
    """Constant diagonal gains K and Λ.

    With a time step h, K h must be well below 2 M for stability, with M the inertia at the joint.

    Attributes:
        damping: K, N·m·s/rad or N·s/m; scalar or (nv,).
        rate: Λ, 1/s; scalar or (nv,).
    """

    damping: ArrayLike
    rate: ArrayLike

    def __post_init__(self) -> None:
        for name in ("damping", "rate"):
            values = real_array(getattr(self, name), name)
            one_or_each(values, name, values.size, strict=True)


@dataclass(frozen=True)
class VaryingGains:
    """Gains K = λ M̂(q) and Λ = λ 𝟙, proportional to inertia ([Lee2019] Remark 5.1).

    Attributes:
        rate: λ, 1/s; the same for all joints, as K must be symmetric.
    """

    rate: float = 10.0

    def __post_init__(self) -> None:
        positive(self.rate, "rate")


@differenced
class PassivityBasedAdaptiveController(AdaptiveController):
    """Tracks a motion and adapts the model, based on passivity ([Lee2019] §5.2.1.2).

    .. pydrake_system::

        name: PassivityBasedAdaptiveController
        input_ports:
        - estimated_state
        - desired_state
        - desired_acceleration
        - effort
        output_ports:
        - actuation
        - parameters
        - lyapunov

    With v = q̇_d − Λ (q − q_d), a = v̇ and r = q̇ − v, for fixed or varying gains,

        actuation = Y(q, q̇, v, a) p̂ − K r          [Lee2019] Eq. (5.2.10), b = Yᵀ r
        actuation = Y(q, q̇, v, a − λ r) p̂          [Lee2019] Remark 5.1, b = Y(…, a − λ r)ᵀ r

    and the law updates p̂ by b, to which a `PredictionError` adds. `lyapunov` is ½ rᵀ M r + γ D(p‖p̂)
    for the true p. Apart from discretization it never rises, if friction grows with speed or
    effects use the measured velocity, and no effect is proportional to the load. It omits the first
    term while an input is missing. The port exists only if the true p is given, and `effort` only
    if prediction uses measured efforts.

    `actuation` (nv) is N·m or N in the order of velocities, `parameters` (p) that of ControlModel,
    and states are q and q̇. See `AdaptiveController` for missing inputs.
    """

    def __init__(
        self,
        control: ControlModel,
        law: UpdateLaw | None,
        *,
        gains: VaryingGains | FixedGains = VaryingGains(),
        time_step: float = 1e-3,
        parameters: ArrayLike | None = None,
        truth: ArrayLike | None = None,
        safeguards: Safeguards | None = None,
        prediction: PredictionError | None = None,
    ) -> None:
        """Construct the system.

        Args:
            law: Update law of the estimate; None for a controller without adaptation.
            time_step: Period of control and adaptation, s; zero for continuous time.
            parameters: (p,) initial estimate; that of the model if None.
            truth: (p,) true parameters, for the port `lyapunov`.
            safeguards: `Safeguards()` if None, which has no effort limits.
            prediction: Adaptation by prediction error; needs a time step.

        Raises:
            ArgumentError: The robot has joints with several degrees of freedom, or an argument is
                invalid.
        """
        nv = len(checked_control(control).joints)
        self._varying = isinstance(gains, VaryingGains)
        super().__init__(
            control,
            law,
            time_step=time_step,
            parameters=parameters,
            truth=truth,
            safeguards=safeguards,
            prediction=prediction,
            gains=_gain_vector(gains, nv),
        )

    def set_gains(self, context: Context, gains: VaryingGains | FixedGains) -> None:
        """Change the gains in a Context."""
        vector = _gain_vector(gains, self._nv)
        if isinstance(gains, VaryingGains) != self._varying:
            raise ArgumentError(
                f"The controller has {'varying' if self._varying else 'fixed'} gains; got "
                f"{gains!r}.",
                advice="Pass gains of the same kind, or construct another controller.",
            )
        self._set_gains(context, vector)

    @cached_property
    def _fast_step(self) -> _FastStep | None:
        """Constant arguments of `calc_fast_step`; None if it does not apply."""
        robot, law = getattr(self.control, "plain", None), self.law
        steps = None if law is None else law.compiled
        if robot is None or steps is None or self._prediction is not None or self._dead_zone.any():
            return None
        flags = self._varying, self.control.measured_friction
        return _FastStep(robot, self._monitor, self._limits, *flags, self._monitor.period, steps)

    def _take_fast_step(self, context: Context, state: DiscreteValues) -> bool:
        if self._fast_step is None:
            return False
        gains, gamma = self._gains(context), context.get_numeric_parameter(GAMMA).value()[0]
        p, actuation, monitor, history = map(state.get_mutable_value, range(4))
        states, inputs = (p, actuation, monitor, history), self._inputs_in(context)
        return calc_fast_step(self._fast_step, inputs, (gains, gamma), states)

    def _error(self, observed: Observation, rate: Array) -> tuple[Array, Array, Array]:
        """Return v, a and r, each (nv,)."""
        v = observed.v_d - rate * (observed.q - observed.q_d)
        return v, observed.a_d - rate * (observed.qd - observed.v_d), observed.qd - v

    def _result_at(self, p: Array, observed: Observation, gains: Array) -> ControlResult:
        rate, damping = gains[: self._nv], gains[self._nv :]
        v, a, r = self._error(observed, rate)
        if self._varying:
            sample = self.control.at(observed.q, observed.qd, v, a - rate * r)
            effort = sample.effort(p)
        else:
            sample = self.control.at(observed.q, observed.qd, v, a)
            effort = sample.effort(p) - damping * r
        return ControlResult(effort, sample, lambda _: sample.covector(r))

    def _tracking_energy(self, truth: Array, observed: Observation, gains: Array) -> float:
        r = self._error(observed, gains[: self._nv])[2]
        sample = self.control.at(observed.q, observed.qd, observed.qd, np.zeros(self._nv))
        return float(0.5 * r @ sample.mass_matrix(truth) @ r)  # [Lee2019] Eq. (5.2.14)


def _gain_vector(gains: VaryingGains | FixedGains, nv: int) -> Array:
    """Return rates Λ, and damping K if gains are fixed: (nv,) or (2 nv,)."""
    instance(gains, "gains", (VaryingGains, FixedGains))
    rate = one_or_each(gains.rate, "rates", nv, strict=True)
    if isinstance(gains, VaryingGains):
        return rate
    damping = one_or_each(gains.damping, "damping gains", nv, strict=True)
    return np.concatenate([rate, damping])


@compiled
def calc_fast_step(
    constants: _FastStep,
    inputs: tuple[Array, Array, Array],
    gains: tuple[Array, float],
    states: tuple[Array, Array, Array, Array],
) -> bool:
    """Take a time step of a plain robot; return False, without changes, if it needs special care.

    That is the case if an input is not trusted, or an effort or the estimate reaches its limits.

    Args:
        inputs: Measured and desired states (2 nv,), and desired accelerations (nv,).
        gains: `_gain_vector`, and γ.
        states: Estimate, actuation, memory of the monitor, and history of estimates.
    """
    p, actuation, monitor, history = states
    n, memory = len(actuation), monitor.copy()
    motion, Y = np.empty((5, n)), np.zeros((n, len(p)))
    trusted, _, _, settled = calc_observed(inputs, constants.monitor, memory, motion)
    if not (trusted and settled) or memory[-2] == 0.0:
        return False
    q, qd, (q_d, v_d, a_d) = motion[0].copy(), motion[1].copy(), motion[2:]
    rate, damping = gains[0][:n], gains[0][n:]
    v = v_d - rate * (q - q_d)
    a, r = a_d - rate * (qd - v_d), qd - v
    if constants.has_varying_gains:
        a -= rate * r
    friction_v = qd if constants.measured_friction else v
    calc_plain_regressor(constants.robot, (q, qd, v, a), friction_v, Y)
    effort, applied, b, next_p = np.dot(Y, p), np.empty(n), np.dot(r, Y), np.empty(len(p))
    if not constants.has_varying_gains:
        effort -= damping * r
    finite, clipped = calc_applied(effort, constants.limits, applied)
    if clipped or not (finite and is_usable(b)):
        return False
    if not calc_limited_step(p, b, constants.steps, constants.period / gains[1], next_p):
        return False
    if not is_usable(next_p):
        return False
    actuation[:], monitor[:], p[:] = applied, memory, next_p
    update_history(history, next_p, constants.period)
    return True
