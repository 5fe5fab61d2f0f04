"""Criteria of excitation: how much a motion identifies, as one number, [Lee2019] §4.2.1 and §4.3.3.

All are symmetric functions of the eigenvalues λ of a normalized information matrix; less is better.

| name | value |
|---|---|
| `a_optimality` | Σ 1/λᵢ, the expected squared error |
| `d_optimality` | −Σ log λᵢ, the volume of the confidence ellipsoid |
| `e_optimality` | 1/λ_min, the variance along the worst direction |
| `condition_number` | √(λ_max/λ_min) |

A solver gets the logarithm of the value (for D-optimality, its mean), which no scale disturbs.
λ_min is not smooth where eigenvalues meet, and optimal motions make them meet. What is minimized in
its place is the mean log (Σ λᵢ⁻ˢ)/s, a function of power sums, smooth everywhere, and never further
above log(1/λ_min) than log(n)/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import instance, integer, number, real_array
from geodrake.errors import ArgumentError

Array = NDArray[np.float64]

CRITERIA = ("a_optimality", "d_optimality", "e_optimality", "condition_number")
_EQUAL = 1e-9  # relative difference below which eigenvalues are one that is multiple


@dataclass(frozen=True)
class Criterion:
    """A function of the eigenvalues of an information matrix.

    Attributes:
        sharpness: s of the smooth forms of λ_min and λ_max; infinite for those themselves, whose
            gradient at a multiple eigenvalue is one of many.
        kept: Look at the r greatest eigenvalues only, [Lee2019] §4.5.2 step b.2; all if None.

    Raises:
        ArgumentError: There is no such criterion, or the sharpness or r is not positive.
    """

    name: str = "e_optimality"
    sharpness: float = 16.0
    kept: int | None = None

    def __post_init__(self) -> None:
        if instance(self.name, "criterion", str) not in CRITERIA:
            raise ArgumentError(
                f"There is no criterion {self.name!r}.", advice=f"Use one of {', '.join(CRITERIA)}."
            )
        if not number(self.sharpness, "sharpness", finite=False) > 0:
            raise ArgumentError(f"A criterion needs a positive sharpness; got {self.sharpness}.")
        if self.kept is not None:
            integer(self.kept, "kept", lower=1)

    def value(self, eigenvalues: ArrayLike) -> float:
        """Return the criterion itself, as in the table; infinite for a singular matrix.

        Args:
            eigenvalues: (n,) eigenvalues, none negative.

        Raises:
            ArgumentError: There are fewer eigenvalues than are to be kept.
        """
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
        """Return what a solver minimizes, and its gradient, as functions of log λ.

        Args:
            log_eigenvalues: (n,) finite logarithms of the eigenvalues.

        Returns:
            log of the value (for D-optimality, the value over n), with λ_min and λ_max smooth, and
            the gradient (n,).

        Raises:
            ArgumentError: There are fewer eigenvalues than are to be kept.
        """
        logs = real_array(log_eigenvalues, "log_eigenvalues", ("n",))
        order = np.argsort(logs, kind="stable")[len(logs) - len(self._largest(logs)) :]
        kept, gradient = logs[order], np.zeros_like(logs)
        match self.name:
            case "a_optimality":
                value, slope = _soft_maximum(-kept, 1.0)
                gradient[order] = -slope
            case "d_optimality":
                value = -float(kept.mean())
                gradient[order] = -1.0 / len(kept)
            case "e_optimality":
                value, slope = _soft_maximum(-kept, self.sharpness)
                gradient[order] = -slope
            case _:
                low, down = _soft_maximum(-kept, self.sharpness)
                high, up = _soft_maximum(kept, self.sharpness)
                value = 0.5 * (high + low)
                gradient[order] = 0.5 * (up - down)
        return value, gradient

    def _largest(self, eigenvalues: Array) -> Array:
        """Return the r greatest eigenvalues."""
        count = len(eigenvalues) if self.kept is None else self.kept
        if count > len(eigenvalues) or not len(eigenvalues):
            raise ArgumentError(
                f"A criterion of {count} eigenvalues needs as many; there are {len(eigenvalues)}."
            )
        return np.sort(eigenvalues)[len(eigenvalues) - count :]


def _soft_maximum(x: Array, sharpness: float) -> tuple[float, Array]:
    """log(Σ exp(s x))/s and its gradient; the maximum itself for an infinite s."""
    highest = float(x.max())
    if np.isinf(sharpness):
        multiple = x >= highest - _EQUAL
        return highest, multiple / multiple.sum()
    parts = np.exp(sharpness * (x - highest))
    total = float(parts.sum())
    return highest + float(np.log(total)) / sharpness, parts / total
