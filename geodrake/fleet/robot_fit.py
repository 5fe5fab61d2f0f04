"""One robot's own parameters, of all its logs: a linear fit with a normal prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from geodrake.boundary.showing import Short

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LogScores(Short):
    """How large scores of logs are along the directions of K factors F_k.

    With G = F_kᵀ M_t F_k, scores of known parameters have the covariance G.

    Attributes:
        squares: (T, K) |F_kᵀ score_t|².
        trace: (T, K) traces of G.
        norm: (T, K) traces of G².
    """

    squares: Array
    trace: Array
    norm: Array


@dataclass(frozen=True, eq=False)
class RobotFit(Short):
    """Parameters x_t = x̄_t + L_t θ of logs t, with θ ~ N(0, 𝟙) and L_t = [A, B_t].

    Attributes:
        information: (T, p, p) normal matrices M_t of the logs' means.
        rest: (T, p) right sides less what x̄_t explains, m_t − M_t x̄_t.
        common: (p, a) map A, which all logs have.
        own: (T, p, b) maps B_t.
    """

    information: Array
    rest: Array
    common: Array
    own: Array

    @property
    def size(self) -> int:
        """Number n of parameters θ."""
        return self.common.shape[1] + self.own.shape[2]

    def mapped(self, rows: Array) -> Array:
        """(T, c, n) products of rows (T, c, p) and L_t."""
        return np.concatenate([rows @ self.common, rows @ self.own], axis=2)

    def seen_along(self, factor: Array) -> Array:
        """(T, n, r) products L_tᵀ M_t F.

        Args:
            factor: (p, r) directions F.
        """
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
        """N⁻¹ times (n,) or (n, m), with the normal matrix N = 𝟙 + Σ L_tᵀ M_t L_t."""
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
        """(T, p) what θ adds to the parameters of every log, L_t θ."""
        a = self.common.shape[1]
        return np.asarray(self.common @ self.theta[:a] + self.own @ self.theta[a:])

    @cached_property
    def score(self) -> Array:
        """(T, p) what is left of every log's right side, rest_t − M_t L_t θ."""
        return np.asarray(self.rest - (self.information @ self.deviation[..., None])[..., 0])

    def scores(self, factors: Sequence[Array]) -> LogScores:
        """How large scores are along the directions of some factors.

        Args:
            factors: K factors F_k (p, r_k).
        """
        ends = np.cumsum([factor.shape[1] for factor in factors])[:-1]
        every = np.hstack(factors)
        along = np.split((self.score @ every) ** 2, ends, axis=1)
        shown = np.split(self.information @ every, ends, axis=2)
        blocks = [f.T @ each for f, each in zip(factors, shown, strict=True)]
        return LogScores(
            np.stack([each.sum(axis=1) for each in along], axis=1),
            np.stack([np.trace(each, axis1=1, axis2=2) for each in blocks], axis=1),
            np.stack([np.square(each).sum(axis=(1, 2)) for each in blocks], axis=1),
        )

    def expected_squares(self, factor: Array) -> Array:
        """(r,) what squares of Fᵀ score_t are in the sum of all logs, if the model is right.

        Args:
            factor: (p, r) directions F.
        """
        own = np.einsum("pr,pr->r", factor, self.information.sum(axis=0) @ factor)
        part = self.seen_along(factor).transpose(1, 0, 2)
        flat = part.reshape(len(part), -1)
        fitted = np.sum((flat * self.solve(flat)).reshape(part.shape), axis=(0, 1))
        return np.maximum(own - fitted, 0.0)  # what rounding makes of nothing
