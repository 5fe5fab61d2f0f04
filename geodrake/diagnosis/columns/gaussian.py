"""One Gaussian fit of all joints: parameters with a prior, noise and gains found with them.

Efforts g s of a joint are e^ε (X x) + noise: X are columns of its design, and ε is what is wrong
with the logarithm of its gain g.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.columns.design import JointDesign
from geodrake.identification.logs.criteria import LEAST_NOISE
from geodrake.identification.normal_equations import scaled_cholesky, solved

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_ROUNDS = 12  # of a fit, in which weights change
_HOPED = 0.03  # error over the deviation of efforts, that a fit begins with where none is near
_SETTLED = 1e-3  # change of the logarithm of the noise
_FURTHEST = 0.7  # logarithm of a gain's error: farther, sizes of efforts are other ones
_RIDGE = 1e-12


class JointEquations:
    """Equations of one joint in some parameters, the last of which may be its gain's error ε."""

    def __init__(
        self, design: JointDesign, at: Indices, local: Indices, effort: Array, known: Array
    ) -> None:
        self.design, self.at = design, at  # the parameters
        # Columns of X of all but ε, and weights of columns for efforts g s and for known payloads.
        self._local, self._effort, self._known = local, effort, known
        self._gram = np.empty((len(at), len(at)))
        self._gram[: len(local), : len(local)] = design.gram[local[:, None], local]
        self.power = float(effort @ design.gram @ effort)  # sum of the squared efforts

    def _needed(self, x: Array) -> tuple[Array, float]:
        """Weights of the columns for what is needed with parameters (p,), and ε."""
        weights, own = self._known.copy(), x[self.at]
        weights[self._local] = own[: len(self._local)]
        return weights, float(own[-1]) if len(own) > len(self._local) else 0.0

    def needed(self, x: Array) -> tuple[Array, Array]:
        """Return (K,) efforts that are needed with parameters (p,), and those of the log (K,)."""
        weights, error = self._needed(x)
        return np.exp(error) * (self.design.X @ weights), self.design.X @ self._effort

    def normal(self, x: Array) -> tuple[Array, Array, float]:
        """Return the normal matrix, the moments and the squared efforts near parameters (p,).

        To first order, the sum of squared errors with parameters z is zᵀ H z − 2 bᵀ z + c.
        """
        m, (weights, error) = len(self._local), self._needed(x)
        target = self._effort * np.exp(-error) - self._known + error * weights
        column = self.design.gram @ np.column_stack([target, weights])
        moments, scale = column[self._local, 0], np.exp(2.0 * error)
        if len(self.at) > m:
            self._gram[m, :m] = self._gram[:m, m] = column[self._local, 1]
            self._gram[m, m] = weights @ column[:, 1]
            moments = np.append(moments, weights @ column[:, 0])
        return scale * self._gram, scale * moments, float(scale * (target @ column[:, 0]))


@dataclass(frozen=True, eq=False)
class JointFit:
    """The most probable parameters and noise."""

    x: Array  # (p,) parameters
    mse: Array  # (J,) mean squared errors, (N·m)² or N²
    score: float  # twice the logarithm of the evidence, without the likelihood of the errors


def most_probable(
    joints: Sequence[JointEquations],
    worth: Array,
    prior: tuple[Array, Array, Array],
    *,
    start: Array,
    gains: Indices,
    mse: Array | None = None,
) -> JointFit:
    """Fit joints whose errors are worth (J,) independent samples.

    The prior has a mean (p,), an information (p, p) and lower bounds (p,); gains act near `start`
    (p,) at first, and `mse` (J,) say how much each joint counts then: as if it was explained by
    default. `gains` are the parameters that are logarithms.
    """
    mean, information, lower = prior
    count = np.array([len(joint.design.rows) for joint in joints], float)
    power = np.array([joint.power for joint in joints]) / count
    least = power * LEAST_NOISE**2 + 1e-300
    mse = np.clip(_HOPED**2 * power if mse is None else mse, least, np.maximum(power, least))
    pull, held, x = information @ mean, np.zeros(len(mean), bool), start
    for _ in range(_ROUNDS):
        H, b, squares = information.copy(), pull.copy(), [joint.normal(x) for joint in joints]
        for joint, (A, moments, _), weight in zip(
            joints, squares, worth / count / mse, strict=True
        ):
            H[joint.at[:, None], joint.at] += weight * A
            b[joint.at] += weight * moments
        x = _bounded(H, b, lower, held)
        held = np.where(held, H @ x >= b, x < lower)
        x = np.maximum(x, lower)
        x[gains] = np.clip(x[gains], -_FURTHEST, _FURTHEST)
        left = [
            own @ A @ own - 2.0 * moments @ own + c
            for own, (A, moments, c) in zip([x[j.at] for j in joints], squares, strict=True)
        ]
        before, mse = mse, np.maximum(np.array(left) / count, least)
        if np.abs(np.log(mse / before)).max() < _SETTLED:
            break
    far, determinants = x - mean, [_log_determinant(A) for A in (information, H)]
    score = determinants[0] - determinants[1] - far @ information @ far
    return JointFit(x, mse, float(score))


def _bounded(A: Array, b: Array, lower: Array, held: NDArray[np.bool_]) -> Array:
    """Solve a positive definite system, some of the unknowns at their lower bounds."""
    x, free = np.where(held, lower, 0.0), ~held
    if held.any():
        A, b = A[np.ix_(free, free)], b[free] - A[np.ix_(free, held)] @ x[held]
    factor, scale = scaled_cholesky(A, _RIDGE)
    x[free] = scale * solved(factor, scale * b)
    return x


def _log_determinant(A: Array) -> float:
    factor, scale = scaled_cholesky(A, _RIDGE)
    return float(2.0 * (np.log(np.diag(factor)).sum() - np.log(scale).sum()))
