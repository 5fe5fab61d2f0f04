"""Adaptation by the model's prediction error, in addition to the tracking error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import instance, number, one_or_each, positive, real_array
from geodrake.boundary.showing import Short
from geodrake.control.adaptation import UpdateLaw
from geodrake.control.online_estimation import FilteredRegressor
from geodrake.control.regressor import ControlModel, ControlSample
from geodrake.control.systems.safeguards import Observation
from geodrake.errors import ArgumentError
from geodrake.inertia import Array

_ROUNDING = 1e-9  # relative to a matrix's diagonal, above rounding errors of its eigenvalues


@dataclass(frozen=True, eq=False)
class PredictionError(Short):
    """Composite adaptation: prediction and tracking error both drive the estimate.

    With filtered rows Y_f p = u_f, which need no acceleration, the covector of the law is

        b + Y_fᵀ W (Y_f p̂ − u_f)             (J.-J. Slotine, W. Li, Automatica 25(4), 1989)

    This subtracts (p̂ − p)ᵀ Y_fᵀ W Y_f (p̂ − p) ≥ 0 from the rate of V = V_t + γ D(p‖p̂). The estimate
    thus continues to improve when tracking is good, but only in directions that the motion excites.
    [Lee2019] Remark 3.14 and §5.5.2 recommend it against the drift of direct adaptation.

    A single sample excites few of the parameters, and following it alone undoes earlier progress.
    With a memory τ, the covector includes

        S p̂ − c,   Ṡ = λ Y_fᵀ W Y_f − S / τ,   ċ = λ Y_fᵀ W u_f − c / τ,

    with the filter's bandwidth λ (G. Kreisselmeier, IEEE Transactions on Automatic Control 22(1),
    1977), and the rate of V another −(p̂ − p)ᵀ S (p̂ − p) for all recent excitation. The memory also
    accumulates efforts that were not applied, as by weakened actuators. Use measured efforts if
    this may occur.

    Attributes:
        weight: W ≥ 0 in (rad/s)/(N·m) or (m/s)/N, scalar or (nv,): the velocity error with the same
            influence as an effort error of 1 N·m.
        bandwidth: Bandwidth of the filter, 1/s.
        tolerance: Error of filtered efforts that is ignored, N·m or N, scalar or (nv,); the size of
            noise and model error. It keeps noise from changing the estimate, as the dead zone of
            `Safeguards` does for the tracking error.
        measured: Whether efforts come from the port `effort`, as from torque sensors or motor
            currents. Otherwise they are the controller's, and nothing else may act on the robot.
        alone: Whether the tracking error does not drive the estimate: indirect adaptation.
        memory: Time constant τ of the memory, s; zero for none. It takes p² numbers for p
            parameters, and a step costs as much as p rows.
    """

    weight: ArrayLike = 0.1
    bandwidth: float = 20.0
    tolerance: ArrayLike = 0.0
    measured: bool = False
    alone: bool = False
    memory: float = 0.0

    def __post_init__(self) -> None:
        for name in ("weight", "tolerance"):
            values = real_array(getattr(self, name), name)
            one_or_each(values, name, values.size)
        positive(self.bandwidth, "bandwidth")
        instance(self.measured, "measured", bool)
        instance(self.alone, "alone", bool)
        number(self.memory, "memory", lower=0.0)


class Prediction:
    """`PredictionError` of one controller, for a robot and a time step, s."""

    def __init__(self, error: PredictionError, control: ControlModel, time_step: float) -> None:
        if time_step == 0:
            raise ArgumentError(
                "The filtered regressor needs a time step.",
                advice="Pass one to the controller, or adapt with the tracking error only.",
            )
        nv = len(control.joints)
        self.filtered = FilteredRegressor(control, time_step, error.bandwidth, held_effort=True)
        self.weight = one_or_each(error.weight, "weight", nv)
        self.tolerance = one_or_each(error.tolerance, "tolerance", nv)
        self.measured, self.alone, self.memory = error.measured, error.alone, error.memory

    def start(self) -> Array:
        """Return the memory before the first sample: the filter's, then S and c (p, p + 1)."""
        p = self.filtered.shape[1] if self.memory > 0 else 0
        return np.concatenate([self.filtered.start(), np.zeros(p * (p + 1))])

    def skipped(self, memory: Array) -> Array:
        """Return the memory after a missing sample."""
        size = self.filtered.size
        return np.concatenate([self.filtered.skipped(memory[:size]), memory[size:]])

    def advanced(
        self, memory: Array, p: Array, observed: Observation, effort: Array, sample: ControlSample
    ) -> Array:
        """Return the memory after a sample of efforts (nv,), at an estimate (p,)."""
        size = self.filtered.size
        state, repeated = (observed.q, observed.qd), observed.repeated
        filtered = self.filtered.advanced(
            memory[:size], *state, effort, sample=sample, repeated=repeated
        )
        sums = memory[size:]
        if sums.size and not repeated:
            Y, error = self._error(p, filtered)
            rows = np.column_stack([Y, Y @ p - error])
            gain = -np.expm1(-self.filtered.bandwidth * self.filtered.period)
            sums = np.exp(-self.filtered.period / self.memory) * sums
            sums += gain * ((self.weight * Y.T) @ rows).ravel()
        return np.concatenate([filtered, sums])

    def _error(self, p: Array, memory: Array) -> tuple[Array, Array]:
        """Return Y_f (nv, p), and the error Y_f p̂ − u_f (nv,) beyond the tolerance."""
        Y, effort = self.filtered.rows(memory)
        error = Y @ p - effort
        return Y, error - np.clip(error, -self.tolerance, self.tolerance)

    def covector(self, law: UpdateLaw, p: Array, memory: Array) -> Array:
        """Return Y_fᵀ W (Y_f p̂ − u_f) + S p̂ − c (p,), scaled so that no step overshoots."""
        size = self.filtered.size
        Y, error = self._error(p, memory[:size])
        b, rows = (self.weight * error) @ Y, np.sqrt(self.weight)[:, None] * Y
        if len(memory) > size:
            S, c = np.split(memory[size:].reshape(len(p), -1), [len(p)], axis=1)
            b += S @ p - c.ravel()
            regularization = _ROUNDING * np.diagonal(S) + np.finfo(float).tiny
            L = np.linalg.cholesky(S + np.diag(regularization))  # S may be singular
            rows = np.concatenate([rows, L.T])
        return np.asarray(b / (1.0 + self.filtered.period * law.calc_reach(p, rows)))
