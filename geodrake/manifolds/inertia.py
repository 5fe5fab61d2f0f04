"""Inertial parameters of one body, inside the cone of physical ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.arguments.arrays import LARGEST
from geodrake.inertia import (
    PARAMETERS_PER_BODY,
    is_physical,
    pseudo_inertia_basis,
    pullback_metric,
)
from geodrake.inertia.kernels import (
    calc_dual,
    calc_from_pseudo_inertia,
    calc_pseudo_inertia,
)
from geodrake.manifolds.base import Array, Manifold
from geodrake.manifolds.mirror import MirrorLine
from geodrake.positive_definite import log_det_divergence, whitening

_BASIS = pseudo_inertia_basis()
_PAIRS = [np.eye(4)[[i, j]] for i in range(4) for j in range(i, 4)]
_UNIT_TANGENTS = np.array(
    [(np.outer(a, b) + np.outer(b, a)) / (2.0 if a @ b else np.sqrt(2.0)) for a, b in _PAIRS]
)
"""Orthonormal basis (10, 4, 4) of the symmetric matrices."""
_TO_MATRIX = _BASIS.reshape(PARAMETERS_PER_BODY, 16)
_FROM_MATRIX = calc_from_pseudo_inertia(np.eye(16).reshape(16, 4, 4))
_ROUNDING = 1e-14  # least relative eigenvalue of P that rounding leaves positive
_LONGEST_GROWTH = 300.0  # logarithm of a growth that is still a number


@dataclass(frozen=True)
class PhysicalInertia(Manifold):
    """Inertial parameters φ of one body with P(φ) ≻ 0 and h = −log det P(φ), [Lee2019] §5.3.1.

    The metric is the Hessian of h, [Lee2019] Eq. (5.3.24): twice the one of (B.1.7), so that one
    adaptation gain means one speed for inertias and friction alike.
    """

    @property
    def dimension(self) -> int:
        """Ten."""
        return PARAMETERS_PER_BODY

    def calc_contains(self, x: Array) -> NDArray[np.bool_]:
        """Whether P(x) ≻ 0 (...)."""
        return is_physical(x)

    def calc_barrier(self, x: Array) -> Array:
        """−log det P(x), [Lee2019] Eq. (5.3.23)."""
        return -np.linalg.slogdet(calc_pseudo_inertia(x))[1]

    def calc_gradient(self, x: Array) -> Array:
        """−tr(P(x)⁻¹ P(eᵢ)), (..., 10)."""
        return -np.einsum("...ab,iab->...i", np.linalg.inv(calc_pseudo_inertia(x)), _BASIS)

    def calc_metric(self, x: Array) -> Array:
        """tr(P⁻¹ P(eᵢ) P⁻¹ P(eⱼ)), (..., 10, 10), [Lee2019] Eq. (5.3.24)."""
        return 2.0 * pullback_metric(x)

    def calc_inverse_metric_times(self, x: Array, b: Array) -> Array:
        """P⁻¹(P(x) X(b) P(x)), [Lee2019] Eq. (B.4.20) without its factor 2.

        X(b) is the symmetric matrix with tr(P(φ) X(b)) = φᵀ b, [Lee2019] Eq. (B.1.8).
        """
        matrix = calc_pseudo_inertia(x)
        return calc_from_pseudo_inertia(matrix @ calc_dual(b) @ matrix)

    def calc_divergence(self, x: Array, y: Array) -> Array:
        """D(x‖y) = −log det(P(y)⁻¹P(x)) + tr(P(y)⁻¹P(x)) − 4, [Lee2019] Eq. (5.3.25)."""
        return log_det_divergence(calc_pseudo_inertia(x), calc_pseudo_inertia(y))

    def calc_longest_step(self, x: Array, v: Array) -> Array:
        """The time (...) at which P(x + t v) becomes singular."""
        rates = self._rates(x, v)[..., 0]
        falling = rates < 0
        return np.where(falling, -1.0 / np.where(falling, rates, -1.0), np.inf)

    def calc_frame(self, x: Array) -> Array:
        """P⁻¹(L E Lᵀ) (10, 10) for orthonormal symmetric E, which no scale costs precision."""
        L = _root(x)
        return np.asarray(((L @ _UNIT_TANGENTS @ L.T).reshape(-1, 16) @ _FROM_MATRIX).T)

    def calc_mirror_line(self, x: Array, b: Array) -> MirrorLine:
        """P(y(t)) = L (𝟙 − t Lᵀ X(b) L)⁻¹ Lᵀ, from P⁻¹(y) = P⁻¹(x) − t X(b)."""
        L = _root(x)
        spectrum, axes = np.linalg.eigh(L.T @ calc_dual(b) @ L)
        rates = spectrum.tolist()

        def point(t: float) -> Array:
            root = (L @ axes) / np.sqrt(1.0 - t * spectrum)
            return np.asarray((root @ root.T).reshape(16) @ _FROM_MATRIX)

        def value(t: float) -> float:
            return sum(rate / (1.0 - t * rate) for rate in rates)

        longest = 1.0 / rates[-1] if rates[-1] > 0 else np.inf
        return MirrorLine(point, value, longest, 1.0 / max(rates[-1], -rates[0]))

    def _retract(self, x: Array, v: Array) -> Array:
        """The geodesic, [Lee2019] Eq. (2.2.9)."""
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
        """Eigenvalues (..., 4) of P(x)⁻¹ P(v) in ascending order."""
        _, root = whitening(calc_pseudo_inertia(x))
        whitened = root @ calc_pseudo_inertia(v) @ np.swapaxes(root, -1, -2)
        return np.asarray(np.linalg.eigvalsh(whitened), float)


def _root(x: Array) -> Array:
    """Lower triangular L (4, 4) with P(x) = L Lᵀ of one body; units cost no precision."""
    P = (x @ _TO_MATRIX).reshape(4, 4)
    scale = np.sqrt(np.diagonal(P))
    return np.asarray(scale[:, None] * np.linalg.cholesky(P / np.outer(scale, scale)))
