"""The solution of a fit, with what it leaves known."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from geodrake.boundary.showing import Short
from geodrake.identification.certificate import Certificate
from geodrake.identification.coordinates import Coordinates
from geodrake.identification.problem import FitProblem
from geodrake.inertia import Array, pullback_metric

_NOTHING = 1e-24
"""A parameter is not identifiable up to this share of the largest information: rounding's."""
_BOUNDARY = 1e-5
"""Distance, in scaled units, within which a bound counts as reached."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FitResult(Short):
    """Solution of a `FitProblem`.

    Attributes:
        x: (p,) parameters; every inertia block is physical and every bound is kept exactly.
        information: (p, p) posterior information: half the cost's Hessian at x, so that its
            inverse is the covariance of x while no bound is active.
        residual: Squared residual ‖R x − r‖².
        active_bounds: Indices of parameters at one of their bounds.
        active_blocks: First columns of inertia blocks at the boundary of physical bodies.
        prior_weight: Weight of the prior against the data: 1, and in the point-to-set form the
            γ for which the regularized form has this solution (inf when the data are idle).
        solver: What solved it: "closed form", "bounded least squares", "newton", or the conic
            solver.
        solve_time: Time of the whole solution, s.
        note: Why another solver than usual gave the answer; empty if it was the usual one.
        certificate: What the MathematicalProgram of the fit says of it; None if it was not asked.
    """

    x: Array
    information: Array
    residual: float
    active_bounds: tuple[int, ...]
    active_blocks: tuple[int, ...]
    prior_weight: float
    solver: str
    solve_time: float
    note: str = ""
    certificate: Certificate | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Return what solved it, where that was not the usual, and what certifies it, in words."""
        certificate = self.certificate
        return tuple(filter(None, [self.note, certificate.words if certificate else ""]))

    def standard_deviations(self) -> Array:
        """Standard deviations (p,) of x, in its units; inf where nothing is known.

        They count every row of data as independent: with correlated residuals, scale the
        information by the share of effective samples first.
        """
        known = np.diagonal(self.information)
        size = np.sqrt(np.where(known > _NOTHING * known.max(initial=0.0), known, 1.0))
        values, vectors = np.linalg.eigh(self.information / np.outer(size, size))
        known = values > len(values) * np.finfo(float).eps * values[-1]
        variances = (vectors[:, known] ** 2 / values[known]).sum(1)
        unknown = (vectors[:, ~known] ** 2).sum(1) > np.sqrt(np.finfo(float).eps)
        return np.where(unknown, np.inf, np.sqrt(variances) / size)


def fit_result(
    problem: FitProblem, x: Array, prior_weight: float, solver: str, begin: float
) -> FitResult:
    """Return the result of a solver that began at a `time.perf_counter()`, at its solution x (p,).

    The `prior_weight` is that of the prior against the data.
    """
    coordinates, R = Coordinates.of(problem), problem.factor[:, :-1]
    prior = problem.prior_information.copy()
    for start, (_, gamma) in problem.entropic.items():
        block = slice(start, start + 10)
        prior[block, block] += gamma * pullback_metric(x[block])
    for column, (_, gamma) in problem.entropic_scalars.items():
        prior[column, column] += 0.5 * gamma / x[column] ** 2
    scale = np.diagonal(coordinates.transform)
    at_bound = np.minimum(x - problem.lower, problem.upper - x) <= _BOUNDARY * scale
    near = coordinates.smallest_eigenvalues(x) < 2.0 * problem.margin
    return FitResult(
        x=x,
        information=prior if np.isinf(prior_weight) else R.T @ R + prior_weight * prior,
        residual=problem.residual(x),
        active_bounds=tuple(np.flatnonzero(at_bound).tolist()),
        active_blocks=tuple(np.array(problem.inertia_blocks, int)[near].tolist()),
        prior_weight=prior_weight,
        solver=solver,
        solve_time=time.perf_counter() - begin,
    )
