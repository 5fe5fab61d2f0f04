"""Adaptation by what the model predicts wrong, beside the tracking error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import instance, one_or_each, positive, real_array
from geodrake.boundary.showing import Short
from geodrake.control.adaptation import UpdateLaw
from geodrake.control.online_estimation import FilteredRegressor
from geodrake.control.regressor import ControlModel
from geodrake.control.systems.requirements import checked_time_step
from geodrake.errors import ArgumentError
from geodrake.inertia import Array


@dataclass(frozen=True, eq=False)
class PredictionError(Short):
    """What an adaptive controller adds to its tracking error: composite adaptation.

    With filtered rows Y_f p = u_f, which need no acceleration, the law moves the estimate by

        b + Y_fᵀ W (Y_f p̂ − u_f)             (J.-J. Slotine, W. Li, Automatica 25(4), 1989)

    which takes another (p̂ − p)ᵀ Y_fᵀ W Y_f (p̂ − p) ≥ 0 from the rate of V = V_t + γ D(p‖p̂): the
    estimate goes on where tracking is good already, but only along what the motion shows.
    [Lee2019] Remark 3.14 and §5.5.2 name it against the drift of direct adaptation.

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

    Raises:
        ArgumentError: A number is out of range.
    """

    weight: ArrayLike = 0.1
    bandwidth: float = 20.0
    tolerance: ArrayLike = 0.0
    measured: bool = False
    alone: bool = False

    def __post_init__(self) -> None:
        for name in ("weight", "tolerance"):
            values = real_array(getattr(self, name), name)
            if values.ndim > 1 or not (values >= 0).all():
                raise ArgumentError(f"{name} must be zero or more; got {values.tolist()}.")
        positive(self.bandwidth, "bandwidth")
        instance(self.measured, "measured", bool)
        instance(self.alone, "alone", bool)


@dataclass(frozen=True, eq=False)
class Prediction:
    """`PredictionError` of one controller.

    Attributes:
        filtered: The filter, whose memory is in the controller's Context.
        weight: (nv,) W.
        tolerance: (nv,) errors that are not believed.
        measured: Whether efforts come in by a port.
        alone: Whether the tracking error does not count.
    """

    filtered: FilteredRegressor
    weight: Array
    tolerance: Array
    measured: bool
    alone: bool

    @classmethod
    def of(cls, error: PredictionError, control: ControlModel, time_step: float) -> Prediction:
        """For a robot and a period of control.

        Args:
            error: What is asked for.
            control: The robot.
            time_step: Period of control, s.

        Raises:
            ArgumentError: There is no time step, or numbers are not as many as joints.
        """
        if checked_time_step(time_step) == 0:
            raise ArgumentError(
                "The filtered regressor needs a time step.",
                advice="Give the controller one, or adapt by the tracking error alone.",
            )
        nv = len(control.joints)
        return cls(
            FilteredRegressor(control, time_step, error.bandwidth, held_effort=True),
            one_or_each(error.weight, "weight", nv),
            one_or_each(error.tolerance, "tolerance", nv),
            error.measured,
            error.alone,
        )

    def covector(self, law: UpdateLaw, p: Array, memory: Array) -> Array:
        """Y_fᵀ W (Y_f p̂ − u_f) (p,), shortened so that no step of the law overshoots.

        Args:
            law: The law that takes it.
            p: (p,) estimate.
            memory: That of the filter.
        """
        Y, effort = self.filtered.rows(memory)
        error = Y @ p - effort
        error -= np.minimum(np.maximum(error, -self.tolerance), self.tolerance)
        # |error| falls by less than its size within a time step.
        reach = law.calc_reach(p, np.sqrt(self.weight)[:, None] * Y)
        return np.asarray((self.weight * error) @ Y / (1.0 + self.filtered.period * reach))
