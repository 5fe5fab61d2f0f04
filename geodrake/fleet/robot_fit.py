"""One robot's own parameters, of all its logs: a linear fit with a normal prior."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from geodrake.boundary.showing import Short

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RobotFit(Short):
    """Parameters x_t = x̄_t + L_t θ of logs t, with θ ~ N(0, 𝟙).

    Attributes:
        information: (T, p, p) normal matrices M_t of the logs' means.
        rest: (T, p) right sides less what x̄_t explains, m_t − M_t x̄_t.
        design: (T, p, n) maps L_t.
    """

    information: Array
    rest: Array
    design: Array

    @cached_property
    def seen(self) -> Array:
        """(T, n, p) products L_tᵀ M_t."""
        return np.swapaxes(self.design, 1, 2) @ self.information

    @cached_property
    def _factor(self) -> tuple[Array, bool]:
        normal = (self.seen @ self.design).sum(axis=0)
        found: tuple[Array, bool] = cho_factor(normal + np.eye(len(normal)), lower=True)
        return found

    def solve(self, right: Array) -> Array:
        """N⁻¹ times (n,) or (n, m), with the normal matrix N = 𝟙 + Σ L_tᵀ M_t L_t."""
        return np.asarray(cho_solve(self._factor, right))

    @cached_property
    def covariance(self) -> Array:
        """(n, n) covariance N⁻¹ of θ."""
        return self.solve(np.eye(self.design.shape[2]))

    @cached_property
    def theta(self) -> Array:
        """(n,) the best θ."""
        return self.solve(np.einsum("tpn,tp->n", self.design, self.rest))

    @cached_property
    def score(self) -> Array:
        """(T, p) what is left of every log's right side, rest_t − M_t L_t θ."""
        return np.asarray(self.rest - np.einsum("tnp,n->tp", self.seen, self.theta))

    def squares(self, factor: Array) -> tuple[Array, Array, Array]:
        """How large scores are along some directions.

        Args:
            factor: (p, r) directions F.

        Returns:
            (T, r) squares of Fᵀ score_t; (T, r) diagonals of Fᵀ M_t F; and (r,) the sums over logs
            of what the first are expected to be, if the model is right.
        """
        own = np.einsum("pr,tpr->tr", factor, self.information @ factor)
        part = (self.seen @ factor).transpose(1, 0, 2)
        flat = part.reshape(len(part), -1)
        fitted = np.sum((flat * self.solve(flat)).reshape(part.shape), axis=(0, 1))
        return (self.score @ factor) ** 2, own, own.sum(axis=0) - fitted
