"""geodrake: find out from measurements what a robot's model is missing, and add it."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geodrake.model import load_model, save_model

__all__ = ["load_model", "save_model"]

_PACKAGES = (
    "inertia",
    "manifolds",
    "logs",
    "robot",
    "effects",
    "model",
    "identification",
    "diagnosis",
    "fleet",
    "excitation",
    "control",
    "report",
)


def __getattr__(name: str) -> Any:
    """Import packages, and Drake with them, on first use, so that `geodrake --help` is fast."""
    if name in __all__:
        return getattr(import_module("geodrake.model"), name)
    if name in _PACKAGES:
        return import_module(f"geodrake.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
