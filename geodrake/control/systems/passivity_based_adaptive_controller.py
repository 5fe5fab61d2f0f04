"""The adaptive controller of Slotine and Li."""

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
from geodrake.control.regressor import ControlModel, Plain, calc_plain_regressor, checked_control
from geodrake.control.systems.adaptive_controller import (
    GAMMA,
    AdaptiveController,
    ControlResult,
    remember,
)
from geodrake.control.systems.prediction_error import PredictionError
from geodrake.control.systems.safeguards import (
    Safeguards,
    Seen,
    Watch,
    calc_applied,
    calc_looked,
    is_usable,
)
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.model.simulation.scalar_system import differenced


class _Usual(NamedTuple):
    """Constants of the usual steps of a plain robot."""

    robot: Plain
    watch: Watch
    most: Array  # (nv,) limits of efforts
    varies: bool  # whether gains vary with the estimate
    measured: bool  # whether friction is of the measured velocity
    period: float  # s
    steps: Steps


@dataclass(frozen=True, eq=False)
class FixedGains(Short):
    """Constant diagonal gains K and Λ.

    Sampled at a time step h, damping is stable for K h well below 2 M only, with M the inertia that
    a joint moves.

    Attributes:
        damping: K, N·m·s/rad or N·s/m; one for all joints or (nv,).
        rate: Λ, 1/s; one for all joints or (nv,).
    """

    damping: ArrayLike
    rate: ArrayLike

    def __post_init__(self) -> None:
        for name in ("damping", "rate"):
            values = real_array(getattr(self, name), name)
            one_or_each(values, name, values.size, strict=True)


@dataclass(frozen=True)
class VaryingGains:
    """K = λ M̂(q) and Λ = λ 𝟙, [Lee2019] Remark 5.1: stiffer where there is more inertia.

    Attributes:
        rate: λ, 1/s; one for all joints, as K must be symmetric.
    """

    rate: float = 10.0

    def __post_init__(self) -> None:
        positive(self.rate, "rate")


@differenced
class PassivityBasedAdaptiveController(AdaptiveController):
    """Tracks a motion and adapts the model, by the passivity of robots ([Lee2019] §5.2.1.2).

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

    With v = q̇_d − Λ (q − q_d), a = v̇ and r = q̇ − v, for gains that are fixed or vary with M̂,

        actuation = Y(q, q̇, v, a) p̂ − K r          [Lee2019] Eq. (5.2.10), b = Yᵀ r
        actuation = Y(q, q̇, v, a − λ r) p̂          [Lee2019] Remark 5.1, b = Y(…, a − λ r)ᵀ r

    and the law moves p̂ by b, to which a `PredictionError` adds. `lyapunov` is
    ½ rᵀ M r + γ D(p‖p̂) for the true p, which never rises except by what a time step adds, if
    friction grows with speed or effects see the measured velocity, and no effect is in proportion
    to the load. It leaves out the first term while an input is missing. Without the true p there is
    no such port, and no `effort` unless prediction has measured efforts.

    `actuation` (nv) is N·m or N in the order of velocities, `parameters` (p) that of ControlModel,
    states are q and then q̇. What happens when inputs are missing is said in `AdaptiveController`.
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
            law: How the estimate moves; None for a controller that does not adapt.
            time_step: Period of control and adaptation, s; zero for continuous time.
            parameters: (p,) first estimate; that of the model if None.
            truth: (p,) true parameters, for the port `lyapunov`.
            safeguards: Those of `Safeguards()` if None, which has no limits of effort.
            prediction: Adaptation by the error of prediction; needs a time step.

        Raises:
            ArgumentError: The robot has joints of several degrees of freedom, or an argument does
                not fit.
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
    def _usual(self) -> _Usual | None:
        """Arguments of `calc_usual_step`; None where it does not apply."""
        robot, law = getattr(self.control, "plain", None), self.law
        steps = None if law is None else law.compiled
        if robot is None or steps is None or self._prediction is not None or self._dead_zone.any():
            return None
        kinds = self._varying, self.control.measured_friction
        return _Usual(robot, self._watch, self._limits, *kinds, self._watch.period, steps)

    def _step_as_usual(self, context: Context, state: DiscreteValues) -> bool:
        if self._usual is None:
            return False
        gains, gamma = self._gains(context), context.get_numeric_parameter(GAMMA).value()[0]
        p, actuation, watch, before = map(state.get_mutable_value, range(4))
        states, inputs = (p, actuation, watch, before), self._inputs_in(context)
        return calc_usual_step(self._usual, inputs, (gains, gamma), states)

    def _error(self, seen: Seen, rate: Array) -> tuple[Array, Array, Array]:
        """Return v, a and r, each (nv,)."""
        v = seen.v_d - rate * (seen.q - seen.q_d)
        return v, seen.a_d - rate * (seen.qd - seen.v_d), seen.qd - v

    def _result_at(self, p: Array, seen: Seen, gains: Array) -> ControlResult:
        rate, damping = gains[: self._nv], gains[self._nv :]
        v, a, r = self._error(seen, rate)
        if self._varying:
            sample = self.control.at(seen.q, seen.qd, v, a - rate * r)
            effort = sample.effort(p)
        else:
            sample = self.control.at(seen.q, seen.qd, v, a)
            effort = sample.effort(p) - damping * r
        return ControlResult(effort, sample, lambda _: sample.covector(r))

    def _tracking_energy(self, truth: Array, seen: Seen, gains: Array) -> float:
        r = self._error(seen, gains[: self._nv])[2]
        sample = self.control.at(seen.q, seen.qd, seen.qd, np.zeros(self._nv))
        return float(0.5 * r @ sample.mass_matrix(truth) @ r)  # [Lee2019] Eq. (5.2.14)


def _gain_vector(gains: VaryingGains | FixedGains, nv: int) -> Array:
    """Return rates Λ and, where gains are fixed, damping K: (nv,) or (2 nv,)."""
    instance(gains, "gains", (VaryingGains, FixedGains))
    rate = one_or_each(gains.rate, "rates", nv, strict=True)
    if isinstance(gains, VaryingGains):
        return rate
    damping = one_or_each(gains.damping, "damping gains", nv, strict=True)
    return np.concatenate([rate, damping])


@compiled
def calc_usual_step(
    how: _Usual,
    inputs: tuple[Array, Array, Array],
    gains: tuple[Array, float],
    states: tuple[Array, Array, Array, Array],
) -> bool:
    """Take a time step of a plain robot as a whole; return False, with nothing done, if unusual.

    Usual is that all inputs are trusted, no effort is beyond its limits and no estimate beyond
    its own.

    Args:
        inputs: Measured and desired states (2 nv,), and desired accelerations (nv,).
        gains: Those of `_gain_vector`, and γ.
        states: Estimate, actuation, and memories of watch and earlier estimates.
    """
    p, actuation, watch, before = states
    n, memory = len(actuation), watch.copy()
    motion, Y = np.empty((5, n)), np.zeros((n, len(p)))
    trusted, _, _, settled = calc_looked(inputs, how.watch, memory, motion)
    if not (trusted and settled) or memory[-2] == 0.0:
        return False
    q, qd, (q_d, v_d, a_d) = motion[0].copy(), motion[1].copy(), motion[2:]
    rate, damping = gains[0][:n], gains[0][n:]
    v = v_d - rate * (q - q_d)
    a, r = a_d - rate * (qd - v_d), qd - v
    if how.varies:
        a -= rate * r
    calc_plain_regressor(how.robot, (q, qd, v, a), qd if how.measured else v, Y)
    effort, applied, b, following = np.dot(Y, p), np.empty(n), np.dot(r, Y), np.empty(len(p))
    if not how.varies:
        effort -= damping * r
    finite, beyond = calc_applied(effort, how.most, applied)
    if beyond or not (finite and is_usable(b)):
        return False
    if not calc_limited_step(p, b, how.steps, how.period / gains[1], following):
        return False
    if not is_usable(following):
        return False
    actuation[:], watch[:], p[:] = applied, memory, following
    remember(before, following, how.period)
    return True
