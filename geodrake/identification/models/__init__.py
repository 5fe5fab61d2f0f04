"""Identify a robot model from logs: its inertias near their prior, its effects from the data."""

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
