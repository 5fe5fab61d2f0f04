"""Inertial parameters of one body in the cone of physical bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import LARGEST
from geodrake.compiling import contiguous
from geodrake.inertia import PARAMETERS_PER_BODY, is_physical, pullback_metric
from geodrake.inertia.kernels import BASIS, calc_dual, calc_from_pseudo_inertia, calc_pseudo_inertia
from geodrake.inertia.positive_definite import log_det_divergence, whitening
from geodrake.manifolds.base import Array, Manifold, MirrorSpan
from geodrake.manifolds.robot_kernels import (
    Factors,
    calc_clearly_inside,
    calc_natural_steps,
    robot_span,
)

_PAIRS = [np.eye(4)[[i, j]] for i in range(4) for j in range(i, 4)]
_UNIT_TANGENTS = np.array(
    [(np.outer(a, b) + np.outer(b, a)) / (2.0 if a @ b else np.sqrt(2.0)) for a, b in _PAIRS]
)
"""Orthonormal basis (10, 4, 4) of the symmetric matrices."""
_ROUNDING = 1e-14  # least relative eigenvalue of P despite rounding
_LONGEST_GROWTH = 300.0  # logarithm of the largest growth without overflow


@dataclass(frozen=True)
class PhysicalInertia(Manifold):
    """Inertial parameters φ of one body with P(φ) ≻ 0 and h = −log det P(φ), [Lee2019] §5.3.1.

    The metric is the Hessian of h, [Lee2019] Eq. (5.3.24), twice that of (B.1.7), so that an
    adaptation gain means the same speed for inertias and friction.
    """

    @property
    def dimension(self) -> int:
        """Ten."""
        return PARAMETERS_PER_BODY

    def calc_contains(self, x: Array) -> NDArray[np.bool_]:
        """Return whether P(x) ≻ 0 (...)."""
        clear = calc_clearly_inside(contiguous(x).ravel(), _bodies(x))
        return np.ones(x.shape[:-1], bool) if clear else is_physical(x)

    def calc_barrier(self, x: Array) -> Array:
        """Return −log det P(x), [Lee2019] Eq. (5.3.23)."""
        return -np.linalg.slogdet(calc_pseudo_inertia(x))[1]

    def calc_gradient(self, x: Array) -> Array:
        """Return −tr(P(x)⁻¹ P(eᵢ)), (..., 10)."""
        inverse = np.linalg.inv(calc_pseudo_inertia(x))
        return np.asarray(-inverse.reshape((*x.shape[:-1], 16)) @ BASIS.reshape(-1, 16).T)

    def calc_metric(self, x: Array) -> Array:
        """Return tr(P⁻¹ P(eᵢ) P⁻¹ P(eⱼ)), (..., 10, 10), [Lee2019] Eq. (5.3.24)."""
        return 2.0 * pullback_metric(x)

    def calc_inverse_metric_times(self, x: Array, b: Array) -> Array:
        """Return P⁻¹(P(x) X(b) P(x)), [Lee2019] Eq. (B.4.20) without its factor 2.

        X(b) is the symmetric matrix with tr(P(φ) X(b)) = φᵀ b, [Lee2019] Eq. (B.1.8).
        """
        P = calc_pseudo_inertia(x)
        return calc_from_pseudo_inertia(P @ calc_dual(b) @ P)

    def calc_divergence(self, x: Array, y: Array) -> Array:
        """Return D(x‖y) = −log det(P(y)⁻¹P(x)) + tr(P(y)⁻¹P(x)) − 4, [Lee2019] Eq. (5.3.25)."""
        return log_det_divergence(calc_pseudo_inertia(x), calc_pseudo_inertia(y))

    def calc_longest_step(self, x: Array, v: Array) -> Array:
        """Return the time (...) at which P(x + t v) becomes singular."""
        rates = self._rates(x, v)[..., 0]
        falling = rates < 0
        return np.where(falling, -1.0 / np.where(falling, rates, -1.0), np.inf)

    def calc_frame(self, x: Array) -> Array:
        """Return P⁻¹(L E Lᵀ) (10, 10) for orthonormal symmetric E, precise in any units."""
        L = _root(x)
        return calc_from_pseudo_inertia(L @ _UNIT_TANGENTS @ L.T).T

    def calc_mirror_span(self, x: Array, rows: Array) -> MirrorSpan:
        """Return the span P(y(λ)) = L (𝟙 − Lᵀ X(Aᵀ λ) L)⁻¹ Lᵀ with P⁻¹(y) = P⁻¹(x) − X(Aᵀ λ)."""
        return robot_span(contiguous(x), contiguous(rows), _bodies(x))

    def calc_point_of_gradient(self, gradient: Array, near: Array) -> Array:
        """Return the points with P(y)⁻¹ = −X(∇h(y))."""
        try:
            inverse = np.linalg.inv(-calc_dual(gradient))
            return calc_from_pseudo_inertia(np.asarray(inverse, float))
        except np.linalg.LinAlgError:
            return np.full(gradient.shape, np.nan)

    def calc_natural_step(self, x: Array, b: Array, time: float) -> Array:
        """Return the geodesic step of [Lee2019] Eq. (2.2.9), which needs no inverse."""
        if x.shape == b.shape:
            stepped, each = np.empty(x.shape), (contiguous(x).ravel(), contiguous(b).ravel())
            if calc_natural_steps(*each, _bodies(x), float(time), stepped.reshape(-1)):
                return stepped
        return super().calc_natural_step(x, b, time)  # long, or close to the boundary

    def _retract(self, x: Array, v: Array) -> Array:
        """Return the end point of the geodesic, [Lee2019] Eq. (2.2.9)."""
        L, root = whitening(calc_pseudo_inertia(x))
        rates, axes = np.linalg.eigh(root @ calc_pseudo_inertia(v) @ np.swapaxes(root, -1, -2))
        longest = np.abs(rates).max(-1, keepdims=True)
        half = 0.5 * rates * (_LONGEST_GROWTH / np.maximum(longest, _LONGEST_GROWTH))
        side = (L @ axes) * np.exp(half)[..., None, :]
        return calc_from_pseudo_inertia(side @ np.swapaxes(side, -1, -2))

    def _well_inside(self, x: Array) -> NDArray[np.bool_]:
        size = np.abs(x).max(-1)
        return is_physical(x, tolerance=_ROUNDING) & (size < LARGEST) & (x[..., 0] > 1 / LARGEST)

    @staticmethod
    def _rates(x: Array, v: Array) -> Array:
        """Return the eigenvalues (..., 4) of P(x)⁻¹ P(v) in ascending order."""
        _, root = whitening(calc_pseudo_inertia(x))
        whitened = root @ calc_pseudo_inertia(v) @ np.swapaxes(root, -1, -2)
        return np.asarray(np.linalg.eigvalsh(whitened), float)


def _bodies(x: Array) -> Factors:
    """Return the factors of vectors (..., 10)."""
    places = np.arange(0, x.size, PARAMETERS_PER_BODY)
    return places, np.ones(len(places)), places[:0], np.empty(0), np.empty(0)


def _root(x: Array) -> Array:
    """Return the lower triangular L (..., 4, 4) with P(x) = L Lᵀ, precise in any units."""
    P = calc_pseudo_inertia(x)
    scale = np.sqrt(np.diagonal(P, axis1=-2, axis2=-1))
    units = scale[..., :, None] * scale[..., None, :]
    return np.asarray(scale[..., None] * np.linalg.cholesky(P / units))
