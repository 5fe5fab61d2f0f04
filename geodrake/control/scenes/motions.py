"""Motions that scenarios name, as trajectories."""

from __future__ import annotations

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from geodrake.boundary.arguments import positive, real_array
from geodrake.control.scenes.scenario import LogMotion, Waypoints
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.logs.files import read_log
from geodrake.model.robot_model import RobotModel


def motion_of(spec: Waypoints | LogMotion, model: RobotModel) -> PiecewisePolynomial:
    """A spline with continuous accelerations, at rest at both ends.

    Args:
        model: The robot, whose order of joints the (n) positions have.

    Raises:
        ArgumentError: A joint is none of the robot's, or numbers do not make a motion.
        LogError: The log cannot be read.
    """
    time, positions = _logged(spec, model) if isinstance(spec, LogMotion) else _told(spec, model)
    still = np.zeros((len(model.joints), 1))
    return PiecewisePolynomial.CubicWithContinuousSecondDerivatives(time, positions.T, still, still)


def _told(spec: Waypoints, model: RobotModel) -> tuple[Array, Array]:
    """Times (N,) and positions (N, n) of waypoints."""
    time = real_array(spec.times, "times", ("N",))
    if len(time) < 2 or not (np.diff(time) > 0).all():
        raise ArgumentError(f"Waypoints need two times or more, increasing; got {time.tolist()}.")
    if strange := [joint for joint in spec.positions if joint not in model.joints]:
        raise ArgumentError(
            f"The robot has no joint {strange[0]!r}.", advice=f"It has {', '.join(model.joints)}."
        )
    positions = np.empty((len(time), len(model.joints)))
    for k, joint in enumerate(model.joints):
        values = spec.positions.get(joint)
        if values is None:
            positions[:, k] = model.default_position(joint)
        else:
            positions[:, k] = real_array(values, f"positions of {joint}", (len(time),))
    return time, positions


def _logged(spec: LogMotion, model: RobotModel) -> tuple[Array, Array]:
    """Times from zero on and positions at the knots, of a log."""
    period = positive(spec.period, "period")
    log = read_log(spec.file, joints=model.joints)
    known = np.isfinite(log.position).all(1)
    time, position = log.time[known] - log.time[known][0], log.position[known]
    knots = np.linspace(0.0, time[-1], max(2, 1 + round(time[-1] / period)))
    columns = [np.interp(knots, time, column) for column in position.T]
    return knots, np.array(columns).T
