"""Computed-torque control with an adaptive model."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, InputPort

from geodrake.boundary.arguments import one_or_each
from geodrake.control.adaptation import UpdateLaw
from geodrake.control.regressor import ControlModel, checked_control
from geodrake.control.systems.adaptive_controller import AdaptiveController, ControlResult
from geodrake.control.systems.prediction_error import PredictionError
from geodrake.control.systems.safeguards import Observation, Safeguards
from geodrake.inertia import Array
from geodrake.model.simulation.scalar_system import differenced


@differenced
class AdaptiveComputedTorqueController(AdaptiveController):
    """Tracks a motion by computed torque and adapts the model ([Lee2019] §5.2.1.1).

    .. pydrake_system::

        name: AdaptiveComputedTorqueController
        input_ports:
        - estimated_state
        - desired_state
        - desired_acceleration
        - acceleration
        - effort
        output_ports:
        - actuation
        - parameters
        - lyapunov

    With e = (q − q_d, q̇ − q̇_d) and Aᵀ P + P A = −𝟙 for the error dynamics A,

        actuation = M̂ (q̈_d − K_v ė − K_p e) + b̂(q, q̇)               [Lee2019] Eq. (5.2.4)

    There are three kinds of adaptation:

    - By the measured `acceleration` (nv), rad/s² or m/s²: b = Y(q, q̇, q̈)ᵀ M̂⁻¹ Bᵀ P e, Eq. (5.2.9),
      and `lyapunov` is ½ eᵀ P e + γ D(p‖p̂).
    - With a `PredictionError`, also by that error; its weight refers to a tracking error
      M̂⁻¹ Bᵀ P e.
    - With one that is `alone`, by the filtered regressor, which needs no acceleration: b is the
      gradient of the prediction error, Y_fᵀ W (Y_f p̂ − u_f). `lyapunov` is γ D(p‖p̂), which never
      rises, independently of tracking. Adaptation continues at effort limits and in the dead zone.
      A memory of a second improves tracking several times during adaptation.

    M̂ is invertible if the estimate is physical, which the natural law guarantees.

    The port `acceleration` exists unless prediction is alone, `effort` only if prediction uses
    measured efforts, and `lyapunov` only if the true p is given.

    See `AdaptiveController` for missing inputs. A measured acceleration that is not finite only
    pauses adaptation.
    """

    def __init__(
        self,
        control: ControlModel,
        law: UpdateLaw | None,
        *,
        rate: ArrayLike = 10.0,
        time_step: float = 1e-3,
        parameters: ArrayLike | None = None,
        truth: ArrayLike | None = None,
        safeguards: Safeguards | None = None,
        prediction: PredictionError | None = None,
    ) -> None:
        """Construct the system.

        Args:
            rate: λ of both poles of each joint's error, 1/s: K_v = 2 λ and K_p = λ². See
                `PassivityBasedAdaptiveController` for the other arguments.
        """
        nv = len(checked_control(control).joints)
        poles = one_or_each(rate, "rates", nv, strict=True)
        super().__init__(
            control,
            law,
            time_step=time_step,
            parameters=parameters,
            truth=truth,
            safeguards=safeguards,
            prediction=prediction,
            gains=poles,
        )
        self._measured_port: InputPort | None = None
        if prediction is None or not prediction.alone:
            self._measured_port = self.DeclareVectorInputPort("acceleration", BasicVector(nv))

    def set_gains(self, context: Context, rate: ArrayLike) -> None:
        """Change the gains in a Context."""
        self._set_gains(context, one_or_each(rate, "rates", self._nv, strict=True))

    def _result_at(self, p: Array, observed: Observation, gains: Array) -> ControlResult:
        e, ed = observed.q - observed.q_d, observed.qd - observed.v_d
        acceleration = observed.a_d - 2.0 * gains * ed - gains**2 * e
        sample = self.control.at(observed.q, observed.qd, observed.qd, acceleration)
        _, P_12, P_22 = _weights(gains)
        error = P_12 * e + P_22 * ed  # Bᵀ P (e, ė)
        return ControlResult(
            sample.effort(p), sample, lambda context: self._covector(context, p, observed, error)
        )

    def _covector(
        self, context: Context, p: Array, observed: Observation, error: Array
    ) -> Array | None:
        if self._measured_port is None:
            return None  # adaptation by prediction error only
        acceleration = self._measured_port.Eval(context)
        if not np.isfinite(acceleration).all():
            return None
        sample = self.control.at(observed.q, observed.qd, observed.qd, acceleration)
        return np.asarray(np.linalg.solve(sample.mass_matrix(p), error) @ sample.regressor)

    def _tracking_energy(self, truth: Array, observed: Observation, gains: Array) -> float:
        if self._measured_port is None:
            return 0.0
        e, ed = observed.q - observed.q_d, observed.qd - observed.v_d
        P_11, P_12, P_22 = _weights(gains)
        return float(0.5 * np.sum(P_11 * e**2 + 2.0 * P_12 * e * ed + P_22 * ed**2))


def _weights(poles: Array) -> tuple[Array, Array, Array]:
    """Return P₁₁, P₁₂ and P₂₂ of each joint, (nv,), with Aᵀ P + P A = −𝟙, [Lee2019] Eq. (5.2.8)."""
    P_12 = 0.5 / poles**2
    P_22 = (1.0 + 2.0 * P_12) / (4.0 * poles)
    return 2.0 * poles * P_12 + poles**2 * P_22, P_12, P_22
