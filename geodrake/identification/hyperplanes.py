"""Geodesic projections of bodies onto hyperplanes aᵀΦ = b ([Lee2019] Proposition 3.2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.special import lambertw

from geodrake.identification.coordinates import SYMMETRIC_BASIS, svec
from geodrake.inertia import Array

_ROOT = 1e-14
_MOST_STEPS = 200
_SAME = 1e-5
_LEAST_ROOM = 1e-8  # 1 + W where a projection is about to get lost


class Projections(NamedTuple):
    """Projections of one set of bodies onto m hyperplanes.

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
    """Return roots λ (m,) of C(λ) = Σ_k σ_k exp(−W(λ σ_k)) − b, and whether there are any.

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
