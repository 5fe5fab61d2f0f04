"""`RobotModel`: a robot with its effects and parameters."""

from geodrake.effects import FittedEffect
from geodrake.model.dynamics_check import check_dynamics
from geodrake.model.effort_signal import EffortSignal
from geodrake.model.export import save_export
from geodrake.model.holding import holding
from geodrake.model.logged_joints import model_of_logs
from geodrake.model.robot_model import RobotModel, load_description
from geodrake.model.saved_model import load_model, save_model
from geodrake.model.source import cpp_source, python_source
from geodrake.robot.files import Given

__all__ = [
    "EffortSignal",
    "FittedEffect",
    "Given",
    "RobotModel",
    "check_dynamics",
    "cpp_source",
    "holding",
    "load_description",
    "load_model",
    "model_of_logs",
    "python_source",
    "save_export",
    "save_model",
]
