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
    """Normal equations of one joint."""

    def __init__(self, design: JointDesign, at: Indices, local: Indices, target: Array) -> None:
        self.design, self.at, self.has_gain = design, at, bool((local == design.gain).any())
        self._local, self._target, self.factor = local, target, 1.0
        self.gram = design.gram[local[:, None], local]
        moments = design.gram @ target
        self.moments, self._power = moments[local], float(target @ moments)
        effort = target[design.effort(0) :]
        self.power = float(effort @ design.gram[design.effort(0) :, design.effort(0) :] @ effort)

    @property
    def effort(self) -> Array:
        """(K,) efforts of the log."""
        first = self.design.effort(0)
        return np.asarray(self.design.X[:, first:] @ self._target[first:])

    def residual(self, x: Array) -> Array:
        """Return (K,) what is needed with parameters (p,), less the efforts."""
        X = self.design.X
        return np.asarray(X[:, self._local] @ x[self.at] - X @ self._target)

    def square(self, x: Array) -> float:
        """Return the sum of squared errors with parameters (p,)."""
        own = x[self.at]
        left = own @ self.gram @ own - 2.0 * own @ self.moments + self._power
        return float(left) * self.factor**2

    def turn(self, x: Array) -> None:
        """Let the error ε of the gain act on what is needed, near parameters (p,)."""
        design, gain, needed = self.design, self.design.gain, np.zeros(len(self._target))
        needed[self._local], error = x[self.at], float(x[self.at[gain]])
        needed[gain], needed[design.effort(-1)] = 0.0, 1.0
        self.factor, target = float(np.exp(error)), self._target + error * needed
        target[design.effort(0) :] /= self.factor
        column, moments = design.gram @ needed, design.gram @ target
        self.gram[gain] = self.gram[:, gain] = column[self._local]
        self.gram[gain, gain] = needed @ column
        self.moments, self._power = moments[self._local], float(target @ moments)
        self.moments[gain] = column @ target


@dataclass(frozen=True, eq=False)
class Posterior:
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
) -> Posterior:
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
        H, b = information.copy(), pull.copy()
        for joint, weight in zip(joints, worth / count / mse, strict=True):
            if joint.has_gain:
                joint.turn(x)
            H[joint.at[:, None], joint.at] += weight * joint.factor**2 * joint.gram
            b[joint.at] += weight * joint.factor**2 * joint.moments
        x = _bounded(H, b, lower, held)
        held = np.where(held, H @ x >= b, x < lower)
        x = np.maximum(x, lower)
        x[gains] = np.clip(x[gains], -_FURTHEST, _FURTHEST)
        before, mse = mse, np.maximum(np.array([j.square(x) for j in joints]) / count, least)
        if np.abs(np.log(mse / before)).max() < _SETTLED:
            break
    far, determinants = x - mean, [_log_determinant(A) for A in (information, H)]
    score = determinants[0] - determinants[1] - far @ information @ far
    return Posterior(x, mse, float(score))


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
