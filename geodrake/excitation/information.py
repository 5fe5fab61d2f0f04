"""What a motion says about a target, as eigenvalues and as one number with its gradient."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import instance, one_of, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.excitation.criteria import Criterion
from geodrake.excitation.motion_gradient import regressor_motion_gradient
from geodrake.excitation.normalization import NORMALIZATIONS, normalizing_map
from geodrake.excitation.reverse_recursion import MotionGradient
from geodrake.excitation.target import Measurement, Target
from geodrake.logs.motion import Motion

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Objective(Short):
    """A normalized criterion of a target, as a function of the motion.

    Attributes:
        target: What is to be identified.
        normalization: "geometric", "diagonal" or "none"; see `geodrake.excitation.normalization`.
        base: (n_B, p) base parameters B, for the normalizations that depend on the choice; those
            of the target if None.
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
        """(p, n_B) K: parameter changes of length one."""
        base = self.target.base.matrix if self.base is None else self.base
        return normalizing_map(self.normalization, base, self.target.prior, self.target.metric_root)

    def factor(self, measurement: Measurement) -> Array:
        """(N m, n_B) A K, the whitened and normalized regressor of a motion.

        Raises:
            ArgumentError: There are fewer measurements than base parameters.
        """
        X, K = measurement.regressor, self.normalizing_map
        if X.shape[0] * X.shape[1] < K.shape[1]:
            raise ArgumentError(
                f"{X.shape[0]} samples of {X.shape[1]} measurements cannot identify {K.shape[1]} "
                "parameters.",
                advice="Use more samples.",
            )
        return np.asarray((X / self.target.noise[:, None]).reshape(-1, len(K)) @ K)

    def eigenvalues(self, motion: Motion) -> Array:
        """(n_B,) eigenvalues of the normalized information matrix, ascending.

        Their inverses are variances: of parameter errors in units of the normalization.
        """
        return np.asarray(_spectrum(self.factor(self.target.measure(motion)))[0] ** 2)

    def value(self, motion: Motion) -> float:
        """The criterion, [Lee2019] Eqs. (4.2.19), (4.2.26), (4.3.38)."""
        return self.criterion.value(self.eigenvalues(motion))

    def value_and_gradient(self, motion: Motion) -> tuple[float, MotionGradient]:
        """What a solver minimizes (`Criterion.objective`), and its gradient by the motion.

        [Lee2019] Eqs. (4.4.48) to (4.4.52), by way of the regressor's entries.

        Raises:
            ArgumentError: There are fewer measurements than base parameters, or the motion leaves
                some wholly unknown.
        """
        measurement = self.target.measure(motion)
        A, K = self.factor(measurement), self.normalizing_map
        singular, V = _spectrum(A)
        if not singular[0] > 0:
            raise ArgumentError(
                "The motion says nothing of some parameters, so that the criterion is infinite.",
                advice="Start from a motion of all joints.",
            )
        value, slope = self.criterion.objective(2.0 * np.log(singular))
        # ∂f/∂A = A V diag(2 ∂f/∂λ) Vᵀ, with ∂f/∂λ = slope/λ.
        weights = A @ ((V * (2.0 * slope / singular**2)) @ (V.T @ K.T))
        shape = len(motion), len(self.target.noise), len(K)
        weights = weights.reshape(shape) / self.target.noise[:, None]
        return value, regressor_motion_gradient(self.target, measurement, weights)


def _spectrum(A: Array) -> tuple[Array, Array]:
    """Singular values (n,) ascending and right singular vectors (n, n) of a tall matrix.

    By a QR factorization, not from AᵀA, whose small eigenvalues have lost half their digits.
    """
    _, singular, Vt = np.linalg.svd(np.linalg.qr(A, mode="r"))
    return singular[::-1], Vt[::-1].T
