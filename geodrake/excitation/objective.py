"""Scalar measures of the information in a motion, [Lee2019] §4.2.1 and §4.3.3.

With the regressor A of all p parameters, whitened by the noise, the normalized information is

    (A K)ᵀ (A K),   B K Kᵀ Bᵀ = H⁻¹,

for base parameters φ_B = B φ whose errors are measured by the metric H: the identity (`none`),
[diag φ_B⁰]⁻² (`diagonal`, Eq. (4.2.26)) or the pushforward H₀ of the metric on physical bodies
(`geometric`, Eq. (4.3.38)). The columns of K are parameter changes of unit length. Only the
geometric normalization is invariant to frames, units and B, up to rounding: its K = G₀^(−½) Q, with
orthonormal columns Q that span the rows of B G₀^(−½), needs no inverse.

Criteria are symmetric functions of the eigenvalues λ of that matrix; smaller is better.

| name | value |
|---|---|
| `a_optimality` | Σ 1/λᵢ, the expected squared error |
| `d_optimality` | −Σ log λᵢ, the volume of the confidence ellipsoid |
| `e_optimality` | 1/λ_min, the variance along the worst direction |
| `condition_number` | √(λ_max/λ_min) |

Solvers minimize the logarithm of the value (for D-optimality, the mean), which is independent of
scale. λ_min is not smooth at multiple eigenvalues, which optimal motions tend to have. It is
replaced by log(Σ λᵢ⁻ˢ)/s, a smooth function that exceeds log(1/λ_min) by at most log(n)/s.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from geodrake.boundary.arguments import Sizes, instance, integer, number, one_of, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.excitation.regressor_gradient import MotionGradient, regressor_motion_gradient
from geodrake.excitation.target import Measurement, Target
from geodrake.inertia import Array
from geodrake.logs.motion import Motion

CRITERIA = ("a_optimality", "d_optimality", "e_optimality", "condition_number")
NORMALIZATIONS = ("none", "diagonal", "geometric")
_EQUAL = 1e-9  # relative difference below which eigenvalues count as multiple
_STATES = 300  # number of samples for which a direction must be identifiable
_LEAST_SHARE = 1e-3  # least size of a parameter, relative to its geometric unit


@dataclass(frozen=True)
class Criterion:
    """A function of the eigenvalues of an information matrix.

    Attributes:
        sharpness: s of the smooth forms of λ_min and λ_max; infinite for the exact values, which
            have only a subgradient at multiple eigenvalues.
        kept: Number r of the largest eigenvalues to use, [Lee2019] §4.5.2 step b.2; all if None.
    """

    name: str = "e_optimality"
    sharpness: float = 16.0
    kept: int | None = None

    def __post_init__(self) -> None:
        one_of(self.name, "criterion", CRITERIA)
        if not number(self.sharpness, "sharpness", finite=False) > 0:
            raise ArgumentError(f"sharpness must be positive; it is {self.sharpness}.")
        if self.kept is not None:
            integer(self.kept, "kept", lower=1)

    def value(self, eigenvalues: ArrayLike) -> float:
        """Return the criterion as in the table above; infinite for a singular matrix."""
        kept = self._largest(real_array(eigenvalues, "eigenvalues", ("n",)))
        if not kept.min() > 0:
            return np.inf
        match self.name:
            case "a_optimality":
                return float((1.0 / kept).sum())
            case "d_optimality":
                return float(-np.log(kept).sum())
            case "e_optimality":
                return float(1.0 / kept.min())
            case _:
                return float(np.sqrt(kept.max() / kept.min()))

    def objective(self, log_eigenvalues: ArrayLike) -> tuple[float, Array]:
        """Return the solver's objective, and its gradient (n,), as functions of log λ (n,)."""
        logs = real_array(log_eigenvalues, "log_eigenvalues", ("n",))
        order = np.argsort(logs, kind="stable")[len(logs) - len(self._largest(logs)) :]
        kept, gradient = logs[order], np.zeros_like(logs)
        if self.name == "d_optimality":
            gradient[order] = -1.0 / len(kept)
            return -float(kept.mean()), gradient
        sharpness = 1.0 if self.name == "a_optimality" else self.sharpness
        value, down = _soft_maximum(-kept, sharpness)
        gradient[order] = -down
        if self.name == "condition_number":
            high, up = _soft_maximum(kept, sharpness)
            value, gradient[order] = 0.5 * (high + value), 0.5 * (up - down)
        return value, gradient

    def _largest(self, eigenvalues: Array) -> Array:
        """Return the r largest eigenvalues."""
        count = len(eigenvalues) if self.kept is None else self.kept
        if count > len(eigenvalues) or not len(eigenvalues):
            raise ArgumentError(
                f"A criterion of {count} eigenvalues needs as many; got {len(eigenvalues)}."
            )
        return np.sort(eigenvalues)[len(eigenvalues) - count :]


def _soft_maximum(x: Array, sharpness: float) -> tuple[float, Array]:
    """Return log(Σ exp(s x))/s and its gradient; the maximum itself for an infinite s."""
    highest = float(x.max())
    if np.isinf(sharpness):
        multiple = x >= highest - _EQUAL
        return highest, multiple / multiple.sum()
    parts = np.exp(sharpness * (x - highest))
    total = float(parts.sum())
    return highest + float(np.log(total)) / sharpness, parts / total


def normalizing_map(
    normalization: str, base: ArrayLike, prior: ArrayLike, metric_root: ArrayLike
) -> Array:
    """Return the matrix K (p, n_B) of a normalization.

    The diagonal normalization is undefined for base parameters of zero nominal value. Their size is
    at least a thousandth of the geometric unit √(H₀⁻¹)ᵢᵢ.

    Args:
        base: (n_B, p) B.
        metric_root: (p, p) root L of the inverse metric, G₀⁻¹ = L Lᵀ.
    """
    one_of(normalization, "normalization", NORMALIZATIONS)
    sizes: Sizes = {}
    B, prior = (
        real_array(base, "base", ("n_B", "p"), sizes),
        real_array(prior, "prior", ("p",), sizes),
    )
    L = real_array(metric_root, "metric_root", ("p", "p"), sizes)
    if normalization == "geometric":
        return np.asarray(L @ _row_space(B @ L)[0])
    Q, R = _row_space(B)
    pseudo_inverse = solve_triangular(R, Q.T).T  # Q R⁻ᵀ
    if normalization == "none":
        return np.asarray(pseudo_inverse)
    least = _LEAST_SHARE * np.linalg.norm(B @ L, axis=1)
    return np.asarray(pseudo_inverse * np.maximum(np.abs(B @ prior), least))


def _row_space(B: Array) -> tuple[Array, Array]:
    """Return Q (p, n) and triangular R with B = Rᵀ Qᵀ, after scaling out the units of rows."""
    sizes = np.linalg.norm(B, axis=1)
    if not (sizes > 0).all():
        raise ArgumentError("A row of B is zero.", advice="Take B from `base_parameters`.")
    Q, R = np.linalg.qr((B / sizes[:, None]).T)
    if len(R) < len(B) or np.abs(np.diagonal(R)).min(initial=1.0) < 1e-12:
        raise ArgumentError(
            "Rows of B are linearly dependent, so they are not base parameters.",
            advice="Take B from `base_parameters`.",
        )
    return Q, R * sizes


@dataclass(frozen=True, eq=False)
class Objective(Short):
    """A normalized criterion of a target, as a function of the motion.

    Attributes:
        base: (n_B, p) base parameters B, for normalizations that depend on this choice; those of
            the target if None.
    """

    target: Target
    criterion: Criterion = field(default_factory=Criterion)
    normalization: str = "geometric"
    base: Array | None = None

    def __post_init__(self) -> None:
        instance(self.target, "target", Target)
        instance(self.criterion, "criterion", Criterion)
        one_of(self.normalization, "normalization", NORMALIZATIONS)
        if self.base is not None:
            real_array(self.base, "base", ("n_B", "p"))

    @cached_property
    def normalizing_map(self) -> Array:
        """(p, n_B) K: parameter changes of unit length.

        For a target with trial states, the geometric K excludes directions that hundreds of such
        states do not identify within their size.
        """
        target, base = self.target, self.base
        B = target.base.matrix if base is None else base
        K = normalizing_map(self.normalization, B, target.prior, target.metric_root)
        if target.trial is None or base is not None or self.normalization != "geometric":
            return K
        X = target.measure(target.trial).regressor / target.noise[:, None]
        singular, V = _spectrum(X.reshape(-1, len(K)) @ K)
        identifiable = singular**2 * (_STATES / len(target.trial)) >= 1.0
        if not identifiable.any():
            raise ArgumentError(
                "No motion within the limits identifies any parameter within its size, as the "
                f"noise is {target.noise.tolist()}.",
                advice="Check the noise, or widen the limits.",
            )
        return np.asarray(K @ V[:, identifiable])

    def factor(self, measurement: Measurement) -> Array:
        """Return the whitened and normalized regressor A K (N m, n_B) of a motion."""
        X, K = measurement.regressor, self.normalizing_map
        if X.shape[0] * X.shape[1] < K.shape[1]:
            raise ArgumentError(
                f"{X.shape[0]} samples of {X.shape[1]} measurements cannot identify "
                f"{K.shape[1]} parameters.",
                advice="Use more samples.",
            )
        return np.asarray((X / self.target.noise[:, None]).reshape(-1, len(K)) @ K)

    def eigenvalues(self, motion: Motion) -> Array:
        """Return the eigenvalues (n_B,) of the normalized information matrix, ascending.

        Their inverses are variances of parameter errors, in units of the normalization.
        """
        return np.asarray(_spectrum(self.factor(self.target.measure(motion)))[0] ** 2)

    def value(self, motion: Motion) -> float:
        """Return the criterion, [Lee2019] Eqs. (4.2.19), (4.2.26), (4.3.38)."""
        return self.criterion.value(self.eigenvalues(motion))

    def value_and_gradient(self, motion: Motion) -> tuple[float, MotionGradient]:
        """Return `Criterion.objective` of a motion, and its gradient with respect to the motion.

        [Lee2019] Eqs. (4.4.48) to (4.4.52), by the chain rule over the regressor's entries.
        """
        measurement = self.target.measure(motion)
        A, K = self.factor(measurement), self.normalizing_map
        singular, V = _spectrum(A)
        if not singular[0] > 0:
            raise ArgumentError(
                "The motion does not identify some parameters, so the criterion is infinite.",
                advice="Start with a motion of all joints.",
            )
        value, slope = self.criterion.objective(2.0 * np.log(singular))
        # ∂f/∂A = A V diag(2 ∂f/∂λ) Vᵀ, with ∂f/∂λ = slope/λ.
        weights = A @ ((V * (2.0 * slope / singular**2)) @ (V.T @ K.T))
        shape = len(motion), len(self.target.noise), len(K)
        weights = weights.reshape(shape) / self.target.noise[:, None]
        return value, regressor_motion_gradient(self.target, measurement, weights)


def _spectrum(A: Array) -> tuple[Array, Array]:
    """Return singular values (n,), ascending, and right singular vectors (n, n) of a tall matrix.

    A QR factorization avoids AᵀA, which loses half the digits of small eigenvalues.
    """
    _, singular, Vt = np.linalg.svd(np.linalg.qr(A, mode="r"))
    return singular[::-1], Vt[::-1].T
