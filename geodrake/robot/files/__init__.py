"""Model files: texts simplified for Drake's parser, and the elements that are left out."""

from geodrake.robot.files.description import ModelDescription, read_description
from geodrake.robot.files.load_options import Given

__all__ = ["Given", "ModelDescription", "read_description"]
