"""Models in the loop: adaptation laws, online estimation, LeafSystems, closed loops, rollouts."""

from geodrake.control.adaptation import (
    PartialLaw,
    euclidean_adaptation,
    natural_adaptation,
    parameter_manifold,
    pullback_adaptation,
)
from geodrake.control.loops import AdaptiveLoop, add_adaptive_loop
from geodrake.control.online_estimation import SampleUpdate
from geodrake.control.regressor import ControlModel
from geodrake.control.rollout import fit_rollouts, roll_out
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
    "AdaptiveLoop",
    "BregmanProjectionEstimator",
    "ControlModel",
    "DelayedEffort",
    "EffectForce",
    "FixedGains",
    "LogSource",
    "ModelResidual",
    "PartialLaw",
    "PassivityBasedAdaptiveController",
    "PositionServo",
    "PredictionError",
    "Safeguards",
    "SampleUpdate",
    "VaryingGains",
    "add_adaptive_loop",
    "euclidean_adaptation",
    "fit_rollouts",
    "natural_adaptation",
    "parameter_manifold",
    "pullback_adaptation",
    "roll_out",
]
