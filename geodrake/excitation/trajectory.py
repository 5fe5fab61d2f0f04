"""Trajectories of a robot, and their export to logs, ROS and Drake."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.yaml import yaml_dump, yaml_load
from pydrake.math import BsplineBasis
from pydrake.trajectories import BsplineTrajectory
from scipy.interpolate import make_interp_spline

from geodrake.boundary.arguments import file_path, instance, number
from geodrake.boundary.escaping import quoted
from geodrake.boundary.showing import Short
from geodrake.boundary.whole_files import Content, write_whole
from geodrake.errors import ArgumentError, OutputError
from geodrake.excitation.families import JoinedMotion, MotionFamily, SplineMotion
from geodrake.excitation.stance import Stance
from geodrake.inertia import Array
from geodrake.logs.files import log_content
from geodrake.logs.motion import JointLog, Motion
from geodrake.model.robot_model import RobotModel

_LOGS, _YAML, _DRAKE = (".csv", ".txt", ".npz"), (".yaml", ".yml"), (".drake.yaml", ".drake.yml")
_MOST_INSTANTS = 1e6  # per file
_DEGREE = 5  # of interpolating splines
_PER_FASTEST = 64  # their intervals per shortest time scale, for errors of about 1e-9


def check_rate(rate: float, length: float) -> None:
    """Raise if a motion of some length, s, cannot be sampled at a rate, 1/s."""
    number(rate, "rate", lower=0.0, upper=_MOST_INSTANTS / length, strict=True)


@dataclass(frozen=True, eq=False)
class ExcitationTrajectory(Short):
    """Positions of all joints over time, from a family of motions.

    Each joint has one degree of freedom, so Drake's order of positions is that of velocities.

    Attributes:
        coefficients: (count, nv) coefficients, a column for each joint of the model.
        joints: Names of the joints in the order of velocities; for a robot on its feet those of the
            motors, which depend on the free joints of the stance's model.
        stance: The stance of a robot on its feet.
    """

    family: MotionFamily
    coefficients: Array
    joints: tuple[str, ...]
    stance: Stance | None = None

    @property
    def free_joints(self) -> tuple[str, ...]:
        """Names of the joints to which the coefficients belong."""
        return self.joints if self.stance is None else self.stance.model.joints

    @property
    def length(self) -> float:
        """Duration, s; zero if samples are not ordered in time."""
        return self.family.length

    def free_states(self, times: ArrayLike) -> Array:
        """Return positions, velocities and accelerations (3, N, nv) of the model's joints."""
        return np.asarray(self.family.basis(times) @ self.coefficients)

    def states(self, times: ArrayLike) -> Array:
        """Return positions, velocities and accelerations (3, N, ·) by joint at times (N,), s."""
        free = self.free_states(times)
        return free if self.stance is None else self.stance.motor_states(free)

    def motion(self, times: ArrayLike) -> Motion:
        """Return the model's motion at instants (N,)."""
        q, v, vd = self.free_states(times)
        return Motion(q, v, vd, np.atleast_1d(np.asarray(times, float)) if self.length else None)

    def efforts(self, model: RobotModel, times: ArrayLike, *, sign_width: ArrayLike = 0.0) -> Array:
        """Return the predicted efforts (N, ·) by joint at times (N,), N·m or N."""
        motion = self.motion(times)
        if self.stance is None:
            return instance(model, "model", RobotModel).effort(motion, sign_width=sign_width)
        return self.stance.efforts(motion, sign_width)

    def followed_by(self, *others: ExcitationTrajectory) -> ExcitationTrajectory:
        """Return the sequence of this and other motions of the same joints."""
        if not others:
            return self
        parts = self, *others
        coefficients = np.concatenate([part.coefficients for part in parts])
        family = JoinedMotion(tuple(part.family for part in parts))
        return replace(self, family=family, coefficients=coefficients)

    def to_drake(self) -> BsplineTrajectory:
        """Return the positions as a Drake trajectory, with derivatives.

        A spline motion is exact. Others are interpolated with a relative error of about 1e-9 for
        Fourier motions and 1e-5 for ramps.
        """
        self._require_time("Drake trajectory")
        family, degree = self.family, _DEGREE
        if isinstance(family, SplineMotion) and self.joints == self.free_joints:
            knots, points, degree = family.knots, self.coefficients, family.degree
        else:
            times = family.limit_times(1.0 / _PER_FASTEST)
            q, v, vd = self.states(times)
            ends = [[(1, v[end]), (2, vd[end])] for end in (0, -1)]
            spline = make_interp_spline(times, q, k=degree, bc_type=ends)
            knots, points = spline.t, spline.c
        basis = BsplineBasis(degree + 1, knots.tolist())
        return BsplineTrajectory(basis, [np.array(point)[:, None] for point in points])

    def log(self, model: RobotModel, *, rate: float = 100.0, name: str = "excitation") -> JointLog:
        """Return the motion as a log at a rate (1/s), with predicted efforts.

        The log of a robot on its feet includes the pose of its base.
        """
        instance(model, "model", RobotModel)
        times = self.instants(rate)
        q, v, vd = self.states(times)
        effort = self.efforts(model, times)
        floating = {} if self.stance is None else self.stance.base_columns(self.motion(times))
        return JointLog(name, self.joints, times, q, effort, v, vd, floating=floating)

    def instants(self, rate: float) -> Array:
        """Return instants at a rate (1/s) from start to end; the last step may be shorter."""
        self._require_time("instants")
        check_rate(rate, self.length)
        times = np.arange(np.ceil(self.length * rate - 1e-9)) / rate
        return np.append(times, self.length)

    def _require_time(self, what: str) -> None:
        if not self.length:
            raise ArgumentError(
                f"Free samples are not ordered in time, so they have no {what}.",
                advice="Design a Fourier or spline motion.",
            )


def write_trajectory(
    trajectory: ExcitationTrajectory, path: str | Path, model: RobotModel, *, rate: float = 100.0
) -> None:
    """Write a motion to a file atomically.

    Args:
        path: `.csv` or `.npz` for a log with the predicted efforts, `.yaml` for a ROS
            trajectory_msgs/JointTrajectory for `ros2 topic pub`, `.drake.yaml` for a Drake
            BsplineTrajectory for `read_drake_trajectory`.
    """
    path = file_path(path)
    write_whole(path, trajectory_content(trajectory, path, model, rate=rate))


def trajectory_content(
    trajectory: ExcitationTrajectory, path: str | Path, model: RobotModel, *, rate: float = 100.0
) -> Content:
    """Return the content of the file; see `write_trajectory` for the arguments."""
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
    """Return a motion as YAML of a ROS 2 trajectory_msgs/JointTrajectory message.

    Efforts are empty, since position and velocity controllers reject them.
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
    """Return a motion's positions as YAML of a Drake BsplineTrajectory.

    Drake's C++ `LoadYamlFile<BsplineTrajectory<double>>` reads it as well.
    """
    spline = instance(trajectory, "trajectory", ExcitationTrajectory).to_drake()
    basis = {"order": spline.basis().order(), "knots": list(spline.basis().knots())}
    points = [point.tolist() for point in spline.control_points()]
    return yaml_dump({"basis": basis, "control_points": points})


def read_drake_trajectory(path: str | Path) -> BsplineTrajectory:
    """Return the positions over time, s, from a `.drake.yaml` file."""
    path = file_path(path)
    try:
        fields = yaml_load(filename=str(path))
        basis, points = fields["basis"], np.array(fields["control_points"], float)
        knots = [float(knot) for knot in basis["knots"]]
        return BsplineTrajectory(BsplineBasis(int(basis["order"]), knots), list(points))
    except Exception as error:  # YAML raises many types of errors, and Drake RuntimeErrors
        raise ArgumentError(
            f"{str(path)!r} does not contain a B-spline: {error}",
            advice="Use a .drake.yaml file written by `geodrake excite --save`.",
        ) from error


def _numbers(values: Iterable[float]) -> str:
    """Return a list in decimal notation with a point, which all YAML readers parse as floats."""
    return "[" + ", ".join(f"{value:.9f}" for value in values) + "]"
