"""One Gaussian fit of all joints: parameters with a prior, noise and gains found with them.

Efforts g s of a joint are e^ε (X x) + noise: X are columns of its design, and ε is what is wrong
with the logarithm of its gain g.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, contiguous
from geodrake.diagnosis.columns.design import JointDesign
from geodrake.identification.logs.criteria import LEAST_NOISE
from geodrake.identification.normal_equations import calc_solution, not_held

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_ROUNDS = 12  # of a fit, in which weights change
_HOPED = 0.03  # error over the deviation of efforts, that a fit begins with where none is near
_SETTLED = 1e-3  # change of the logarithm of the noise
_FURTHEST = 0.7  # logarithm of a gain's error: farther, sizes of efforts are other ones
_RIDGE = 1e-12


@dataclass(frozen=True, eq=False)
class JointEquations:
    """Equations of one joint in some parameters, the last of which may be its gain's error ε."""

    design: JointDesign
    at: Indices  # the parameters
    local: Indices  # columns of X of all but ε
    effort: Array  # weights of the columns for the efforts g s
    known: Array  # weights of the columns for known payloads

    def needed(self, x: Array) -> tuple[Array, Array]:
        """Return (K,) efforts that are needed with parameters (p,), and those of the log (K,)."""
        weights, own, m = self.known.copy(), x[self.at], len(self.local)
        weights[self.local] = own[:m]
        gain = np.exp(own[-1]) if len(own) > m else 1.0
        return gain * (self.design.X @ weights), self.design.X @ self.effort


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
    power = np.array([joint.effort @ joint.design.gram @ joint.effort for joint in joints]) / count
    least = power * LEAST_NOISE**2 + 1e-300
    mse = np.clip(_HOPED**2 * power if mse is None else mse, least, np.maximum(power, least))
    width = max(len(joint.effort) for joint in joints)
    grams, sides = np.zeros((len(joints), width, width)), np.zeros((len(joints), 2, width))
    places = np.full((len(joints), 2, width + 1), -1)
    for k, joint in enumerate(joints):
        m = len(joint.effort)
        grams[k, :m, :m] = joint.design.gram
        sides[k, :, :m] = joint.effort, joint.known
        places[k, 0, : len(joint.at)], places[k, 1, : len(joint.local)] = joint.at, joint.local
    bounds = contiguous(information), contiguous(information @ mean), contiguous(lower)
    weights = contiguous(worth / count), count, least
    try:
        x, mse, H = calc_most_probable((grams, sides, places), weights, bounds, gains, (start, mse))
    except np.linalg.LinAlgError as error:
        raise not_held() from error
    far, zero = x - mean, np.zeros_like(x)
    prior_known, known = (calc_solution(A, zero, _RIDGE)[1] for A in (bounds[0], H))
    score = prior_known - known - far @ information @ far
    return JointFit(x, mse, float(score))


@compiled
def calc_most_probable(
    joints: tuple[Array, Array, Indices],
    samples: tuple[Array, Array, Array],  # (J,) worth of a row, rows, least squared error
    prior: tuple[Array, Array, Array],  # information, its product with the mean, lower bounds
    gains: Indices,
    first: tuple[Array, Array],  # parameters (p,), and mean squared errors (J,)
) -> tuple[Array, Array, Array]:
    """Return the parameters (p,), mean squared errors (J,), and the normal matrix (p, p).

    Joints have normal matrices (J, M, M) of all columns, weights (J, 2, M) of these for efforts and
    for known payloads, and (J, 2, M + 1) parameters and columns of all but ε, −1 where none is.
    To first order near x, the sum of squared errors of a joint is zᵀ A z − 2 bᵀ z + c.
    """
    (grams, sides, places), (start, mse) = joints, first
    (worth, rows, least), (information, pull, lower) = samples, prior
    n, size = len(grams), places.shape[2]
    x, held, H = start.copy(), np.zeros(len(start), np.bool_), information.copy()
    A, b, c = np.zeros((n, size, size)), np.zeros((n, size)), np.zeros(n)
    for _ in range(_ROUNDS):
        H, right = information.copy(), pull.copy()
        for j in range(n):
            m, p = np.sum(places[j, 1] >= 0), np.sum(places[j, 0] >= 0)
            at, columns = places[j, 0, :p], places[j, 1, :m]
            weights = calc_weights(sides[j, 1], columns, x, at)
            error = x[at[m]] if p > m else 0.0
            target = sides[j, 0] * np.exp(-error) - sides[j, 1] + error * weights
            of_target, of_weights = grams[j] @ target, grams[j] @ weights
            scale = np.exp(2.0 * error)
            for i in range(m):
                for k in range(m):
                    A[j, i, k] = scale * grams[j, columns[i], columns[k]]
                b[j, i] = scale * of_target[columns[i]]
                if p > m:
                    A[j, i, m] = A[j, m, i] = scale * of_weights[columns[i]]
            if p > m:
                A[j, m, m], b[j, m] = scale * (weights @ of_weights), scale * (weights @ of_target)
            c[j] = scale * (target @ of_target)
            share = worth[j] / mse[j]
            for i in range(p):
                right[at[i]] += share * b[j, i]
                for k in range(p):
                    H[at[i], at[k]] += share * A[j, i, k]
        x = calc_bounded(H, right, lower, held)
        slope = H @ x
        for i in range(len(x)):
            held[i] = slope[i] >= right[i] if held[i] else x[i] < lower[i]
            x[i] = max(x[i], lower[i])
        for i in gains:
            x[i] = min(max(x[i], -_FURTHEST), _FURTHEST)
        change = 0.0
        for j in range(n):
            p = np.sum(places[j, 0] >= 0)
            own = x[places[j, 0, :p]]
            left = own @ (np.ascontiguousarray(A[j, :p, :p]) @ own) - 2.0 * (b[j, :p] @ own) + c[j]
            found = max(left / rows[j], least[j])
            change = max(change, abs(np.log(found / mse[j])))
            mse[j] = found
        if change < _SETTLED:
            break
    return x, mse, H


@compiled
def calc_weights(known: Array, columns: Indices, x: Array, at: Indices) -> Array:
    """Return weights (M,) of all columns: those that are known, and parameters of the others."""
    weights = known.copy()
    for i in range(len(columns)):
        weights[columns[i]] = x[at[i]]
    return weights


@compiled
def calc_bounded(A: Array, b: Array, lower: Array, held: NDArray[np.bool_]) -> Array:
    """Solve a positive definite system, some of the unknowns at their lower bounds."""
    x, free, size = lower.copy(), np.empty(len(b), np.intp), 0
    for i in range(len(b)):
        if not held[i]:
            free[size] = i
            size += 1
    inner, right = np.empty((size, size)), np.empty(size)
    for row in range(size):
        i = free[row]
        right[row] = b[i]
        for k in range(len(b)):
            if held[k]:
                right[row] -= A[i, k] * lower[k]
        for column in range(size):
            inner[row, column] = A[i, free[column]]
    found = calc_solution(inner, right, _RIDGE)[0]
    for row in range(size):
        x[free[row]] = found[row]
    return x
