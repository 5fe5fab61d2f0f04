"""Geodesic least squares: the bodies closest to the hyperplanes that measurements stand for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

from geodrake.boundary.arguments import integer, one_of, positive
from geodrake.descent import is_within_rounding, rounding_of_squares, step_length
from geodrake.errors import ArgumentError, ConvergenceError, IdentificationError
from geodrake.identification.coordinates import SYMMETRIC_BASIS, smat
from geodrake.identification.hyperplanes import Projections, flat, pairwise, project, spectral
from geodrake.identification.identify import identify, physical_prior
from geodrake.identification.problem import whitened
from geodrake.inertia import PARAMETERS_PER_BODY, Array, dual, from_pseudo_inertia, pseudo_inertia
from geodrake.inertia.positive_definite import karcher_mean, whitening

METHODS = ("newton", "cyclic")

_SHARE = 0.9  # of the way to where a body is none, at most in one step
_SHORT = 2.0**-8  # of that, the share from which on rows may be left out
_LEAST_CURVATURE = 1e-3  # of that of the prior
_SMALL = 1e-100
_SETTLED = 1e-6  # distance below which rounding may end the search
_MOST_ROUNDS = 5


@dataclass(frozen=True, kw_only=True, eq=False)
class GeodesicLeastSquaresResult:
    """Bodies found by `geodesic_least_squares`."""

    phi: Array  # (nb, 10) inertial parameters, all physical
    cost: float  # Σ γ_i ½ d(Φ, H_i)² + γ ½ d(Φ, Φ⁰)² over the rows that were used
    residual: float  # ‖A Φ − b‖²_{Σ⁻¹} over all rows
    rejected: tuple[int, ...]  # rows without a projection near enough, which were left out
    iterations: int
    distance: float  # length of a further Newton step, about the geodesic distance from the minimum
    curvature: float  # least eigenvalue of the Hessian over γ, which is above zero at a minimum


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
    """Find the bodies that minimize Σ γ_i ½ d(Φ, H_i)² + γ ½ d(Φ, Φ⁰)² ([Lee2019] Eq. (3.4.37)).

    H_i are the hyperplanes a_iᵀ Φ = b_i, d is the geodesic distance, and γ_i = a_iᵀ M₀⁻¹ a_i / σ_i²
    with the pullback metric M₀ at the prior (Remark 3.8), so that near the prior this is the
    regularized least squares (3.4.39) with the same γ. A row whose hyperplane no bodies within a
    factor e reach is left out, until some are within reach: measurements that make no sense for
    physical bodies do no harm.

    The problem is not convex. It starts at the minimum of its convex relation, the entropic fit
    (§3.5) with the same γ to the rows that are in use, where most hyperplanes are within reach.

    "newton" takes steps by the exact Hessian, straight on so that rows that are fulfilled stay so,
    and short enough to end inside of the cone and to lower the cost. A row is left out on the way
    only if no step lowers the cost otherwise. The "cyclic" method is that of the source (§3.4.2):
    project onto every hyperplane, and take the Karcher mean of the projections. It lowers the cost
    in every iteration, but by a share of about γ / Σ γ_i of what is left where data say nothing:
    where γ is small it says that it has not converged.

    A (m, 10·nb), b, the prior Φ⁰, γ and sigma are those of `identify`. It stops at a `tolerance`,
    the geodesic distance from the minimum by the next Newton step, or where rounding hides what is
    left of it, and gives up after `max_iterations`.

    Raises:
        ArgumentError: No row has a projection.
        ConvergenceError: No minimum was found to the tolerance.
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
    point, readmitted = _start(rows, prior, gamma), np.zeros(len(rows), bool)
    before = np.inf
    for count in range(max_iterations + 1):
        hidden = is_within_rounding(point.promise, before, point.rounding)
        if point.distance <= tolerance or (point.distance < _SETTLED and hidden):
            everything = replace(point, used=np.ones(len(rows), bool))
            returning = everything.projections.exists & ~(point.used | readmitted)
            if not returning.any():
                return _result(point, rows, count)
            # (Once each, so that there is an end.)
            readmitted |= returning
            point = replace(point, used=point.used | returning)
        if count < max_iterations:
            before = point.promise
            point = point.mean() if method == "cyclic" else point.newton_step()
    raise point.failure(
        f"is still {point.distance:.2g} from its minimum after {max_iterations} iterations",
        'Raise gamma or max_iterations, or take method="newton".',
    )


def _start(rows: Array, prior: Array, gamma: float) -> _GeodesicPoint:
    """Return the entropic fit to the rows that have projections there, and these rows."""
    point = _GeodesicPoint.of(rows, prior, gamma)
    if not point.used.any():
        raise ArgumentError(
            f"None of the {len(rows)} rows has a projection near the prior.",
            advice="Check units and signs of A and b against the prior.",
        )
    for _ in range(_MOST_ROUNDS):
        A, b = rows[point.used, :-1], rows[point.used, -1]
        try:
            fit = identify(A, b, prior, regularizer="entropic", gamma=gamma, certify=False)
        except IdentificationError:  # of data that are too much for double precision
            break
        found = point.at(whitening(pseudo_inertia(fit.phi))[0], np.ones(len(rows), bool))
        if not found.used.any():
            break
        same, point = np.array_equal(found.used, point.used), found
        if same:
            break
    return point


def _result(point: _GeodesicPoint, rows: Array, iterations: int) -> GeodesicLeastSquaresResult:
    curvature = float(point.spectrum[0][0] / point.gamma)
    if not curvature > 0:
        raise point.failure(
            f"ended where its cost has a curvature of {curvature:.2g} γ: a saddle",
            "Raise gamma, or begin at another prior.",
        )
    phi = from_pseudo_inertia(point.root @ np.swapaxes(point.root, -1, -2))
    errors = rows @ np.append(phi.ravel(), -1.0)
    return GeodesicLeastSquaresResult(
        phi=phi,
        cost=point.cost,
        residual=float(errors @ errors),
        rejected=tuple(np.flatnonzero(~point.used).tolist()),
        iterations=iterations,
        distance=point.distance,
        curvature=curvature,
    )


@dataclass(frozen=True, eq=False)
class _GeodesicPoint:
    """Bodies P = L Lᵀ, seen from m rows tr(P X) = b of weights γ_i and from a prior of weight γ.

    P is kept as its root L, which stays one however far a step leads.
    """

    prior: Array  # roots L⁰ (nb, 4, 4) of the prior P⁰
    X: Array  # (m, nb, 4, 4)
    b: Array  # (m,)
    gammas: Array  # (m,)
    gamma: float
    root: Array  # (nb, 4, 4) L
    used: NDArray[np.bool_]  # (m,) rows in use

    @classmethod
    def of(cls, rows: Array, prior: Array, gamma: float) -> _GeodesicPoint:
        """Return the prior, with the rows (m, 10·nb + 1) that have projections there."""
        root = whitening(pseudo_inertia(prior))[0]
        X = dual(rows[:, :-1].reshape(len(rows), -1, PARAMETERS_PER_BODY))
        gammas = 2.0 * np.square(np.swapaxes(root, -1, -2) @ X @ root).sum((1, 2, 3))
        everything = np.ones(len(rows), bool)
        return cls(root, X, rows[:, -1], gammas, gamma, root, everything).at(root, everything)

    def at(self, root: Array, used: NDArray[np.bool_]) -> _GeodesicPoint:
        """Return other bodies with some of the rows, less those without a projection there."""
        there = replace(self, root=root, used=used)
        if (exists := there.projections.exists).all():
            return there
        kept = used.copy()
        kept[used] = exists
        return replace(there, used=kept)

    @cached_property
    def projections(self) -> Projections:
        """Projections onto the rows in use."""
        return project(self.root, self.X[self.used], self.b[self.used])

    @property
    def weights(self) -> Array:
        return self.gammas[self.used]

    @cached_property
    def to_prior(self) -> tuple[Array, Array]:
        """Logarithms (nb, 4) and axes (nb, 4, 4) of L⁻¹ P⁰ L⁻ᵀ."""
        axes, ratios, _ = np.linalg.svd(np.linalg.solve(self.root, self.prior))
        return 2.0 * np.log(ratios), axes

    @cached_property
    def cost(self) -> float:
        data = self.weights @ self.projections.half_squared_distances
        return float(data + 0.5 * self.gamma * np.square(self.to_prior[0]).sum())

    @cached_property
    def downhill(self) -> Array:
        """Minus the gradient of the cost, (10 nb,)."""
        logs, axes = self.to_prior
        return flat(self.gamma * spectral(axes, logs) - self.projections.gradient(self.weights))

    @cached_property
    def spectrum(self) -> tuple[Array, Array]:
        """Eigenvalues and eigenvectors of the Hessian (10 nb, 10 nb) of the cost, in V."""
        logs, axes = self.to_prior
        half = np.maximum(0.5 * np.abs(logs[:, :, None] - logs[:, None, :]), _SMALL)
        own = pairwise(self.gamma * (half / np.tanh(half))[None], axes[None])
        # To second order, L (𝟙 + V) Lᵀ is on the geodesic of velocity V − ½ V².
        pull = smat(self.downhill.reshape(len(axes), -1))
        bent = block_diag(*np.einsum("bca,iad,jdc->bij", pull, SYMMETRIC_BASIS, SYMMETRIC_BASIS))
        own += self.projections.hessian(self.weights) + 0.5 * (bent + bent.T)
        values, vectors = np.linalg.eigh(own)
        return values, vectors

    @cached_property
    def step(self) -> Array:
        """Newton's step (10 nb,), turned downhill where the cost is not convex."""
        values, vectors = self.spectrum
        along = vectors.T @ self.downhill
        return vectors @ (along / np.maximum(np.abs(values), _LEAST_CURVATURE * self.gamma))

    @property
    def distance(self) -> float:
        return float(np.linalg.norm(self.step))

    @property
    def promise(self) -> float:
        """What the slope promises of Newton's step."""
        return float(self.step @ self.downhill)

    @property
    def rounding(self) -> float:
        """What the cost is not known better than."""
        return float(rounding_of_squares(self.cost, self.weights.sum() + self.gamma))

    def moved(self, change: Array) -> _GeodesicPoint:
        """Return bodies L (𝟙 + V) Lᵀ, without the rows that have no projection there."""
        values, axes = np.linalg.eigh(change)
        return self.at(self.root @ spectral(axes, np.sqrt(1.0 + values)), self.used)

    def newton_step(self) -> _GeodesicPoint:
        """Return bodies of lower cost along Newton's step; rows are lost if nothing else helps."""
        change = smat(self.step.reshape(len(self.root), -1))
        longest = _SHARE / max(_SHARE, -float(np.linalg.eigvalsh(change).min()))
        trial = self

        def decrease(share: Array) -> float:
            nonlocal trial
            trial = self.moved(share * change)
            if np.array_equal(trial.used, self.used):
                return self.cost - trial.cost
            if share > _SHORT * longest or not trial.used.any():
                return -np.inf
            return replace(self, used=trial.used).cost - trial.cost

        if step_length(decrease, self.promise, self.rounding, longest=longest):
            return trial
        raise self.failure(
            f"has no lower cost along Newton's step, {self.distance:.2g} from its minimum",
            "Raise gamma, sigma or the tolerance.",
        )

    def mean(self) -> _GeodesicPoint:
        """Return the Karcher mean of all projections and the prior ([Lee2019] Eq. (3.4.42))."""
        logs, axes = self.to_prior
        rates = np.concatenate([self.projections.rates, logs[None]])
        points = spectral(np.concatenate([self.projections.axes, axes[None]]), np.exp(rates))
        try:
            # Seen from here, so that what is far from another is so by its logarithm only.
            mean = karcher_mean(np.swapaxes(points, 0, 1), np.append(self.weights, self.gamma))
            return self.moved(mean - np.eye(4))
        except (ArgumentError, ConvergenceError) as error:
            raise self.failure(
                f"finds no mean of its projections, {self.distance:.2g} from its minimum: {error}",
                'Raise gamma, or take method="newton".',
            ) from error

    def failure(self, what: str, advice: str) -> ConvergenceError:
        words = f"Geodesic least squares {what}."
        return ConvergenceError(words, advice=advice, distance=self.distance)
