"""Metric, geodesics, distance and divergence on P(n), [Lee2019] §2.2.

All functions broadcast over leading axes, and work on whitened matrices L⁻¹ · L⁻ᵀ with P = L Lᵀ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import Sizes, real_array
from geodrake.errors import ArgumentError

Array = NDArray[np.float64]

_ASYMMETRY = 1e-8  # most relative asymmetry of a matrix that counts as rounding
_CLOSE = 0.5  # relative difference below which it is precise to work with differences
_SERIES = 1e-3  # logarithm below which eˣ − 1 − x is precise as a series


def inner_product(P: ArrayLike, X: ArrayLike, Y: ArrayLike) -> Array:
    """Affine-invariant metric ⟨X, Y⟩_P = ½ tr(P⁻¹ X P⁻¹ Y).

    Args:
        P: (..., n, n) positive-definite matrices.
        X: (..., n, n) symmetric matrices, tangent at P.
        Y: (..., n, n) symmetric matrices, tangent at P.

    Returns:
        (...) numbers ([Lee2019] Eq. (2.2.5), with its ½).

    Raises:
        ArgumentError: A matrix of P is not symmetric positive definite, or X or Y has another size
            or values that are not finite.
    """
    _, inverse = whitening(P)
    whitened = [congruent(inverse, _tangent(V, inverse)) for V in (X, Y)]
    return np.asarray(0.5 * np.einsum("...ij,...ji->...", *whitened))


def exponential(P: ArrayLike, V: ArrayLike) -> Array:
    """Where the geodesic that leaves P with velocity V is at time one.

    Args:
        P: (..., n, n) positive-definite matrices.
        V: (..., n, n) symmetric matrices, tangent at P.

    Returns:
        (..., n, n) matrices P^½ exp(P^-½ V P^-½) P^½ ([Lee2019] Eq. (2.2.9)), symmetric and, as far
        as rounding lets them, positive definite however long V is.

    Raises:
        ArgumentError: A matrix of P is not symmetric positive definite, or V has another size or
            values that are not finite.
    """
    L, inverse = whitening(P)
    rates, axes = np.linalg.eigh(congruent(inverse, _tangent(V, inverse)))
    return from_root(L @ axes, 0.5 * rates)


def logarithm(P1: ArrayLike, P2: ArrayLike) -> Array:
    """Velocity at P1 of the geodesic that reaches P2 at time one, the inverse of `exponential`.

    Args:
        P1: (..., n, n) positive-definite matrices.
        P2: (..., n, n) positive-definite matrices.

    Returns:
        (..., n, n) symmetric matrices ([Lee2019] Eq. (2.2.8)).

    Raises:
        ArgumentError: A matrix is not symmetric positive definite.
    """
    L, _ = whitening(P1)
    logs, axes = relative_spectrum(P1, P2)
    side = L @ axes
    return np.asarray((side * logs[..., None, :]) @ np.swapaxes(side, -1, -2))


def geodesic(P1: ArrayLike, P2: ArrayLike, t: ArrayLike) -> Array:
    """The minimal geodesic from P1 at t = 0 to P2 at t = 1.

    Args:
        P1: (..., n, n) positive-definite matrices.
        P2: (..., n, n) positive-definite matrices.
        t: (...) times; outside of [0, 1] the geodesic goes on.

    Returns:
        (..., n, n) matrices P1^½ (P1^-½ P2 P1^-½)ᵗ P1^½ ([Lee2019] Eq. (2.2.7)).

    Raises:
        ArgumentError: A matrix is not symmetric positive definite, or a time is not finite.
    """
    L, _ = whitening(P1)
    logs, axes = relative_spectrum(P1, P2)
    t = real_array(t, "t", ("...",), {"...": logs.shape[:-1]})
    return from_root(L @ axes, 0.5 * t[..., None] * logs)


def distance(P1: ArrayLike, P2: ArrayLike) -> Array:
    """Geodesic distance √(Σ log² λᵢ), with λ the eigenvalues of P1⁻¹ P2.

    This is √2 times the length of the geodesic in the metric (2.2.5), whose ½ the source leaves out
    here ([Lee2019] Eq. (2.2.10)).

    Args:
        P1: (..., n, n) positive-definite matrices.
        P2: (..., n, n) positive-definite matrices.

    Returns:
        (...) distances.

    Raises:
        ArgumentError: A matrix is not symmetric positive definite.
    """
    return np.asarray(np.linalg.norm(relative_logarithms(P1, P2), axis=-1))


def log_det_divergence(P1: ArrayLike, P2: ArrayLike) -> Array:
    """Log-det divergence −log|P2⁻¹ P1| + tr(P2⁻¹ P1) − n = Σ (λᵢ − 1 − log λᵢ).

    Args:
        P1: (..., n, n) positive-definite matrices.
        P2: (..., n, n) positive-definite matrices.

    Returns:
        (...) divergences d(P1‖P2) ≥ 0, zero just when P1 = P2 ([Lee2019] Eq. (2.2.14) with −n for
        its −4, and Eq. (2.2.15)).

    Raises:
        ArgumentError: A matrix is not symmetric positive definite.
    """
    logs = relative_logarithms(P2, P1)
    series = 0.5 * logs**2 * (1.0 + logs / 3.0 * (1.0 + logs / 4.0 * (1.0 + logs / 5.0)))
    terms = np.where(np.abs(logs) < _SERIES, series, np.expm1(logs) - logs)
    return np.asarray(terms.sum(-1))


def relative_logarithms(P1: ArrayLike, P2: ArrayLike) -> Array:
    """Logarithms of the eigenvalues of P1⁻¹ P2, which is all that P1 and P2 differ by.

    Args:
        P1: (..., n, n) positive-definite matrices.
        P2: (..., n, n) positive-definite matrices.

    Returns:
        (..., n) logarithms in ascending order.

    Raises:
        ArgumentError: A matrix is not symmetric positive definite.
    """
    return relative_spectrum(P1, P2)[0]


def whitening(P: ArrayLike) -> tuple[Array, Array]:
    """Lower triangular L with P = L Lᵀ, and its inverse.

    P is scaled to a unit diagonal first, so that units do not cost precision.

    Args:
        P: (..., n, n) positive-definite matrices.

    Returns:
        L and L⁻¹, both (..., n, n).

    Raises:
        ArgumentError: A matrix is not symmetric positive definite.
    """
    P = real_array(P, "P", ("...", "n", "n"), finite=False)
    diagonal = np.diagonal(P, axis1=-2, axis2=-1)
    usable = np.asarray(np.isfinite(P).all((-2, -1)) & (diagonal > 0).all(-1))
    if not usable.all():
        raise _not_positive(P, usable)
    scale = np.sqrt(diagonal)
    scaled = P / (scale[..., :, None] * scale[..., None, :])
    even = np.abs(scaled - np.swapaxes(scaled, -1, -2)).max((-2, -1), initial=0.0) < _ASYMMETRY
    if not even.all():
        raise ArgumentError(
            f"Expected symmetric matrices; got {_first(P, even)}.",
            advice="Pass 0.5 * (P + P.T) if the difference is meant to be rounding.",
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
        advice="For inertial parameters this means: no body can have them.",
        matrix=bad,
    )


def _first(P: Array, good: NDArray[np.bool_]) -> list[list[float]]:
    """The first bad matrix; any, where rounding lets no test find it."""
    flat = P.reshape(-1, *P.shape[-2:])
    found: list[list[float]] = flat[int(np.argmin(good.ravel()))].tolist()
    return found


def _tangent(V: ArrayLike, L: Array) -> Array:
    """Tangent matrices of the size of L."""
    n = L.shape[-1]
    return real_array(V, "a tangent matrix", ("...", n, n), {"...": L.shape[:-2]})


def congruent(G: Array, V: Array) -> Array:
    """G V Gᵀ, exactly symmetric.

    Args:
        G: (..., m, n) matrices.
        V: (..., n, n) symmetric matrices.
    """
    product = G @ V @ np.swapaxes(G, -1, -2)
    return np.asarray(0.5 * (product + np.swapaxes(product, -1, -2)))


def from_root(side: Array, half_logs: Array) -> Array:
    """Side exp(2 half_logs) sideᵀ, exactly symmetric.

    Args:
        side: (..., n, n) matrices.
        half_logs: (..., n) half the logarithms of the diagonal between the two sides.
    """
    root = side * np.exp(half_logs)[..., None, :]
    return np.asarray(root @ np.swapaxes(root, -1, -2))


def relative_spectrum(P1: ArrayLike, P2: ArrayLike) -> tuple[Array, Array]:
    """Logarithms (..., n) and axes (..., n, n) of L⁻¹ P2 L⁻ᵀ with P1 = L Lᵀ.

    Close matrices are compared by their difference, others by their roots: either way the small
    eigenvalues are as precise as they can be.

    Args:
        P1: (..., n, n) positive-definite matrices, from which the logarithms are counted.
        P2: (..., n, n) positive-definite matrices.
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
