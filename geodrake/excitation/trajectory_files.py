"""Motions as files: a log in CSV or NPZ, and ROS's JointTrajectory in YAML."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from geodrake.errors import OutputError
from geodrake.excitation.trajectory import ExcitationTrajectory
from geodrake.log_files import write_log
from geodrake.model import RobotModel
from geodrake.saved_model import write_whole

_LOGS = (".csv", ".txt", ".npz")
_YAML = (".yaml", ".yml")


def write_trajectory(
    trajectory: ExcitationTrajectory, path: str | Path, model: RobotModel, *, rate: float = 100.0
) -> None:
    """Write a motion, whole or not at all.

    Args:
        trajectory: The motion.
        path: Where to: `.csv` or `.npz` for a log with the predicted efforts, `.yaml` for a ROS
            trajectory_msgs/JointTrajectory, which `ros2 topic pub` takes.
        model: The robot, for the efforts.
        rate: Samples a second.

    Raises:
        OutputError: The suffix is another, or the file cannot be written.
        ArgumentError: The samples do not follow each other in time.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in _LOGS:
        write_log(trajectory.log(model, rate=rate, name=path.stem), path)
    elif suffix in _YAML:
        write_whole(path, ros_joint_trajectory(trajectory, rate=rate))
    else:
        raise OutputError(
            f"A motion cannot be written to {str(path)!r}.",
            advice=f"Use {', '.join((*_LOGS, *_YAML))}.",
        )


def ros_joint_trajectory(trajectory: ExcitationTrajectory, *, rate: float = 100.0) -> str:
    """A motion as YAML of the message trajectory_msgs/JointTrajectory of ROS 2.

    Efforts are left empty, since position and velocity controllers refuse them.

    Args:
        trajectory: The motion.
        rate: Points a second.

    Raises:
        ArgumentError: The samples do not follow each other in time, or the rate is not positive.
    """
    times = trajectory.instants(rate)
    lines = [
        "header:",
        "  stamp: {sec: 0, nanosec: 0}",
        '  frame_id: ""',
        f"joint_names: {json.dumps(trajectory.joints)}",
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


def _numbers(values: Iterable[float]) -> str:
    """A list in decimal notation with a point, which every YAML reader takes for floats."""
    return "[" + ", ".join(f"{value:.9f}" for value in values) + "]"
