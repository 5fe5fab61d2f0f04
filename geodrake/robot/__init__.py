"""A robot as its model file says: plant, tree, regressors, base parameters, transmissions."""

from geodrake.robot.base_parameters import BaseParameters, base_parameters, pushforward_metric
from geodrake.robot.floating_base import base_wrench_regressor, body_poses, zero_moment_point
from geodrake.robot.joints import joint_names
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.plant import load_plant, position_limits, velocity_limits
from geodrake.robot.regressor import inverse_dynamics, inverse_dynamics_regressor
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
    "body_poses",
    "gears",
    "inverse_dynamics",
    "inverse_dynamics_regressor",
    "joint_names",
    "load_plant",
    "position_limits",
    "pushforward_metric",
    "rolling_joint",
    "take_out_stated",
    "velocity_limits",
    "zero_moment_point",
]
