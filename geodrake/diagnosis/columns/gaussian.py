"""Gaussian fit of all joints' efforts: parameters with a prior, noise and gains.

The model of a joint is g s = e^ε X x + noise, where s are the logged efforts, X the columns of its
design, and ε the error of the logarithm of its gain g.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, contiguous
from geodrake.diagnosis.columns.design import JointDesign
from geodrake.identification.logs.criteria import LEAST_NOISE
from geodrake.identification.normal_equations import calc_solution, singular_error

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_ROUNDS = 24  # reweighted Newton steps of a fit, at most
_FIRST_ERROR = 0.03  # initial RMS error, relative to the RMS effort
_TOLERANCE = 1e-3  # change of the logarithm of the noise
_LARGEST_ERROR = 0.7  # magnitude of ε
_HALVINGS = 8  # of a step, at most
_ACTIVE_SETS = 8  # tried in one bounded step, at most
_RIDGE = 1e-12


@dataclass(frozen=True, eq=False)
class JointEquations:
    """Equations of one joint, whose last parameter may be the error ε of its gain."""

    design: JointDesign
    at: Indices  # indices of its parameters
    local: Indices  # columns of X of its parameters, except ε
    effort: Array  # weights of the columns for the efforts g s
    known: Array  # weights of the columns for known payloads

    def needed(self, x: Array) -> tuple[Array, Array]:
        """Return the (K,) efforts predicted with parameters (p,), and the (K,) logged efforts."""
        weights, values, m = self.known.copy(), x[self.at], len(self.local)
        weights[self.local] = values[:m]
        gain = np.exp(values[-1]) if len(values) > m else 1.0
        return gain * (self.design.X @ weights), self.design.X @ self.effort


@dataclass(frozen=True, eq=False)
class JointFit:
    """Most probable parameters and noise."""

    x: Array  # (p,) parameters
    mse: Array  # (J,) mean squared errors, (N·m)² or N²
    score: float  # twice the log-evidence, without the likelihood of the errors


def most_probable(
    joints: Sequence[JointEquations],
    counts: Array,
    prior: tuple[Array, Array, Array],
    *,
    start: Array,
    gains: Indices,
    mse: Array | None = None,
) -> JointFit:
    """Fit all joints, whose errors count as `counts` (J,) independent samples.

    The prior consists of a mean (p,), an information (p, p) and lower bounds (p,). The fit is
    linearized about `start` (p,) first, with weights by `mse` (J,); by default, as if every joint
    was well explained. `gains` are the indices of the parameters ε.
    """
    mean, information, lower = prior
    rows = np.array([len(joint.design.rows) for joint in joints], float)
    power = np.array([joint.effort @ joint.design.gram @ joint.effort for joint in joints]) / rows
    least = power * LEAST_NOISE**2 + 1e-300
    mse = np.clip(_FIRST_ERROR**2 * power if mse is None else mse, least, np.maximum(power, least))
    columns = max(len(joint.effort) for joint in joints)
    grams, sides = np.zeros((len(joints), columns, columns)), np.zeros((len(joints), 2, columns))
    places = np.full((len(joints), 2, columns + 1), -1)
    for k, joint in enumerate(joints):
        m = len(joint.effort)
        grams[k, :m, :m] = joint.design.gram
        sides[k, :, :m] = joint.effort, joint.known
        places[k, 0, : len(joint.at)], places[k, 1, : len(joint.local)] = joint.at, joint.local
    bounds = contiguous(information), contiguous(information @ mean), contiguous(lower)
    weights = contiguous(counts / rows), rows, least
    try:
        x, mse, H = calc_most_probable((grams, sides, places), weights, bounds, gains, (start, mse))
    except np.linalg.LinAlgError as error:
        raise singular_error() from error
    deviation = x - mean
    score = _log_det(bounds[0]) - _log_det(H) - deviation @ information @ deviation
    return JointFit(x, mse, float(score))


def _log_det(A: Array) -> float:
    """Return log |A| of a scaled matrix (p, p) whose eigenvalues are at least the ridge."""
    scale = np.diag(A) ** -0.5
    eigenvalues = np.linalg.eigvalsh(A * scale[:, None] * scale)
    return float(np.log(np.maximum(eigenvalues, _RIDGE)).sum() - 2.0 * np.log(scale).sum())


@compiled
def calc_most_probable(
    joints: tuple[Array, Array, Indices],
    samples: tuple[Array, Array, Array],  # (J,) independent samples per row, rows, least error
    prior: tuple[Array, Array, Array],  # information, its product with the mean, lower bounds
    gains: Indices,
    first: tuple[Array, Array],  # parameters (p,), and mean squared errors (J,)
) -> tuple[Array, Array, Array]:
    """Return the parameters (p,), mean squared errors (J,), and normal matrix (p, p).

    Each joint has a normal matrix (M, M) of all columns, their weights (2, M) for efforts and for
    known payloads, and indices (2, M + 1) of parameters and of their columns, padded with −1. As
    gains multiply parameters, a step that increases the cost is halved.
    """
    (_, _, places), (start, mse) = joints, first
    information, information_mean, lower = prior
    n, size = len(mse), places.shape[2]
    origin, x, minimum, H = start.copy(), start.copy(), start.copy(), information.copy()
    active = np.zeros(len(start), np.bool_)
    lowest, highest = lower.copy(), np.full(len(x), np.inf)
    for k in gains:
        lowest[k], highest[k] = -_LARGEST_ERROR, _LARGEST_ERROR
    A, b, errors = np.zeros((size, size)), np.zeros(size), np.empty(n)
    cost = calc_cost(joints, samples, prior, x, errors)
    for _ in range(_ROUNDS):
        H, right = information.copy(), information_mean.copy()
        for j in range(n):
            at, share = unpadded(places[j, 0]), samples[0][j] / mse[j]
            share *= calc_equations(joints, j, x, (A, b))
            for i in range(len(at)):
                right[at[i]] += share * b[i]
                for k in range(len(at)):
                    H[at[i], at[k]] += share * A[i, k]
        calc_bounded(H, right, (lowest, highest), minimum, active)
        share, previous_cost = 1.0, cost
        for k in range(len(x)):
            origin[k] = x[k]
        while True:
            for k in range(len(x)):
                x[k] = origin[k] + share * (minimum[k] - origin[k])
            cost = calc_cost(joints, samples, prior, x, errors)
            if cost < previous_cost or share == 0.0:
                break
            share = 0.5 * share if share > 0.5**_HALVINGS else 0.0
        change = 0.0
        for j in range(n):
            change = max(change, abs(np.log(errors[j] / mse[j])))
        mse = errors.copy()
        if change < _TOLERANCE:
            break
    return x, mse, H


@compiled
def calc_equations(
    joints: tuple[Array, Array, Indices], j: int, x: Array, out: tuple[Array, Array]
) -> float:
    """Write the normal equations A, b of a joint, linearized at x, and return their scale."""
    (grams, sides, places), (A, b), error = joints, out, 0.0
    at, columns = unpadded(places[j, 0]), unpadded(places[j, 1])
    m, weights = len(columns), calc_weights(sides[j, 1], columns, x, at)
    if len(at) > m:
        error = x[at[m]]
    target = np.empty(len(weights))
    for k in range(len(target)):
        target[k] = sides[j, 0, k] * np.exp(-error) - sides[j, 1, k] + error * weights[k]
    gram_target, gram_weights = grams[j] @ target, grams[j] @ weights
    for i in range(m):
        for k in range(m):
            A[i, k] = grams[j, columns[i], columns[k]]
        b[i] = gram_target[columns[i]]
        A[i, m] = A[m, i] = gram_weights[columns[i]]
    A[m, m], b[m] = weights @ gram_weights, weights @ gram_target
    return float(np.exp(2.0 * error))


@compiled
def calc_cost(
    joints: tuple[Array, Array, Indices],
    samples: tuple[Array, Array, Array],
    prior: tuple[Array, Array, Array],
    x: Array,
    mse: Array,
) -> float:
    """Return −2 log posterior of the parameters (p,), and write the mean squared errors (J,)."""
    (grams, sides, places), (row_weights, rows, least) = joints, samples
    cost = x @ (prior[0] @ x) - 2.0 * (prior[1] @ x)
    for j in range(len(grams)):
        at, columns = unpadded(places[j, 0]), unpadded(places[j, 1])
        residual = calc_weights(sides[j, 1], columns, x, at)
        gain = np.exp(x[at[-1]]) if len(at) > len(columns) else 1.0
        for k in range(len(residual)):
            residual[k] = sides[j, 0, k] - gain * residual[k]
        mse[j] = max(residual @ (grams[j] @ residual) / rows[j], least[j])
        cost += row_weights[j] * rows[j] * np.log(mse[j])
    return float(cost)


@compiled
def unpadded(places: Indices) -> Indices:
    """Return the places before the padding with −1."""
    count = 0
    while count < len(places) and places[count] >= 0:
        count += 1
    return places[:count]


@compiled
def calc_weights(known: Array, columns: Indices, x: Array, at: Indices) -> Array:
    """Return the weights (M,) of all columns, with parameters inserted at `columns`."""
    weights = known.copy()
    for i in range(len(columns)):
        weights[columns[i]] = x[at[i]]
    return weights


@compiled
def calc_bounded(
    A: Array, b: Array, bounds: tuple[Array, Array], x: Array, active: NDArray[np.bool_]
) -> None:
    """Write the minimum x (p,) of xᵀ A x / 2 − bᵀ x within bounds, and its active set.

    The search starts from the active set that is passed in.
    """
    lower, upper = bounds
    count, free = len(b), np.empty(len(b), np.intp)
    for _ in range(_ACTIVE_SETS):
        size = 0
        for i in range(count):
            if not active[i]:
                free[size] = i
                size += 1
        inner, right = np.empty((size, size)), np.empty(size)
        for row in range(size):
            i = free[row]
            right[row] = b[i]
            for k in range(count):
                if active[k]:
                    right[row] -= A[i, k] * x[k]
            for column in range(size):
                inner[row, column] = A[i, free[column]]
        minimum, settled = calc_solution(inner, right, _RIDGE), True
        for row in range(size):
            i = free[row]
            x[i] = min(max(minimum[row], lower[i]), upper[i])
            active[i] = x[i] != minimum[row]
            settled &= not active[i]
        if settled:
            for i in range(count):
                if active[i]:
                    slope = A[i] @ x - b[i]
                    active[i] = slope >= 0.0 if x[i] == lower[i] else slope <= 0.0
                    settled &= active[i]
        if settled:
            break
