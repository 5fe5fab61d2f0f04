"""What robots of a type share, how they differ, and how the logs of each scatter: learnt at once.

    x_rt = μ + D_σ Σ_k s_k F_k w_rk + D_r (c_t ∘ (1 + a_r)) + D_r Σ_k τ_rtk F_k u_rtk + changes

μ is common, w a robot's own, c the course of all robots with each one's response 1 + a, u a log's
own. D scales relative columns by the value of the type or the robot. Scales s, τ and that of a are
those of the largest restricted likelihood; logs that scatter more than others have a larger τ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from geodrake.boundary.arguments import instance
from geodrake.boundary.showing import Short
from geodrake.fleet.columns import TypeColumns
from geodrake.fleet.course import Course
from geodrake.fleet.history import LogEquations
from geodrake.fleet.marginals import calc_marginal, narrow_factor
from geodrake.fleet.robot_fit import LogScores, RobotFit

Array = NDArray[np.float64]

_LEAST = 1e-8  # scale that is none
_FAR = 3.0  # factor between a robot's friction and the type's beyond which it is no scale
_USUAL = 4.0  # squared deviation, in its expectation, up to which a log is none that is odd


@dataclass(frozen=True, eq=False)
class TypeModel(Short):
    """What is known of a type of robots.

    Attributes:
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

    @cached_property
    def typical(self) -> Array:
        """(p,) size of each common value; of one of nothing a thousandth of the largest like it."""
        size, columns = np.abs(self.mean), self.columns
        like = columns.alike() & columns.relative
        largest = np.where(like, size, 0.0).max(axis=1)
        return np.maximum(size, 1e-3 * np.where(largest > 0.0, largest, 1e3))

    def of(self, robot: int) -> TypeModel:
        """The type as one of its robots alone needs it, whose number is 0."""
        one = slice(robot, robot + 1)
        return replace(self, own=self.own[one], odd=self.odd[one])

    def scale(self, robot: int) -> Array:
        """(p,) what a share of each column is to a robot: its own value, for relative columns."""
        typical = self.typical
        own = np.clip(np.abs(self.own[robot]), typical / _FAR, _FAR * typical)
        return np.where(self.columns.relative, own, 1.0)

    def fit(
        self, robot: int, logs: LogEquations, changes: Array | None = None, odd: Array | None = None
    ) -> RobotFit:
        """A robot's own parameters by its logs.

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
        """A fit of the same logs with other changes.

        Args:
            changes: (T, p, m) further parameters, each N(0, 1).
        """
        response = fit.own[:, :, : self.columns.sizes[-1]]
        return replace(fit, own=np.concatenate([response, changes], axis=2))

    def log_scores(self, robot: int, fit: RobotFit) -> LogScores:
        """How large scores of a robot's logs are along each spread."""
        scale = self.scale(robot)[:, None]
        return fit.scores([scale * spread.factor for spread in self.columns.spreads])

    def oddness(self, scores: LogScores, odd: Array) -> tuple[Array, Array]:
        """How odd logs are in a fit, and what that costs.

        Deviations have the density exp(−½ z²) up to z² = `_USUAL` and (z²)^(−½ `_USUAL`) beyond,
        as those of Student's distribution have. Such a log counts as one of a larger scatter.

        Args:
            scores: What the fit leaves along each spread.
            odd: (T, K) what was added to τ² in the fit.

        Returns:
            (T, K) what is to be added to τ², and (T,) minus the logarithm of what a log's density
            loses by it, at the spread where that is most.
        """
        # Of directions of a spread count those of which a log tells: squared deviations and what
        # they are expected to be. Where it tells nothing, both are 0.
        norm = np.where(scores.norm > 0.0, scores.norm, 1.0)
        squared, expected = scores.squares / norm, scores.trace / norm
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
        """(p, r) factor of each spread between robots, in the parameters' units."""
        typical = np.where(self.columns.relative, self.typical, 1.0)[:, None]
        return [
            s * typical * spread.factor
            for s, spread in zip(self.deviations, self.columns.spreads, strict=True)
        ]

    def together(self, robot: int, logs: LogEquations) -> Array:
        """(T, p) what the common course adds to a robot's parameters at its logs."""
        values = np.zeros((len(logs.days), len(self.mean)))
        values[:, self.columns.course] = self.course.of(logs)
        return np.asarray(values * self.scale(robot))

    def parameters(self, robot: int, logs: LogEquations, fit: RobotFit) -> Array:
        """(T, p) a robot's parameters at its logs by a fit, without the logs' own scatter."""
        return np.asarray(self.mean + self.together(robot, logs) + fit.deviation)

    def _scattered(self, scale: Array, odd: Array) -> Array:
        """(T, p, q) factors of the covariance by which logs scatter; most have the same."""
        different, which = np.unique(odd, axis=0, return_inverse=True)
        scales = np.repeat(np.sqrt(self.scatter**2 + different), self.columns.sizes[:-1], axis=1)
        factors = narrow_factor(scales[:, None] * scale[:, None] * self.factor)
        return np.asarray(factors[which.ravel()])

    def _spread_out(self, together: Array) -> Array:
        """(T, p, q) the course of each column as a column of its own."""
        at = np.flatnonzero(self.columns.course)
        found = np.zeros((*together.shape, len(at)))
        found[:, at, np.arange(len(at))] = together[:, at]
        return found


def kept_share(directions: Array) -> Array:
    """(...) share of logs' squared scores that is left where odd ones count less, if none is odd.

    Args:
        directions: (...) in how many directions of a spread a log tells of it.
    """
    return np.interp(directions, *_kept_shares())


@cache
def _kept_shares() -> tuple[Array, Array]:
    """Numbers of directions, and the share for each, over those of mean squares z² ~ χ²_r / r."""
    directions = np.arange(1.0, 7.0)
    middles = (np.arange(1000) + 0.5) / 1000
    squares = 2.0 * gammaincinv(0.5 * directions[:, None], middles) / directions[:, None]
    larger = np.maximum(squares / _USUAL, 1.0)  # the variance of an odd log, in that of others
    return directions, (squares / larger**2).mean(axis=1) / (1.0 / larger).mean(axis=1)


def own_parameters(model: TypeModel, fit: RobotFit) -> tuple[Array, Array]:
    """A robot's parameters (p,) without course and changes, and their covariance (p, p).

    Raises:
        ArgumentError: They are something else.
    """
    instance(model, "model", TypeModel)
    instance(fit, "fit", RobotFit)
    factor = fit.common
    part = slice(0, factor.shape[1])
    covariance = factor @ fit.covariance[part, part] @ factor.T
    # If all robots have more of something, this one has it where its logs do not say otherwise.
    silent = np.eye(len(factor)) - factor @ fit.solve(fit.seen)[part]
    covariance += silent @ model.covariance @ silent.T
    return model.mean + factor @ fit.theta[part], covariance
