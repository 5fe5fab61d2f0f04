"""geodrake: what a robot's model is missing, found in its measurements, and then fixed."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geodrake.saved_model import load_model, save_model

__all__ = ["load_model", "save_model"]

_MODULES = (
    "adaptation",
    "base_parameters",
    "body_distances",
    "control_regressor",
    "diagnosis",
    "drafting",
    "effects",
    "ellipsoids",
    "excitation",
    "export",
    "floating_base",
    "identification",
    "inertia",
    "loops",
    "manifolds",
    "model_identification",
    "perturbation",
    "positive_definite",
    "projections",
    "regressor",
    "rollout",
    "systems",
    "transmission",
)


def __getattr__(name: str) -> Any:
    """Import Drake when something is first asked for, so that `geodrake --help` is quick."""
    if name in __all__:
        return getattr(import_module("geodrake.saved_model"), name)
    if name in _MODULES:
        return import_module(f"geodrake.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
