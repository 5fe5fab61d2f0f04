"""Half the squared geodesic distance ½ ‖log S‖² from the identity, with its derivatives.

In the coordinates of `SYMMETRIC_BASIS`, where S = I + Σ z_k B_k. It is convex along geodesics, but
not along straight lines: beyond an eigenvalue of e it flattens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geodrake.identification.coordinates import SYMMETRIC_BASIS, Scalars
from geodrake.inertia import Array


def half_squared_logs(S: Array) -> Array:
    """½ Σ_k log² λ_k(S) of matrices S (..., n, n); infinite if one is not positive definite."""
    eigenvalues = np.asarray(np.linalg.eigvalsh(S), float)
    positive = eigenvalues > 0
    logs = np.log(np.where(positive, eigenvalues, 1.0))
    return np.where(positive.all(-1), 0.5 * (logs * logs).sum(-1), np.inf)


def log_derivatives(S: Array) -> tuple[Array, Array]:
    """Gradients (..., 10) and Hessians (..., 10, 10) at positive definite S (..., 4, 4).

    The function is a spectral one, so that its gradient is V diag(h) Vᵀ with h(λ) = log λ / λ, and
    its Hessian has the divided differences of h as coefficients in the eigenvectors V.
    """
    eigenvalues, V = np.linalg.eigh(S)
    logs = np.log(eigenvalues)
    gradient = np.einsum("...ai,...i,...bi,kab->...k", V, logs / eigenvalues, V, SYMMETRIC_BASIS)
    ratio = logs[..., :, None] - logs[..., None, :]
    # δ/(e^δ − 1), with its limit 1 at δ = 0.
    small = np.abs(ratio) < 1e-12
    share = np.where(small, 1.0, ratio / np.where(small, 1.0, np.expm1(ratio)))
    products = eigenvalues[..., :, None] * eigenvalues[..., None, :]
    differences = (share - logs[..., None, :]) / products
    turned = _turned_basis(V)
    hessian = np.einsum("...kij,...ij,...lij->...kl", turned, differences, turned, optimize=True)
    return gradient, hessian


def log_metric(S: Array) -> Array:
    """tr(S⁻¹ B_k S⁻¹ B_l), (..., 10, 10): the Hessian as it is where S is the reference."""
    eigenvalues, V = np.linalg.eigh(S)
    turned = _turned_basis(V / np.sqrt(eigenvalues)[..., None, :])
    return np.asarray(np.einsum("...kij,...lij->...kl", turned, turned, optimize=True))


def _turned_basis(V: Array) -> Array:
    """Vᵀ B_k V, (..., 10, 4, 4)."""
    V = V[..., None, :, :]
    return np.asarray(np.swapaxes(V, -1, -2) @ SYMMETRIC_BASIS @ V, float)


@dataclass(frozen=True, eq=False)
class LogCost:
    """data ‖F z − f‖² + weight (zᵀ Λ z + γ (Σ_i ½ ‖log S_i‖² + Σ_k w_k ½ log² y_k)).

    It is a `SmoothCost`.

    Attributes:
        triangle: (p, p + 1) factor [F f] of the data.
        prior: (p, p) Λ.
        starts: (n_blocks, 4, 4) S_i at z = 0.
        blocks: (n_blocks,) first coordinate of every block.
        scalars: Positive scalars y with their weights w.
        gamma: γ.
        data: Weight of the data, 1 or 0.
        weight: Weight of the prior against the data.
        size: Value that counts as one.
    """

    triangle: Array
    prior: Array
    starts: Array
    blocks: Array
    scalars: Scalars
    gamma: float
    data: float
    weight: float
    size: float

    def matrices(self, z: Array) -> Array:
        """S_i at z, (n_blocks, 4, 4)."""
        return self.starts + np.einsum("bk,kij->bij", z[self.inside], SYMMETRIC_BASIS)

    def misfit(self, z: Array) -> float:
        """‖F z − f‖², the residual above the least any parameters reach."""
        return float(np.square(self.triangle @ np.append(z, -1.0)).sum())

    def value(self, z: Array) -> float:
        """The cost at z; infinite where a body is not physical."""
        logs = float(half_squared_logs(self.matrices(z)).sum())
        ratios = self.scalars.ratios(z)[:, None, None]
        logs += float((self.scalars.weights * half_squared_logs(ratios)).sum())
        prior = float(z @ self.prior @ z) + self.gamma * logs
        return self.data * self.misfit(z) + self.weight * prior

    def derivatives(self, z: Array) -> tuple[Array, Array]:
        """Gradient (p,) and Hessian (p, p) at z."""
        F, f = self.triangle[:, :-1], self.triangle[:, -1]
        gradient = 2.0 * (self.data * F.T @ (F @ z - f) + self.weight * self.prior @ z)
        hessian = 2.0 * (self.data * F.T @ F + self.weight * self.prior)
        slopes, curvatures = log_derivatives(self.matrices(z))
        scale = self.weight * self.gamma
        gradient[self.inside] += scale * slopes
        hessian[self.inside[:, :, None], self.inside[:, None, :]] += scale * curvatures
        columns, slope, y = self.scalars.columns, self.scalars.slope, self.scalars.ratios(z)
        weights, logs = scale * self.scalars.weights, np.log(y)
        gradient[columns] += weights * slope * logs / y
        hessian[columns, columns] += weights * np.square(slope / y) * (1.0 - logs)
        return gradient, hessian

    def metric(self, z: Array) -> Array:
        """The affine-invariant metric for bodies, and that of the data for scalars."""
        scale = self.weight * self.gamma
        metric = 2.0 * np.eye(len(z))
        metric[self.inside[:, :, None], self.inside[:, None, :]] = scale * log_metric(
            self.matrices(z)
        )
        rates = self.scalars.slope / self.scalars.ratios(z)
        metric[self.scalars.columns, self.scalars.columns] += (
            scale * self.scalars.weights * rates**2
        )
        return metric

    @property
    def inside(self) -> Array:
        """(n_blocks, 10) coordinates of the blocks."""
        return self.blocks[:, None] + np.arange(len(SYMMETRIC_BASIS))
