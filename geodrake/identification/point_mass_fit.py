"""Regularizers of point masses: the distance of their masses from the prior ones."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from pydrake.solvers import MathematicalProgram, SolutionResult
from scipy.linalg import block_diag
from scipy.special import rel_entr

from geodrake.boundary.arguments import instance
from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification.conic_fit import solution_of, solve_fit
from geodrake.identification.fit import FitResult, fit_result
from geodrake.identification.point_mass import PointMasses
from geodrake.identification.problem import FitProblem, LinearConstraints
from geodrake.identification.program import build_fit
from geodrake.identification.regularizer import Regularizer
from geodrake.identification.residual_path import check_residual_bound, out_of_reach
from geodrake.identification.solvers import ROUGHLY, Tolerances, run_solver, solved_apart
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.robot.reduction import triangular_factor

_SAME_PRIOR = 1e-6
_SCALES = (1.0, 0.3, 3.0, 0.1, 10.0, 0.03)
_LEAST, _SPENT = 1e-6, 1e-5
"""Least share of its prior that a point mass keeps, and one below which it cannot get any less."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PointMassFit(FitResult):
    """A `FitResult` with the masses (N,), kg, of all bodies in a row behind its parameters."""

    masses: Array


@dataclass(frozen=True, eq=False)
class PointMassRegularizer(Regularizer):
    """A distance of masses μ ≥ 0 from their prior ones, with Φ = R μ.

    The prior of `identify` must be `points.parameters()`. Masses are kept above a millionth of
    their prior, so that every body is strictly physical.
    """

    points: PointMasses

    def __post_init__(self) -> None:
        instance(self.points, "points", PointMasses)

    @abstractmethod
    def distance(self, masses: Array) -> float:
        """Return d(μ, ⁰μ)² of masses (N,)."""

    @abstractmethod
    def add_cost(self, program: MathematicalProgram, shares: Any, weight: float) -> None:
        """Add weight · d² of μ = shares ∘ ⁰μ as a convex cost of (N,) variables of the program."""

    @abstractmethod
    def mobility(self, masses: Array) -> Array:
        """Return (N,) inverses of half the second derivatives of d² at masses (N,)."""

    def divergence(self, phi: Array, prior: Array) -> float:
        """Return the least d² of masses with the inertial parameters Φ (nb, 10)."""
        p = phi.size
        problem = FitProblem(
            factor=np.zeros((1, p + 1)),
            inertia_blocks=tuple(range(0, p, PARAMETERS_PER_BODY)),
            prior_mean=prior.ravel(),
            prior_information=np.zeros((p, p)),
            constraints=LinearConstraints(matrix=np.eye(p), lower=phi.ravel(), upper=phi.ravel()),
        )
        return self.distance(self.solve(problem, prior, 1.0, "clarabel").masses)

    def divergence_of(self, fit: FitResult, prior: Array) -> float:
        """Return d² at a solution of `solve`."""
        if isinstance(fit, PointMassFit):
            return self.distance(fit.masses)
        return super().divergence_of(fit, prior)

    def regularize(self, problem: FitProblem, prior: Array, gamma: float) -> FitProblem:
        """Return the problem with γ d² to second order around the prior; `solve` is exact."""
        return self._informed(problem, gamma, self.points.prior)

    def solve(
        self, problem: FitProblem, prior: Array, gamma: float, solver: str | None
    ) -> PointMassFit:
        """Return the masses that fit best, by Drake's conic solver of that name, Clarabel if None.

        The ArgumentError of a residual bound that no masses reach has the `minimum` that they do.
        """
        begin, solver = time.perf_counter(), solver or "clarabel"
        self._check(prior)
        check_residual_bound(problem)
        transform, inner, floor = self._of_masses(problem)
        try:
            v, weight = solved_apart(partial(self._solved, inner, solver, gamma), solver)
        except IdentificationError as failure:
            if (bound := problem.residual_bound) is not None:
                free = solve_fit(replace(inner, residual_bound=None), solver=solver)
                if bound < (least := floor + free.residual):
                    raise out_of_reach(bound, least) from failure
            raise
        x = np.clip(transform @ v, problem.lower, problem.upper)
        masses = v[: len(self.points.prior)] * self.points.prior
        fit = fit_result(self._informed(problem, gamma, masses), x, weight, solver, begin)
        return PointMassFit(**vars(fit), masses=masses)

    def certified(
        self, problem: FitProblem, prior: Array, gamma: float, fit: FitResult
    ) -> FitResult:
        """Return the solution as it is: a MathematicalProgram has solved it."""
        return fit

    def _of_masses(self, problem: FitProblem) -> tuple[Array, FitProblem, float]:
        """Return T, the fit of v = [μ/⁰μ, extra] with x = T v, and the least residual of any x.

        The residual of that fit, which has no distance, is what there is beyond the least.
        """
        N, R = len(self.points.prior), self.points.matrix()
        extra = problem.size - len(R)
        transform = np.asarray(block_diag(R * self.points.prior, np.eye(extra)))
        constraints = problem.constraints
        if constraints is not None:
            constraints = replace(constraints, matrix=constraints.matrix @ transform)
        p, bound = problem.size, problem.residual_bound
        triangle = triangular_factor([problem.factor])
        floor = float(np.square(triangle[p:, p]).sum())
        beyond = FitProblem(
            factor=np.column_stack([triangle[:p, :p] @ transform, triangle[:p, p]]),
            inertia_blocks=(),
            prior_mean=np.zeros(N + extra),
            prior_information=np.zeros((N + extra, N + extra)),
            lower=np.append(np.full(N, _LEAST), problem.lower[len(R) :]),
            upper=np.append(np.full(N, np.inf), problem.upper[len(R) :]),
            scalar_priors=dict.fromkeys(range(N), (1.0, 1.0)),
            constraints=constraints,
            residual_bound=None if bound is None else max(bound - floor, np.finfo(float).tiny),
        )
        return transform, beyond, floor

    def _solved(
        self, inner: FitProblem, solver: str, gamma: float, accuracies: Sequence[Tolerances]
    ) -> tuple[Array, float]:
        """Return v, and the weight of the prior."""
        N, prior = len(self.points.prior), self.points.prior
        # The first solution only says how to scale the cost for the second.
        size = 1e-2 * gamma * self.distance(0.0 * prior)
        for tried in (ROUGHLY, accuracies):
            for factor in _SCALES:
                fit = build_fit(inner, size=factor * size)
                self.add_cost(fit.program, fit.z[:N], gamma / fit.cost_scale)
                try:
                    result, _ = run_solver(fit.program, solver, tried)
                    break
                except IdentificationError as failure:  # rounding may end it at one scale alone
                    rounding = SolutionResult.kSolverSpecificError.name
                    if factor == _SCALES[-1] or failure.evidence.get("status") != rounding:
                        raise
            v, weight = solution_of(fit, result)
            cost = gamma * self.distance(v[:N] * prior)
            cost += inner.residual(v) if inner.residual_bound is None else 0.0
            size = max(cost, 1e-4 * size)
        return v, weight

    def _informed(self, problem: FitProblem, gamma: float, masses: Array) -> FitProblem:
        """Return it with (R M Rᵀ)⁻¹ as information, for mobilities M of masses not spent."""
        R = self.points.matrix()
        free = self.mobility(masses) * (masses > _SPENT * self.points.prior)
        information = problem.prior_information.copy()
        information[: len(R), : len(R)] += gamma * np.linalg.pinv((R * free) @ R.T, hermitian=True)
        return replace(problem, prior_information=information)

    def _check(self, prior: Array) -> None:
        own = self.points.parameters()
        differ = f"its shape is {prior.shape} instead of {own.shape}"
        if own.shape == prior.shape:
            away = np.abs(own - prior).max(1)
            bodies = np.flatnonzero(away > _SAME_PRIOR * np.abs(prior).max()).tolist()
            if not bodies:
                return
            differ = f"bodies {bodies} differ by up to {away.max():.2g}"
        raise ArgumentError(
            f"The prior is not that of the point masses: {differ}.",
            advice="Pass points.parameters() as the prior, or make points that have this one "
            "with PointMasses.of_bodies(prior).",
        )


@dataclass(frozen=True, eq=False)
class PointMassEuclidean(PointMassRegularizer):
    """d² = ‖μ − ⁰μ‖² ([Lee2019] Eq. (3.5.54)), in kg²."""

    name: ClassVar[str] = "point_mass_euclidean"

    def distance(self, masses: Array) -> float:
        """Return d(μ, ⁰μ)² of masses (N,)."""
        return float(np.square(masses - self.points.prior).sum())

    def add_cost(self, program: MathematicalProgram, shares: Any, weight: float) -> None:
        """Add weight · d² of μ = shares ∘ ⁰μ."""
        squares = 2.0 * weight * self.points.prior**2
        program.AddQuadraticCost(np.diag(squares), -squares, 0.5 * squares.sum(), shares, True)

    def mobility(self, masses: Array) -> Array:
        """Return ones (N,)."""
        return np.ones_like(masses)


@dataclass(frozen=True, eq=False)
class PointMassKL(PointMassRegularizer):
    """d² = Σ μ log(μ/⁰μ) + ⁰μ − μ, the generalized KL divergence, in kg ([Lee2019] (3.7.87))."""

    name: ClassVar[str] = "point_mass_kl"

    def distance(self, masses: Array) -> float:
        """Return d(μ ‖ ⁰μ)² of masses (N,)."""
        prior = self.points.prior
        return float((rel_entr(masses, prior) + prior - masses).sum())

    def add_cost(self, program: MathematicalProgram, shares: Any, weight: float) -> None:
        """Add weight · d² of μ = s ∘ ⁰μ: t ≥ s log s just when 1 ≥ s exp(−t/s)."""
        t = program.NewContinuousVariables(len(shares), "t")
        cone, offset = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1.0]]), np.array([1.0, 0.0, 0.0])
        for pair in zip(shares, t, strict=True):
            program.AddExponentialConeConstraint(cone, offset, np.array(pair))
        weights = weight * self.points.prior
        program.AddLinearCost(np.append(weights, -weights), weights.sum(), np.append(t, shares))

    def mobility(self, masses: Array) -> Array:
        """Return 2 μ, (N,)."""
        return 2.0 * masses
