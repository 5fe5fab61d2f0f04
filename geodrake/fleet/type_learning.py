"""Learn the common values of a type of robot, and how robots differ, from all logs.

Scales are those of the largest restricted likelihood, all steps explicit: one pass over the robots
tells what each says of everything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincinv

from geodrake.fleet.history import RobotHistory
from geodrake.fleet.type_columns import TypeColumns
from geodrake.fleet.type_model import Course, LogScores, RobotFit, TypeModel, kept_share
from geodrake.fleet.workers import HERE, Workers
from geodrake.inertia import Array

_START_DEVIATION, _START_SCATTER, _START_RESPONSE = 0.1, 0.03, 0.2
_WEAK = 10.0  # scale of spreads in the prior of what all share
_FLAT = 1e-9  # share of information that is none
_SEEN = 1e-3  # deviations of a robot that tell of a scale
_LEAST = 1e-8  # scale that is none


def learn_type(
    logs: Sequence[RobotHistory],
    columns: TypeColumns,
    *,
    changes: Sequence[Array] | None = None,
    start: TypeModel | None = None,
    rounds: int = 12,
    team: Workers = HERE,
) -> TypeModel:
    """Learn the common values of a type, and how robots differ, from all logs.

    Changes (T, p, m) that were found in each robot are further parameters of it.
    """
    model = _begun(team, logs, columns) if start is None else start
    every = [None] * len(logs) if changes is None else changes
    for _ in range(rounds):
        pieces = [(model.of(r), *each) for r, each in enumerate(zip(logs, every, strict=True))]
        model = _improved(model, logs, team.in_order(_told, pieces))
    return model


def pooled(team: Workers, logs: Sequence[RobotHistory]) -> tuple[Array, Array]:
    """Return sums of all normal matrices (p, p), and of right sides (p,)."""
    information, right = zip(*team.in_order(_sums, logs), strict=True)
    return np.sum(information, axis=0), np.sum(right, axis=0)


def _sums(logs: RobotHistory) -> tuple[Array, Array]:
    equations = logs.equations()
    return equations.information.sum(axis=0), equations.right.sum(axis=0)


def _begun(team: Workers, logs: Sequence[RobotHistory], columns: TypeColumns) -> TypeModel:
    """Return pooled least squares, and the prior where logs determine nothing."""
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
        Course.begin(logs, int(columns.course.sum())),
        np.tile(mean, (len(logs), 1)),
        tuple(np.zeros((len(each.days), K)) for each in logs),
    )


@dataclass(frozen=True, eq=False)
class _RobotStatistics:
    """One robot's statistics, for everything that is learnt."""

    own: Array  # (p,) its own parameters
    seen: Array  # (p, p) what it knows of μ
    side: Array  # (p,) by which μ should be larger, times that
    links: Array  # (n, p) how its θ varies with μ
    # (2, K + 1) squares of θ for each spread and the response, and their expectations for a known
    # μ.
    spread: Array
    # (3, K) squares of its logs' scores along each spread, their expectations, and what share of
    # these a robot in the middle has.
    scattered: Array
    course: tuple[Array, Array]  # (T, q, q) and (T, q): what it says of shares of the course
    response: Array  # (q,) by how much it follows the course more
    odd: Array  # (T, K) how odd its logs are


def _told(piece: tuple[TypeModel, RobotHistory, Array | None]) -> _RobotStatistics:
    """Return one robot's contribution to the model of its type."""
    model, logs, changes = piece
    fit, scale = model.fit(0, logs.equations(), changes), model.scale(0)
    links, common, columns = fit.solve(fit.seen), fit.common.shape[1], model.columns
    scores = model.log_scores(0, fit)
    squares = np.stack([fit.theta**2, 1.0 - np.diagonal(fit.covariance)])
    share, at = scale[columns.course], columns.course
    part = fit.information[:, at][:, :, at] * share[:, None] * share
    return _RobotStatistics(
        model.mean + fit.common @ fit.theta[:common],
        fit.information.sum(axis=0) - fit.seen.T @ links,
        fit.score.sum(axis=0),
        links,
        columns.parts(squares),
        _scattered(model, scale, fit, scores),
        (part, fit.score[:, at] * share),
        model.response * fit.theta[common : common + columns.sizes[-1]],
        model.oddness(scores, model.odd[0])[0],
    )


def _scattered(model: TypeModel, scale: Array, fit: RobotFit, scores: LogScores) -> Array:
    """Return (3, K) statistics of the scatter of a robot's logs, as in `_RobotStatistics`."""
    along, trace, norm = scores
    squares, norm = along.sum(axis=0), np.maximum(norm.sum(axis=0), 1e-300)
    expected = model.columns.parts(fit.expected_squares(scale[:, None] * model.factor))[:-1]
    # The middle of few squares is less than their mean; without large ones, they are less skew.
    count = np.maximum(expected * trace.sum(axis=0) / norm, 1.0)
    kept = kept_share(np.square(trace).sum(axis=0) / norm)
    middle = np.minimum(2.0 * gammaincinv(0.5 * count, 0.5) / count, kept)
    return np.stack([squares, expected, middle])


def _improved(
    model: TypeModel, logs: Sequence[RobotHistory], told: Sequence[_RobotStatistics]
) -> TypeModel:
    """Return one step of all that is learnt.

    Squared scales go by what squares of scores are over what they would be, whose fixed point is
    the largest restricted likelihood. From log to log it is the median over robots, as a robot
    that changed is none of the usual; each counts as much as its logs tell.
    """
    free = model.columns.free
    typical = np.where(model.columns.relative, model.typical, 1.0)[:, None]
    weak = sum(((typical * s.factor) @ (typical * s.factor).T for s in model.columns.spreads), 0.0)
    precision = _inverse(_WEAK**2 * np.asarray(weak)[np.ix_(free, free)])
    seen = np.sum([each.seen for each in told], axis=0)[np.ix_(free, free)] + precision
    side = np.sum([each.side for each in told], axis=0)[free]
    covariance = np.zeros_like(model.covariance)
    covariance[np.ix_(free, free)] = _inverse(seen)
    mean = model.mean.copy()
    pull = precision @ (model.columns.prior - mean)[free]
    mean[free] += covariance[np.ix_(free, free)] @ (side + pull)
    spread = _spread_ratio(model.columns, told, covariance)
    course = model.course.improved(
        logs, [each.course[0] for each in told], [each.course[1] for each in told]
    )
    course = course.stronger(np.mean([each.response for each in told], axis=0))
    return replace(
        model,
        mean=mean,
        covariance=covariance,
        deviations=np.maximum(model.deviations * np.sqrt(spread[:-1]), _LEAST),
        scatter=np.maximum(model.scatter * np.sqrt(_scatter_ratio(model, told)), _LEAST),
        response=max(model.response * float(np.sqrt(spread[-1])), _LEAST),
        course=course,
        own=np.array([each.own for each in told]),
        odd=tuple(each.odd for each in told),
    )


def _spread_ratio(
    columns: TypeColumns, told: Sequence[_RobotStatistics], covariance: Array
) -> Array:
    """Return (K + 1,) squares of θ over their expectations, of all robots, with μ learnt."""
    squares, expected = np.stack([each.spread for each in told], axis=1)
    for robot, each in enumerate(told):
        taken = np.einsum("na,ab,nb->n", each.links, covariance, each.links)
        expected[robot] -= columns.parts(taken)
    # A little as expected beside them: where nothing is seen yet, scales stay.
    squares, expected = squares + _SEEN, np.maximum(expected, 0.0) + _SEEN
    ratio = squares.sum(axis=0) / expected.sum(axis=0)
    # Friction that changed in a robot is none of its response to a season.
    ratio[-1] = np.median(squares[:, -1] / expected[:, -1])
    return np.asarray(ratio)


def _scatter_ratio(model: TypeModel, told: Sequence[_RobotStatistics]) -> Array:
    """Return (K,) squares of scores over their expectations, of the robot in the middle.

    Each robot counts as the deviations that its logs show, and what was known before as one.
    """
    squares, expected, middle = np.stack([each.scattered for each in told], axis=1)
    ratio = squares / np.maximum(middle * expected, 1e-300)
    ratio = np.vstack([ratio, np.ones_like(model.scatter)])
    weight = np.vstack([model.scatter**2 * expected, np.ones_like(model.scatter)])
    order = np.argsort(ratio, axis=0)
    ratio, weight = (np.take_along_axis(each, order, axis=0) for each in (ratio, weight))
    passed = np.cumsum(weight, axis=0) - 0.5 * weight
    half = 0.5 * weight.sum(axis=0)
    return np.array([np.interp(h, m, r) for h, m, r in zip(half, passed.T, ratio.T, strict=True)])


def least_squares(information: Array, right: Array) -> Array:
    """Return the shortest (p,) solution of normal equations, in units of the columns' own sizes."""
    unit = _units(information)
    scaled = information * unit[:, None] * unit
    return np.asarray(unit * np.linalg.lstsq(scaled, unit * right, _FLAT)[0])


def _inverse(matrix: Array) -> Array:
    """Return the inverse of a matrix of columns in several units; 0 for empty columns."""
    unit = _units(matrix)
    return np.linalg.pinv(matrix * unit[:, None] * unit, hermitian=True) * unit[:, None] * unit


def _units(matrix: Array) -> Array:
    """Return (p,) scales that give a normal matrix's columns size 1; 0 for those of size 0."""
    size = np.diagonal(matrix)
    return np.where(size > 0.0, 1.0 / np.sqrt(np.where(size > 0.0, size, 1.0)), 0.0)
