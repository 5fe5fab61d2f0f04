"""Geodesic least squares: the bodies closest to the hyperplanes of measurements."""

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

_SHARE = 0.9  # of the way to where a body is none, at most in one step
_SHORT = 2.0**-8  # of that, the share from which on rows may be left out
_LEAST_CURVATURE = 1e-3  # of that of the prior
_SMALL = 1e-100
_SETTLED = 1e-6  # distance below which rounding may end the search
_MOST_ROUNDS = 5
_ROOT = 1e-14
_MOST_STEPS = 200
_SAME = 1e-5
_LEAST_ROOM = 1e-8  # 1 + W where a projection is about to get lost


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
            f"A has {rows.shape[1] - 1} columns, but {len(prior)} bodies of the prior need "
            f"{prior.size}; other parameters are not allowed here.",
            advice="Subtract contributions of friction and the like from b first.",
        )
    point, readmitted = _start(rows, prior, gamma), np.zeros(len(rows), bool)
    before = np.inf
    for count in range(max_iterations + 1):
        hidden = is_within_rounding(point.promise, before, point.rounding)
        if point.distance <= tolerance or (point.distance < _SETTLED and hidden):
            everything = replace(point, used=np.ones(len(rows), bool))
            returning = everything.projections.exists & ~(point.used | readmitted)
            if not returning.any():
                return point.result(rows, count)
            # (Once each, so that there is an end.)
            readmitted |= returning
            point = replace(point, used=point.used | returning)
        if count < max_iterations:
            before = point.promise
            point = point.mean() if method == "cyclic" else point.newton_step()
    raise point.failure(
        f"is still {point.distance:.2g} from its minimum after {max_iterations} iterations",
        'Raise gamma or max_iterations, or use method="newton".',
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
        """Return other bodies with some rows, without those that have no projection there."""
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
        """Decrease of the cost predicted by the slope of Newton's step."""
        return float(self.step @ self.downhill)

    @property
    def rounding(self) -> float:
        """Rounding error of the cost."""
        return float(rounding_of_squares(self.cost, self.weights.sum() + self.gamma))

    def moved(self, change: Array) -> _GeodesicPoint:
        """Return bodies L (𝟙 + V) Lᵀ, without the rows that have no projection there."""
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
            # Seen from here, so that what is far from another is so by its logarithm only.
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

    def failure(self, what: str, advice: str) -> ConvergenceError:
        words = f"Geodesic least squares {what}."
        return ConvergenceError(words, advice=advice, distance=self.distance)


class Projections(NamedTuple):
    """Geodesic projections of one set of bodies onto m hyperplanes ([Lee2019] Proposition 3.2).

    With P = L Lᵀ, the gradient of tr(P X) is N = Lᵀ X L = U diag(σ) Uᵀ, and P̂ = L exp(Q) Lᵀ with
    Q = −W(λ N) for the inverse W of w eʷ.
    """

    # (m,) whether there is one within a factor e: λ_max(P⁻¹ P̂) ≤ e for every body.
    exists: NDArray[np.bool_]
    sigma: Array  # (m, nb, 4) eigenvalues σ
    axes: Array  # (m, nb, 4, 4) U
    rates: Array  # (m, nb, 4) eigenvalues −W(λ σ) of Q; zero where there is no projection

    @property
    def half_squared_distances(self) -> Array:
        """½ d², (m,)."""
        return 0.5 * np.square(self.rates).sum((1, 2))

    def gradient(self, weights: Array) -> Array:
        """Return that of Σ γ_i ½ d_i² as P moves along L exp(t V) Lᵀ, (nb, 4, 4)."""
        return -np.asarray(np.einsum("m,mbij->bij", weights, spectral(self.axes, self.rates)))

    def hessian(self, weights: Array) -> Array:
        """Return that of the same, (10 nb, 10 nb) in the coordinates of `flat`.

        L exp(½ t V) is a frame that is parallel along the geodesic, so Hess[V] = −dQ with
        dN = ½ (V N + N V), where λ changes so that P̂ stays on its hyperplane. In the axes of N,
        that of each row is diagonal, plus a term of rank one.
        """
        W = -self.rates
        decay = np.exp(-W) / np.maximum(1.0 + W, _LEAST_ROOM)  # W'(λ σ)
        x = W * np.exp(W)
        # Divided differences of W, which are W' where two arguments are nearly the same.
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
    """Return symmetric matrices (…, 4, 4) of axes (…, 4, 4) and eigenvalues (…, 4)."""
    return np.asarray((axes * values[..., None, :]) @ np.swapaxes(axes, -1, -2))


def flat(matrices: Array) -> Array:
    """Return coordinates (…, 10 nb) of symmetric matrices (…, nb, 4, 4)."""
    coordinates = svec(np.ascontiguousarray(matrices))
    return coordinates.reshape(*coordinates.shape[:-2], -1)


def pairwise(values: Array, axes: Array) -> Array:
    """Return the sum of m quadratic forms Σ values_ab (uₐᵀ V u_b)², (10 nb, 10 nb) as of `flat`.

    Values (m, nb, 4, 4) are symmetric; axes (m, nb, 4, 4) have u as columns.
    """
    turned = np.swapaxes(axes, -1, -2)[..., None, :, :] @ SYMMETRIC_BASIS @ axes[..., None, :, :]
    rows, nb = turned.shape[:2]
    turned = np.moveaxis(turned, 0, 1).reshape(nb, rows, len(SYMMETRIC_BASIS), 16)
    scaled = turned * np.moveaxis(values, 0, 1).reshape(nb, rows, 1, 16)
    blocks = np.einsum("bmip,bmjp->bij", scaled, turned, optimize=True)
    return np.asarray(block_diag(*blocks))


def project(roots: Array, X: Array, b: Array) -> Projections:
    """Return projections of bodies P_j = L_j L_jᵀ onto the hyperplanes Σ_j tr(P_j X_ij) = b_i.

    L is (nb, 4, 4), and X (m, nb, 4, 4).
    """
    sigma, axes = np.linalg.eigh(np.swapaxes(roots, -1, -2) @ X @ roots)
    multiplier, exists = _multipliers(sigma.reshape(len(b), -1), b)
    rates = -_lambert(multiplier[:, None, None] * sigma)
    rates[~exists] = 0.0
    return Projections(exists, sigma, axes, rates)


def _multipliers(sigma: Array, b: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return roots λ (m,) of C(λ) = Σ_k σ_k exp(−W(λ σ_k)) − b, and whether they exist.

    [Lee2019] Eq. (3.4.40): C decreases from one end of the interval where all λ σ_k ≥ −1/e to the
    other, so that its values there tell whether it has a root. Newton's method, kept in a bracket.
    """
    scale = np.abs(sigma).max(1)
    usable = scale > 0
    safe = np.where(usable, scale, 1.0)
    sigma, b = sigma / safe[:, None], b / safe
    # Ends where λ σ_k is −1/e for the largest σ, if that is above 0, and the least, if below.
    ends = np.stack([-sigma.max(1), -sigma.min(1)])
    inner = ends * [[-1.0], [1.0]] > 0
    # Without such a σ, C + b ≤ Σ log(1 + |λ|)/|λ| ≤ n/√|λ| tells how far out a root can be.
    far = np.square(sigma.shape[1] / np.where(b == 0.0, 1.0, b))
    low, high = np.where(inner, 1.0 / (np.e * np.where(inner, ends, 1.0)), [-far, far])
    # Far out C comes close to −b, but does not reach it.
    finite = np.where(inner, [low, high], 0.0)
    above, below = (np.exp(-_lambert(finite[..., None] * sigma)) * sigma).sum(2) - b
    exists = usable & np.where(inner[0], above >= 0, b < 0) & np.where(inner[1], below <= 0, b > 0)
    at = (sigma.sum(1) - b) / np.where(usable, np.square(sigma).sum(1), 1.0)
    at = np.where((at > low) & (at < high), at, 0.5 * (low + high))
    active, last = exists.copy(), np.full(len(b), np.inf)
    for _ in range(_MOST_STEPS):
        rows = np.flatnonzero(active)
        if not len(rows):
            break
        s, x = sigma[rows], at[rows]
        decay = np.exp(-_lambert(x[:, None] * s))
        error = (s * decay).sum(1) - b[rows]
        low[rows] = np.where(error > 0, x, low[rows])
        high[rows] = np.where(error > 0, high[rows], x)
        slope = (np.square(s * decay) / np.maximum(1.0 - np.log(decay), 1e-12)).sum(1)
        following = x + error / slope
        # At the ends C falls so steeply that Newton's steps are short: halve instead.
        poor = (following <= low[rows]) | (following >= high[rows])
        poor |= np.abs(error) > 0.5 * last[rows]
        last[rows] = np.abs(error)
        following = np.where(poor, 0.5 * (low[rows] + high[rows]), following)
        done = np.abs(error) <= _ROOT * (1.0 + np.abs(b[rows]))
        done |= high[rows] - low[rows] <= _ROOT * np.abs(x)
        active[rows], at[rows] = ~done, np.where(done, x, following)
    return np.where(exists, at, 0.0) / safe, exists


def _lambert(x: Array) -> Array:
    """Return W(x) ≥ −1 with W eᵂ = x ≥ −1/e, of which SciPy gives NaN within rounding of −1/e."""
    return np.fmax(lambertw(x).real, -1.0)
