"""What the logs of one robot say: a normal matrix a log, over the same columns in all logs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import instance, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError

Array = NDArray[np.float64]

_SYMMETRIC = 1e-6  # share of the largest entry by which a normal matrix may differ from its mirror


@dataclass(frozen=True, eq=False)
class RobotHistory(Short):
    """Weighted normal matrices of a robot's logs, in the order of time.

    Attributes:
        robot: The robot's name.
        days: (T,) when each log was recorded, days, ascending.
        grams: (T, n, p + 1, p + 1) weighted matrices [A | b]ᵀ W [A | b] of each log and joint.
        temperature: (T,) mean temperature of each log, °C; NaN where it is not known.
    """

    robot: str
    days: Array
    grams: Array
    temperature: Array

    def __post_init__(self) -> None:
        """Checks that arrays fit each other."""
        instance(self.robot, "robot", str)
        sizes: dict[str, tuple[int, ...]] = {}
        real_array(self.days, "days", ("T",), sizes)
        real_array(self.grams, "grams", ("T", "n", "p", "p"), sizes)
        real_array(self.temperature, "temperature", ("T",), sizes, finite=False)
        if not len(self.days) or (np.diff(self.days) < 0.0).any():
            raise ArgumentError(
                f"The logs of {self.robot} must be at least one, in the order of their days.",
                advice="Sort them by date.",
                robot=self.robot,
            )

    def equations(self) -> LogEquations:
        """Normal equations of the p columns alone."""
        total = self.grams.sum(axis=1)
        return LogEquations(self.days, total[:, :-1, :-1], total[:, :-1, -1], self.temperature)

    def with_gains(self, reference: ArrayLike) -> LogEquations:
        """Normal equations with a further column for the gain of every joint's effort.

        The column of joint j is what a reference says of the effort there, and zero at the other
        joints, so that its parameter is ε where the logged effort is 1 + ε times that.

        Args:
            reference: (p,) or (T, p) parameters: those of the robot, as far as they are known.

        Raises:
            ArgumentError: Shapes do not fit, or values are not finite.
        """
        T, n, p = (*self.grams.shape[:2], self.grams.shape[3] - 1)
        reference = np.broadcast_to(real_array(reference, "reference", ("...", p)), (T, p))
        total = self.grams.sum(axis=1)
        along = np.einsum("tjab,tb->tja", self.grams[..., :p], reference)
        squares = np.einsum("tja,ta->tj", along[..., :p], reference)
        information, right = np.zeros((T, p + n, p + n)), np.zeros((T, p + n))
        information[:, :p, :p], right[:, :p] = total[:, :p, :p], total[:, :p, p]
        information[:, p:, :p] = along[..., :p]
        information[:, :p, p:] = np.swapaxes(along[..., :p], 1, 2)
        gains = p + np.arange(n)
        information[:, gains, gains], right[:, p:] = squares, along[..., p]
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
        robot: The robot's name.
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
    weighted = (weights[..., None, None] * grams)[order]
    return RobotHistory(robot, days[order], weighted, warm[order])
