"""Identify a robot model from logs: its inertias near their prior, its effects from the data."""

from geodrake.model_identification.identify import identify_model, with_effects
from geodrake.model_identification.results import (
    Alternative,
    BodyChange,
    IdentificationSettings,
    ModelIdentification,
)

__all__ = [
    "Alternative",
    "BodyChange",
    "IdentificationSettings",
    "ModelIdentification",
    "identify_model",
    "with_effects",
]
