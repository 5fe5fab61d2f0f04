"""A model of a type: common values, differences of robots, and the scatter of logs, learnt jointly.

    x_rt = μ + D_σ Σ_k s_k F_k w_rk + D_r (c_t ∘ (1 + a_r)) + D_r Σ_k τ_rtk F_k u_rtk + changes

μ is common, w a robot's own, c the course of all robots with each one's response 1 + a, u a log's
own. D scales relative columns by the value of the type or the robot. Scales s, τ and that of a are
those of the largest restricted likelihood; logs that scatter more than others have a larger τ.
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
    """Return normal equations of the mean x̄, where each log has parameters x̄ + u, u ~ N(0, F Fᵀ).

    M = (H⁻¹ + F Fᵀ)⁻¹ and m = (𝟙 + H F Fᵀ)⁻¹ s, which exist for singular H too.

    Args:
        information: (..., p, p) normal matrices H.
        right: (..., p) right sides s.
        factor: (p, r) or (..., p, r) factor F of the scatter's covariance.
        columns: (c,) which columns of M and elements of m are asked for; all if None.

    Returns:
        (..., p, c) columns of matrices M, and (..., c) right sides m.
    """
    columns = np.arange(right.shape[-1]) if columns is None else columns
    seen = information @ factor
    inner = np.swapaxes(seen, -1, -2) @ factor
    inner[..., np.arange(inner.shape[-1]), np.arange(inner.shape[-1])] += 1.0
    rows = np.concatenate([seen[..., columns, :], right[..., None, :] @ factor], axis=-2)
    solved = np.linalg.solve(inner, np.swapaxes(rows, -1, -2))
    marginal = information[..., columns] - seen @ solved[..., :-1]
    return marginal, right[..., columns] - (seen[..., columns, :] @ solved[..., -1:])[..., 0]


LogScores = tuple[Array, Array, Array]
"""(T, K) squares |F_kᵀ score_t|² of logs along K factors; traces of G and G² for G = F_kᵀ M_t F_k.

G is the covariance of these scores where parameters are known.
"""


@dataclass(frozen=True, eq=False)
class RobotFit(Short):
    """Parameters x_t = x̄_t + L_t θ of logs t, with θ ~ N(0, 𝟙) and L_t = [A, B_t]."""

    information: Array  # (T, p, p) normal matrices M_t of the logs' means
    rest: Array  # (T, p) right sides less what x̄_t explains, m_t − M_t x̄_t
    common: Array  # (p, a) map A, which all logs have
    own: Array  # (T, p, b) maps B_t

    @property
    def size(self) -> int:
        """Number n of parameters θ."""
        return self.common.shape[1] + self.own.shape[2]

    def mapped(self, rows: Array) -> Array:
        """Return (T, c, n) products of rows (T, c, p) and L_t."""
        return np.concatenate([rows @ self.common, rows @ self.own], axis=2)

    def seen_along(self, factor: Array) -> Array:
        """Return (T, n, r) products L_tᵀ M_t F with directions F (p, r)."""
        return np.swapaxes(self.mapped(np.swapaxes(self.information @ factor, 1, 2)), 1, 2)

    @cached_property
    def seen(self) -> Array:
        """(n, p) sum of all products L_tᵀ M_t."""
        by_own = np.einsum("tpb,tpq->bq", self.own, self.information, optimize=True)
        return np.vstack([self.common.T @ self.information.sum(axis=0), by_own])

    @cached_property
    def _factor(self) -> tuple[Array, bool]:
        a, n = self.common.shape[1], self.size
        seen, own = self.information @ self.own, self.own
        normal = np.eye(n)
        normal[:, :a] += self.seen @ self.common
        normal[a:, a:] += np.einsum("tpb,tpc->bc", own, seen, optimize=True)
        found: tuple[Array, bool] = cho_factor(normal, lower=True)  # what is above does not count
        return found

    def solve(self, right: Array) -> Array:
        """Return N⁻¹ times (n,) or (n, m), with the normal matrix N = 𝟙 + Σ L_tᵀ M_t L_t."""
        return np.asarray(cho_solve(self._factor, right))

    @cached_property
    def covariance(self) -> Array:
        """(n, n) covariance N⁻¹ of θ."""
        return self.solve(np.eye(self.size))

    @cached_property
    def theta(self) -> Array:
        """(n,) the best θ."""
        of_own = np.einsum("tpb,tp->b", self.own, self.rest)
        return self.solve(np.append(self.common.T @ self.rest.sum(axis=0), of_own))

    @cached_property
    def deviation(self) -> Array:
        """(T, p) the contribution of θ to the parameters of every log, L_t θ."""
        a = self.common.shape[1]
        return np.asarray(self.common @ self.theta[:a] + self.own @ self.theta[a:])

    @cached_property
    def score(self) -> Array:
        """(T, p) the remainder of every log's right side, rest_t − M_t L_t θ."""
        return np.asarray(self.rest - (self.information @ self.deviation[..., None])[..., 0])

    def scores(self, factors: Sequence[Array]) -> LogScores:
        """Return how large scores are along the directions of K factors F_k (p, r_k)."""
        ends = np.cumsum([factor.shape[1] for factor in factors])[:-1]
        every = np.hstack(factors)
        along = np.split((self.score @ every) ** 2, ends, axis=1)
        shown = np.split(self.information @ every, ends, axis=2)
        blocks = [f.T @ each for f, each in zip(factors, shown, strict=True)]
        return (
            np.stack([each.sum(axis=1) for each in along], axis=1),
            np.stack([np.trace(each, axis1=1, axis2=2) for each in blocks], axis=1),
            np.stack([np.square(each).sum(axis=(1, 2)) for each in blocks], axis=1),
        )

    def expected_squares(self, factor: Array) -> Array:
        """Return (r,) sums of squares of Fᵀ score_t, F (p, r), expected if the model is right."""
        own = np.einsum("pr,pr->r", factor, self.information.sum(axis=0) @ factor)
        part = self.seen_along(factor).transpose(1, 0, 2)
        flat = part.reshape(len(part), -1)
        fitted = np.sum((flat * self.solve(flat)).reshape(part.shape), axis=(0, 1))
        return np.maximum(own - fitted, 0.0)  # what rounding makes of nothing


LEAST_ROBOTS = 5
"""Robots of a day below which it is not told what all do together; neighbouring days are."""

_WIDE = 1.0  # deviation of a course before logs are seen: friction may double
_FLAT = 1e-12  # share of information that is none


@dataclass(frozen=True, eq=False)
class Course(Short):
    """Shares by which columns of all robots are larger."""

    days: Array  # (D,) whole days on which enough robots have logs, ascending
    values: Array  # (D, q) shares on each day, of mean 0
    slope: Array  # (q,) what a degree adds, 1/°C, where logs have temperatures
    reference: float

    @classmethod
    def begin(cls, logs: Sequence[RobotHistory], columns: int) -> Course:
        """Return a course of zeros."""
        each = [np.unique(np.floor(robot.days)) for robot in logs]
        days, robots = np.unique(np.concatenate(each), return_counts=True)
        days = days[robots >= LEAST_ROBOTS]
        warm = np.concatenate([robot.temperature for robot in logs])
        known = warm[np.isfinite(warm)]
        reference = float(known.mean()) if len(known) else 0.0
        return cls(days, np.zeros((len(days), columns)), np.zeros(columns), reference)

    def of(self, logs: RobotHistory | LogEquations) -> Array:
        """Return (T, q) shares at a robot's logs; between days with too few robots it is linear."""
        values = self._warmer(logs)[:, None] * self.slope
        if self.values.size:
            at = np.floor(logs.days)
            values = values + np.stack([np.interp(at, self.days, c) for c in self.values.T], -1)
        return np.asarray(values)

    def improved(
        self, logs: Sequence[RobotHistory], information: Sequence[Array], right: Sequence[Array]
    ) -> Course:
        """Return the course after a step of its fit to the logs.

        Args:
            information: (T, q, q) of each robot: what its logs say of shares.
            right: (T, q) of each robot: its right sides, less what the course explains.
        """
        warm = [self._warmer(each) for each in logs]
        if any(each.any() for each in warm):
            slope = _slope(warm, information, right)
            right = [
                r - w[:, None] * (info @ slope)
                for w, info, r in zip(warm, information, right, strict=True)
            ]
            with_slope = replace(self, slope=self.slope + slope)
        else:
            with_slope = self
        return with_slope._day_by_day(logs, information, right)

    def stronger(self, share: Array) -> Course:
        """Return the course of robots that all follow it more than was thought, by shares (q,)."""
        return replace(self, values=self.values * (1.0 + share), slope=self.slope * (1.0 + share))

    def _day_by_day(
        self, logs: Sequence[RobotHistory], information: Sequence[Array], right: Sequence[Array]
    ) -> Course:
        D, q = self.values.shape
        if not self.values.size:
            return self
        seen, side = np.tile(np.eye(q) / _WIDE**2, (D, 1, 1)), -self.values / _WIDE**2
        for each, info, rest in zip(logs, information, right, strict=True):
            day = np.floor(each.days)
            at = np.minimum(np.searchsorted(self.days, day), D - 1)
            known = self.days[at] == day
            np.add.at(seen, at[known], info[known])
            np.add.at(side, at[known], rest[known])
        values = self.values + np.linalg.solve(seen, side[..., None])[..., 0]
        return replace(self, values=values - values.mean(axis=0))

    def _warmer(self, logs: RobotHistory | LogEquations) -> Array:
        """Return (T,) degrees above the reference; 0 where the temperature is not known."""
        return np.nan_to_num(logs.temperature - self.reference)


def _slope(warm: Sequence[Array], information: Sequence[Array], right: Sequence[Array]) -> Array:
    """Return (q,) the effect of a degree more, from all logs."""
    q = right[0].shape[1]
    seen, side = np.zeros((q, q)), np.zeros(q)
    for w, info, rest in zip(warm, information, right, strict=True):
        seen += np.einsum("t,tab->ab", w**2, info)
        side += w @ rest
    seen[np.arange(q), np.arange(q)] += _FLAT * np.trace(seen) + np.finfo(float).tiny
    return np.asarray(np.linalg.solve(seen, side))


_LEAST = 1e-8  # scale that is none
_FAR = 3.0  # factor between a robot's friction and the type's beyond which it is no scale
_USUAL = 4.0  # squared deviation, in its expectation, up to which a log is none that is odd


@dataclass(frozen=True, eq=False)
class TypeModel(Short):
    """The learnt model of a type of robots."""

    columns: TypeColumns
    mean: Array  # (p,) parameters μ that all share
    covariance: Array  # (p, p) covariance of μ
    deviations: Array  # (K,) scale s of each spread, from robot to robot
    scatter: Array  # (K,) scale τ of each spread, from log to log of one robot
    response: float  # scale of a, by which robots follow the common course more or less
    course: Course
    own: Array  # (R, p) parameters of every robot, without the course and changes
    # (T, K) of every robot: what τ² of each of its logs has beyond that of the type.
    odd: tuple[Array, ...]

    @cached_property
    def typical(self) -> Array:
        """(p,) size of each common value; of one that is 0, a thousandth of its kind's largest."""
        size, columns = np.abs(self.mean), self.columns
        like = columns.alike() & columns.relative
        largest = np.where(like, size, 0.0).max(axis=1)
        return np.maximum(size, 1e-3 * np.where(largest > 0.0, largest, 1e3))

    def of(self, robot: int) -> TypeModel:
        """Return the type as seen by one of its robots, which gets number 0."""
        one = slice(robot, robot + 1)
        return replace(self, own=self.own[one], odd=self.odd[one])

    def scale(self, robot: int) -> Array:
        """Return (p,) each column's unit for a robot: its own value, for relative columns."""
        typical = self.typical
        own = np.clip(np.abs(self.own[robot]), typical / _FAR, _FAR * typical)
        return np.where(self.columns.relative, own, 1.0)

    def fit(
        self, robot: int, logs: LogEquations, changes: Array | None = None, odd: Array | None = None
    ) -> RobotFit:
        """Return a robot's own parameters by its logs.

        θ has a part for every spread, one for the response to the course, and one for changes.

        Args:
            changes: (T, p, m) further parameters of its own, each N(0, 1); None if there are none.
            odd: (T, K) what τ² has beyond that of the type; None for what was learnt.
        """
        odd = self.odd[robot] if odd is None else odd
        scattered = self._scattered(self.scale(robot), odd)
        M, m = calc_marginal(logs.information, logs.right, scattered)
        M = 0.5 * (M + np.swapaxes(M, 1, 2))  # which rounding makes not quite symmetric
        together = self.together(robot, logs)
        mean = self.mean + together
        common = np.hstack(self.deviation_factors())
        response = self.response * self._spread_out(together)
        fit = RobotFit(M, m - (M @ mean[..., None])[..., 0], common, response)
        return fit if changes is None else self.with_changes(fit, changes)

    def with_changes(self, fit: RobotFit, changes: Array) -> RobotFit:
        """Return a fit of the same logs with other changes (T, p, m), each N(0, 1)."""
        response = fit.own[:, :, : self.columns.sizes[-1]]
        return replace(fit, own=np.concatenate([response, changes], axis=2))

    def log_scores(self, robot: int, fit: RobotFit) -> LogScores:
        """Return how large scores of a robot's logs are along each spread."""
        scale = self.scale(robot)[:, None]
        return fit.scores([scale * spread.factor for spread in self.columns.spreads])

    def oddness(self, scores: LogScores, odd: Array) -> tuple[Array, Array]:
        """Return how odd logs are in a fit, and the cost of that.

        Deviations have the density exp(−½ z²) up to z² = `_USUAL` and (z²)^(−½ `_USUAL`) beyond,
        as those of Student's distribution have. Such a log counts as one of a larger scatter.

        Args:
            odd: (T, K) what was added to τ² in the fit.

        Returns:
            (T, K) what is to be added to τ², and (T,) minus the logarithm of what a log's density
            loses by it, at the spread where that is most.
        """
        # Of directions of a spread count those of which a log tells: squared deviations and what
        # they are expected to be. Where it tells nothing, both are 0.
        squares, trace, norm = scores
        norm = np.where(norm > 0.0, norm, 1.0)
        squared, expected = squares / norm, trace / norm
        # Both know of what was odd before; a log's own scatter does not.
        before = np.maximum(expected - odd, _LEAST * expected)
        beyond = np.maximum(squared / _USUAL - before, 0.0)
        cost = 0.5 * _USUAL * np.log1p(beyond / np.maximum(before, 1e-300))
        return beyond, cost.max(axis=1)

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

    def together(self, robot: int, logs: LogEquations) -> Array:
        """Return (T, p) the common course in a robot's parameters at its logs."""
        values = np.zeros((len(logs.days), len(self.mean)))
        values[:, self.columns.course] = self.course.of(logs)
        return np.asarray(values * self.scale(robot))

    def parameters(self, robot: int, logs: LogEquations, fit: RobotFit) -> Array:
        """Return (T, p) a robot's parameters at its logs by a fit, without the logs' scatter."""
        return np.asarray(self.mean + self.together(robot, logs) + fit.deviation)

    def _scattered(self, scale: Array, odd: Array) -> Array:
        """Return (T, p, q) factors of the covariance by which logs scatter; most have the same."""
        different, which = np.unique(odd, axis=0, return_inverse=True)
        scales = np.repeat(np.sqrt(self.scatter**2 + different), self.columns.sizes[:-1], axis=1)
        factors = narrow_factor(scales[:, None] * scale[:, None] * self.factor)
        return np.asarray(factors[which.ravel()])

    def _spread_out(self, together: Array) -> Array:
        """Return (T, p, q) the course of each column in a column of its own."""
        at = np.flatnonzero(self.columns.course)
        found = np.zeros((*together.shape, len(at)))
        found[:, at, np.arange(len(at))] = together[:, at]
        return found


def kept_share(directions: Array) -> Array:
    """Return (...) the share of squared scores that is left by down-weighting if no log is odd.

    It depends on how many directions of a spread the log identifies.
    """
    return np.interp(directions, *_kept_shares())


@cache
def _kept_shares() -> tuple[Array, Array]:
    """Return numbers of directions, and the share for each, over those of mean z² ~ χ²_r / r."""
    directions = np.arange(1.0, 7.0)
    middles = (np.arange(1000) + 0.5) / 1000
    squares = 2.0 * gammaincinv(0.5 * directions[:, None], middles) / directions[:, None]
    larger = np.maximum(squares / _USUAL, 1.0)  # the variance of an odd log, in that of others
    return directions, (squares / larger**2).mean(axis=1) / (1.0 / larger).mean(axis=1)


def own_parameters(model: TypeModel, fit: RobotFit) -> tuple[Array, Array]:
    """Return a robot's parameters (p,) without course and changes, and their covariance (p, p)."""
    factor = fit.common
    part = slice(0, factor.shape[1])
    covariance = factor @ fit.covariance[part, part] @ factor.T
    # If all robots have more of something, this one has it where its logs do not say otherwise.
    silent = np.eye(len(factor)) - factor @ fit.solve(fit.seen)[part]
    covariance += silent @ model.covariance @ silent.T
    return model.mean + factor @ fit.theta[part], covariance
