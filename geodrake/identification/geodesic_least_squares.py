"""Geodesic least squares: bodies with minimal geodesic distances to measured hyperplanes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag
from scipy.special import lambertw

from geodrake.boundary.arguments import integer, one_of, positive
from geodrake.descent import is_within_rounding, rounding_of_squares, step_length
from geodrake.errors import ArgumentError, ConvergenceError, IdentificationError
from geodrake.identification.coordinates import SYMMETRIC_BASIS, smat, svec
from geodrake.identification.identify import identify, physical_prior
from geodrake.identification.problem import whitened
from geodrake.inertia import PARAMETERS_PER_BODY, Array, from_pseudo_inertia, pseudo_inertia
from geodrake.inertia.parameters import dual
from geodrake.inertia.positive_definite import karcher_mean, whitening

METHODS = ("newton", "cyclic")

_SHARE = 0.9  # longest step, relative to the boundary of physical bodies
_SHORT = 2.0**-8  # relative step length below which rows may be dropped
_LEAST_CURVATURE = 1e-3  # relative to the prior's
_SMALL = 1e-100
_SETTLED = 1e-6  # distance below which rounding may end the search
_MOST_ROUNDS = 5
_ROOT = 1e-14
_MOST_STEPS = 200
_SAME = 1e-5
_LEAST_ROOM = 1e-8  # least 1 + W, which vanishes where a projection ceases to exist


@dataclass(frozen=True, kw_only=True, eq=False)
class GeodesicLeastSquaresResult:
    """Bodies found by `geodesic_least_squares`."""

    phi: Array  # (nb, 10) inertial parameters, all physical
    cost: float  # Σ γ_i ½ d(Φ, H_i)² + γ ½ d(Φ, Φ⁰)² over the used rows
    residual: float  # ‖A Φ − b‖²_{Σ⁻¹} over all rows
    rejected: tuple[int, ...]  # unused rows, without a projection within reach
    iterations: int
    distance: float  # length of the next Newton step, about the distance from the minimum
    curvature: float  # least eigenvalue of the Hessian over γ, positive at a minimum


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
    """Minimize Σ γ_i ½ d(Φ, H_i)² + γ ½ d(Φ, Φ⁰)² over physical bodies ([Lee2019] Eq. (3.4.37)).

    H_i are the hyperplanes a_iᵀ Φ = b_i, d is the geodesic distance, and γ_i = a_iᵀ M₀⁻¹ a_i / σ_i²
    with the pullback metric M₀ at the prior (Remark 3.8), so that close to the prior this is the
    regularized least squares (3.4.39) with the same γ. A row is unused while no bodies within a
    factor e reach its hyperplane, so that outliers that are not physical do no harm.

    The problem is not convex. The search starts at the entropic fit (§3.5) with the same γ to the
    used rows, where most hyperplanes are within reach.

    "newton" uses the exact Hessian. Its steps are straight, so that satisfied rows stay satisfied,
    and short enough to stay inside the cone and to lower the cost. A row is dropped only if no
    other step lowers the cost. "cyclic" is the method of the source (§3.4.2): project onto every
    hyperplane, and take the Karcher mean of the projections. It lowers the cost in every iteration,
    but along directions without data by only about γ / Σ γ_i of the rest, so that it does not
    converge for small γ.

    A (m, 10·nb), b, the prior Φ⁰, γ and sigma are those of `identify`. The search stops when the
    next Newton step, about the geodesic distance from the minimum, is below `tolerance` or hidden
    by rounding, and fails after `max_iterations`.

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
            f"A has {rows.shape[1] - 1} columns, but {len(prior)} bodies of the prior need "
            f"{prior.size}; other parameters are not allowed here.",
            advice="Subtract contributions of friction and the like from b first.",
        )
    point, readmitted = _start(rows, prior, gamma), np.zeros(len(rows), bool)
    previous = np.inf
    for count in range(max_iterations + 1):
        hidden = is_within_rounding(point.promise, previous, point.rounding)
        if point.distance <= tolerance or (point.distance < _SETTLED and hidden):
            with_all_rows = replace(point, used=np.ones(len(rows), bool))
            returning = with_all_rows.projections.exists & ~(point.used | readmitted)
            if not returning.any():
                return point.result(rows, count)
            # Once each, so that the search terminates.
            readmitted |= returning
            point = replace(point, used=point.used | returning)
        if count < max_iterations:
            previous = point.promise
            point = point.mean() if method == "cyclic" else point.newton_step()
    raise point.failure(
        f"is still {point.distance:.2g} from its minimum after {max_iterations} iterations",
        'Raise gamma or max_iterations, or use method="newton".',
    )


def _start(rows: Array, prior: Array, gamma: float) -> _GeodesicPoint:
    """Return the entropic fit to the rows with projections there."""
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
        except IdentificationError:  # beyond double precision
            break
        fitted = point.at(whitening(pseudo_inertia(fit.phi))[0], np.ones(len(rows), bool))
        if not fitted.used.any():
            break
        converged, point = np.array_equal(fitted.used, point.used), fitted
        if converged:
            break
    return point


@dataclass(frozen=True, eq=False)
class _GeodesicPoint:
    """Bodies P = L Lᵀ with m rows tr(P X) = b of weights γ_i, and a prior of weight γ.

    P is stored as its root L, which keeps it positive definite.
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
        """Return the prior, with those of the rows (m, 10·nb + 1) that have projections there."""
        root = whitening(pseudo_inertia(prior))[0]
        X = dual(rows[:, :-1].reshape(len(rows), -1, PARAMETERS_PER_BODY))
        gammas = 2.0 * np.square(np.swapaxes(root, -1, -2) @ X @ root).sum((1, 2, 3))
        all_rows = np.ones(len(rows), bool)
        return cls(root, X, rows[:, -1], gammas, gamma, root, all_rows).at(root, all_rows)

    def at(self, root: Array, used: NDArray[np.bool_]) -> _GeodesicPoint:
        """Return other bodies with those of the rows that have projections there."""
        point = replace(self, root=root, used=used)
        if (exists := point.projections.exists).all():
            return point
        kept = used.copy()
        kept[used] = exists
        return replace(point, used=kept)

    @cached_property
    def projections(self) -> Projections:
        """Projections onto the used rows."""
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
        hessian = pairwise(self.gamma * (half / np.tanh(half))[None], axes[None])
        # To second order, L (𝟙 + V) Lᵀ is on the geodesic of velocity V − ½ V².
        gradient = smat(self.downhill.reshape(len(axes), -1))
        basis = SYMMETRIC_BASIS
        bend = block_diag(*np.einsum("bca,iad,jdc->bij", gradient, basis, basis))
        hessian += self.projections.hessian(self.weights) + 0.5 * (bend + bend.T)
        values, vectors = np.linalg.eigh(hessian)
        return values, vectors

    @cached_property
    def step(self) -> Array:
        """Newton's step (10 nb,), a descent direction even if the cost is not convex."""
        values, vectors = self.spectrum
        along = vectors.T @ self.downhill
        return vectors @ (along / np.maximum(np.abs(values), _LEAST_CURVATURE * self.gamma))

    @property
    def distance(self) -> float:
        return float(np.linalg.norm(self.step))

    @property
    def promise(self) -> float:
        """Decrease of the cost predicted by the slope of Newton's step."""
        return float(self.step @ self.downhill)

    @property
    def rounding(self) -> float:
        """Rounding error of the cost."""
        return float(rounding_of_squares(self.cost, self.weights.sum() + self.gamma))

    def moved(self, change: Array) -> _GeodesicPoint:
        """Return the bodies L (𝟙 + V) Lᵀ with the rows that have projections there."""
        values, axes = np.linalg.eigh(change)
        return self.at(self.root @ spectral(axes, np.sqrt(1.0 + values)), self.used)

    def newton_step(self) -> _GeodesicPoint:
        """Return bodies of lower cost along Newton's step, dropping rows if necessary."""
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
            # In coordinates at this point, where logarithms measure distances.
            mean = karcher_mean(np.swapaxes(points, 0, 1), np.append(self.weights, self.gamma))
            return self.moved(mean - np.eye(4))
        except (ArgumentError, ConvergenceError) as error:
            raise self.failure(
                f"finds no mean of its projections, {self.distance:.2g} from its minimum: {error}",
                'Raise gamma, or use method="newton".',
            ) from error

    def result(self, rows: Array, iterations: int) -> GeodesicLeastSquaresResult:
        curvature = float(self.spectrum[0][0] / self.gamma)
        if not curvature > 0:
            raise self.failure(
                f"ended at a saddle point, where its cost has curvature {curvature:.2g} γ",
                "Raise gamma, or use another prior.",
            )
        phi = from_pseudo_inertia(self.root @ np.swapaxes(self.root, -1, -2))
        errors = rows @ np.append(phi.ravel(), -1.0)
        return GeodesicLeastSquaresResult(
            phi=phi,
            cost=self.cost,
            residual=float(errors @ errors),
            rejected=tuple(np.flatnonzero(~self.used).tolist()),
            iterations=iterations,
            distance=self.distance,
            curvature=curvature,
        )

    def failure(self, predicate: str, advice: str) -> ConvergenceError:
        problem = f"Geodesic least squares {predicate}."
        return ConvergenceError(problem, advice=advice, distance=self.distance)


class Projections(NamedTuple):
    """Geodesic projections of bodies onto m hyperplanes ([Lee2019] Proposition 3.2).

    With P = L Lᵀ, the gradient of tr(P X) is N = Lᵀ X L = U diag(σ) Uᵀ, and P̂ = L exp(Q) Lᵀ with
    Q = −W(λ N) for the inverse W of w eʷ.
    """

    # (m,) whether the projection exists within a factor e: λ_max(P⁻¹ P̂) ≤ e for every body.
    exists: NDArray[np.bool_]
    sigma: Array  # (m, nb, 4) eigenvalues σ
    axes: Array  # (m, nb, 4, 4) U
    rates: Array  # (m, nb, 4) eigenvalues −W(λ σ) of Q; zero without a projection

    @property
    def half_squared_distances(self) -> Array:
        """½ d², (m,)."""
        return 0.5 * np.square(self.rates).sum((1, 2))

    def gradient(self, weights: Array) -> Array:
        """Return the gradient (nb, 4, 4) of Σ γ_i ½ d_i² along L exp(t V) Lᵀ."""
        return -np.asarray(np.einsum("m,mbij->bij", weights, spectral(self.axes, self.rates)))

    def hessian(self, weights: Array) -> Array:
        """Return the Hessian (10 nb, 10 nb) of Σ γ_i ½ d_i² in the coordinates of `flat`.

        The frame L exp(½ t V) is parallel along the geodesic, so Hess[V] = −dQ with
        dN = ½ (V N + N V), where λ keeps P̂ on its hyperplane. In the axes of N, the Hessian of each
        row is diagonal plus a rank-one term.
        """
        W = -self.rates
        decay = np.exp(-W) / np.maximum(1.0 + W, _LEAST_ROOM)  # W'(λ σ)
        x = W * np.exp(W)
        # Divided differences of W, or W' for nearly equal arguments.
        gap, middle = W[..., :, None] - W[..., None, :], 0.5 * (W[..., :, None] + W[..., None, :])
        near = np.abs(gap) < _SAME
        slope = np.exp(-middle) / np.maximum(1.0 + middle, _LEAST_ROOM)
        step = np.where(near, 1.0, x[..., :, None] - x[..., None, :])
        curvature = 0.5 * (x[..., :, None] + x[..., None, :])
        curvature *= np.where(near, slope, gap / np.where(step == 0.0, 1.0, step))
        hessian = pairwise(weights[:, None, None, None] * curvature, self.axes)
        along = self.sigma * decay
        size = (np.square(self.sigma) * np.exp(-W) * decay).sum((1, 2))
        pull = flat(spectral(self.axes, along))
        pull *= np.sqrt(weights / np.where(size > 0, size, 1.0))[:, None]
        return np.asarray(hessian + pull.T @ pull)


def spectral(axes: Array, values: Array) -> Array:
    """Return the symmetric matrices (…, 4, 4) with axes (…, 4, 4) and eigenvalues (…, 4)."""
    return np.asarray((axes * values[..., None, :]) @ np.swapaxes(axes, -1, -2))


def flat(matrices: Array) -> Array:
    """Return coordinates (…, 10 nb) of symmetric matrices (…, nb, 4, 4)."""
    coordinates = svec(np.ascontiguousarray(matrices))
    return coordinates.reshape(*coordinates.shape[:-2], -1)


def pairwise(values: Array, axes: Array) -> Array:
    """Return the matrix (10 nb, 10 nb) of m summed quadratic forms Σ values_ab (uₐᵀ V u_b)².

    Coordinates of V are those of `flat`, values (m, nb, 4, 4) are symmetric, and axes (m, nb, 4, 4)
    have u as columns.
    """
    turned = np.swapaxes(axes, -1, -2)[..., None, :, :] @ SYMMETRIC_BASIS @ axes[..., None, :, :]
    rows, nb = turned.shape[:2]
    turned = np.moveaxis(turned, 0, 1).reshape(nb, rows, len(SYMMETRIC_BASIS), 16)
    scaled = turned * np.moveaxis(values, 0, 1).reshape(nb, rows, 1, 16)
    blocks = np.einsum("bmip,bmjp->bij", scaled, turned, optimize=True)
    return np.asarray(block_diag(*blocks))


def project(roots: Array, X: Array, b: Array) -> Projections:
    """Project bodies with roots L (nb, 4, 4) onto hyperplanes Σ_j tr(P_j X_ij) = b_i.

    X is (m, nb, 4, 4).
    """
    sigma, axes = np.linalg.eigh(np.swapaxes(roots, -1, -2) @ X @ roots)
    multiplier, exists = _multipliers(sigma.reshape(len(b), -1), b)
    rates = -_lambert(multiplier[:, None, None] * sigma)
    rates[~exists] = 0.0
    return Projections(exists, sigma, axes, rates)


def _multipliers(sigma: Array, b: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return roots λ (m,) of C(λ) = Σ_k σ_k exp(−W(λ σ_k)) − b, and whether they exist.

    [Lee2019] Eq. (3.4.40): C decreases on the interval where all λ σ_k ≥ −1/e, so that its values
    at the ends determine whether it has a root. Newton's method, with a bracket.
    """
    scale = np.abs(sigma).max(1)
    usable = scale > 0
    safe = np.where(usable, scale, 1.0)
    sigma, b = sigma / safe[:, None], b / safe
    # At an end, λ σ_k = −1/e for the largest σ > 0 or the smallest σ < 0.
    ends = np.stack([-sigma.max(1), -sigma.min(1)])
    inner = ends * [[-1.0], [1.0]] > 0
    # Without such a σ, C + b ≤ Σ log(1 + |λ|)/|λ| ≤ n/√|λ| bounds the root.
    bound = np.square(sigma.shape[1] / np.where(b == 0.0, 1.0, b))
    low, high = np.where(inner, 1.0 / (np.e * np.where(inner, ends, 1.0)), [-bound, bound])
    # C approaches −b at infinity without reaching it.
    finite = np.where(inner, [low, high], 0.0)
    above, below = (np.exp(-_lambert(finite[..., None] * sigma)) * sigma).sum(2) - b
    exists = usable & np.where(inner[0], above >= 0, b < 0) & np.where(inner[1], below <= 0, b > 0)
    root = (sigma.sum(1) - b) / np.where(usable, np.square(sigma).sum(1), 1.0)
    root = np.where((root > low) & (root < high), root, 0.5 * (low + high))
    active, last = exists.copy(), np.full(len(b), np.inf)
    for _ in range(_MOST_STEPS):
        rows = np.flatnonzero(active)
        if not len(rows):
            break
        s, x = sigma[rows], root[rows]
        decay = np.exp(-_lambert(x[:, None] * s))
        error = (s * decay).sum(1) - b[rows]
        low[rows] = np.where(error > 0, x, low[rows])
        high[rows] = np.where(error > 0, high[rows], x)
        slope = (np.square(s * decay) / np.maximum(1.0 - np.log(decay), 1e-12)).sum(1)
        next_x = x + error / slope
        # C is steep at the ends, where Newton's steps are short: bisect instead.
        poor = (next_x <= low[rows]) | (next_x >= high[rows])
        poor |= np.abs(error) > 0.5 * last[rows]
        last[rows] = np.abs(error)
        next_x = np.where(poor, 0.5 * (low[rows] + high[rows]), next_x)
        done = np.abs(error) <= _ROOT * (1.0 + np.abs(b[rows]))
        done |= high[rows] - low[rows] <= _ROOT * np.abs(x)
        active[rows], root[rows] = ~done, np.where(done, x, next_x)
    return np.where(exists, root, 0.0) / safe, exists


def _lambert(x: Array) -> Array:
    """Return W(x) ≥ −1 with W eᵂ = x ≥ −1/e; SciPy returns NaN within rounding of −1/e."""
    return np.fmax(lambertw(x).real, -1.0)
