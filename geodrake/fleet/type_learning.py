"""Learning of the common values of a robot type, and of the differences between robots.

Scales maximize the restricted likelihood, by explicit steps. Each step is one pass over the robots,
which collects the statistics of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincinv

from geodrake.fleet.history import RobotHistory
from geodrake.fleet.type_columns import TypeColumns
from geodrake.fleet.type_model import Course, LogScores, RobotFit, TypeModel, kept_share
from geodrake.fleet.workers import THIS_PROCESS, Workers
from geodrake.inertia import Array

_START_DEVIATION, _START_SCATTER, _START_RESPONSE = 0.1, 0.03, 0.2
_PRIOR_SCALE = 10.0  # of spreads in the prior of the common values
_RANK_TOLERANCE = 1e-9  # relative
_PSEUDO_COUNT = 1e-3  # of each robot's squares, with ratio 1
_LEAST = 1e-8  # lower bound of scales


def learn_type(
    logs: Sequence[RobotHistory],
    columns: TypeColumns,
    *,
    changes: Sequence[Array] | None = None,
    start: TypeModel | None = None,
    rounds: int = 12,
    team: Workers = THIS_PROCESS,
) -> TypeModel:
    """Learn the common values of a type, and the differences between robots, from all logs.

    Args:
        changes: (T, p, m) map of the changes found in each robot, if any.
    """
    model = _initial_model(team, logs, columns) if start is None else start
    changes_by_robot = [None] * len(logs) if changes is None else changes
    for _ in range(rounds):
        rows = enumerate(zip(logs, changes_by_robot, strict=True))
        tasks = [(model.for_robot(r), *row) for r, row in rows]
        model = _updated(model, logs, team.in_order(_robot_statistics, tasks))
    return model


def pooled(team: Workers, logs: Sequence[RobotHistory]) -> tuple[Array, Array]:
    """Return the sums of all normal matrices (p, p), and of right sides (p,)."""
    information, right = zip(*team.in_order(_sums, logs), strict=True)
    return np.sum(information, axis=0), np.sum(right, axis=0)


def _sums(logs: RobotHistory) -> tuple[Array, Array]:
    equations = logs.equations()
    return equations.information.sum(axis=0), equations.right.sum(axis=0)


def _initial_model(team: Workers, logs: Sequence[RobotHistory], columns: TypeColumns) -> TypeModel:
    """Return the pooled least-squares solution, with prior values for undetermined columns."""
    K, p, free = len(columns.spreads), len(columns.prior), columns.free
    information, right = pooled(team, logs)
    mean = columns.prior.copy()
    mean[free] += least_squares(
        information[np.ix_(free, free)], (right - information @ columns.prior)[free]
    )
    return TypeModel(
        columns,
        mean,
        np.zeros((p, p)),
        np.full(K, _START_DEVIATION),
        np.full(K, _START_SCATTER),
        _START_RESPONSE,
        Course.zero(logs, int(columns.course.sum())),
        np.tile(mean, (len(logs), 1)),
        tuple(np.zeros((len(robot.days), K)) for robot in logs),
    )


@dataclass(frozen=True, eq=False)
class _RobotStatistics:
    """Statistics of one robot for learning."""

    values: Array  # (p,) its parameters
    information: Array  # (p, p) its information on μ
    side: Array  # (p,) its right side for a change of μ
    theta_slopes: Array  # (n, p) derivatives of its θ by μ
    # (2, K + 1) squares of θ for each spread and the response, and expectations for known μ.
    spread: Array
    # (3, K) squares of its logs' scores along each spread, expectations, and the median relative
    # to these.
    scatter: Array
    course: tuple[Array, Array]  # (T, q, q) and (T, q): normal equations of the course
    response: Array  # (q,) deviation of its response to the course
    excess: Array  # (T, K) excess scatter of its logs


def _robot_statistics(task: tuple[TypeModel, RobotHistory, Array | None]) -> _RobotStatistics:
    """Return one robot's statistics."""
    model, logs, changes = task
    fit, scale = model.fit(0, logs.equations(), changes), model.scale(0)
    slopes, common, columns = fit.solve(fit.cross), fit.common.shape[1], model.columns
    scores = model.log_scores(0, fit)
    squares = np.stack([fit.theta**2, 1.0 - np.diagonal(fit.covariance)])
    course_scale, course = scale[columns.course], columns.course
    part = fit.information[:, course][:, :, course] * course_scale[:, None] * course_scale
    return _RobotStatistics(
        model.mean + fit.common @ fit.theta[:common],
        fit.information.sum(axis=0) - fit.cross.T @ slopes,
        fit.score.sum(axis=0),
        slopes,
        columns.parts(squares),
        _scatter_statistics(model, scale, fit, scores),
        (part, fit.score[:, course] * course_scale),
        model.response * fit.theta[common : common + columns.sizes[-1]],
        model.updated_excess(scores, model.excess[0])[0],
    )


def _scatter_statistics(model: TypeModel, scale: Array, fit: RobotFit, scores: LogScores) -> Array:
    """Return (3, K) statistics of the scatter of a robot's logs, as in `_RobotStatistics`."""
    by_log, trace, norm = scores
    squares, norm = by_log.sum(axis=0), np.maximum(norm.sum(axis=0), 1e-300)
    expected = model.columns.parts(fit.expected_squares(scale[:, None] * model.factor))[:-1]
    # The median of few squares is less than their mean. Down-weighting reduces their skew.
    count = np.maximum(expected * trace.sum(axis=0) / norm, 1.0)
    kept = kept_share(np.square(trace).sum(axis=0) / norm)
    median = np.minimum(2.0 * gammaincinv(0.5 * count, 0.5) / count, kept)
    return np.stack([squares, expected, median])


def _updated(
    model: TypeModel, logs: Sequence[RobotHistory], robots: Sequence[_RobotStatistics]
) -> TypeModel:
    """Return the model after one step.

    Squared scales are multiplied by the ratio of squares of scores to their expectations, whose
    fixed point maximizes the restricted likelihood. For the scatter of logs, the ratio is the
    weighted median over robots, which is robust against robots that changed.
    """
    free = model.columns.free
    typical = np.where(model.columns.relative, model.typical, 1.0)[:, None]
    prior = sum(((typical * s.factor) @ (typical * s.factor).T for s in model.columns.spreads), 0.0)
    precision = _inverse(_PRIOR_SCALE**2 * np.asarray(prior)[np.ix_(free, free)])
    information = np.sum([robot.information for robot in robots], axis=0)
    side = np.sum([robot.side for robot in robots], axis=0)[free]
    covariance = np.zeros_like(model.covariance)
    covariance[np.ix_(free, free)] = _inverse(information[np.ix_(free, free)] + precision)
    mean = model.mean.copy()
    prior_side = precision @ (model.columns.prior - mean)[free]
    mean[free] += covariance[np.ix_(free, free)] @ (side + prior_side)
    spread = _spread_ratio(model.columns, robots, covariance)
    course = model.course.updated(
        logs, [robot.course[0] for robot in robots], [robot.course[1] for robot in robots]
    )
    course = course.scaled(np.mean([robot.response for robot in robots], axis=0))
    return replace(
        model,
        mean=mean,
        covariance=covariance,
        deviations=np.maximum(model.deviations * np.sqrt(spread[:-1]), _LEAST),
        scatter=np.maximum(model.scatter * np.sqrt(_scatter_ratio(model, robots)), _LEAST),
        response=max(model.response * float(np.sqrt(spread[-1])), _LEAST),
        course=course,
        robot_values=np.array([robot.values for robot in robots]),
        excess=tuple(robot.excess for robot in robots),
    )


def _spread_ratio(
    columns: TypeColumns, robots: Sequence[_RobotStatistics], covariance: Array
) -> Array:
    """Return (K + 1,) ratios of squares of θ of all robots to their expectations, for learnt μ."""
    squares, expected = np.stack([robot.spread for robot in robots], axis=1)
    for k, robot in enumerate(robots):
        slopes = robot.theta_slopes
        expected[k] -= columns.parts(np.einsum("na,ab,nb->n", slopes, covariance, slopes))
    # Pseudo-counts keep scales without information unchanged.
    squares, expected = squares + _PSEUDO_COUNT, np.maximum(expected, 0.0) + _PSEUDO_COUNT
    ratio = squares.sum(axis=0) / expected.sum(axis=0)
    # The median is robust against robots whose friction changed.
    ratio[-1] = np.median(squares[:, -1] / expected[:, -1])
    return np.asarray(ratio)


def _scatter_ratio(model: TypeModel, robots: Sequence[_RobotStatistics]) -> Array:
    """Return (K,) weighted medians over robots of squares of scores over their expectations.

    A robot's weight is the number of deviations that its logs determine; the present value has
    weight 1.
    """
    squares, expected, median = np.stack([robot.scatter for robot in robots], axis=1)
    ratio = squares / np.maximum(median * expected, 1e-300)
    ratio = np.vstack([ratio, np.ones_like(model.scatter)])
    weight = np.vstack([model.scatter**2 * expected, np.ones_like(model.scatter)])
    order = np.argsort(ratio, axis=0)
    ratio, weight = (np.take_along_axis(x, order, axis=0) for x in (ratio, weight))
    cumulative = np.cumsum(weight, axis=0) - 0.5 * weight
    rows = zip(0.5 * weight.sum(axis=0), cumulative.T, ratio.T, strict=True)
    return np.array([np.interp(half, weights, ratios) for half, weights, ratios in rows])


def least_squares(information: Array, right: Array) -> Array:
    """Return the minimum-norm solution (p,) of normal equations, with columns scaled to size 1."""
    unit = _units(information)
    scaled = information * unit[:, None] * unit
    return np.asarray(unit * np.linalg.lstsq(scaled, unit * right, _RANK_TOLERANCE)[0])


def _inverse(matrix: Array) -> Array:
    """Return the pseudo-inverse of a matrix with columns in several units; 0 for zero columns."""
    unit = _units(matrix)
    return np.linalg.pinv(matrix * unit[:, None] * unit, hermitian=True) * unit[:, None] * unit


def _units(matrix: Array) -> Array:
    """Return (p,) scales that normalize a normal matrix's columns; 0 for zero columns."""
    size = np.diagonal(matrix)
    return np.where(size > 0.0, 1.0 / np.sqrt(np.where(size > 0.0, size, 1.0)), 0.0)
