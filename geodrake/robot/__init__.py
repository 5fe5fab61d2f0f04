"""A robot from its model file: plant, tree, regressors, base parameters, transmissions."""

from geodrake.robot.base_parameters import BaseParameters, base_parameters
from geodrake.robot.joints import joint_names
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.regressor import (
    base_wrench_regressor,
    inverse_dynamics,
    inverse_dynamics_regressor,
    zero_moment_point,
)
from geodrake.robot.robot_instance import RobotInstance, RobotPorts, take_out_stated
from geodrake.robot.transmission import (
    InSequence,
    LinearTransmission,
    SideBySide,
    Transmission,
    gears,
    rolling_joint,
)

__all__ = [
    "BaseParameters",
    "InSequence",
    "KinematicTree",
    "LinearTransmission",
    "RobotInstance",
    "RobotPorts",
    "SideBySide",
    "Transmission",
    "base_parameters",
    "base_wrench_regressor",
    "gears",
    "inverse_dynamics",
    "inverse_dynamics_regressor",
    "joint_names",
    "rolling_joint",
    "take_out_stated",
    "zero_moment_point",
]
