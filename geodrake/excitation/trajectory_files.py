"""Motions as files: a log in CSV or NPZ, and trajectories of ROS and of Drake in YAML."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from pydrake.common.yaml import yaml_load
from pydrake.math import BsplineBasis
from pydrake.trajectories import BsplineTrajectory

from geodrake.boundary.arguments import file_path, instance
from geodrake.boundary.escaping import quoted
from geodrake.boundary.whole_files import Content, write_whole
from geodrake.errors import ArgumentError, OutputError
from geodrake.excitation.trajectory import ExcitationTrajectory
from geodrake.logs.files import log_content
from geodrake.model.robot_model import RobotModel

_LOGS = (".csv", ".txt", ".npz")
_YAML = (".yaml", ".yml")
_DRAKE = (".drake.yaml", ".drake.yml")


def write_trajectory(
    trajectory: ExcitationTrajectory, path: str | Path, model: RobotModel, *, rate: float = 100.0
) -> None:
    """Write a motion, whole or not at all.

    Args:
        path: Where to: `.csv` or `.npz` for a log with the predicted efforts, `.yaml` for a ROS
            trajectory_msgs/JointTrajectory, which `ros2 topic pub` takes, `.drake.yaml` for a
            Drake BsplineTrajectory, which `read_drake_trajectory` takes.

    Raises:
        OutputError: The suffix is another, or the file cannot be written.
        ArgumentError: The samples do not follow each other in time.
    """
    path = file_path(path)
    write_whole(path, trajectory_content(trajectory, path, model, rate=rate))


def trajectory_content(
    trajectory: ExcitationTrajectory, path: str | Path, model: RobotModel, *, rate: float = 100.0
) -> Content:
    """The content of the file; see `write_trajectory` for arguments and errors."""
    instance(trajectory, "trajectory", ExcitationTrajectory)
    instance(model, "model", RobotModel)
    path = file_path(path)
    suffix = path.suffix.lower()
    if suffix in _LOGS:
        return log_content(trajectory.log(model, rate=rate, name=path.stem), path)
    if path.name.lower().endswith(_DRAKE):
        return drake_trajectory(trajectory)
    if suffix in _YAML:
        return ros_joint_trajectory(trajectory, rate=rate)
    raise OutputError(
        f"A motion cannot be written to {str(path)!r}.",
        advice=f"Use {', '.join((*_LOGS, *_YAML, *_DRAKE))}.",
    )


def ros_joint_trajectory(trajectory: ExcitationTrajectory, *, rate: float = 100.0) -> str:
    """A motion as YAML of the message trajectory_msgs/JointTrajectory of ROS 2.

    Efforts are left empty, since position and velocity controllers refuse them.

    Raises:
        ArgumentError: The samples do not follow each other in time, or the rate is not positive.
    """
    times = instance(trajectory, "trajectory", ExcitationTrajectory).instants(rate)
    lines = [
        "header:",
        "  stamp: {sec: 0, nanosec: 0}",
        '  frame_id: ""',
        f"joint_names: [{', '.join(map(quoted, trajectory.joints))}]",
        "points:",
    ]
    for time, q, v, vd in zip(times.tolist(), *trajectory.states(times), strict=True):
        nanoseconds = round(time * 1e9)
        lines += [
            f"- positions: {_numbers(q)}",
            f"  velocities: {_numbers(v)}",
            f"  accelerations: {_numbers(vd)}",
            "  effort: []",
            f"  time_from_start: {{sec: {nanoseconds // 10**9}, nanosec: {nanoseconds % 10**9}}}",
        ]
    return "\n".join(lines) + "\n"


def drake_trajectory(trajectory: ExcitationTrajectory) -> str:
    """A motion's positions, in Drake's order, as YAML of a Drake BsplineTrajectory.

    The fields are those by which Drake's C++ classes go through YAML: `LoadYamlFile` of
    `BsplineTrajectory<double>` takes it as well.

    Raises:
        ArgumentError: The samples do not follow each other in time.
    """
    spline = instance(trajectory, "trajectory", ExcitationTrajectory).to_drake()
    basis = spline.basis()
    points = [f"- {json.dumps(point.tolist())}" for point in spline.control_points()]
    lines = ["basis:", f"  order: {basis.order()}", f"  knots: {json.dumps(basis.knots())}"]
    return "\n".join([*lines, "control_points:", *points]) + "\n"


def read_drake_trajectory(path: str | Path) -> BsplineTrajectory:
    """A motion that was written to `.drake.yaml`.

    Returns:
        The positions in Drake's order over time, s.

    Raises:
        ArgumentError: The file cannot be read, or holds no B-spline.
    """
    path = file_path(path)
    try:
        found = yaml_load(filename=str(path))
        basis, points = found["basis"], np.array(found["control_points"], float)
        knots = [float(knot) for knot in basis["knots"]]
        return BsplineTrajectory(BsplineBasis(int(basis["order"]), knots), list(points))
    except Exception as error:  # YAML's errors are of many kinds, and Drake's RuntimeErrors
        raise ArgumentError(
            f"There is no B-spline to read in {str(path)!r}: {error}",
            advice="Give a .drake.yaml file that `geodrake excite --save` wrote.",
        ) from error


def _numbers(values: Iterable[float]) -> str:
    """A list in decimal notation with a point, which every YAML reader takes for floats."""
    return "[" + ", ".join(f"{value:.9f}" for value in values) + "]"
