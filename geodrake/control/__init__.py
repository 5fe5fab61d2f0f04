"""Models in the loop: adaptation laws, online estimation, LeafSystems, closed loops, rollouts."""

from geodrake.control.adaptation import (
    PartialLaw,
    ProjectedLaw,
    adapted_parameters,
    euclidean_adaptation,
    natural_adaptation,
    parameter_manifold,
    pullback_adaptation,
)
from geodrake.control.loops import AdaptiveLoop, add_adaptive_loop
from geodrake.control.online_estimation import FilteredRegressor, SampleUpdate
from geodrake.control.regressor import ControlModel
from geodrake.control.rollout import Rollout, RolloutFit, fit_rollouts, roll_out
from geodrake.control.systems import (
    AdaptiveComputedTorqueController,
    BregmanProjectionEstimator,
    DelayedEffort,
    EffectForce,
    FixedGains,
    LogSource,
    ModelResidual,
    PassivityBasedAdaptiveController,
    PositionServo,
    PredictionError,
    VaryingGains,
    add_tracking_drives,
)

__all__ = [
    "AdaptiveComputedTorqueController",
    "AdaptiveLoop",
    "BregmanProjectionEstimator",
    "ControlModel",
    "DelayedEffort",
    "EffectForce",
    "FilteredRegressor",
    "FixedGains",
    "LogSource",
    "ModelResidual",
    "PartialLaw",
    "PassivityBasedAdaptiveController",
    "PositionServo",
    "PredictionError",
    "ProjectedLaw",
    "Rollout",
    "RolloutFit",
    "SampleUpdate",
    "VaryingGains",
    "adapted_parameters",
    "add_adaptive_loop",
    "add_tracking_drives",
    "euclidean_adaptation",
    "fit_rollouts",
    "natural_adaptation",
    "parameter_manifold",
    "pullback_adaptation",
    "roll_out",
]
