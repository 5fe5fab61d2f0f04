"""Adaptation by what the model predicts wrong, beside the tracking error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import instance, number, one_or_each, positive, real_array
from geodrake.boundary.showing import Short
from geodrake.control.adaptation import UpdateLaw
from geodrake.control.online_estimation import FilteredRegressor
from geodrake.control.regressor import ControlModel, ControlSample
from geodrake.control.systems.safeguards import Seen
from geodrake.errors import ArgumentError
from geodrake.inertia import Array

_ROUNDING = 1e-9  # of the diagonal of a matrix, above what rounding makes of its eigenvalues


@dataclass(frozen=True, eq=False)
class PredictionError(Short):
    """Composite adaptation: a prediction error that is added to the tracking error.

    With filtered rows Y_f p = u_f, which need no acceleration, the law moves the estimate by

        b + Y_fᵀ W (Y_f p̂ − u_f)             (J.-J. Slotine, W. Li, Automatica 25(4), 1989)

    which takes another (p̂ − p)ᵀ Y_fᵀ W Y_f (p̂ − p) ≥ 0 from the rate of V = V_t + γ D(p‖p̂): the
    estimate goes on where tracking is good already, but only along what the motion shows.
    [Lee2019] Remark 3.14 and §5.5.2 name it against the drift of direct adaptation.

    What one moment shows is a few of many parameters, and to follow it alone undoes what was right
    before. With a memory τ, b has another

        S p̂ − c,   Ṡ = λ Y_fᵀ W Y_f − S / τ,   ċ = λ Y_fᵀ W u_f − c / τ,

    with the filter's bandwidth λ (G. Kreisselmeier, IEEE Transactions on Automatic Control 22(1),
    1977), and the rate of V another −(p̂ − p)ᵀ S (p̂ − p) for all that was shown of late. Efforts
    that were not the ones applied, as of actuators that have lost their strength, are remembered
    alike: where that may be, give measured ones.

    Attributes:
        weight: W ≥ 0 in (rad/s)/(N·m) or (m/s)/N, one for all joints or (nv,): the velocity error
            that moves the estimate as much as an error of one N·m does.
        bandwidth: Of the filter of both sides, 1/s.
        tolerance: Error of filtered efforts that is not believed, N·m or N, one or (nv,): what
            noise and what the model lacks make of it. It keeps noise from moving the estimate, as
            the dead zone of `Safeguards` does for the tracking error.
        measured: Whether efforts are those of the port `effort`, as of torque sensors or motor
            currents; else the controller's own, which must be all that moves the robot.
        alone: Whether the tracking error does not move the estimate: indirect adaptation.
        memory: τ, for how long rows are remembered, s; zero for those of the moment alone. A robot
            of p parameters has p² numbers to keep then, and a step costs as much as p rows.
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
    """`PredictionError` of one controller, of a robot and a period of control, s."""

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
        """Return the memory before the first sample: of the filter, and then S and c (p, p + 1)."""
        p = self.filtered.shape[1] if self.memory > 0 else 0
        return np.concatenate([self.filtered.start(), np.zeros(p * (p + 1))])

    def skipped(self, memory: Array) -> Array:
        """Return the memory after a sample that is missing."""
        size = self.filtered.size
        return np.concatenate([self.filtered.skipped(memory[:size]), memory[size:]])

    def advanced(
        self, memory: Array, p: Array, seen: Seen, effort: Array, sample: ControlSample
    ) -> Array:
        """Return the memory after a sample of efforts (nv,), at an estimate (p,)."""
        size = self.filtered.size
        now = self.filtered.advanced(
            memory[:size], seen.q, seen.qd, effort, sample=sample, repeated=seen.repeated
        )
        past = memory[size:]
        if past.size and not seen.repeated:
            Y, error = self._error(p, now)
            believed = np.column_stack([Y, Y @ p - error])
            share = -np.expm1(-self.filtered.bandwidth * self.filtered.period)
            past = np.exp(-self.filtered.period / self.memory) * past
            past += share * ((self.weight * Y.T) @ believed).ravel()
        return np.concatenate([now, past])

    def _error(self, p: Array, memory: Array) -> tuple[Array, Array]:
        """Return Y_f (nv, p), and what is believed of the error Y_f p̂ − u_f (nv,)."""
        Y, effort = self.filtered.rows(memory)
        error = Y @ p - effort
        return Y, error - np.clip(error, -self.tolerance, self.tolerance)

    def covector(self, law: UpdateLaw, p: Array, memory: Array) -> Array:
        """Return Y_fᵀ W (Y_f p̂ − u_f) + S p̂ − c (p,), so short that no step overshoots."""
        size = self.filtered.size
        Y, error = self._error(p, memory[:size])
        b, rows = (self.weight * error) @ Y, np.sqrt(self.weight)[:, None] * Y
        if len(memory) > size:
            S, c = np.split(memory[size:].reshape(len(p), -1), [len(p)], axis=1)
            b += S @ p - c.ravel()
            # S = L Lᵀ, and S may be singular.
            L = np.linalg.cholesky(S + np.diag(_ROUNDING * np.diagonal(S) + np.finfo(float).tiny))
            rows = np.concatenate([rows, L.T])
        # |error| falls by less than its size within a time step.
        return np.asarray(b / (1.0 + self.filtered.period * law.calc_reach(p, rows)))
