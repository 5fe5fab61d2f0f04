"""What robots of a type share, how they differ, and how the logs of each scatter: learnt at once.

    x_rt = μ + D_σ Σ_k s_k F_k w_rk + D_r (c_t ∘ (1 + a_r)) + D_r Σ_k τ_rtk F_k u_rtk + changes

μ is common, w a robot's own, c the course of all robots with each one's response 1 + a, u a log's
own. D scales relative columns by the value of the type or the robot. Scales s, τ and that of a are
those of the largest restricted likelihood; logs that scatter more than others have a larger τ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import instance, instances, integer
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.fleet.columns import TypeColumns
from geodrake.fleet.course import Course
from geodrake.fleet.history import LogEquations
from geodrake.fleet.marginals import calc_marginal
from geodrake.fleet.robot_fit import RobotFit

Array = NDArray[np.float64]

_START_DEVIATION, _START_SCATTER, _START_RESPONSE = 0.1, 0.03, 0.2
_WEAK = 10.0  # scale of spreads in the prior of what all share
_FLAT = 1e-9  # share of information that is none
_TINY = 1e-12  # expectation below which nothing is expected
_LEAST = 1e-8  # scale that is none
_FAR = 3.0  # factor between a robot's friction and the type's beyond which it is no scale
_USUAL = 4.0  # squared deviation, in its expectation, up to which a log is none that is odd


@dataclass(frozen=True, eq=False)
class TypeModel(Short):
    """What is known of a type of robots.

    Attributes:
        columns: Its columns.
        mean: (p,) parameters μ that all share.
        covariance: (p, p) covariance of μ.
        deviations: (K,) scale s of each spread, from robot to robot.
        scatter: (K,) scale τ of each spread, from log to log of one robot.
        response: Scale of a, by which robots follow the common course more or less.
        course: What all do together.
        own: (R, p) parameters of every robot, without the course and changes.
        odd: (T, K) of every robot: what τ² of each of its logs has beyond that of the type.
    """

    columns: TypeColumns
    mean: Array
    covariance: Array
    deviations: Array
    scatter: Array
    response: float
    course: Course
    own: Array
    odd: tuple[Array, ...]

    def scale(self, robot: int) -> Array:
        """(p,) what a share of each column is to a robot: its own value, for relative columns."""
        typical = _typical(self)
        own = np.clip(np.abs(self.own[robot]), typical / _FAR, _FAR * typical)
        return np.where(self.columns.relative, own, 1.0)

    def fit(
        self, robot: int, logs: LogEquations, changes: Array | None = None, odd: Array | None = None
    ) -> RobotFit:
        """A robot's own parameters by its logs.

        θ has a part for every spread, one for the response to the course, and one for changes.

        Args:
            robot: Its number.
            logs: Its logs.
            changes: (T, p, m) further parameters of its own, each N(0, 1); None if there are none.
            odd: (T, K) what τ² has beyond that of the type; None for what was learnt.
        """
        odd = self.odd[robot] if odd is None else odd
        scale, sizes = self.scale(robot), _sizes(self.columns)[:-1]
        factor = scale[:, None] * self._factor
        scales = np.repeat(np.sqrt(self.scatter**2 + odd), sizes, axis=1)
        M, m = calc_marginal(logs.information, logs.right, scales[:, None] * factor)
        together = self.together(robot, logs)
        mean = self.mean + together
        parts = [
            np.broadcast_to(part, (len(mean), *part.shape)) for part in self.deviation_factors()
        ]
        parts.append(self.response * self._spread_out(together))
        if changes is not None:
            parts.append(changes)
        design = np.concatenate(parts, axis=2)
        return RobotFit(M, m - (M @ mean[..., None])[..., 0], design)

    def oddness(
        self, robot: int, logs: LogEquations, fit: RobotFit, odd: Array
    ) -> tuple[Array, Array]:
        """How odd logs are in a fit, and what that costs.

        Deviations have the density exp(−½ z²) up to z² = `_USUAL` and (z²)^(−½ `_USUAL`) beyond,
        as those of Student's distribution have. Such a log counts as one of a larger scatter.

        Args:
            robot: The robot's number.
            logs: Its logs.
            fit: A fit of them.
            odd: (T, K) what was added to τ² in the fit.

        Returns:
            (T, K) what is to be added to τ², and (T,) minus the logarithm of what a log's density
            loses by it, at the spread where that is most.
        """
        squares, seen, _ = fit.squares(self.scale(robot)[:, None] * self._factor)
        count = np.array(_sizes(self.columns)[:-1])
        seen = np.maximum(_parts(seen, self.columns)[:, :-1] / count, 1e-300)
        squared = _parts(squares, self.columns)[:, :-1] / count
        # Scores and information know of what was odd before; these are without it.
        before = 1.0 / seen - np.minimum(odd, (1.0 - _LEAST) / seen)
        beyond = np.maximum(squared / seen**2 / (_USUAL * before), 1.0)
        return (beyond - 1.0) * before, 0.5 * _USUAL * np.log(beyond).max(axis=1)

    @cached_property
    def _factor(self) -> Array:
        """(p, r) factors of all spreads."""
        return np.hstack([spread.factor for spread in self.columns.spreads])

    def deviation_factors(self) -> list[Array]:
        """(p, r) factor of each spread between robots, in the parameters' units."""
        typical = np.where(self.columns.relative, _typical(self), 1.0)[:, None]
        return [
            s * typical * spread.factor
            for s, spread in zip(self.deviations, self.columns.spreads, strict=True)
        ]

    def together(self, robot: int, logs: LogEquations) -> Array:
        """(T, p) what the common course adds to a robot's parameters at its logs.

        Args:
            robot: Its number.
            logs: Its logs.
        """
        values = np.zeros((len(logs.days), len(self.mean)))
        values[:, self.columns.course] = self.course.of(logs)
        return np.asarray(values * self.scale(robot))

    def parameters(self, robot: int, logs: LogEquations, fit: RobotFit) -> Array:
        """(T, p) a robot's parameters at its logs by a fit, without the logs' own scatter.

        Args:
            robot: Its number.
            logs: Its logs.
            fit: The fit.
        """
        own = np.einsum("tpn,n->tp", fit.design, fit.theta)
        return np.asarray(self.mean + self.together(robot, logs) + own)

    def _spread_out(self, together: Array) -> Array:
        """(T, p, q) the course of each column as a column of its own."""
        at = np.flatnonzero(self.columns.course)
        found = np.zeros((*together.shape, len(at)))
        found[:, at, np.arange(len(at))] = together[:, at]
        return found


def learn_type(
    logs: Sequence[LogEquations],
    columns: TypeColumns,
    *,
    changes: Sequence[Array] | None = None,
    start: TypeModel | None = None,
    rounds: int = 12,
) -> TypeModel:
    """What robots of a type share, and how they differ, by the logs of all.

    Args:
        logs: Those of each robot, over the columns of the type.
        columns: What the columns are.
        changes: (T, p, m) of each robot: changes that were found in it, as further parameters.
        start: Where to begin: what was learnt before.
        rounds: Steps of the iteration.

    Raises:
        ArgumentError: There is no robot, or one has other columns.
    """
    logs = instances(logs, "logs", LogEquations)
    instance(columns, "columns", TypeColumns)
    integer(rounds, "rounds", lower=1)
    if not logs or any(each.right.shape[1:] != columns.prior.shape for each in logs):
        raise ArgumentError(
            f"Each robot of a type must have its {len(columns.prior)} columns, and there must be a "
            "robot."
        )
    if changes is not None and len(changes) != len(logs):
        raise ArgumentError(f"{len(logs)} robots have {len(changes)} arrays of changes.")
    found = _begin(logs, columns) if start is None else start
    for _ in range(rounds):
        found = _improved(found, logs, changes)
    return found


def own_parameters(model: TypeModel, fit: RobotFit) -> tuple[Array, Array]:
    """A robot's parameters (p,) without course and changes, and their covariance (p, p).

    Args:
        model: What is known of its type.
        fit: Its fit.

    Raises:
        ArgumentError: They are something else.
    """
    instance(model, "model", TypeModel)
    instance(fit, "fit", RobotFit)
    factor = np.hstack(model.deviation_factors())
    part = slice(0, factor.shape[1])
    covariance = factor @ fit.covariance[part, part] @ factor.T
    return model.mean + factor @ fit.theta[part], covariance


def _begin(logs: Sequence[LogEquations], columns: TypeColumns) -> TypeModel:
    """Pooled least squares, with the prior where logs say nothing."""
    K, p, free = len(columns.spreads), len(columns.prior), columns.free
    information = np.sum([each.information.sum(axis=0) for each in logs], axis=0)
    right = np.sum([each.right.sum(axis=0) for each in logs], axis=0)
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


def _typical(model: TypeModel) -> Array:
    """(p,) size of each column's common value; one of nothing is a thousandth of the largest."""
    size = np.abs(model.mean)
    largest = size[model.columns.relative].max(initial=0.0)
    return np.maximum(size, 1e-3 * largest if largest else 1.0)


@dataclass(frozen=True, eq=False)
class _RobotTells:
    """What one robot tells of all that is learnt.

    Attributes:
        own: (p,) its own parameters.
        seen: (p, p) what it knows of μ.
        side: (p,) by which μ should be larger, times that.
        links: (n, p) how its θ goes with μ.
        spread: (2, K + 1) squares of θ for each spread and the response, and their expectations
            for a known μ.
        scattered: (2, K) the same of its logs' scatter.
        course: (T, q, q) and (T, q): what it says of shares of the course.
        odd: (T, K) how odd its logs are.
    """

    own: Array
    seen: Array
    side: Array
    links: Array
    spread: Array
    scattered: Array
    course: tuple[Array, Array]
    odd: Array


def _told(model: TypeModel, robot: int, logs: LogEquations, changes: Array | None) -> _RobotTells:
    fit, scale = model.fit(robot, logs, changes), model.scale(robot)
    linked = fit.seen.sum(axis=0)
    links = fit.solve(linked)
    columns = model.columns
    scores, _, expected = fit.squares(scale[:, None] * model._factor)
    scattered = np.stack([scores.sum(axis=0), expected])
    squares = np.stack([fit.theta**2, 1.0 - np.diagonal(fit.covariance)])
    share, at = scale[columns.course], columns.course
    part = fit.information[:, at][:, :, at] * share[:, None] * share
    return _RobotTells(
        own_parameters(model, fit)[0],
        fit.information.sum(axis=0) - linked.T @ links,
        fit.score.sum(axis=0),
        links,
        _parts(squares, columns),
        _parts(scattered, columns)[:, :-1],
        (part, fit.score[:, at] * share),
        model.oddness(robot, logs, fit, model.odd[robot])[0],
    )


def _sizes(columns: TypeColumns) -> list[int]:
    """Parameters of each spread, and of the response to the course."""
    return [s.factor.shape[1] for s in columns.spreads] + [int(columns.course.sum())]


def _parts(values: Array, columns: TypeColumns) -> Array:
    """(..., K + 1) sums of (..., n) over the parameters of each spread, and of the response."""
    ends = np.cumsum([0, *_sizes(columns)])
    sums = np.zeros((*values.shape[:-1], ends[-1] + 1))
    kept = values[..., : ends[-1]]
    np.cumsum(kept, axis=-1, out=sums[..., 1 : kept.shape[-1] + 1])
    sums[..., kept.shape[-1] + 1 :] = sums[..., kept.shape[-1], None]
    return np.diff(sums[..., ends])


def _improved(
    model: TypeModel, logs: Sequence[LogEquations], changes: Sequence[Array] | None
) -> TypeModel:
    """One step of all that is learnt.

    Squared scales go by what squares of scores are over what they would be, whose fixed point is
    the largest restricted likelihood. From log to log it is the median over robots, as a robot
    that changed is none of the usual.
    """
    told = [
        _told(model, r, each, None if changes is None else changes[r])
        for r, each in enumerate(logs)
    ]
    free = model.columns.free
    typical = np.where(model.columns.relative, _typical(model), 1.0)[:, None]
    weak = sum(((typical * s.factor) @ (typical * s.factor).T for s in model.columns.spreads), 0.0)
    precision = np.linalg.pinv(_WEAK**2 * np.asarray(weak)[np.ix_(free, free)], hermitian=True)
    seen = np.sum([each.seen for each in told], axis=0)[np.ix_(free, free)] + precision
    side = np.sum([each.side for each in told], axis=0)[free]
    covariance = np.zeros_like(model.covariance)
    covariance[np.ix_(free, free)] = _inverse(seen)
    mean = model.mean.copy()
    pull = precision @ (model.columns.prior - mean)[free]
    mean[free] += covariance[np.ix_(free, free)] @ (side + pull)
    spread = _spread_ratio(model.columns, told, covariance)
    scattered = np.median(
        [each.scattered[0] / np.maximum(each.scattered[1], 1e-300) for each in told], axis=0
    )
    course = model.course.improved(
        logs, [each.course[0] for each in told], [each.course[1] for each in told]
    )
    return replace(
        model,
        mean=mean,
        covariance=covariance,
        deviations=np.maximum(model.deviations * np.sqrt(spread[:-1]), _LEAST),
        scatter=np.maximum(model.scatter * np.sqrt(scattered), _LEAST),
        response=max(model.response * float(np.sqrt(spread[-1])), _LEAST),
        course=course,
        own=np.array([each.own for each in told]),
        odd=tuple(each.odd for each in told),
    )


def _spread_ratio(columns: TypeColumns, told: Sequence[_RobotTells], covariance: Array) -> Array:
    """(K + 1,) squares of θ over their expectations, of all robots; μ is not known but learnt."""
    squares, expected = np.sum([each.spread for each in told], axis=0)
    for each in told:
        taken = np.einsum("na,ab,nb->n", each.links, covariance, each.links)
        expected = expected - _parts(taken, columns)
    return np.asarray(squares / np.maximum(expected, _TINY))


def least_squares(information: Array, right: Array) -> Array:
    """The shortest (p,) solution of normal equations, in units of the columns' own sizes.

    Args:
        information: (p, p) normal matrix.
        right: (p,) right side.
    """
    unit = 1.0 / np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    scaled = information * unit[:, None] * unit
    return np.asarray(unit * np.linalg.lstsq(scaled, unit * right, _FLAT)[0])


def _inverse(matrix: Array) -> Array:
    """The inverse of a positive definite matrix of columns in several units."""
    unit = 1.0 / np.sqrt(np.diagonal(matrix))
    return np.linalg.inv(matrix * unit[:, None] * unit) * unit[:, None] * unit
