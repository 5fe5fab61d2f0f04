"""Solution of a fit, with information and certificate."""

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
"""How far a fit may be above the solver's cost, and that above the least, as shares of the cost.

It is also the greatest violation of a constraint.
"""

_NOTHING = 1e-24
"""A parameter is not identifiable up to this share of the largest information: rounding's."""
_BOUNDARY = 1e-5
"""Distance, in scaled units, within which a bound counts as reached."""
_SAME, SAME_COST = 1e-4, 1e-9
"""Geodesic distance, and relative difference of costs, within which two minima count as one."""


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Optimality certificate of reported parameters by the fit's MathematicalProgram.

    A cost has the unit of squared deviations, with whitened data. The scope is "global" of a convex
    program; "local" where a distance that is not convex was replaced by its second order at the
    reported parameters, so that they are certified as a local minimum.
    """

    solver: str  # the conic solver that solved the program
    # How far the cost is above its minimum at most: its difference from the solver's, and the
    # duality gap of that; inf if the solver found no solution.
    gap: float
    cost: float
    # How far parameters are outside the program's constraints (P ⪰ 0, bounds, ellipsoids, masses,
    # residual) at most, in its dimensionless variables.
    violation: float
    scope: Scope = "global"
    replaced: bool = False  # whether the parameters are the solver's, as the fit itself was worse
    failure: str = ""  # why the solver found no solution; empty if it did

    @property
    def relative_gap(self) -> float:
        """Return the gap as a share of the cost."""
        return self.gap / self.cost

    @property
    def holds(self) -> bool:
        """Return whether both parts of the gap and the violation are within `TOLERANCE`."""
        return self.relative_gap <= 2.0 * TOLERANCE and self.violation <= TOLERANCE

    @property
    def words(self) -> str:
        """Return the certificate in a line."""
        if self.failure:
            return f"{self.solver} could not certify the fit: {self.failure}"
        least = "a local minimum" if self.scope == "local" else "the least"
        near = f"its cost is within {self.relative_gap:.0e} of {least}"
        if not self.holds:
            kept = f"constraints hold to {self.violation:.0e}"
            return f"the fit is not certified by {self.solver}: {near}, and {kept}"
        how = "that of" if self.replaced else "certified by"
        return f"the fit is {how} {self.solver}: {near}, with valid bodies and bounds"


@dataclass(frozen=True, eq=False)
class LocalMinima:
    """Where the starts led to."""

    starts: tuple[str, ...]  # names of the starts
    # (n,) cost reached from each start, at the γ of the solution; inf where the search failed.
    costs: Array
    distances: Array  # (n,) geodesic distance of what each start led to from the best
    strict: bool  # whether the best is a strict local minimum: its Hessian is positive definite

    @property
    def agree(self) -> bool:
        """Return whether all starts led to the same minimum."""
        return bool((self.distances < _SAME).all())

    @property
    def distinct(self) -> int:
        """Return the number of different minima, distinguished by their costs."""
        reached = np.isfinite(self.costs)
        if (self.distances[reached] < _SAME).all():
            return 1
        found = np.sort(self.costs[reached])
        scale = max(abs(found[0]), np.finfo(float).tiny)
        return 1 + int(np.count_nonzero(np.diff(found) > SAME_COST * scale))


@dataclass(frozen=True, kw_only=True, eq=False)
class FitResult(Short):
    """Solution of a `FitProblem`: every inertia block is physical, and every bound kept exactly."""

    x: Array  # (p,) parameters
    # (p, p) posterior information: half the cost's Hessian at x, so that its inverse is the
    # covariance of x while no bound is active.
    information: Array
    residual: float  # squared residual ‖R x − r‖²
    active_bounds: tuple[int, ...]  # indices of parameters at one of their bounds
    active_blocks: tuple[int, ...]  # first columns of inertia blocks at the boundary of bodies
    # Of the prior against the data: 1, and in the point-to-set form the γ for which the regularized
    # form has this solution (inf when the data are idle).
    prior_weight: float
    solver: str  # "closed form", "bounded least squares", "newton", or the conic solver
    solve_time: float  # of the whole solution, s
    note: str = ""  # why another solver than usual gave the answer; empty if it was the usual one
    # None if it was not asked for, and of point masses, which a MathematicalProgram solves.
    certificate: Certificate | None = None
    minima: LocalMinima | None = None  # what the starts led to, if several minima are possible
    masses: Array | None = None  # (N,) point masses of all bodies in a row, kg, if that they are

    @property
    def notes(self) -> tuple[str, ...]:
        """Return notes on an unusual solver, and on the certificate."""
        certificate = self.certificate
        return tuple(filter(None, [self.note, certificate.words if certificate else ""]))

    def covariance(self) -> Array:
        """Return the covariance (p, p) of x, in its units; inf on its diagonal is of the unknown.

        It counts every row of data as independent: with correlated residuals, scale the information
        by the share of effective samples first.
        """
        known = np.diagonal(self.information)
        size = np.sqrt(np.where(known > _NOTHING * known.max(initial=0.0), known, 1.0))
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
