"""Symmetric positive-definite matrices P(n) with the affine-invariant metric, [Lee2019] §2.2.

Distances, divergences and means are invariant to a change of basis P ↦ G P Gᵀ (Eq. (2.2.4)), and
so, for pseudo-inertias, to the choice of frame and units.

The source has a factor ½ in its metric ½ tr((P⁻¹ dP)²) (2.2.5), but none in its distance (2.2.10):

    distance(P, P + dP)² ≈ tr((P⁻¹ dP)²) ≈ 2 log_det_divergence(P + dP, P)

Matrices are (..., n, n), positive definite unless stated otherwise; functions broadcast.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import Sizes, integer, positive, real_array
from geodrake.descent import is_within_rounding, rounding_of_squares, step_length
from geodrake.errors import ArgumentError, ConvergenceError

Array = NDArray[np.float64]

_ASYMMETRY = 1e-8  # largest relative asymmetry due to rounding
_CLOSE = 0.5  # relative difference below which differences are precise
_SERIES = 1e-3  # logarithm below which the series of eˣ − 1 − x is precise


def geodesic(P1: ArrayLike, P2: ArrayLike, t: ArrayLike) -> Array:
    """Return the minimal geodesic from P1 at t = 0 to P2 at t = 1, extended to all t.

    P1^½ (P1^-½ P2 P1^-½)ᵗ P1^½ at times t (...) ([Lee2019] Eq. (2.2.7)).
    """
    L, _ = whitening(P1)
    logs, axes = relative_spectrum(P1, P2)
    t = real_array(t, "t", ("...",), {"...": logs.shape[:-1]})
    return from_root(L @ axes, 0.5 * t[..., None] * logs)


def distance(P1: ArrayLike, P2: ArrayLike) -> Array:
    """Return geodesic distances (...) √(Σ log² λᵢ), with λ the eigenvalues of P1⁻¹ P2.

    This is √2 times the length of the geodesic in the metric (2.2.5), whose ½ the source omits here
    ([Lee2019] Eq. (2.2.10)).
    """
    return np.asarray(np.linalg.norm(relative_logarithms(P1, P2), axis=-1))


def log_det_divergence(P1: ArrayLike, P2: ArrayLike) -> Array:
    """Return log-det divergences (...) −log|P2⁻¹ P1| + tr(P2⁻¹ P1) − n = Σ (λᵢ − 1 − log λᵢ) ≥ 0.

    They are zero only for P1 = P2 ([Lee2019] Eq. (2.2.14) with −n for its −4, and Eq. (2.2.15)).
    """
    logs = relative_logarithms(P2, P1)
    series = 0.5 * logs**2 * (1.0 + logs / 3.0 * (1.0 + logs / 4.0 * (1.0 + logs / 5.0)))
    terms = np.where(np.abs(logs) < _SERIES, series, np.expm1(logs) - logs)
    return np.asarray(terms.sum(-1))


def relative_logarithms(P1: ArrayLike, P2: ArrayLike) -> Array:
    """Return the ascending logarithms (..., n) of the eigenvalues of P1⁻¹ P2."""
    return relative_spectrum(P1, P2)[0]


def whitening(P: ArrayLike) -> tuple[Array, Array]:
    """Return the lower triangular L with P = L Lᵀ, and its inverse, precise in any units."""
    P = real_array(P, "P", ("...", "n", "n"), finite=False)
    diagonal = np.diagonal(P, axis1=-2, axis2=-1)
    usable = np.asarray(np.isfinite(P).all((-2, -1)) & (diagonal > 0).all(-1))
    if not usable.all():
        raise _not_positive(P, usable)
    scale = np.sqrt(diagonal)
    scaled = P / (scale[..., :, None] * scale[..., None, :])
    asymmetry = np.abs(scaled - np.swapaxes(scaled, -1, -2)).max((-2, -1), initial=0.0)
    symmetric = np.asarray(asymmetry < _ASYMMETRY)
    if not symmetric.all():
        raise ArgumentError(
            f"Expected symmetric matrices; got {_first(P, symmetric)}.",
            advice="Pass 0.5 * (P + P.T) if the difference is due to rounding.",
        )
    try:
        L = np.linalg.cholesky(scaled)
    except np.linalg.LinAlgError:
        raise _not_positive(P, np.linalg.eigvalsh(scaled)[..., 0] > 0) from None
    return scale[..., :, None] * L, np.linalg.inv(L) / scale[..., None, :]


def _not_positive(P: Array, good: NDArray[np.bool_]) -> ArgumentError:
    bad = _first(P, good)
    return ArgumentError(
        f"Expected positive-definite matrices; got {bad}.",
        advice="For inertial parameters this means that they are not physical.",
        matrix=bad,
    )


def _first(P: Array, good: NDArray[np.bool_]) -> list[list[float]]:
    """Return the first bad matrix, or any one if rounding hides it."""
    flat = P.reshape(-1, *P.shape[-2:])
    bad: list[list[float]] = flat[int(np.argmin(good.ravel()))].tolist()
    return bad


def congruent(G: Array, V: Array) -> Array:
    """Return G V Gᵀ, exactly symmetric, for G (..., m, n) and symmetric V (..., n, n)."""
    product = G @ V @ np.swapaxes(G, -1, -2)
    return np.asarray(0.5 * (product + np.swapaxes(product, -1, -2)))


def from_root(side: Array, half_logs: Array) -> Array:
    """Return S exp(2 half_logs) Sᵀ, exactly symmetric, for S (..., n, n) and (..., n)."""
    root = side * np.exp(half_logs)[..., None, :]
    return np.asarray(root @ np.swapaxes(root, -1, -2))


def relative_spectrum(P1: ArrayLike, P2: ArrayLike) -> tuple[Array, Array]:
    """Return logarithms (..., n) and axes (..., n, n) of L⁻¹ P2 L⁻ᵀ with P1 = L Lᵀ.

    Close matrices are compared by their difference and others by their roots, which is most precise
    for small eigenvalues.
    """
    _, inverse = whitening(P1)
    L2, _ = whitening(P2)
    sizes: Sizes = {}
    for name, P in (("P1", inverse), ("P2", L2)):
        real_array(P, name, ("...", "n", "n"), sizes)
    difference = np.asarray(P2, float) - np.asarray(P1, float)
    steps, close_axes = np.linalg.eigh(congruent(inverse, difference))
    axes, roots, _ = np.linalg.svd(inverse @ L2)
    close = (np.abs(steps) < _CLOSE).all(-1)[..., None]
    logs = np.where(close, np.log1p(np.where(close, steps, 0.0)), 2.0 * np.log(roots[..., ::-1]))
    return logs, np.where(close[..., None], close_axes, axes[..., ::-1])


def karcher_mean(
    matrices: ArrayLike,
    weights: ArrayLike | None = None,
    *,
    tolerance: float = 1e-10,
    max_iterations: int = 50,
) -> Array:
    """Return the Karcher mean, which minimizes the weighted squared distances Σ wₖ d(S, Pₖ)².

    Newton's method on the manifold. The Hessian of ½ d² is at least the metric, so that the minimum
    is unique, and the norm of the gradient bounds the distance from it.

    Args:
        matrices: (..., k, n, n) positive-definite matrices.
        weights: (..., k) nonnegative weights; by default equal.
        tolerance: Distance from the exact mean, if above rounding errors.
        max_iterations: Largest number of Newton steps.
    """
    integer(max_iterations, "max_iterations", lower=1)
    positive(tolerance, "tolerance")
    sizes: Sizes = {}
    P = real_array(matrices, "matrices", ("...", "k", "n", "n"), sizes)
    w = _normalized(weights, sizes)
    mean, previous, converged = _first_guess(P, w), np.full((), np.inf), np.zeros((), bool)
    for _ in range(max_iterations):
        L, _ = whitening(mean)
        logs, axes = relative_spectrum(mean[..., None, :, :], P)
        gradient = _weighted_sum(w, logs, axes)  # of −½ Σ wₖ d², whitened
        error = np.asarray(np.linalg.norm(gradient, axis=(-2, -1)))
        step = _newton_step(w, logs, axes, gradient)
        promise, cost = (gradient * step).sum((-2, -1)), _cost(P, w, mean)
        rounding = rounding_of_squares(cost, 1.0)
        hidden = is_within_rounding(promise, previous, rounding)
        converged = converged | (error <= tolerance) | hidden
        if converged.all():
            return mean
        previous, mean = promise, _line_search(P, w, (L, step), (cost, promise, rounding))
    raise ConvergenceError(
        f"The Karcher mean did not converge to {tolerance:g} in {max_iterations} steps: the "
        f"error is {float(error.max()):.2g}.",
        advice="Some matrix is nearly singular; remove it, or use a larger tolerance.",
        distance=error,
    )


def _normalized(weights: ArrayLike | None, sizes: Sizes) -> Array:
    """Return weights (..., k) that sum to one."""
    if sizes["k"] == (0,):
        raise ArgumentError("The mean of no matrices is undefined.")
    given = np.ones(sizes["k"]) if weights is None else weights
    w = real_array(given, "weights", ("...", "k"), sizes)
    total = w.sum(-1, keepdims=True)
    if not ((w >= 0).all() and ((total > 0) & np.isfinite(total)).all()):
        raise ArgumentError(f"Expected nonnegative weights, not all zero; got {w.tolist()}.")
    return np.asarray(w / total)


def _first_guess(P: Array, w: Array) -> Array:
    """Return the midpoint of arithmetic and harmonic mean, exact for two equal weights."""
    _, inverses = whitening(P)
    arithmetic = np.einsum("...k,...kij->...ij", w, P)
    inverse = np.einsum("...k,...kli,...klj->...ij", w, inverses, inverses)
    _, root = whitening(inverse)
    return geodesic(arithmetic, np.swapaxes(root, -1, -2) @ root, 0.5)


def _weighted_sum(w: Array, logs: Array, axes: Array) -> Array:
    return np.asarray(np.einsum("...k,...kil,...kl,...kjl->...ij", w, axes, logs, axes))


def _newton_step(w: Array, logs: Array, axes: Array, gradient: Array) -> Array:
    """Return the whitened Newton step H⁻¹ gradient with the Hessian H of ½ Σ wₖ d².

    ½ d² has curvature (x/2) coth(x/2) ≥ 1 along each pair of axes whose logarithms differ by x.
    """
    n = gradient.shape[-1]
    half = 0.5 * np.abs(logs[..., :, None] - logs[..., None, :])
    small = half < 1e-4
    safe = np.where(small, 1.0, half)
    curvature = np.where(small, 1.0 + half**2 / 3.0, safe / np.tanh(safe))
    kron = np.einsum("...kil,...kjm->...ijklm", axes, axes)
    kron = kron.reshape(*kron.shape[:-5], n * n, -1)
    scaled = (w[..., None, None] * curvature).reshape(*kron.shape[:-2], 1, -1)
    hessian = (kron * scaled) @ np.swapaxes(kron, -1, -2)
    step = np.linalg.solve(hessian, gradient.reshape(*gradient.shape[:-2], n * n, 1))
    return congruent(np.eye(n), step.reshape(gradient.shape))


def _line_search(
    P: Array, w: Array, along: tuple[Array, Array], known: tuple[Array, Array, Array]
) -> Array:
    """Return the next mean, from the cost, its predicted decrease and its rounding error."""
    (L, step), (cost, promise, rounding) = along, known
    rates, axes = np.linalg.eigh(step)

    def point(share: Array) -> Array:
        return from_root(L @ axes, 0.5 * share[..., None] * rates)

    return point(step_length(lambda t: cost - _cost(P, w, point(t)), promise, rounding))


def _cost(P: Array, w: Array, mean: Array) -> Array:
    """Return ½ Σ wₖ d(mean, Pₖ)², (...)."""
    return np.asarray(0.5 * (w * distance(mean[..., None, :, :], P) ** 2).sum(-1))
