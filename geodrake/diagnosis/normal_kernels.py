"""Kernels of `LogModel`: weighted normal matrices of all joints, and the most probable parameters.

Joint j has a normal matrix G_j of all that it may feel, and column a of a fit stands at its place
(j, a) in there; places are negative where the joint does not feel it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled
from geodrake.identification.logs.dataset import LEAST_INERTIA
from geodrake.identification.normal_equations import calc_solution

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

RIDGE = 1e-11
_ALIKE = 0.02  # noise is settled if no logarithm of a variance changes by more
_MOST_FITS = 8


@compiled
def add_normal(
    joints: tuple[Array, Indices, Indices], weights: Array, gram: Array, right: Array
) -> None:
    """Add the weighted AᵀA to (n, n), and Aᵀb to (n,).

    `joints` are normal matrices (J, M, M), places (J, n), and where efforts (J,) stand.
    """
    grams, places, efforts = joints
    for j in range(len(grams)):
        own = np.flatnonzero(places[j] >= 0)
        local = places[j][own]
        for i in range(len(own)):
            row, a = grams[j, local[i]], own[i]
            right[a] += weights[j] * row[efforts[j]]
            for k in range(i + 1):
                gram[a, own[k]] += weights[j] * row[local[k]]
                if k < i:
                    gram[own[k], a] += weights[j] * row[local[k]]


@compiled
def calc_squares(joints: tuple[Array, Indices, Indices], x: Array) -> Array:
    """Return sums (J,) of squared residuals with parameters (n,)."""
    grams, places, efforts = joints
    squares = np.empty(len(grams))
    for j in range(len(grams)):
        own = np.flatnonzero(places[j] >= 0)
        local = places[j][own]
        squares[j] = grams[j, efforts[j], efforts[j]]
        for i in range(len(own)):
            row, product = grams[j, local[i]], 0.0
            for k in range(len(own)):
                product += row[local[k]] * x[own[k]]
            squares[j] += (product - 2.0 * row[efforts[j]]) * x[own[i]]
    return squares


@compiled
def calc_most_probable(
    joints: tuple[Array, Indices, Indices],  # as above
    prior: tuple[Array, Array],  # information (n, n), and its product with the mean (n,)
    inertias: Array,  # (J, n) as `Dataset.passive_shares`
    noise: tuple[Array, Array, Array],  # (J,) independent samples over rows, rows, least variance
    variance: Array,  # (J,) to begin with
) -> tuple[Array, Array, tuple[Array, Array, Array, float]]:
    """Return the parameters (n,) and variances (J,), and what they follow from.

    That are weights (J,), the inertias of joints without motors (J,), the normal matrix (n, n) with
    the prior, and the logarithm of its determinant.
    """
    (information, pull), (shares, rows, floor) = prior, noise
    n, count = len(pull), len(rows)
    weights, inertia, passive = np.empty(count), np.ones(count), np.zeros(count, np.bool_)
    for j in range(count):
        passive[j] = np.any(inertias[j] != 0.0)
    x, logarithm, gram = np.zeros(n), 0.0, information.copy()
    for _ in range(_MOST_FITS):
        gram, right = information.copy(), pull.copy()
        for j in range(count):
            weights[j] = shares[j] / max(variance[j], floor[j])
            if passive[j]:
                right += shares[j] * rows[j] / inertia[j] * inertias[j]
        add_normal(joints, weights, gram, right)
        x, logarithm = calc_solution(gram, right, RIDGE)
        before, variance, settled = variance, calc_squares(joints, x) / rows, True
        for j in range(count):
            if passive[j]:
                inertia[j] = max(np.sum(inertias[j] * x), LEAST_INERTIA)
            variance[j] = max(variance[j], floor[j])
            settled = settled and abs(np.log(variance[j] / before[j])) < _ALIKE
        if settled:
            break
    return x, variance, (weights, inertia, gram, logarithm)
