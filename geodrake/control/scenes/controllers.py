"""Adaptive controllers that scenarios name."""

from __future__ import annotations

import numpy as np

from geodrake.control.adaptation import (
    UpdateLaw,
    euclidean_adaptation,
    natural_adaptation,
    parameter_manifold,
    pullback_adaptation,
)
from geodrake.control.regressor import ControlModel
from geodrake.control.scenes.scenario import ComputedTorqueControl, PassivityControl
from geodrake.control.systems import (
    AdaptiveComputedTorqueController,
    AdaptiveController,
    FixedGains,
    PassivityBasedAdaptiveController,
    PredictionError,
    Safeguards,
    VaryingGains,
)
from geodrake.inertia import Array, perturb
from geodrake.model.robot_model import RobotModel


def controller_of(
    spec: PassivityControl | ComputedTorqueControl, model: RobotModel, rng: np.random.Generator
) -> AdaptiveController:
    """The controller that a scenario describes.

    Raises:
        ArgumentError: A number is out of its range.
    """
    control = ControlModel.of(model)
    start = first_estimate(spec, control, rng)
    law = _law(spec, model, start)
    told, prediction = spec.prediction, None
    if told is not None:
        prediction = PredictionError(told.weight, told.bandwidth, alone=told.alone)
    safeguards = Safeguards(model.effort_limits) if spec.effort_limits else Safeguards()
    if isinstance(spec, PassivityControl):
        damping = spec.damping[0] if len(spec.damping) == 1 else spec.damping
        gains = FixedGains(damping, spec.rate) if spec.damping else VaryingGains(spec.rate)
        return PassivityBasedAdaptiveController(
            control,
            law,
            gains=gains,
            prediction=prediction,
            time_step=spec.time_step,
            parameters=start,
            safeguards=safeguards,
        )
    return AdaptiveComputedTorqueController(
        control,
        law,
        rate=spec.rate,
        prediction=prediction,
        time_step=spec.time_step,
        parameters=start,
        safeguards=safeguards,
    )


def first_estimate(
    spec: PassivityControl | ComputedTorqueControl,
    control: ControlModel,
    rng: np.random.Generator,
) -> Array:
    """(p,) what the controller believes at first: the model's parameters, changed as told."""
    start = spec.factor * control.prior
    if spec.mass_uncertainty:
        phi = control.phi(start)
        drawn = perturb(phi, 1, rng=rng, mass_uncertainty=spec.mass_uncertainty)
        start[: control.num_inertial] = drawn.phi[0].ravel()
    return start


def _law(
    spec: PassivityControl | ComputedTorqueControl, model: RobotModel, start: Array
) -> UpdateLaw | None:
    if spec.law == "none":
        return None
    if spec.law == "euclidean":
        return euclidean_adaptation(len(start), spec.gamma)
    manifold = parameter_manifold(model)
    if spec.law == "pullback":
        return pullback_adaptation(manifold, start, spec.gamma)
    return natural_adaptation(manifold, spec.gamma)
