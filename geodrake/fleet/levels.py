"""Parameters of one robot over time: what each log shows, with intervals that hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import instance, integer, integers
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.fleet.history import LogEquations
from geodrake.fleet.marginals import calc_marginal, narrow_factor
from geodrake.fleet.robot_fit import RobotFit
from geodrake.fleet.type_model import TypeModel

Array = NDArray[np.float64]

_LOOSE = 100.0  # deviations of the type that a parameter may be off where a log says nothing


@dataclass(frozen=True, eq=False)
class ParameterLevels(Short):
    """Parameters as each log has them.

    Attributes:
        days: (T,) days of the logs.
        columns: The parameters, by the numbers of their columns.
        values: (T, c) their values.
        deviation: (T, c) standard deviation of a value as that of the log itself, from its noise
            and from what is not known of the robot.
        with_scatter: (T, c) standard deviation of a value as that of the robot in these days: with
            what logs scatter beyond their noise, as models are never exact.
        shown: (T, c) whether the log says more of it than that it is one of the type.
    """

    days: Array
    columns: tuple[int, ...]
    values: Array
    deviation: Array
    with_scatter: Array
    shown: NDArray[np.bool_]


def parameter_levels(
    model: TypeModel, robot: int, logs: LogEquations, fit: RobotFit, columns: Sequence[int]
) -> ParameterLevels:
    """What each log says of some parameters, where all others are those of the robot.

    No log is smoothed by others: levels before and after a change are independent but for what is
    not known of the robot.

    Args:
        fit: Its own parameters, with the changes that were found.
        columns: (c,) the parameters, by the numbers of their columns.

    Raises:
        ArgumentError: There is no such column or robot, or a spread joins them with others.
    """
    instance(model, "model", TypeModel)
    instance(logs, "logs", LogEquations)
    instance(fit, "fit", RobotFit)
    integer(robot, "robot", lower=0, upper=len(model.own) - 1)
    at = np.array(integers(columns, "columns", lower=0, upper=len(model.mean) - 1), np.intp)
    others = np.setdiff1d(np.arange(len(model.mean)), at)
    touch = [spread.factor[at].any() for spread in model.columns.spreads]
    joined = [
        s.name for s in model.columns.spreads if s.factor[at].any() and s.factor[others].any()
    ]
    if not len(at) or joined:
        raise ArgumentError(
            f"Levels need at least one column, and each by itself; {joined} join them with others."
        )
    scale = model.scale(robot)[:, None]
    parts = zip(model.columns.spreads, model.scatter, touch, strict=True)
    rest = [tau * scale * s.factor for s, tau, touched in parts if not touched]
    factor = narrow_factor(np.hstack([np.zeros_like(scale), *rest]))
    M, m = calc_marginal(logs.information, logs.right, factor, at)
    mean = model.parameters(robot, logs, fit)
    usual = _variances(model, at)
    own = M[:, at] + np.diag(1.0 / (_LOOSE**2 * usual))
    covariance = np.linalg.inv(own)
    score = m - np.einsum("tpc,tp->tc", M, mean)
    # What is not known of the other parameters moves all logs' levels together.
    M[:, at] = 0.0
    moved = fit.mapped(covariance @ np.swapaxes(M, 1, 2))
    flat = moved.reshape(-1, moved.shape[2])
    unknown = np.sum(flat * fit.solve(flat.T).T, axis=1).reshape(moved.shape[:2])
    variance = np.diagonal(covariance, axis1=1, axis2=2) + unknown
    scattered = np.zeros_like(variance)
    for k, spread in enumerate(model.columns.spreads):
        if touch[k]:
            squares = np.square(scale * spread.factor)[at].sum(axis=1)
            scattered += model.scatter[k] ** 2 * squares
    return ParameterLevels(
        logs.days,
        tuple(at.tolist()),
        mean[:, at] + (covariance @ score[..., None])[..., 0],
        np.sqrt(variance),
        np.sqrt(variance + scattered),
        variance < usual,
    )


def _variances(model: TypeModel, at: NDArray[np.intp]) -> Array:
    """(c,) variances of parameters between robots of the type."""
    total = sum(
        (np.square(f[at]).sum(axis=1) for f in model.deviation_factors()), np.zeros(len(at))
    )
    return np.maximum(total, np.finfo(float).tiny ** 0.5)
