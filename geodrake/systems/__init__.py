"""Drake systems: thin LeafSystems over geodrake's functions, one a file."""

from __future__ import annotations

from geodrake.systems.adaptive_computed_torque_controller import AdaptiveComputedTorqueController
from geodrake.systems.adaptive_controller import AdaptiveController
from geodrake.systems.bregman_projection_estimator import BregmanProjectionEstimator
from geodrake.systems.effect_force import EffectForce
from geodrake.systems.effort_delay import DelayedEffort
from geodrake.systems.log_source import LogSource
from geodrake.systems.model_residual import ModelResidual
from geodrake.systems.passivity_based_adaptive_controller import (
    FixedGains,
    PassivityBasedAdaptiveController,
    VaryingGains,
)
from geodrake.systems.safeguards import Safeguards
from geodrake.systems.tracking import add_tracking_drives

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
    "Safeguards",
    "VaryingGains",
    "add_tracking_drives",
]
