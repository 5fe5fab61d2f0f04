"""Hierarchical model of a robot type: common values, differences of robots, and scatter of logs.

    x_rt = μ + D_σ Σ_k s_k F_k w_rk + D_r (c_t ∘ (1 + a_r)) + D_r Σ_k τ_rtk F_k u_rtk + changes

μ is common to all robots, w specific to a robot, c the common course over time with each robot's
response 1 + a, and u specific to a log. D scales relative columns by the value of the type or the
robot. The scales s, τ and that of a maximize the restricted likelihood; outlying logs have a larger
τ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import gammaincinv

from geodrake.boundary.showing import Short
from geodrake.fleet.history import LogEquations, RobotHistory
from geodrake.fleet.type_columns import TypeColumns, narrow_factor
from geodrake.identification.logs.dataset import Indices
from geodrake.inertia import Array


def calc_marginal(
    information: Array, right: Array, factor: Array, columns: Indices | None = None
) -> tuple[Array, Array]:
    """Return normal equations of the mean x̄ if each log has parameters x̄ + u, u ~ N(0, F Fᵀ).

    M = (H⁻¹ + F Fᵀ)⁻¹ and m = (𝟙 + H F Fᵀ)⁻¹ s, which also exist for singular H.

    Args:
        information: (..., p, p) normal matrices H.
        right: (..., p) right sides s.
        factor: (p, r) or (..., p, r) factor F of the scatter's covariance.
        columns: (c,) columns of M and elements of m to return; all if None.

    Returns:
        (..., p, c) columns of matrices M, and (..., c) right sides m.
    """
    columns = np.arange(right.shape[-1]) if columns is None else columns
    product = information @ factor
    inner = np.swapaxes(product, -1, -2) @ factor
    inner[..., np.arange(inner.shape[-1]), np.arange(inner.shape[-1])] += 1.0
    rows = np.concatenate([product[..., columns, :], right[..., None, :] @ factor], axis=-2)
    solved = np.linalg.solve(inner, np.swapaxes(rows, -1, -2))
    marginal = information[..., columns] - product @ solved[..., :-1]
    return marginal, right[..., columns] - (product[..., columns, :] @ solved[..., -1:])[..., 0]


LogScores = tuple[Array, Array, Array]
"""(T, K) squares |F_kᵀ score_t|² of logs along K factors; traces of G and G² for G = F_kᵀ M_t F_k.

G is the covariance of these scores for known parameters.
"""


@dataclass(frozen=True, eq=False)
class RobotFit(Short):
    """Parameters x_t = x̄_t + L_t θ of logs t, with θ ~ N(0, 𝟙) and L_t = [A, B_t]."""

    information: Array  # (T, p, p) normal matrices M_t of the logs' means
    residual: Array  # (T, p) right sides minus the part due to x̄_t, m_t − M_t x̄_t
    common: Array  # (p, a) map A, the same for all logs
    per_log: Array  # (T, p, b) maps B_t

    @property
    def size(self) -> int:
        """Number n of parameters θ."""
        return self.common.shape[1] + self.per_log.shape[2]

    def mapped(self, rows: Array) -> Array:
        """Return (T, c, n) products of rows (T, c, p) and L_t."""
        return np.concatenate([rows @ self.common, rows @ self.per_log], axis=2)

    def cross_with(self, factor: Array) -> Array:
        """Return (T, n, r) products L_tᵀ M_t F with directions F (p, r)."""
        return np.swapaxes(self.mapped(np.swapaxes(self.information @ factor, 1, 2)), 1, 2)

    @cached_property
    def cross(self) -> Array:
        """(n, p) sum of all products L_tᵀ M_t."""
        lower = np.einsum("tpb,tpq->bq", self.per_log, self.information, optimize=True)
        return np.vstack([self.common.T @ self.information.sum(axis=0), lower])

    @cached_property
    def _factor(self) -> tuple[Array, bool]:
        a, n = self.common.shape[1], self.size
        product = self.information @ self.per_log
        normal = np.eye(n)
        normal[:, :a] += self.cross @ self.common
        normal[a:, a:] += np.einsum("tpb,tpc->bc", self.per_log, product, optimize=True)
        factor: tuple[Array, bool] = cho_factor(normal, lower=True)  # uses the lower triangle only
        return factor

    def solve(self, right: Array) -> Array:
        """Return N⁻¹ times (n,) or (n, m), with the normal matrix N = 𝟙 + Σ L_tᵀ M_t L_t."""
        return np.asarray(cho_solve(self._factor, right))

    @cached_property
    def covariance(self) -> Array:
        """(n, n) covariance N⁻¹ of θ."""
        return self.solve(np.eye(self.size))

    @cached_property
    def theta(self) -> Array:
        """(n,) the estimate of θ."""
        lower = np.einsum("tpb,tp->b", self.per_log, self.residual)
        return self.solve(np.append(self.common.T @ self.residual.sum(axis=0), lower))

    @cached_property
    def deviation(self) -> Array:
        """(T, p) contribution of θ to the parameters of each log, L_t θ."""
        a = self.common.shape[1]
        return np.asarray(self.common @ self.theta[:a] + self.per_log @ self.theta[a:])

    @cached_property
    def score(self) -> Array:
        """(T, p) score of each log, residual_t − M_t L_t θ."""
        return np.asarray(self.residual - (self.information @ self.deviation[..., None])[..., 0])

    def scores(self, factors: Sequence[Array]) -> LogScores:
        """Return the size of scores along the directions of K factors F_k (p, r_k)."""
        ends = np.cumsum([factor.shape[1] for factor in factors])[:-1]
        stacked = np.hstack(factors)
        squares = np.split((self.score @ stacked) ** 2, ends, axis=1)
        products = np.split(self.information @ stacked, ends, axis=2)
        blocks = [factor.T @ x for factor, x in zip(factors, products, strict=True)]
        return (
            np.stack([x.sum(axis=1) for x in squares], axis=1),
            np.stack([np.trace(G, axis1=1, axis2=2) for G in blocks], axis=1),
            np.stack([np.square(G).sum(axis=(1, 2)) for G in blocks], axis=1),
        )

    def expected_squares(self, factor: Array) -> Array:
        """Return (r,) expected sums of squares of Fᵀ score_t, F (p, r), if the model is correct."""
        total = np.einsum("pr,pr->r", factor, self.information.sum(axis=0) @ factor)
        cross = self.cross_with(factor).transpose(1, 0, 2)
        flat = cross.reshape(len(cross), -1)
        fitted = np.sum((flat * self.solve(flat)).reshape(cross.shape), axis=(0, 1))
        return np.maximum(total - fitted, 0.0)  # against rounding


LEAST_ROBOTS = 5
"""Minimum number of robots with logs on a day for which the common course is estimated."""

_PRIOR_DEVIATION = 1.0  # of the course: friction may double
_RIDGE = 1e-12  # relative regularization


@dataclass(frozen=True, eq=False)
class Course(Short):
    """Common course over time: relative changes of columns of all robots."""

    days: Array  # (D,) whole days on which enough robots have logs, ascending
    values: Array  # (D, q) relative changes on each day, with mean 0
    slope: Array  # (q,) relative change per degree, 1/°C, for logs with temperatures
    reference: float  # reference temperature, °C

    @classmethod
    def zero(cls, logs: Sequence[RobotHistory], columns: int) -> Course:
        """Return a course of zeros."""
        days_by_robot = [np.unique(np.floor(robot.days)) for robot in logs]
        days, robots = np.unique(np.concatenate(days_by_robot), return_counts=True)
        days = days[robots >= LEAST_ROBOTS]
        temperature = np.concatenate([robot.temperature for robot in logs])
        finite = temperature[np.isfinite(temperature)]
        reference = float(finite.mean()) if len(finite) else 0.0
        return cls(days, np.zeros((len(days), columns)), np.zeros(columns), reference)

    def at(self, logs: RobotHistory | LogEquations) -> Array:
        """Return (T, q) relative changes at a robot's logs, interpolated between days."""
        values = self._temperature_difference(logs)[:, None] * self.slope
        if self.values.size:
            days = np.floor(logs.days)
            values = values + np.stack([np.interp(days, self.days, c) for c in self.values.T], -1)
        return np.asarray(values)

    def updated(
        self, logs: Sequence[RobotHistory], information: Sequence[Array], right: Sequence[Array]
    ) -> Course:
        """Return the course after a step of its fit to the logs.

        Args:
            information: (T, q, q) of each robot, on relative changes at its logs.
            right: (T, q) of each robot, right sides minus the part due to the course.
        """
        temperatures = [self._temperature_difference(robot) for robot in logs]
        course = self
        if any(difference.any() for difference in temperatures):
            slope = _slope(temperatures, information, right)
            right = [
                r - difference[:, None] * (info @ slope)
                for difference, info, r in zip(temperatures, information, right, strict=True)
            ]
            course = replace(self, slope=self.slope + slope)
        return course._with_days_updated(logs, information, right)

    def scaled(self, share: Array) -> Course:
        """Return the course multiplied by 1 + share, share (q,)."""
        return replace(self, values=self.values * (1.0 + share), slope=self.slope * (1.0 + share))

    def _with_days_updated(
        self, logs: Sequence[RobotHistory], information: Sequence[Array], right: Sequence[Array]
    ) -> Course:
        D, q = self.values.shape
        if not self.values.size:
            return self
        normal = np.tile(np.eye(q) / _PRIOR_DEVIATION**2, (D, 1, 1))
        side = -self.values / _PRIOR_DEVIATION**2
        for robot, info, r in zip(logs, information, right, strict=True):
            day = np.floor(robot.days)
            index = np.minimum(np.searchsorted(self.days, day), D - 1)
            has_day = self.days[index] == day
            np.add.at(normal, index[has_day], info[has_day])
            np.add.at(side, index[has_day], r[has_day])
        values = self.values + np.linalg.solve(normal, side[..., None])[..., 0]
        return replace(self, values=values - values.mean(axis=0))

    def _temperature_difference(self, logs: RobotHistory | LogEquations) -> Array:
        """Return (T,) temperatures relative to the reference, °C; 0 where unknown."""
        return np.nan_to_num(logs.temperature - self.reference)


def _slope(
    temperatures: Sequence[Array], information: Sequence[Array], right: Sequence[Array]
) -> Array:
    """Return (q,) relative changes per degree, from all logs."""
    q = right[0].shape[1]
    normal, side = np.zeros((q, q)), np.zeros(q)
    for difference, info, r in zip(temperatures, information, right, strict=True):
        normal += np.einsum("t,tab->ab", difference**2, info)
        side += difference @ r
    normal[np.arange(q), np.arange(q)] += _RIDGE * np.trace(normal) + np.finfo(float).tiny
    return np.asarray(np.linalg.solve(normal, side))


_LEAST = 1e-8  # lower bound of scales, relative
_LARGEST_RATIO = 3.0  # bound of a robot's scale relative to the type's
_OUTLIER = 4.0  # squared deviation over its expectation, above which a log is an outlier


@dataclass(frozen=True, eq=False)
class TypeModel(Short):
    """The learnt model of a type of robots."""

    columns: TypeColumns
    mean: Array  # (p,) common parameters μ
    covariance: Array  # (p, p) covariance of μ
    deviations: Array  # (K,) scale s of each spread, between robots
    scatter: Array  # (K,) scale τ of each spread, between logs of one robot
    response: float  # scale of a, the deviation of a robot's response to the common course
    course: Course
    robot_values: Array  # (R, p) parameters of each robot, without course and changes
    excess: tuple[Array, ...]  # (T, K) of each robot: excess of τ² of its logs over the type's

    @cached_property
    def typical(self) -> Array:
        """(p,) size of each common value, at least a thousandth of the largest of its kind."""
        size, columns = np.abs(self.mean), self.columns
        same_kind = columns.alike() & columns.relative
        largest = np.where(same_kind, size, 0.0).max(axis=1)
        return np.maximum(size, 1e-3 * np.where(largest > 0.0, largest, 1e3))

    def for_robot(self, robot: int) -> TypeModel:
        """Return the model restricted to one robot, which gets index 0."""
        part = slice(robot, robot + 1)
        return replace(self, robot_values=self.robot_values[part], excess=self.excess[part])

    def scale(self, robot: int) -> Array:
        """Return (p,) units of a robot's columns: its value for relative columns, otherwise 1."""
        lower, upper = self.typical / _LARGEST_RATIO, self.typical * _LARGEST_RATIO
        values = np.clip(np.abs(self.robot_values[robot]), lower, upper)
        return np.where(self.columns.relative, values, 1.0)

    def fit(
        self,
        robot: int,
        logs: LogEquations,
        changes: Array | None = None,
        excess: Array | None = None,
    ) -> RobotFit:
        """Fit a robot's parameters to its logs.

        θ consists of the spreads, the response to the course, and changes.

        Args:
            changes: (T, p, m) map of changes, each N(0, 1), if any.
            excess: (T, K) excess of τ² over the type's; None for the learnt one.
        """
        excess = self.excess[robot] if excess is None else excess
        factors = self._scatter_factors(self.scale(robot), excess)
        M, m = calc_marginal(logs.information, logs.right, factors)
        M = 0.5 * (M + np.swapaxes(M, 1, 2))  # symmetric despite rounding
        course = self.common_course(robot, logs)
        mean = self.mean + course
        common = np.hstack(self.deviation_factors())
        response = self.response * self._course_columns(course)
        fit = RobotFit(M, m - (M @ mean[..., None])[..., 0], common, response)
        return fit if changes is None else self.with_changes(fit, changes)

    def with_changes(self, fit: RobotFit, changes: Array) -> RobotFit:
        """Return a fit of the same logs with other changes (T, p, m), each N(0, 1)."""
        response = fit.per_log[:, :, : self.columns.sizes[-1]]
        return replace(fit, per_log=np.concatenate([response, changes], axis=2))

    def log_scores(self, robot: int, fit: RobotFit) -> LogScores:
        """Return the size of the scores of a robot's logs along each spread."""
        scale = self.scale(robot)[:, None]
        return fit.scores([scale * spread.factor for spread in self.columns.spreads])

    def updated_excess(self, scores: LogScores, excess: Array) -> tuple[Array, Array]:
        """Return the excess scatter of outlying logs in a fit, and its cost.

        Deviations have the density exp(−½ z²) up to z² = `_OUTLIER`, and (z²)^(−½ `_OUTLIER`)
        beyond, like Student's t-distribution. An outlying log is given a larger scatter.

        Args:
            excess: (T, K) excess of τ² in the fit.

        Returns:
            (T, K) updated excess of τ², and (T,) reduction of each log's log-density by it, for the
            spread with the largest.
        """
        # Averages over the directions that a log determines; 0 if it determines none.
        squares, trace, norm = scores
        norm = np.where(norm > 0.0, norm, 1.0)
        squared, expected = squares / norm, trace / norm
        # Both include the present excess; the variance without it:
        variance = np.maximum(expected - excess, _LEAST * expected)
        new_excess = np.maximum(squared / _OUTLIER - variance, 0.0)
        cost = 0.5 * _OUTLIER * np.log1p(new_excess / np.maximum(variance, 1e-300))
        return new_excess, cost.max(axis=1)

    @cached_property
    def factor(self) -> Array:
        """(p, r) factors of all spreads."""
        return np.hstack([spread.factor for spread in self.columns.spreads])

    def deviation_factors(self) -> list[Array]:
        """Return (p, r) factor of each spread between robots, in the parameters' units."""
        typical = np.where(self.columns.relative, self.typical, 1.0)[:, None]
        return [
            s * typical * spread.factor
            for s, spread in zip(self.deviations, self.columns.spreads, strict=True)
        ]

    def common_course(self, robot: int, logs: LogEquations) -> Array:
        """Return (T, p) the contribution of the common course to a robot's parameters."""
        values = np.zeros((len(logs.days), len(self.mean)))
        values[:, self.columns.course] = self.course.at(logs)
        return np.asarray(values * self.scale(robot))

    def parameters(self, robot: int, logs: LogEquations, fit: RobotFit) -> Array:
        """Return (T, p) a robot's fitted parameters at its logs, without the logs' scatter."""
        return np.asarray(self.mean + self.common_course(robot, logs) + fit.deviation)

    def _scatter_factors(self, scale: Array, excess: Array) -> Array:
        """Return (T, p, q) factors of the covariance of each log's scatter."""
        distinct, indices = np.unique(excess, axis=0, return_inverse=True)  # most are equal
        scales = np.repeat(np.sqrt(self.scatter**2 + distinct), self.columns.sizes[:-1], axis=1)
        factors = narrow_factor(scales[:, None] * scale[:, None] * self.factor)
        return np.asarray(factors[indices.ravel()])

    def _course_columns(self, course: Array) -> Array:
        """Return (T, p, q) the course of each of the q columns as a separate column."""
        indices = np.flatnonzero(self.columns.course)
        columns = np.zeros((*course.shape, len(indices)))
        columns[:, indices, np.arange(len(indices))] = course[:, indices]
        return columns


def kept_share(directions: Array) -> Array:
    """Return (...) the fraction of squared scores after down-weighting, without outlying logs.

    It depends on the number of directions of a spread that the log determines.
    """
    return np.interp(directions, *_kept_shares())


@cache
def _kept_shares() -> tuple[Array, Array]:
    """Return numbers of directions r, and the fraction for each, with mean z² ~ χ²_r / r."""
    directions = np.arange(1.0, 7.0)
    quantiles = (np.arange(1000) + 0.5) / 1000
    squares = 2.0 * gammaincinv(0.5 * directions[:, None], quantiles) / directions[:, None]
    variance = np.maximum(squares / _OUTLIER, 1.0)  # relative to logs that are not outliers
    return directions, (squares / variance**2).mean(axis=1) / (1.0 / variance).mean(axis=1)


def own_parameters(model: TypeModel, fit: RobotFit) -> tuple[Array, Array]:
    """Return a robot's parameters (p,) without course and changes, and their covariance (p, p)."""
    factor = fit.common
    part = slice(0, factor.shape[1])
    covariance = factor @ fit.covariance[part, part] @ factor.T
    # Uncertainty of the common values, where the robot's logs do not determine its own.
    undetermined = np.eye(len(factor)) - factor @ fit.solve(fit.cross)[part]
    covariance += undetermined @ model.covariance @ undetermined.T
    return model.mean + factor @ fit.theta[part], covariance
