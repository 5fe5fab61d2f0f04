"""Identify a robot model from logs: inertias close to their prior, effects from the data."""

from geodrake.identification.models.identify import identify_model
from geodrake.identification.models.results import (
    BodyChange,
    IdentificationSettings,
    ModelIdentification,
)

__all__ = [
    "BodyChange",
    "IdentificationSettings",
    "ModelIdentification",
    "identify_model",
]
