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
)

__all__ = [
    "AdaptiveComputedTorqueController",
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
