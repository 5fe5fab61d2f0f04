"""Base parameters of a model: what logs determine of its bodies, with an equivalent prior.

Rows contain inertial parameters only in certain combinations, β = φ_b + K φ_d, as the columns of
the others depend on the columns b: Y_d = Y_b K. A fit over the columns b with the prior of β has
the same evidence as one over all columns, and about a third fewer unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpstrf

from geodrake.identification.logs.unknowns import Unknowns
from geodrake.identification.normal_equations import scaled_cholesky, solved
from geodrake.inertia import PARAMETERS_PER_BODY

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_DEPENDENT = 1e-11
"""Largest squared remainder of a dependent column, over its square. Filtered rows contain rounding
errors of about 1e-14."""


@dataclass(frozen=True, eq=False)
class BaseUnknowns:
    """Base parameters of bodies, and all parameters of effects, r in all."""

    kept: Indices  # (r,) indices of their columns among those of all p unknowns
    bodies: int  # number of base parameters, which come first
    mean: Array  # (r,) prior mean
    information: Array  # (r, r) prior information
    log_volume: float  # log |Λ| of their prior, less that of all unknowns
    _all: Unknowns
    _slopes: Array  # (p, r) of all unknowns with respect to these, in the prior
    _rest: Array  # (10·nb, 10·nb) covariance of the bodies, given these

    @classmethod
    def of(cls, unknowns: Unknowns, gram: Array) -> BaseUnknowns:
        """Return the base unknowns of rows whose columns of bodies have a normal matrix (k, k)."""
        scale = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
        factor, order, rank, _ = dpstrf(gram / scale / scale[:, None], tol=_DEPENDENT, lower=0)
        order = order.astype(np.intp) - 1
        base, others = order[:rank], order[rank:]
        p, bodies = len(unknowns.columns), len(gram)
        upper = np.triu(factor[:rank])
        ratios = np.linalg.solve(upper[:, :rank], upper[:, rank:]) / scale[base, None]
        mixing = np.zeros((rank + p - bodies, p))  # β = `mixing` @ φ
        ascending = np.argsort(base)
        mixing[: len(base), others] = (ratios * scale[others])[ascending]
        kept = np.concatenate([base[ascending], np.arange(bodies, p)])
        mixing[np.arange(len(kept)), kept] = 1.0
        covariance, log_all = _inverse(unknowns.information)
        information, log_own = _inverse(mixing @ covariance @ mixing.T)
        slopes = covariance @ mixing.T @ information
        rest = (covariance - slopes @ mixing @ covariance)[:bodies, :bodies]
        mean = mixing @ unknowns.mean
        return cls(kept, rank, mean, information, -log_own - log_all, unknowns, slopes, rest)

    def scales(self, width: float) -> Array:
        """Return factors (r,) of the prior's deviations if those of bodies are wider."""
        scales = np.ones(len(self.kept))
        scales[: self.bodies] = width
        return scales

    def all_of(self, x: Array, width: float) -> Array:
        """Return the most probable values (p,) of all unknowns, given these (r,).

        The prior of bodies is wider by a factor `width`.
        """
        shift, effects = (x - self.mean) / self.scales(width), slice(len(self._rest), None)
        found = self._all.mean + width * self._slopes @ shift
        found[effects] = x[self.bodies :]
        return np.asarray(found)

    def slopes_of_body(self, body: int, width: float) -> Array:
        """Return the slopes (10, r) of a body's parameters with respect to these."""
        return width * self._slopes[_span(body)] / self.scales(width)

    def rest_root(self, body: int, width: float) -> Array:
        """Return R (10, 10) with RᵀR the covariance of a body's parameters, given these."""
        return width * self._rest_roots[body]

    @cached_property
    def _rest_roots(self) -> list[Array]:
        roots = list[Array]()
        for body in range(len(self._rest) // PARAMETERS_PER_BODY):
            values, vectors = np.linalg.eigh(self._rest[_span(body), _span(body)])
            roots.append(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T)
        return roots


def _span(body: int) -> slice:
    return slice(PARAMETERS_PER_BODY * body, PARAMETERS_PER_BODY * (body + 1))


def _inverse(matrix: Array) -> tuple[Array, float]:
    """Return the inverse of a positive definite matrix of any scale, and log |matrix|."""
    factor, scale = scaled_cholesky(matrix, ridge=0.0)
    inverse = solved(factor, np.eye(len(scale))) * scale * scale[:, None]
    return 0.5 * (inverse + inverse.T), 2.0 * float(np.log(np.diag(factor) / scale).sum())
