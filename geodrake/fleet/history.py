"""What the logs of one robot say: a normal matrix a log, over the same columns in all logs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import instance, instances, integer, integers, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.fleet.columns import MOST_COLUMNS

Array = NDArray[np.float64]

_SYMMETRIC = 1e-6  # share of the largest entry by which a normal matrix may differ from its mirror


class EquationSource(Protocol):
    """Where the normal equations of a robot's logs come from: a file, or what is at hand."""

    @property
    def days(self) -> Array:
        """(T,) days of the logs, ascending."""

    @property
    def temperature(self) -> Array:
        """(T,) mean temperature of each log, °C; NaN where it is not known."""

    def equations(self) -> LogEquations:
        """Their normal equations."""


class HistorySource(Protocol):
    """Where a robot's history comes from: a file, or what is at hand."""

    @property
    def robot(self) -> str:
        """The robot's name."""

    @property
    def days(self) -> Array:
        """(T,) days of its logs, ascending."""

    @property
    def temperature(self) -> Array:
        """(T,) mean temperature of each log, °C; NaN where it is not known."""

    def read(self) -> RobotHistory:
        """The history."""


@dataclass(frozen=True, eq=False)
class JointHistory(Short):
    """Weighted normal matrices of one joint, over the columns that its rows ever have.

    Attributes:
        columns: (m,) which of the p columns these are, ascending.
        information: (T, m, m) Aᵀ W A of each log.
        right: (T, m) Aᵀ W b.
    """

    columns: NDArray[np.intp]
    information: Array
    right: Array

    def __post_init__(self) -> None:
        """Checks that arrays fit each other."""
        at = integers(self.columns, "columns", lower=0, upper=MOST_COLUMNS)
        sizes: dict[str, tuple[int, ...]] = {"m": (len(at),)}
        real_array(self.information, "information", ("T", "m", "m"), sizes)
        real_array(self.right, "right", ("T", "m"), sizes)


@dataclass(frozen=True, eq=False)
class RobotHistory(Short):
    """What a robot's logs say, in the order of time.

    Attributes:
        days: (T,) when each log was recorded, days, ascending.
        joints: (n,) what they say of each joint.
        temperature: (T,) mean temperature of each log, °C; NaN where it is not known.
    """

    robot: str
    days: Array
    joints: tuple[JointHistory, ...]
    columns: int
    temperature: Array

    def __post_init__(self) -> None:
        """Checks that all fit each other."""
        instance(self.robot, "robot", str)
        integer(self.columns, "columns", lower=0, upper=MOST_COLUMNS)
        sizes: dict[str, tuple[int, ...]] = {}
        real_array(self.days, "days", ("T",), sizes)
        real_array(self.temperature, "temperature", ("T",), sizes, finite=False)
        for joint in instances(self.joints, "joints", JointHistory):
            if len(joint.right) != len(self.days) or (joint.columns >= self.columns).any():
                raise ArgumentError(
                    f"{self.robot} has {len(self.days)} logs and {self.columns} columns, and a "
                    f"joint of {len(joint.right)} logs with the columns {joint.columns.tolist()}."
                )
        if not len(self.days) or (np.diff(self.days) < 0.0).any():
            raise ArgumentError(
                f"The logs of {self.robot} must be at least one, in the order of their days.",
                advice="Sort them by date.",
                robot=self.robot,
            )

    def read(self) -> RobotHistory:
        """This one, which is at hand."""
        return self

    def equations(self) -> LogEquations:
        """Normal equations of the p columns alone."""
        return self._equations(self.columns)

    def with_gains(self, reference: ArrayLike) -> LogEquations:
        """Normal equations with a further column for the gain of every joint's effort.

        The column of joint j is what a reference says of the effort there, and zero at the other
        joints, so that its parameter is ε where the logged effort is 1 + ε times that.

        Args:
            reference: (p,) or (T, p) parameters: those of the robot, as far as they are known.

        Raises:
            ArgumentError: Shapes do not fit, or values are not finite.
        """
        T, p = len(self.days), self.columns
        reference = np.broadcast_to(real_array(reference, "reference", ("...", p)), (T, p))
        equations = self._equations(p + len(self.joints))
        information, right = equations.information, equations.right
        for gain, joint in enumerate(self.joints, start=p):
            own = reference[:, joint.columns]
            along = np.einsum("tab,tb->ta", joint.information, own)
            information[:, gain, joint.columns] = information[:, joint.columns, gain] = along
            information[:, gain, gain] = np.einsum("ta,ta->t", along, own)
            right[:, gain] = np.einsum("ta,ta->t", joint.right, own)
        return equations

    def _equations(self, size: int) -> LogEquations:
        """Sums over joints, in (T, size, size) matrices."""
        T = len(self.days)
        information, right = np.zeros((T, size, size)), np.zeros((T, size))
        for joint in self.joints:
            at = joint.columns
            information[:, at[:, None], at] += joint.information
            right[:, at] += joint.right
        return LogEquations(self.days, information, right, self.temperature)


@dataclass(frozen=True, eq=False)
class LogEquations(Short):
    """Normal equations of a robot's logs.

    Attributes:
        days: (T,) days of the logs.
        information: (T, p, p) weighted normal matrices Aᵀ W A.
        right: (T, p) right sides Aᵀ W b.
        temperature: (T,) mean temperature of each log, °C; NaN where it is not known.
    """

    days: Array
    information: Array
    right: Array
    temperature: Array

    def equations(self) -> LogEquations:
        """These."""
        return self


@dataclass(frozen=True, eq=False)
class ReferredLogs(Short):
    """Logs over the columns of a type, whose gains refer to some parameters of the robot.

    Attributes:
        gains: Number of gains among the columns: one for each joint, or 0.
        reference: (T, p) or (p,) parameters that gains refer to.
    """

    history: HistorySource
    gains: int
    reference: Array

    @property
    def days(self) -> Array:
        """(T,) days of the logs, ascending."""
        return self.history.days

    @property
    def temperature(self) -> Array:
        """(T,) mean temperature of each log, °C; NaN where it is not known."""
        return self.history.temperature

    def equations(self) -> LogEquations:
        """Their normal equations."""
        history = self.history.read()
        if not self.gains:
            return history.equations()
        return history.with_gains(self.reference[..., : history.columns])


def weighted_history(
    robot: str,
    days: ArrayLike,
    grams: ArrayLike,
    weights: ArrayLike,
    *,
    temperature: ArrayLike | None = None,
) -> RobotHistory:
    """The history of a robot, of normal matrices of its logs and joints.

    Args:
        days: (T,) when each log was recorded, days, in any order.
        grams: (T, n, p + 1, p + 1) matrices [A | b]ᵀ[A | b] of each log and joint over the same p
            columns, in units of the efforts and columns, not divided by the number of rows.
        weights: (T, n) what a row is worth: the share of samples that are independent, over the
            variance of the noise, 1/(N·m)² or 1/N²; 0 where a joint's rows are not to be used.
        temperature: (T,) mean temperature of each log, °C; NaN or None where it is not known.

    Raises:
        ArgumentError: Shapes do not fit, values are not finite, or a matrix is not symmetric.
    """
    sizes: dict[str, tuple[int, ...]] = {}
    days = real_array(days, "days", ("T",), sizes)
    weights = real_array(weights, "weights", ("T", "n"), sizes)
    grams = real_array(grams, "grams", ("T", "n", "p", "p"), sizes)
    mirrored = np.abs(grams - np.swapaxes(grams, 2, 3)).max(initial=0.0)
    squares = np.diagonal(grams, axis1=2, axis2=3)
    if (
        (weights < 0.0).any()
        or (squares < 0.0).any()
        or mirrored > _SYMMETRIC * np.abs(grams).max(initial=0.0)
    ):
        raise ArgumentError(
            f"The logs of {robot} have a negative weight or square, or a normal matrix that is "
            "not symmetric.",
            advice="Weights are shares over variances; matrices are [A | b]ᵀ[A | b].",
            robot=robot,
        )
    warm = np.full(len(days), np.nan) if temperature is None else temperature
    warm = real_array(warm, "temperature", ("T",), sizes, finite=False)
    order = np.argsort(days, kind="stable")
    every = np.arange(grams.shape[2] - 1)
    joints = [
        joint_history(every, (weights[:, j, None, None] * grams[:, j])[order])
        for j in range(grams.shape[1])
    ]
    return RobotHistory(robot, days[order], tuple(joints), grams.shape[2] - 1, warm[order])


def joint_history(columns: NDArray[np.intp], grams: Array) -> JointHistory:
    """What logs say of a joint, without the columns that its rows never have.

    Args:
        columns: (m,) columns of the matrices, ascending.
        grams: (T, m + 1, m + 1) weighted matrices [A | b]ᵀ W [A | b] of each log.
    """
    seen = np.flatnonzero(np.diagonal(grams, axis1=1, axis2=2)[:, :-1].any(axis=0))
    return JointHistory(columns[seen], grams[:, seen[:, None], seen], grams[:, seen, -1])
