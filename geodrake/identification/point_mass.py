"""Identify bodies as point masses at given positions, close to prior masses.

With nonnegative masses, every body is physical and inside the hull of its points ([Lee2019]
Eqs. (3.5.54)–(3.5.56), (3.7.87)).
"""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import MathematicalProgram, SolutionResult
from scipy.linalg import block_diag, eigvalsh
from scipy.special import rel_entr

from geodrake.boundary.arguments import instance, instances, integer, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification.conic_fit import build_fit, solution_of, solve_fit
from geodrake.identification.fit import FitResult, fit_result
from geodrake.identification.identify import build_problem
from geodrake.identification.problem import (
    FitProblem,
    LinearConstraints,
    check_residual_bound,
    unreachable_bound,
)
from geodrake.identification.regularizer import Regularizer, Solver
from geodrake.identification.solvers import ROUGHLY, Accuracies, run_solver, solve_in_subprocess
from geodrake.inertia import (
    PARAMETERS_PER_BODY,
    Array,
    Ellipsoid,
    is_physical,
    pseudo_inertia,
)
from geodrake.inertia.parameters import central_second_moment, from_point_masses
from geodrake.robot.reduction import triangular_factor

_MOST = 1_000_000  # largest number of points of a body
_SAME_PRIOR = 1e-6
_SCALES = (1.0, 0.3, 3.0, 0.1, 10.0, 0.03)
_LEAST, _SPENT = 1e-6, 1e-5
"""Lower bound of a point mass relative to its prior, and the ratio below which it is active."""


@dataclass(frozen=True, eq=False)
class PointMasses(Short):
    """Point masses of several bodies."""

    positions: tuple[Array, ...]  # (n_i, 3) in each body's frame, m
    masses: tuple[Array, ...]  # (n_i,) prior masses ⁰μ > 0, kg

    def __post_init__(self) -> None:
        places = instances(self.positions, "positions", object)
        given = instances(self.masses, "masses", object)
        if len(given) != len(places):
            raise ArgumentError(
                f"Masses are needed for each of the {len(places)} bodies; got {len(given)}."
            )
        positions = [real_array(p, f"positions[{i}]", ("m", 3)) for i, p in enumerate(places)]
        masses = [
            real_array(mass, f"masses[{i}]", (len(positions[i]),)) for i, mass in enumerate(given)
        ]
        if wrong := [i for i, mass in enumerate(masses) if not (len(mass) and (mass > 0).all())]:
            raise ArgumentError(
                f"Bodies {wrong} have no points, or prior masses that are not positive."
            )
        object.__setattr__(self, "positions", tuple(positions))
        object.__setattr__(self, "masses", tuple(masses))

    @classmethod
    def of_bodies(cls, phi: ArrayLike, counts: int | Sequence[int] = 85) -> PointMasses:
        """Spread equal masses evenly over the uniform ellipsoid of every body of phi (nb, 10).

        They have exactly the inertial parameters phi. The counts, one for all or one for each body,
        are at least 10 points.
        """
        phi, numbers = _checked_bodies(phi, counts)
        com, spread = phi[:, 1:4] / phi[:, :1], central_second_moment(phi) / phi[:, :1, None]
        parts = zip(com, np.linalg.cholesky(spread), numbers, strict=True)
        positions = [center + _unit_ball(number) @ root.T for center, root, number in parts]
        masses = [np.full(n, body[0] / n) for n, body in zip(numbers, phi, strict=True)]
        return cls(tuple(positions), tuple(masses))

    @classmethod
    def within(
        cls, phi: ArrayLike, ellipsoids: Ellipsoid, counts: int | Sequence[int] = 85
    ) -> PointMasses:
        """Spread points over given regions of bodies phi (nb, 10), with more mass at the bodies.

        Half of the points are spread evenly over the region, with half of the largest uniform mass
        that the body allows there. The others are those of `of_bodies` for the rest of the body.
        `ellipsoids` are of shape (nb,). The counts, one for all or one for each body, are at least
        20 points.
        """
        phi, numbers = _checked_bodies(phi, counts, least=2 * PARAMETERS_PER_BODY)
        regions = instance(ellipsoids, "ellipsoids", Ellipsoid)
        if regions.center.shape != (len(phi), 3):
            raise ArgumentError(
                f"Ellipsoids of shape ({len(phi)},), one for each body, are needed; got "
                f"{regions.center.shape[:-1]}."
            )
        positions, masses = [], []
        for k, (body, number) in enumerate(zip(phi, numbers, strict=True)):
            ball = _unit_ball(number // 2)
            spread = regions.rotation[k] * regions.semi_axes[k]
            even = regions.center[k] + ball / np.linalg.norm(ball, axis=1).max() @ spread.T
            unit = from_point_masses(np.full(len(even), 1.0 / len(even)), even)
            mass = 0.5 / float(eigvalsh(pseudo_inertia(unit), pseudo_inertia(body))[-1])
            rest = cls.of_bodies([body - mass * unit], number - len(even))
            positions.append(np.vstack([*rest.positions, even]))
            masses.append(np.append(rest.masses[0], np.full(len(even), mass / len(even))))
        return cls(tuple(positions), tuple(masses))

    @property
    def prior(self) -> Array:
        """Prior masses ⁰μ (N,) of all bodies, kg."""
        return np.concatenate(self.masses)

    def matrix(self) -> Array:
        """Return R (10·nb, N) with Φ = R μ."""
        units = (from_point_masses(np.ones((len(x), 1)), x[:, None]) for x in self.positions)
        return np.asarray(block_diag(*(unit.T for unit in units)))

    def parameters(self, masses: ArrayLike | None = None) -> Array:
        """Return the parameters (nb, 10) of masses μ (N,), by default the prior ones."""
        mu = self.prior if masses is None else real_array(masses, "masses", (len(self.prior),))
        return (self.matrix() @ mu).reshape(-1, PARAMETERS_PER_BODY)


def _checked_bodies(
    phi: ArrayLike, counts: int | Sequence[int], least: int = PARAMETERS_PER_BODY
) -> tuple[Array, list[int]]:
    """Return physical bodies (nb, 10), and the number of points of each."""
    phi = real_array(phi, "phi", ("m", PARAMETERS_PER_BODY))
    wrong = np.flatnonzero(~is_physical(phi)).tolist()
    if wrong:
        raise ArgumentError(
            f"Bodies {wrong} are not physical, so point masses cannot represent them.",
            bodies=wrong,
        )
    if isinstance(counts, int | np.integer):
        counts = (counts,) * len(phi)
    elif real_array(counts, "counts").shape != (len(phi),):
        raise ArgumentError(f"counts must have shape ({len(phi)},); got {np.shape(counts)}.")
    return phi, [integer(n, "counts", lower=least, upper=_MOST) for n in counts]


def _unit_ball(number: int) -> Array:
    """Return evenly spread points (n, 3) of a ball, with zero mean and unit covariance.

    R_3 low-discrepancy points (M. Roberts 2018) in a cube, mapped to the ball and then corrected.
    """
    fractions = np.power(1.2207440846057596, -np.arange(1, 4))
    cube = (0.5 + np.arange(1, number + 1)[:, None] * fractions) % 1.0
    radius, height = np.cbrt(cube[:, 0]), 2.0 * cube[:, 1] - 1.0
    angle, side = 2.0 * np.pi * cube[:, 2], np.sqrt(1.0 - height**2)
    ball = radius[:, None] * np.column_stack([side * np.cos(angle), side * np.sin(angle), height])
    ball -= ball.mean(0)
    root = np.linalg.cholesky(ball.T @ ball / number)
    return np.asarray(np.linalg.solve(root, ball.T).T)


@dataclass(frozen=True, eq=False)
class PointMassRegularizer(Regularizer):
    """Distance of masses μ ≥ 0 from prior masses, with Φ = R μ.

    The prior of `identify` must be `points.parameters()`. Masses stay above a millionth of their
    prior, so that every body is strictly physical.
    """

    points: PointMasses

    def __post_init__(self) -> None:
        instance(self.points, "points", PointMasses)

    @abstractmethod
    def distance(self, masses: Array) -> float:
        """Return d(μ, ⁰μ)² of masses (N,)."""

    @abstractmethod
    def add_cost(self, program: MathematicalProgram, shares: Any, weight: float) -> None:
        """Add the convex cost weight · d² of μ = shares ∘ ⁰μ, with shares (N,) as variables."""

    @abstractmethod
    def mobility(self, masses: Array) -> Array:
        """Return the inverses (N,) of half the second derivatives of d² at masses (N,)."""

    def divergence(self, phi: Array, prior: Array) -> float:
        """Return the smallest d² of masses with the inertial parameters Φ (nb, 10)."""
        wanted = LinearConstraints(matrix=np.eye(phi.size), lower=phi.ravel(), upper=phi.ravel())
        problem = build_problem(np.zeros((1, phi.size + 1)), prior)
        problem = replace(problem, constraints=wanted)
        return self.divergence_of(self.solve(problem, prior, 1.0, None), prior)

    def divergence_of(self, fit: FitResult, prior: Array) -> float:
        """Return d² at a solution of `solve`."""
        if fit.masses is None:
            return super().divergence_of(fit, prior)
        return self.distance(fit.masses)

    def regularize(self, problem: FitProblem, prior: Array, gamma: float) -> FitProblem:
        """Return the problem with the second order of γ d² at the prior; `solve` is exact."""
        return self._informed(problem, gamma, self.points.prior)

    def solve(
        self, problem: FitProblem, prior: Array, gamma: float, solver: Solver, certify: bool = False
    ) -> FitResult:
        """Return the fit of the masses by one of Drake's conic solvers, by default Clarabel.

        There is no certificate, as the fit itself is a MathematicalProgram. The ArgumentError of an
        unreachable residual bound has the `minimum` in its evidence.
        """
        begin, solver = time.perf_counter(), solver or "clarabel"
        self._check(prior)
        check_residual_bound(problem)
        transform, inner, floor = self._of_masses(problem)
        try:
            v, weight = solve_in_subprocess(partial(self._solved, inner, solver, gamma), solver)
        except IdentificationError as failure:
            if (bound := problem.residual_bound) is not None:
                free = solve_fit(replace(inner, residual_bound=None), solver=solver)
                if bound < (least := floor + free.residual):
                    raise unreachable_bound(bound, least) from failure
            raise
        x = np.clip(transform @ v, problem.lower, problem.upper)
        masses = v[: len(self.points.prior)] * self.points.prior
        fit = fit_result(self._informed(problem, gamma, masses), x, weight, solver, begin)
        return replace(fit, masses=masses)

    def _of_masses(self, problem: FitProblem) -> tuple[Array, FitProblem, float]:
        """Return T, the fit of v = [μ/⁰μ, extra] with x = T v, and the least residual of any x.

        The fit has no distance yet, and its residual is that beyond the least.
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
        self, inner: FitProblem, solver: str, gamma: float, accuracies: Accuracies
    ) -> tuple[Array, float]:
        """Return v, and the weight of the prior."""
        N, prior = len(self.points.prior), self.points.prior
        # The first, rough solution only sets the scale of the cost for the second.
        size = 1e-2 * gamma * self.distance(0.0 * prior)
        for tolerances in (ROUGHLY, accuracies):
            for factor in _SCALES:
                fit = build_fit(inner, size=factor * size)
                self.add_cost(fit.program, fit.z[:N], gamma / fit.cost_scale)
                try:
                    result, _ = run_solver(fit.program, solver, tolerances)
                    break
                except IdentificationError as failure:  # rounding may fail at only one scale
                    rounding = SolutionResult.kSolverSpecificError.name
                    if factor == _SCALES[-1] or failure.evidence.get("status") != rounding:
                        raise
            v, weight = solution_of(fit, result)
            cost = gamma * self.distance(v[:N] * prior)
            cost += inner.residual(v) if inner.residual_bound is None else 0.0
            size = max(cost, 1e-4 * size)
        return v, weight

    def _informed(self, problem: FitProblem, gamma: float, masses: Array) -> FitProblem:
        """Return the problem with the information (R M Rᵀ)⁻¹, for mobilities M of free masses."""
        R = self.points.matrix()
        free = self.mobility(masses) * (masses > _SPENT * self.points.prior)
        information = problem.prior_information.copy()
        information[: len(R), : len(R)] += gamma * np.linalg.pinv((R * free) @ R.T, hermitian=True)
        return replace(problem, prior_information=information)

    def _check(self, prior: Array) -> None:
        """Raise if the prior is not that of the points."""
        expected = self.points.parameters()
        difference = f"its shape is {prior.shape} instead of {expected.shape}"
        if expected.shape == prior.shape:
            errors = np.abs(expected - prior).max(1)
            bodies = np.flatnonzero(errors > _SAME_PRIOR * np.abs(prior).max()).tolist()
            difference = f"bodies {bodies} differ by up to {errors.max():.2g}" if bodies else ""
        if difference:
            raise ArgumentError(
                f"The prior differs from the point masses: {difference}.",
                advice="Pass points.parameters() as the prior, or construct points for this "
                "prior with PointMasses.of_bodies(prior).",
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
        """Add weight · d² of μ = s ∘ ⁰μ, with t ≥ s log s as 1 ≥ s exp(−t/s)."""
        t = program.NewContinuousVariables(len(shares), "t")
        cone, offset = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1.0]]), np.array([1.0, 0.0, 0.0])
        for pair in zip(shares, t, strict=True):
            program.AddExponentialConeConstraint(cone, offset, np.array(pair))
        weights = weight * self.points.prior
        program.AddLinearCost(np.append(weights, -weights), weights.sum(), np.append(t, shares))

    def mobility(self, masses: Array) -> Array:
        """Return 2 μ, (N,)."""
        return 2.0 * masses
