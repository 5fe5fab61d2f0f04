"""Solutions of fits, with information and certificates."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Literal

import numpy as np

from geodrake.boundary.showing import Short
from geodrake.identification.coordinates import Coordinates
from geodrake.identification.problem import FitProblem
from geodrake.inertia import Array, pullback_metric

Scope = Literal["global", "local"]

TOLERANCE = 1e-6
"""Certified relative excess of a fit's cost over the solver's, and of that over the minimum.

It is also the largest certified violation of a constraint.
"""

_NOTHING = 1e-24
"""Information of an unidentifiable parameter, relative to the largest: rounding errors."""
_BOUNDARY = 1e-5
"""Distance, in scaled units, within which a bound is active."""
_SAME, SAME_COST = 1e-4, 1e-9
"""Geodesic distance, and relative difference of costs, within which two minima are the same."""


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Optimality certificate of reported parameters by the fit's MathematicalProgram.

    Costs are in units of squared standard deviations. The scope is "global" for a convex program,
    and "local" if a nonconvex distance was replaced by its second order at the reported parameters,
    which are then a certified local minimum.
    """

    solver: str  # the conic solver
    # Bound of the cost's excess over its minimum: the difference from the solver's cost plus the
    # duality gap; inf if the solver failed.
    gap: float
    cost: float
    # Largest violation of the program's constraints (P ⪰ 0, bounds, ellipsoids, masses, residual),
    # in its dimensionless variables.
    violation: float
    scope: Scope = "global"
    replaced: bool = False  # whether the parameters are the solver's, which were better
    failure: str = ""  # why the solver failed; empty if it succeeded

    @property
    def relative_gap(self) -> float:
        """The gap relative to the cost."""
        return self.gap / self.cost

    @property
    def holds(self) -> bool:
        """Whether both parts of the gap and the violation are within `TOLERANCE`."""
        return self.relative_gap <= 2.0 * TOLERANCE and self.violation <= TOLERANCE

    @property
    def words(self) -> str:
        """The certificate in a sentence."""
        if self.failure:
            return f"{self.solver} could not certify the fit: {self.failure}"
        minimum = "a local minimum" if self.scope == "local" else "the minimum"
        cost = f"its cost is within {self.relative_gap:.0e} of {minimum}"
        if not self.holds:
            violation = f"constraints hold to {self.violation:.0e}"
            return f"the fit is not certified by {self.solver}: {cost}, and {violation}"
        how = "that of" if self.replaced else "certified by"
        return f"the fit is {how} {self.solver}: {cost}, with valid bodies and bounds"


@dataclass(frozen=True, eq=False)
class LocalMinima:
    """Local minima reached from several starts."""

    starts: tuple[str, ...]  # names of the starts
    # (n,) cost reached from each start, at the γ of the solution; inf if the search failed.
    costs: Array
    distances: Array  # (n,) geodesic distance of each minimum from the best
    strict: bool  # whether the Hessian at the best is positive definite

    @property
    def agree(self) -> bool:
        """Whether all starts led to the same minimum."""
        return bool((self.distances < _SAME).all())

    @property
    def distinct(self) -> int:
        """Number of different minima, distinguished by their costs."""
        reached = np.isfinite(self.costs)
        if (self.distances[reached] < _SAME).all():
            return 1
        costs = np.sort(self.costs[reached])
        scale = max(abs(costs[0]), np.finfo(float).tiny)
        return 1 + int(np.count_nonzero(np.diff(costs) > SAME_COST * scale))


@dataclass(frozen=True, kw_only=True, eq=False)
class FitResult(Short):
    """Solution of a `FitProblem`, with physical inertia blocks and exactly satisfied bounds."""

    x: Array  # (p,) parameters
    # (p, p) posterior information, half the cost's Hessian at x. Its inverse is the covariance of x
    # if no bound is active.
    information: Array
    residual: float  # squared residual ‖R x − r‖²
    active_bounds: tuple[int, ...]  # indices of parameters at one of their bounds
    active_blocks: tuple[int, ...]  # first columns of inertia blocks at the physical boundary
    # Weight of the prior relative to the data: 1, or in the point-to-set form the γ for which the
    # regularized form has the same solution (inf if the data are inactive).
    prior_weight: float
    solver: str  # "closed form", "bounded least squares", "newton", or the conic solver
    solve_time: float  # total, s
    note: str = ""  # why an unusual solver was used, or empty
    # None if not requested, and for point masses, which a MathematicalProgram solves.
    certificate: Certificate | None = None
    minima: LocalMinima | None = None  # of nonconvex fits
    masses: Array | None = None  # (N,) point masses of all bodies, kg, if bodies consist of them

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on an unusual solver, and on the certificate."""
        certificate = self.certificate
        return tuple(filter(None, [self.note, certificate.words if certificate else ""]))

    def covariance(self) -> Array:
        """Return the covariance (p, p) of x; variances of unidentified parameters are inf.

        It assumes independent rows of data: with correlated residuals, scale the information by the
        share of effective samples first.
        """
        diagonal = np.diagonal(self.information)
        size = np.sqrt(np.where(diagonal > _NOTHING * diagonal.max(initial=0.0), diagonal, 1.0))
        values, vectors = np.linalg.eigh(self.information / np.outer(size, size))
        known = values > len(values) * np.finfo(float).eps * values[-1]
        inverse = (vectors[:, known] / values[known]) @ vectors[:, known].T
        unknown = (vectors[:, ~known] ** 2).sum(1) > np.sqrt(np.finfo(float).eps)
        np.fill_diagonal(inverse, np.where(unknown, np.inf, np.diagonal(inverse)))
        return np.asarray(inverse / np.outer(size, size))

    def standard_deviations(self) -> Array:
        """Return standard deviations (p,) of x, in its units; inf if unidentified."""
        return np.sqrt(np.diagonal(self.covariance()))


def fit_result(
    problem: FitProblem, x: Array, prior_weight: float, solver: str, begin: float
) -> FitResult:
    """Return the result at a solution x (p,) of a solver that began at a `time.perf_counter()`."""
    coordinates, R = Coordinates.of(problem), problem.factor[:, :-1]
    prior = problem.prior_information.copy()
    for start, (_, gamma) in problem.entropic.items():
        block = slice(start, start + 10)
        prior[block, block] += gamma * pullback_metric(x[block])
    for column, (_, gamma) in problem.entropic_scalars.items():
        prior[column, column] += 0.5 * gamma / x[column] ** 2
    scale = np.diagonal(coordinates.transform)
    at_bound = np.minimum(x - problem.lower, problem.upper - x) <= _BOUNDARY * scale
    at_boundary = coordinates.smallest_eigenvalues(x) < 2.0 * problem.margin
    return FitResult(
        x=x,
        information=prior if np.isinf(prior_weight) else R.T @ R + prior_weight * prior,
        residual=problem.residual(x),
        active_bounds=tuple(np.flatnonzero(at_bound).tolist()),
        active_blocks=tuple(np.array(problem.inertia_blocks, int)[at_boundary].tolist()),
        prior_weight=prior_weight,
        solver=solver,
        solve_time=time.perf_counter() - begin,
    )
