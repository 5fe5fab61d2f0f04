"""Model files: their texts, simplified before Drake parses them, and what those do not hold."""

from geodrake.robot.files.description import ModelDescription, read_description
from geodrake.robot.files.given import Given

__all__ = ["Given", "ModelDescription", "read_description"]
