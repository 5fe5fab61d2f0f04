"""The Karcher mean of positive-definite matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import Sizes, integer, positive, real_array
from geodrake.descent import is_within_rounding, rounding_of_squares, step_length
from geodrake.errors import ArgumentError, ConvergenceError
from geodrake.inertia.positive_definite.geometry import (
    Array,
    congruent,
    distance,
    from_root,
    geodesic,
    relative_spectrum,
    whitening,
)


def karcher_mean(
    matrices: ArrayLike,
    weights: ArrayLike | None = None,
    *,
    tolerance: float = 1e-10,
    max_iterations: int = 50,
) -> Array:
    """Return the matrix with the least weighted sum of squared distances Σ wₖ d(S, Pₖ)².

    Newton's method on the manifold: the Hessian of ½ d² is at least the metric, so that the
    minimum is unique, and the norm of the gradient bounds the distance that is left.

    Args:
        matrices: (..., k, n, n) positive-definite matrices.
        weights: (..., k) weights, none negative; all equal if None.
        tolerance: Distance from the exact mean at which to stop, unless rounding hides what is
            left of it.
        max_iterations: Newton steps after which to give up.

    Returns:
        (..., n, n) means.

    Raises:
        ArgumentError: A matrix is not symmetric positive definite, a weight is negative, or the
            tolerance or the number of steps is not above zero.
        ConvergenceError: The tolerance was not reached.
    """
    integer(max_iterations, "max_iterations", lower=1)
    positive(tolerance, "tolerance")
    sizes: Sizes = {}
    P = real_array(matrices, "matrices", ("...", "k", "n", "n"), sizes)
    w = _normalized(weights, sizes)
    mean, before, found = _first_guess(P, w), np.full((), np.inf), np.zeros((), bool)
    for _ in range(max_iterations):
        L, _ = whitening(mean)
        logs, axes = relative_spectrum(mean[..., None, :, :], P)
        gradient = _weighted_sum(w, logs, axes)  # of −½ Σ wₖ d², whitened
        left = np.asarray(np.linalg.norm(gradient, axis=(-2, -1)))
        step = _newton_step(w, logs, axes, gradient)
        promise, cost = (gradient * step).sum((-2, -1)), _cost(P, w, mean)
        rounding = rounding_of_squares(cost, 1.0)
        found = found | (left <= tolerance) | is_within_rounding(promise, before, rounding)
        if found.all():
            return mean
        before, mean = promise, _line_search(P, w, (L, step), (cost, promise, rounding))
    raise ConvergenceError(
        f"The Karcher mean is not found to {tolerance:g} in {max_iterations} steps: it is still "
        f"{float(left.max()):.2g} away.",
        advice="Some matrix is too close to singular for this tolerance; leave it out, or allow a "
        "larger tolerance.",
        distance=left,
    )


def _normalized(weights: ArrayLike | None, sizes: Sizes) -> Array:
    """Weights (..., k) that sum to one."""
    if sizes["k"] == (0,):
        raise ArgumentError("There is no mean of no matrices.")
    given = np.ones(sizes["k"]) if weights is None else weights
    w = real_array(given, "weights", ("...", "k"), sizes)
    total = w.sum(-1, keepdims=True)
    if not ((w >= 0).all() and ((total > 0) & np.isfinite(total)).all()):
        raise ArgumentError(f"Expected weights of zero or more, not all zero; got {w.tolist()}.")
    return np.asarray(w / total)


def _first_guess(P: Array, w: Array) -> Array:
    """Midway between arithmetic and harmonic mean, which is exact for two equal weights."""
    _, inverses = whitening(P)
    arithmetic = np.einsum("...k,...kij->...ij", w, P)
    inverse = np.einsum("...k,...kli,...klj->...ij", w, inverses, inverses)
    _, root = whitening(inverse)
    return geodesic(arithmetic, np.swapaxes(root, -1, -2) @ root, 0.5)


def _weighted_sum(w: Array, logs: Array, axes: Array) -> Array:
    return np.asarray(np.einsum("...k,...kil,...kl,...kjl->...ij", w, axes, logs, axes))


def _newton_step(w: Array, logs: Array, axes: Array, gradient: Array) -> Array:
    """H⁻¹ gradient with the Hessian H of ½ Σ wₖ d², all whitened.

    In the axes of its logarithm, ½ d² has curvature (x/2) coth(x/2) ≥ 1 along each pair of axes
    whose logarithms differ by x.
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
    """Next mean: the cost, what the slope promises of the step, and rounding are known."""
    (L, step), (cost, promise, rounding) = along, known
    rates, axes = np.linalg.eigh(step)

    def moved(share: Array) -> Array:
        return from_root(L @ axes, 0.5 * share[..., None] * rates)

    return moved(step_length(lambda t: cost - _cost(P, w, moved(t)), promise, rounding))


def _cost(P: Array, w: Array, mean: Array) -> Array:
    """½ Σ wₖ d(mean, Pₖ)², (...)."""
    return np.asarray(0.5 * (w * distance(mean[..., None, :, :], P) ** 2).sum(-1))
