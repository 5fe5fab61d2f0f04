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
    """A squared distance d(Φ, Φ⁰)² of inertial parameters (nb, 10) from their physical prior.

    A regularizer says what it adds to a convex fit, and measures what came out. One that is not
    convex overrides `solve` too.
    """

    name: ClassVar[str]

    @abstractmethod
    def divergence(self, phi: Array, prior: Array) -> float:
        """Return d(Φ, Φ⁰)² of all bodies together."""

    @abstractmethod
    def regularize(self, problem: FitProblem, prior: Array, gamma: float) -> FitProblem:
        """Return the problem, whose first columns are the bodies', with γ d(Φ, Φ⁰)² added."""

    def scalar_divergence(self, values: Array, priors: Array) -> Array:
        """Return d(x, x⁰)² of positive scalars (k,) one by one ([Lee2019] Remark 3.13)."""
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

        With None, as `solve_with_fallback` does, and if asked with its `Certificate`, or the better
        solution of its program; with "newton", by that alone; else by Drake's conic solver of that
        name alone. Where such a solver is not exact enough to keep bodies physical at the problem's
        margin, it tries ten times that margin, up to 1e-4.
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
    """A regularizer (Φ − Φ⁰)ᵀ G (Φ − Φ⁰) with a constant G, block by block.

    Positive scalars have the metric ½ / x⁰² of P(1), unless `scalar_metric` is another.
    """

    @abstractmethod
    def metric(self, prior: Array) -> Array:
        """Return G of every body, (nb, 10, 10), for a prior (nb, 10)."""

    def scalar_metric(self, priors: Array) -> Array:
        """Return G (k,) of positive scalars, for priors (k,)."""
        return 0.5 / priors**2

    def scalar_divergence(self, values: Array, priors: Array) -> Array:
        """Return d(x, x⁰)² of positive scalars, one by one."""
        return self.scalar_metric(priors) * (values - priors) ** 2

    def divergence(self, phi: Array, prior: Array) -> float:
        """Return d(Φ, Φ⁰)² of all bodies together."""
        change = phi - prior
        return float(np.einsum("bi,bij,bj", change, self.metric(prior), change))

    def regularize(self, problem: FitProblem, prior: Array, gamma: float) -> FitProblem:
        """Return the problem with γ G as further prior information."""
        information = problem.prior_information.copy()
        for start, metric in zip(problem.inertia_blocks, self.metric(prior), strict=True):
            information[start : start + 10, start : start + 10] += gamma * metric
        for column, (value, weight) in problem.scalar_priors.items():
            metric = self.scalar_metric(np.array([value]))[0]
            information[column, column] += gamma * weight * metric
        return replace(problem, prior_information=information)


class Euclidean(QuadraticRegularizer):
    """d² = ‖Φ − Φ⁰‖² ([Lee2019] Eq. (3.2.16)): adds kg² and (kg·m²)², so prefer another.

    Its minimum often lies at the boundary of physical bodies.
    """

    name = "euclidean"

    def scalar_metric(self, priors: Array) -> Array:
        """Return one for every scalar."""
        return np.ones_like(priors)

    def metric(self, prior: Array) -> Array:
        """Return the identity for every body."""
        return np.broadcast_to(np.eye(10), (len(prior), 10, 10))


class Pullback(QuadraticRegularizer):
    """d² = Σ_i ½ tr((P(φ_i⁰)⁻¹ P(φ_i − φ_i⁰))²) ([Lee2019] Eqs. (3.3.33), (3.5.50)).

    The geometric distance near the prior, as a quadratic form: independent of units and frames.
    Finite at the boundary of physical bodies, which a fit with strong data and a weak prior
    therefore can reach.
    """

    name = "pullback"

    def metric(self, prior: Array) -> Array:
        """Return g(φ⁰) of every body ([Lee2019] Eq. (B.1.7))."""
        return pullback_metric(prior)


class Entropic(Regularizer):
    """d² = Σ_i −log|P_i| + log|P_i⁰| + tr((P_i⁰)⁻¹ P_i) − 4 ([Lee2019] Eqs. (2.2.14), (3.5.44)).

    Convex and independent of units and frames. Grows without limit at the boundary of physical
    bodies, so that every result is well inside.
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
        """Return it with an entropic prior for every body, and every scalar that has a prior."""
        priors = zip(problem.inertia_blocks, prior, strict=True)
        return replace(
            problem,
            entropic={start: (phi, gamma) for start, phi in priors},
            entropic_scalars={k: (x, gamma * w) for k, (x, w) in problem.scalar_priors.items()},
        )
