"""Drake systems: thin LeafSystems over geodrake's functions, one a file."""

from __future__ import annotations

from geodrake.control.systems.adaptive_computed_torque_controller import (
    AdaptiveComputedTorqueController,
)
from geodrake.control.systems.adaptive_controller import AdaptiveController
from geodrake.control.systems.bregman_projection_estimator import BregmanProjectionEstimator
from geodrake.control.systems.log_source import LogSource
from geodrake.control.systems.model_residual import ModelResidual
from geodrake.control.systems.passivity_based_adaptive_controller import (
    FixedGains,
    PassivityBasedAdaptiveController,
    VaryingGains,
)
from geodrake.control.systems.position_servo import PositionServo
from geodrake.control.systems.prediction_error import PredictionError
from geodrake.control.systems.safeguards import Safeguards
from geodrake.model.simulation.effect_force import EffectForce
from geodrake.model.simulation.robot_in_diagram import DelayedEffort

__all__ = [
    "AdaptiveComputedTorqueController",
    "AdaptiveController",
    "BregmanProjectionEstimator",
    "DelayedEffort",
    "EffectForce",
    "FixedGains",
    "LogSource",
    "ModelResidual",
    "PassivityBasedAdaptiveController",
    "PositionServo",
    "PredictionError",
    "Safeguards",
    "VaryingGains",
]
