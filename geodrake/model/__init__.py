"""`RobotModel`: a robot, its effects, their parameters, and what is known about them."""

from geodrake.effects import FittedEffect
from geodrake.model.export import export_model, save_export
from geodrake.model.robot_model import RobotModel, load_description
from geodrake.model.saved_model import load_model, save_model
from geodrake.model.source import cpp_source, python_source

__all__ = [
    "FittedEffect",
    "RobotModel",
    "cpp_source",
    "export_model",
    "load_description",
    "load_model",
    "python_source",
    "save_export",
    "save_model",
]
