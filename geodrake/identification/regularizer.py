"""Base of the regularizers: distances from a prior that make an ill-posed fit well posed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import ClassVar

import numpy as np

from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification.certification import certified
from geodrake.identification.conic_fit import solve_fit, solve_with_fallback
from geodrake.identification.fit import FitResult
from geodrake.identification.newton import solve_newton
from geodrake.identification.problem import FitProblem
from geodrake.inertia import Array

_MARGINS = (1.0, 10.0, 100.0)


class Regularizer(ABC):
    """A squared distance d(Φ, Φ⁰)² of inertial parameters from their prior.

    A regularizer says what it adds to a convex fit, and measures what came out. One that is not
    convex overrides `solve` too.
    """

    name: ClassVar[str]

    @abstractmethod
    def divergence(self, phi: Array, prior: Array) -> float:
        """d(Φ, Φ⁰)² of all bodies together.

        Args:
            phi: (nb, 10) inertial parameters.
            prior: (nb, 10) physical prior.
        """

    @abstractmethod
    def regularize(self, problem: FitProblem, prior: Array, gamma: float) -> FitProblem:
        """The problem with γ d(Φ, Φ⁰)² added.

        Args:
            problem: Fit whose first columns are the bodies', in order.
            prior: (nb, 10) physical prior.
            gamma: Weight γ > 0.
        """

    def scalar_divergence(self, values: Array, priors: Array) -> Array:
        """d(x, x⁰)² of positive scalars such as rotor inertias, one by one ([Lee2019] Remark 3.13).

        Args:
            values: (k,) values.
            priors: (k,) positive prior values.

        Raises:
            ArgumentError: The regularizer has none.
        """
        raise ArgumentError(
            f"The regularizer {self.name} has no divergence of extra parameters, and extra_prior "
            "gives them a prior.",
            advice="Leave extra_prior out, or take another regularizer.",
        )

    def divergence_of(self, fit: FitResult, prior: Array) -> float:
        """d² at a solution of `solve`.

        Args:
            fit: A solution of `solve`.
            prior: (nb, 10) physical prior Φ⁰.
        """
        return self.divergence(fit.x[: prior.size].reshape(prior.shape), prior)

    def solve(
        self, problem: FitProblem, prior: Array, gamma: float, solver: str | None
    ) -> FitResult:
        """Solve the fit with γ d(Φ, Φ⁰)² added.

        With None, as `solve_with_fallback` does; with "newton", by that alone; else by Drake's
        conic solver of that name alone. Where such a solver is not exact enough to keep bodies
        physical at the problem's margin, it tries ten and a hundred times that margin.

        Args:
            problem: The data, bounds and constraints.
            prior: (nb, 10) physical prior Φ⁰.
            gamma: Weight γ of d².
            solver: None, "newton", or the name of a conic solver of Drake's.
        """
        regularized = self.regularize(problem, prior, gamma)
        if solver is None:
            return solve_with_fallback(regularized)
        if solver == "newton":
            return solve_newton(regularized)
        for factor in _MARGINS[:-1]:
            try:
                wider = replace(regularized, margin=factor * problem.margin)
                return solve_fit(wider, solver=solver)
            except IdentificationError as error:
                if "columns" not in error.evidence:
                    raise
        return solve_fit(replace(regularized, margin=_MARGINS[-1] * problem.margin), solver=solver)

    def certified(
        self, problem: FitProblem, prior: Array, gamma: float, fit: FitResult
    ) -> FitResult:
        """A solution of `solve` with its `Certificate`, or the better one of its program.

        Args:
            problem: The data, bounds and constraints.
            prior: (nb, 10) physical prior Φ⁰.
            gamma: Weight γ of d².
            fit: The solution.
        """
        return certified(self.regularize(problem, prior, gamma), fit)


class QuadraticRegularizer(Regularizer):
    """A regularizer (Φ − Φ⁰)ᵀ G (Φ − Φ⁰) with a constant G, block by block.

    Positive scalars have the metric ½ / x⁰² of P(1), unless `scalar_metric` is another.
    """

    @abstractmethod
    def metric(self, prior: Array) -> Array:
        """G of every body, (nb, 10, 10), for a prior (nb, 10)."""

    def scalar_metric(self, priors: Array) -> Array:
        """G (k,) of positive scalars, for priors (k,)."""
        return 0.5 / priors**2

    def scalar_divergence(self, values: Array, priors: Array) -> Array:
        """d(x, x⁰)² of positive scalars, one by one."""
        return self.scalar_metric(priors) * (values - priors) ** 2

    def divergence(self, phi: Array, prior: Array) -> float:
        """d(Φ, Φ⁰)² of all bodies together."""
        change = phi - prior
        return float(np.einsum("bi,bij,bj", change, self.metric(prior), change))

    def regularize(self, problem: FitProblem, prior: Array, gamma: float) -> FitProblem:
        """The problem with γ G as further prior information."""
        information = problem.prior_information.copy()
        for start, metric in zip(problem.inertia_blocks, self.metric(prior), strict=True):
            information[start : start + 10, start : start + 10] += gamma * metric
        for column, (value, weight) in problem.scalar_priors.items():
            metric = self.scalar_metric(np.array([value]))[0]
            information[column, column] += gamma * weight * metric
        return replace(problem, prior_information=information)
