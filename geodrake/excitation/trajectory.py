"""One motion of a robot out of a family, and the forms that others take it in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import BsplineBasis
from pydrake.trajectories import BsplineTrajectory
from scipy.interpolate import make_interp_spline

from geodrake.boundary.arguments import instance, number, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.excitation.families import MotionFamily, SplineMotion
from geodrake.excitation.reverse_recursion import MotionGradient
from geodrake.logs.motion import JointLog, Motion
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_MOST_INSTANTS = 1e6  # of a file
_DEGREE = 5  # of the spline that stands for other families in Drake
_PER_FASTEST = 64  # intervals of that spline in the shortest time: errors of some 1e-9


@dataclass(frozen=True, eq=False)
class ExcitationTrajectory(Short):
    """A motion of all joints of a robot whose joints have one degree of freedom each.

    Attributes:
        coefficients: (count, nv) coefficients, a column a joint.
        joints: Names of the nv joints, in the order of velocities.
        order: (nv,) joint of each position in Drake's order.
    """

    family: MotionFamily
    coefficients: Array
    joints: tuple[str, ...]
    order: NDArray[np.intp]

    def states(self, times: ArrayLike) -> Array:
        """(3, N, nv) positions, velocities and accelerations by joint, at instants (N,), s."""
        return np.asarray(self.family.basis(times) @ self.coefficients)

    def motion(self, times: ArrayLike) -> Motion:
        """The motion at instants (N,), in Drake's order."""
        return self.motion_of(self.states(times), np.atleast_1d(real_array(times, "times")))

    def motion_of(self, states: Array, times: Array | None = None) -> Motion:
        """The motion in Drake's order of states (3, N, nv) by joint.

        Args:
            states: (3, N, nv) positions, velocities and accelerations by joint.
            times: (N,) times, s; not used where the motion is free samples.
        """
        q, v, vd = states
        return Motion(q[:, self.order], v, vd, times if self.family.timed else None)

    def coefficient_gradient(self, basis: Array, gradient: MotionGradient) -> Array:
        """(count, nv) gradient by the coefficients, from one by the motion.

        Args:
            basis: (3, N, count) `family.basis` of the samples.
        """
        by_joint = np.zeros_like(gradient.v)
        by_joint[:, self.order] = gradient.q
        total = basis[0].T @ by_joint + basis[1].T @ gradient.v + basis[2].T @ gradient.vd
        return np.asarray(total)

    def to_drake(self) -> BsplineTrajectory:
        """The positions in Drake's order as a Drake trajectory, with derivatives.

        A spline motion is itself; others are interpolated to about 1e-9 of their size.

        Raises:
            ArgumentError: The samples do not follow each other in time.
        """
        self._require_time("a Drake trajectory")
        family = self.family
        if isinstance(family, SplineMotion):
            knots, points, degree = family.knots, self.coefficients, family.degree
        else:
            times = family.limit_times(1.0 / _PER_FASTEST)
            q, v, vd = self.states(times)
            ends = [[(1, v[end]), (2, vd[end])] for end in (0, -1)]
            spline = make_interp_spline(times, q, k=_DEGREE, bc_type=ends)
            knots, points, degree = spline.t, spline.c, _DEGREE
        controls = [np.array(point)[:, None] for point in points[:, self.order]]
        return BsplineTrajectory(BsplineBasis(degree + 1, knots.tolist()), controls)

    def log(self, model: RobotModel, *, rate: float = 100.0, name: str = "excitation") -> JointLog:
        """The motion as a log, with the efforts that the model predicts.

        Raises:
            ArgumentError: The samples do not follow each other in time, or the rate is not
                positive.
        """
        instance(model, "model", RobotModel)
        times = self.instants(rate)
        q, v, vd = self.states(times)
        effort = model.effort(self.motion(times))
        return JointLog(name, self.joints, times, q, effort, v, vd)

    def instants(self, rate: float) -> Array:
        """Instants at a rate (1/s) from the start to the end; the last step may be shorter.

        Raises:
            ArgumentError: The samples do not follow each other in time, or the rate is not
                positive, or gives more samples than a file is good for.
        """
        self._require_time("instants")
        number(rate, "rate", finite=False)
        length = self.family.length
        if not 0 < rate < np.inf or rate * length > _MOST_INSTANTS:
            raise ArgumentError(
                f"A rate is a positive number of samples a second; got {rate}.",
                advice=f"Give at most {_MOST_INSTANTS / length:g} a second.",
            )
        times = np.arange(np.ceil(length * rate - 1e-9)) / rate
        return np.append(times, length)

    def _require_time(self, what: str) -> None:
        if not self.family.timed:
            raise ArgumentError(
                f"There is no {what} of samples that do not follow each other in time.",
                advice="Design a Fourier or spline motion.",
            )


def joint_order(model: RobotModel) -> NDArray[np.intp]:
    """(nq,) joint of each position in Drake's order.

    Raises:
        ArgumentError: The robot has joints of several degrees of freedom.
    """
    joints = np.arange(len(model.joints), dtype=float)
    return np.asarray(np.rint(model.positions(joints[None])[0]), np.intp)
