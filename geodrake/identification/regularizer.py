"""Regularizers: distances from a prior that make an ill-posed fit well-posed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import ClassVar

import numpy as np

from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification.conic_fit import certified, solve_fit, solve_with_fallback
from geodrake.identification.fit import FitResult
from geodrake.identification.newton import solve_newton
from geodrake.identification.problem import FitProblem
from geodrake.inertia import Array, entropic_divergence, pullback_metric

Solver = str | None
"""Name of a solver; None for the default."""

_WIDE = 5e-5


class Regularizer(ABC):
    """Squared distance d(Φ, Φ⁰)² of inertial parameters (nb, 10) from a physical prior.

    A regularizer adds a term to a convex fit, and evaluates it at the solution. A nonconvex one
    also overrides `solve`.
    """

    name: ClassVar[str]

    @abstractmethod
    def divergence(self, phi: Array, prior: Array) -> float:
        """Return d(Φ, Φ⁰)² of all bodies together."""

    @abstractmethod
    def regularize(self, problem: FitProblem, prior: Array, gamma: float) -> FitProblem:
        """Return the problem with γ d(Φ, Φ⁰)² added; the columns of bodies come first."""

    def scalar_divergence(self, values: Array, priors: Array) -> Array:
        """Return d(x, x⁰)² of each positive scalar (k,) ([Lee2019] Remark 3.13)."""
        raise ArgumentError(
            f"The regularizer {self.name} has no divergence for extra parameters, but "
            "extra_prior gives them a prior.",
            advice="Omit extra_prior, or use another regularizer.",
        )

    def divergence_of(self, fit: FitResult, prior: Array) -> float:
        """Return d² at a solution of `solve`."""
        return self.divergence(fit.x[: prior.size].reshape(prior.shape), prior)

    def solve(
        self, problem: FitProblem, prior: Array, gamma: float, solver: Solver, certify: bool = False
    ) -> FitResult:
        """Return the fit with γ d(Φ, Φ⁰)² added.

        Without a `solver`, use `solve_with_fallback`, optionally with a certificate. Otherwise use
        only "newton" or the conic solver of that name. If the conic solver is too inexact to keep
        bodies physical, increase the margin tenfold, up to 1e-4.
        """
        regularized = self.regularize(problem, prior, gamma)
        if solver is None:
            fit = solve_with_fallback(regularized)
            return certified(regularized, fit) if certify else fit
        if solver == "newton":
            return solve_newton(regularized)
        try:
            return solve_fit(regularized, solver=solver)
        except IdentificationError as error:
            if "columns" not in error.evidence or problem.margin > _WIDE:
                raise
        return self.solve(replace(problem, margin=10.0 * problem.margin), prior, gamma, solver)


class QuadraticRegularizer(Regularizer):
    """Regularizer (Φ − Φ⁰)ᵀ G (Φ − Φ⁰) with a constant block-diagonal G.

    Positive scalars have the metric ½ / x⁰² of P(1), unless `scalar_metric` is overridden.
    """

    @abstractmethod
    def metric(self, prior: Array) -> Array:
        """Return G of every body, (nb, 10, 10), for a prior (nb, 10)."""

    def scalar_metric(self, priors: Array) -> Array:
        """Return G (k,) of positive scalars, for priors (k,)."""
        return 0.5 / priors**2

    def scalar_divergence(self, values: Array, priors: Array) -> Array:
        """Return d(x, x⁰)² of each positive scalar."""
        return self.scalar_metric(priors) * (values - priors) ** 2

    def divergence(self, phi: Array, prior: Array) -> float:
        """Return d(Φ, Φ⁰)² of all bodies together."""
        change = phi - prior
        return float(np.einsum("bi,bij,bj", change, self.metric(prior), change))

    def regularize(self, problem: FitProblem, prior: Array, gamma: float) -> FitProblem:
        """Return the problem with γ G added to the prior information."""
        information = problem.prior_information.copy()
        for start, metric in zip(problem.inertia_blocks, self.metric(prior), strict=True):
            information[start : start + 10, start : start + 10] += gamma * metric
        for column, (value, weight) in problem.scalar_priors.items():
            metric = self.scalar_metric(np.array([value]))[0]
            information[column, column] += gamma * weight * metric
        return replace(problem, prior_information=information)


class Euclidean(QuadraticRegularizer):
    """d² = ‖Φ − Φ⁰‖² ([Lee2019] Eq. (3.2.16)), which depends on units and frames.

    It adds kg² and (kg·m²)², and its minimum often lies at the boundary of physical bodies. Prefer
    another regularizer.
    """

    name = "euclidean"

    def scalar_metric(self, priors: Array) -> Array:
        """Return 1 for every scalar."""
        return np.ones_like(priors)

    def metric(self, prior: Array) -> Array:
        """Return the identity for every body."""
        return np.broadcast_to(np.eye(10), (len(prior), 10, 10))


class Pullback(QuadraticRegularizer):
    """d² = Σ_i ½ tr((P(φ_i⁰)⁻¹ P(φ_i − φ_i⁰))²) ([Lee2019] Eqs. (3.3.33), (3.5.50)).

    The second order of the geometric distance at the prior, independent of units and frames. It is
    finite at the boundary of physical bodies, which a fit with strong data can therefore reach.
    """

    name = "pullback"

    def metric(self, prior: Array) -> Array:
        """Return g(φ⁰) of every body ([Lee2019] Eq. (B.1.7))."""
        return pullback_metric(prior)


class Entropic(Regularizer):
    """d² = Σ_i −log|P_i| + log|P_i⁰| + tr((P_i⁰)⁻¹ P_i) − 4 ([Lee2019] Eqs. (2.2.14), (3.5.44)).

    It is convex, and independent of units and frames. It is infinite at the boundary of physical
    bodies, so that every result is strictly inside.
    """

    name = "entropic"

    def divergence(self, phi: Array, prior: Array) -> float:
        """Return d(Φ ‖ Φ⁰)² of all bodies together."""
        return float(entropic_divergence(phi, prior).sum())

    def scalar_divergence(self, values: Array, priors: Array) -> Array:
        """Return x/x⁰ − log(x/x⁰) − 1 of positive scalars ([Lee2019] Eqs. (3.6.60), (5.3.33))."""
        change = values / priors - 1.0
        return np.asarray(change - np.log1p(change))

    def regularize(self, problem: FitProblem, prior: Array, gamma: float) -> FitProblem:
        """Return the problem with an entropic prior of every body and every scalar with a prior."""
        priors = zip(problem.inertia_blocks, prior, strict=True)
        return replace(
            problem,
            entropic={start: (phi, gamma) for start, phi in priors},
            entropic_scalars={k: (x, gamma * w) for k, (x, w) in problem.scalar_priors.items()},
        )
