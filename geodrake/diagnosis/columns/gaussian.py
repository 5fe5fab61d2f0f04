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

_ROUNDS = 24  # of a fit, in which weights change, at most
_HOPED = 0.03  # error over the deviation of efforts, that a fit begins with where none is near
_SETTLED = 1e-3  # change of the logarithm of the noise
_FURTHEST = 0.7  # logarithm of a gain's error: farther, sizes of efforts are other ones
_HALVES = 8  # of a step, until it is worth taking
_HOLDS = 8  # of parameters at their bounds, in one step
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
    shared = np.full(len(x), -1)
    prior_known, known = (calc_solution(A, zero, _RIDGE, shared)[1] for A in (bounds[0], H))
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
    To first order near x, the squared errors of a joint have a normal matrix A and a right side b.
    Parameters times gains are not linear: of a step that is too long a half is taken, or a quarter.
    """
    (grams, sides, places), (start, mse) = joints, first
    worth, (information, pull, lower) = samples[0], prior
    n, size = len(grams), places.shape[2]
    x, there, H = start.copy(), start.copy(), information.copy()
    held = np.zeros(len(start), np.bool_)
    lowest, highest = lower.copy(), np.full(len(x), np.inf)
    lowest[gains], highest[gains] = -_FURTHEST, _FURTHEST
    A, b, errors = np.zeros((size, size)), np.zeros(size), np.empty(n)
    cost = calc_cost(joints, samples, prior, x, errors)
    for _ in range(_ROUNDS):
        H, right = information.copy(), pull.copy()
        for j in range(n):
            m, p = np.sum(places[j, 1] >= 0), np.sum(places[j, 0] >= 0)
            at, columns = places[j, 0, :p], places[j, 1, :m]
            weights = calc_weights(sides[j, 1], columns, x, at)
            error = x[at[m]] if p > m else 0.0
            target = sides[j, 0] * np.exp(-error) - sides[j, 1] + error * weights
            of_target, of_weights = grams[j] @ target, grams[j] @ weights
            for i in range(m):
                for k in range(m):
                    A[i, k] = grams[j, columns[i], columns[k]]
                b[i] = of_target[columns[i]]
                if p > m:
                    A[i, m] = A[m, i] = of_weights[columns[i]]
            if p > m:
                A[m, m], b[m] = weights @ of_weights, weights @ of_target
            share = worth[j] / mse[j] * np.exp(2.0 * error)
            for i in range(p):
                right[at[i]] += share * b[i]
                for k in range(p):
                    H[at[i], at[k]] += share * A[i, k]
        calc_bounded(H, right, (lowest, highest), there, held)
        share, begin, before = 1.0, x, cost
        while True:
            x = begin + share * (there - begin)
            cost = calc_cost(joints, samples, prior, x, errors)
            if cost < before or share == 0.0:
                break
            share = 0.5 * share if share > 0.5**_HALVES else 0.0
        change = np.abs(np.log(errors / mse)).max()
        mse = errors.copy()
        if change < _SETTLED:
            break
    return x, mse, H


@compiled
def calc_cost(
    joints: tuple[Array, Array, Indices],
    samples: tuple[Array, Array, Array],
    prior: tuple[Array, Array, Array],
    x: Array,
    mse: Array,
) -> float:
    """Return −2 log of the posterior of parameters (p,), and write mean squared errors (J,)."""
    (grams, sides, places), (worth, rows, least) = joints, samples
    cost = x @ (prior[0] @ x) - 2.0 * (prior[1] @ x)
    for j in range(len(grams)):
        m, p = np.sum(places[j, 1] >= 0), np.sum(places[j, 0] >= 0)
        weights = calc_weights(sides[j, 1], places[j, 1, :m], x, places[j, 0, :p])
        left = sides[j, 0] - (np.exp(x[places[j, 0, m]]) if p > m else 1.0) * weights
        mse[j] = max(left @ (grams[j] @ left) / rows[j], least[j])
        cost += worth[j] * rows[j] * np.log(mse[j])
    return float(cost)


@compiled
def calc_weights(known: Array, columns: Indices, x: Array, at: Indices) -> Array:
    """Return weights (M,) of all columns: those that are known, and parameters of the others."""
    weights = known.copy()
    for i in range(len(columns)):
        weights[columns[i]] = x[at[i]]
    return weights


@compiled
def calc_bounded(
    A: Array, b: Array, bounds: tuple[Array, Array], x: Array, held: NDArray[np.bool_]
) -> None:
    """Write the minimum x (p,) of xᵀ A x / 2 − bᵀ x within bounds, and who is held there.

    It begins with those that are held.
    """
    lower, upper = bounds
    count, free = len(b), np.empty(len(b), np.intp)
    for _ in range(_HOLDS):
        size = 0
        for i in range(count):
            if not held[i]:
                free[size] = i
                size += 1
        inner, right = np.empty((size, size)), np.empty(size)
        for row in range(size):
            i = free[row]
            right[row] = b[i]
            for k in range(count):
                if held[k]:
                    right[row] -= A[i, k] * x[k]
            for column in range(size):
                inner[row, column] = A[i, free[column]]
        found, settled = calc_solution(inner, right, _RIDGE, np.full(size, -1))[0], True
        for row in range(size):
            i = free[row]
            x[i] = min(max(found[row], lower[i]), upper[i])
            held[i] = x[i] != found[row]
            settled &= not held[i]
        if settled:
            slope = A @ x - b
            for i in range(count):
                if held[i]:
                    held[i] = slope[i] >= 0.0 if x[i] == lower[i] else slope[i] <= 0.0
                    settled &= held[i]
        if settled:
            break
