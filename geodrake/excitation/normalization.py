"""Normalizations of information matrices: in what units errors of parameters are counted.

With regressor A of all p parameters, whitened by the noise, the normalized information matrix is

    (A K)ᵀ (A K),   B K Kᵀ Bᵀ = H⁻¹,

for base parameters φ_B = B φ whose errors are measured by the metric H: the identity (`none`),
[diag φ_B⁰]⁻² (`diagonal`, [Lee2019] Eq. (4.2.26)) or the pushforward H₀ of the metric on physical
bodies (`geometric`, Eq. (4.3.38)). The columns of K are parameter changes of length one.

Only the last is indifferent to frames, units and B. Its K = G₀^(−½) Q, with orthonormal columns Q
that span the rows of B G₀^(−½), needs no inverse, so it is so to rounding.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from geodrake.errors import ArgumentError
from geodrake.inertia import Array

NORMALIZATIONS = ("none", "diagonal", "geometric")
_LEAST_SHARE = 1e-3  # of a parameter's geometric unit that its nominal value counts for


def normalizing_map(
    normalization: str, base: ArrayLike, prior: ArrayLike, metric_root: ArrayLike
) -> Array:
    """The matrix K of a normalization.

    Args:
        base: (n_B, p) B.
        prior: (p,) nominal parameters φ⁰.
        metric_root: (p, p) root L of the inverse metric, G₀⁻¹ = L Lᵀ.

    Returns:
        (p, n_B) K. A base parameter of (nearly) zero nominal value, for which the diagonal
        normalization is not defined, counts with a thousandth of its geometric unit √(H₀⁻¹)ᵢᵢ.

    Raises:
        ArgumentError: There is no such normalization, shapes do not fit, or rows of B depend.
    """
    B, prior, L = (np.asarray(x, float) for x in (base, prior, metric_root))
    if normalization not in NORMALIZATIONS:
        raise ArgumentError(
            f"There is no normalization {normalization!r}.",
            advice=f"Use one of {', '.join(NORMALIZATIONS)}.",
        )
    if B.ndim != 2 or prior.shape != B.shape[1:] or L.shape != (len(prior), len(prior)):
        raise ArgumentError(
            f"B {B.shape}, the nominal parameters {prior.shape} and the root of the metric "
            f"{L.shape} do not fit together."
        )
    if normalization == "geometric":
        return np.asarray(L @ _row_space(B @ L)[0])
    Q, R = _row_space(B)
    pseudo_inverse = solve_triangular(R, Q.T).T  # Q R⁻ᵀ
    if normalization == "none":
        return np.asarray(pseudo_inverse)
    least = _LEAST_SHARE * np.linalg.norm(B @ L, axis=1)
    return np.asarray(pseudo_inverse * np.maximum(np.abs(B @ prior), least))


def _row_space(B: Array) -> tuple[Array, Array]:
    """Q (p, n) and triangular R with B = Rᵀ Qᵀ; rows are scaled first, for they have units."""
    sizes = np.linalg.norm(B, axis=1)
    if not (sizes > 0).all():
        raise ArgumentError("A row of B is zero.", advice="Take B from `base_parameters`.")
    Q, R = np.linalg.qr((B / sizes[:, None]).T)
    if len(R) < len(B) or np.abs(np.diagonal(R)).min(initial=1.0) < 1e-12:
        raise ArgumentError(
            "Rows of B are dependent, so they are no base parameters.",
            advice="Take B from `base_parameters`.",
        )
    return Q, R * sizes
