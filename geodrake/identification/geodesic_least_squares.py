"""Geodesic least squares: the bodies closest to the hyperplanes that measurements stand for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve

from geodrake.boundary.arguments import integer, one_of, positive
from geodrake.errors import ArgumentError, ConvergenceError
from geodrake.identification.coordinates import SYMMETRIC_BASIS
from geodrake.identification.hyperplanes import Projections, covectors, project
from geodrake.identification.identify import physical_prior
from geodrake.identification.problem import whitened
from geodrake.inertia import Array, from_pseudo_inertia, pseudo_inertia
from geodrake.inertia.positive_definite import exponential, karcher_mean, logarithm, whitening

METHODS = ("newton", "cyclic")

_ROUNDING = 1e-12
_MOST_HALVINGS = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class GeodesicLeastSquaresResult:
    """Bodies found by `geodesic_least_squares`.

    Attributes:
        phi: (nb, 10) inertial parameters, all physical.
        cost: Σ γ_i ½ d(Φ, H_i)² + γ ½ d(Φ, Φ⁰)² over the rows that were used.
        residual: ‖A Φ − b‖²_{Σ⁻¹} over all rows.
        rejected: Rows without a projection near enough, which were left out.
        iterations: Iterations taken.
    """

    phi: Array
    cost: float
    residual: float
    rejected: tuple[int, ...]
    iterations: int


def geodesic_least_squares(
    A: ArrayLike,
    b: ArrayLike,
    prior: ArrayLike,
    *,
    gamma: float,
    sigma: ArrayLike | None = None,
    method: str = "newton",
    tolerance: float = 1e-8,
    max_iterations: int = 2000,
) -> GeodesicLeastSquaresResult:
    """Bodies that minimize Σ γ_i ½ d(Φ, H_i)² + γ ½ d(Φ, Φ⁰)² ([Lee2019] Eq. (3.4.37)).

    H_i are the hyperplanes a_iᵀ Φ = b_i, d is the geodesic distance, and γ_i = a_iᵀ M₀⁻¹ a_i / σ_i²
    with the pullback metric M₀ at the prior (Remark 3.8), so that near the prior this is the
    regularized least squares (3.4.39) with the same γ. A row whose hyperplane no bodies within a
    factor e reach is left out: measurements that make no sense for physical bodies do no harm.

    The "cyclic" method is that of the source (§3.4.2): project onto every hyperplane, and take the
    Karcher mean of the projections. It lowers the cost in every iteration, but slowly when γ is
    small. "newton" goes to the same place by Gauss–Newton steps along geodesics.

    Args:
        A: (m, 10·nb) regressor.
        b: (m,) measurements.
        prior: (nb, 10) physical inertial parameters Φ⁰, where it starts.
        gamma: Weight γ > 0.
        sigma: (m,) or scalar standard deviations of b, in its units; None for 1.
        method: "newton" or "cyclic".
        tolerance: Geodesic distance from the minimum at which to stop.
        max_iterations: Iterations after which to give up.

    Returns:
        A local minimum, as the problem is not convex.

    Raises:
        ArgumentError: A shape or value is wrong, or no row has a projection.
        ConvergenceError: The tolerance was not reached.
    """
    one_of(method, "method", METHODS)
    gamma = positive(gamma, "gamma")
    positive(tolerance, "tolerance")
    integer(max_iterations, "max_iterations", lower=1)
    prior = physical_prior(prior)
    rows = whitened(A, b, sigma=sigma)
    if rows.shape[1] - 1 != prior.size:
        raise ArgumentError(
            f"A has {rows.shape[1] - 1} columns, but {len(prior)} bodies of the prior have "
            f"{prior.size}; there are no other parameters here.",
            advice="Subtract what friction and the like contribute to b first.",
        )
    iteration = _Iteration.start(rows, prior, gamma)
    for count in range(max_iterations):
        step = iteration.gauss_newton()
        if np.linalg.norm(step) <= tolerance:
            phi = from_pseudo_inertia(iteration.P)
            errors = rows @ np.append(phi.ravel(), -1.0)
            rejected = tuple(np.flatnonzero(~iteration.used).tolist())
            return GeodesicLeastSquaresResult(
                phi=phi,
                cost=iteration.cost,
                residual=float(errors @ errors),
                rejected=rejected,
                iterations=count,
            )
        iteration = iteration.mean() if method == "cyclic" else iteration.along(step)
    raise ConvergenceError(
        f"Geodesic least squares is still {np.linalg.norm(step):.2g} from its minimum after "
        f"{max_iterations} iterations.",
        advice='Raise gamma or max_iterations, or take method="newton".',
        distance=float(np.linalg.norm(step)),
    )


@dataclass(frozen=True, eq=False)
class _Iteration:
    """One set of bodies and its projections.

    Attributes:
        P: (nb, 4, 4) pseudo inertias of the bodies.
        prior: (nb, 4, 4) those of the prior.
        X: (m, nb, 4, 4) rows of the regressor.
        b: (m,) values.
        weights: (m,) γ_i.
        gamma: γ.
        used: (m,) rows that are not rejected.
        projections: Onto the rows in use.
    """

    P: Array
    prior: Array
    X: Array
    b: Array
    weights: Array
    gamma: float
    used: NDArray[np.bool_]
    projections: Projections

    @classmethod
    def start(cls, rows: Array, prior: Array, gamma: float) -> _Iteration:
        P, X = pseudo_inertia(prior), covectors(rows[:, :-1])
        projections = project(whitening(P)[0], X, rows[:, -1])
        weights = 2.0 * np.square(projections.normals).sum((1, 2, 3))
        used = projections.exists
        if not used.any():
            raise ArgumentError(
                f"None of the {len(rows)} rows has a projection near the prior.",
                advice="Check units and signs of A and b against the prior.",
            )
        return cls(P, P, X, rows[:, -1], weights, gamma, used, _chosen(projections, used))

    def moved(self, P: Array) -> _Iteration:
        """The same rows at other bodies; those that lost their projection are rejected."""
        found = project(whitening(P)[0], self.X[self.used], self.b[self.used])
        used = self.used.copy()
        used[used] = found.exists
        values = (P, self.prior, self.X, self.b, self.weights, self.gamma)
        return _Iteration(*values, used, _chosen(found, found.exists))

    @property
    def towards_prior(self) -> Array:
        """(nb, 4, 4) velocity Q of the geodesic to the prior, P⁰ = L exp(Q) Lᵀ."""
        _, inverse = whitening(self.P)
        turned = inverse @ logarithm(self.P, self.prior) @ np.swapaxes(inverse, -1, -2)
        return np.asarray(turned, float)

    @property
    def cost(self) -> float:
        """The cost over the rows in use."""
        data = self.weights[self.used] @ self.projections.half_squared_distances
        return float(data + 0.5 * self.gamma * np.square(self.towards_prior).sum())

    def gauss_newton(self) -> Array:
        """Velocities (10·nb,) in the axes of `SYMMETRIC_BASIS`, towards the minimum."""
        weights = self.weights[self.used]
        pull = np.einsum("m,mbij->bij", weights, self.projections.velocities)
        downhill = _flat(pull + self.gamma * self.towards_prior)
        normals = self.projections.normals
        sizes = np.sqrt(np.square(normals).sum((1, 2, 3)))
        directions = _flat(normals) * (np.sqrt(weights) / sizes)[:, None]
        hessian = directions.T @ directions + self.gamma * np.eye(len(downhill))
        return np.asarray(cho_solve(cho_factor(hessian), downhill), float)

    def along(self, step: Array) -> _Iteration:
        """Bodies of lower cost along a step; rows are only rejected where nothing else helps."""
        L, _ = whitening(self.P)
        velocity = np.einsum("bk,kij->bij", step.reshape(len(L), -1), SYMMETRIC_BASIS)
        velocity = L @ velocity @ np.swapaxes(L, -1, -2)
        before, length = self.cost, 1.0
        for _ in range(_MOST_HALVINGS):
            trial = self.moved(exponential(self.P, length * velocity))
            whole = np.array_equal(trial.used, self.used)
            if whole and trial.cost <= before * (1.0 + _ROUNDING):
                return trial
            length *= 0.5
        return self.mean()

    def mean(self) -> _Iteration:
        """The Karcher mean of all projections and the prior ([Lee2019] Eq. (3.4.42))."""
        L, _ = whitening(self.P)
        rates, axes = np.linalg.eigh(self.projections.velocities)
        sides = L @ axes * np.exp(0.5 * rates)[..., None, :]
        points = np.concatenate([sides @ np.swapaxes(sides, -1, -2), self.prior[None]])
        weights = np.append(self.weights[self.used], self.gamma)
        return self.moved(karcher_mean(np.swapaxes(points, 0, 1), weights))


def _chosen(projections: Projections, rows: NDArray[np.bool_]) -> Projections:
    """The projections onto some rows."""
    return Projections(
        projections.exists[rows], projections.velocities[rows], projections.normals[rows]
    )


def _flat(matrices: Array) -> Array:
    """Coordinates (…, 10·nb) of symmetric matrices (…, nb, 4, 4)."""
    coordinates = np.einsum("...ij,kij->...k", matrices, SYMMETRIC_BASIS)
    return np.asarray(coordinates.reshape(*matrices.shape[:-3], -1), float)
