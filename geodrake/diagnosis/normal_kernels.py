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

Packed = tuple[Indices, Indices, Array]
"""Columns that joints feel, ascending, where those of each end, and lower triangles, row by row."""
Normal = tuple[Packed, Array, Array]
"""With these, Aᵀb (J, n) and bᵀb (J,) of all joints."""

RIDGE = 1e-11
_ALIKE = 0.02  # noise is settled if no logarithm of a variance changes by more
_MOST_FITS = 8


@compiled
def calc_packed(grams: Array, places: Indices) -> Packed:
    """Return what normal matrices (J, M, M) hold of columns at places (J, n), close together.

    Fits go through it again and again, and do not have to gather it each time.
    """
    count, size = 0, 0
    for j in range(len(places)):
        felt = np.sum(places[j] >= 0)
        count, size = count + felt, size + felt * (felt + 1) // 2
    columns, ends = np.empty(count, np.intp), np.zeros(len(places) + 1, np.intp)
    lower, at = np.empty(size), 0
    for j in range(len(places)):
        own = np.flatnonzero(places[j] >= 0)
        local = places[j][own]
        ends[j + 1] = ends[j] + len(own)
        columns[ends[j] : ends[j + 1]] = own
        for i in range(len(own)):
            row = grams[j, local[i]]
            for k in range(i + 1):
                lower[at + k] = row[local[k]]
            at += i + 1
    return columns, ends, lower


def packed_of(packed: Packed, joint: int) -> Packed:
    """Return what is there of one joint."""
    columns, ends, lower = packed
    counts = np.diff(ends)
    last = np.cumsum(counts * (counts + 1) // 2)[joint]
    size = counts[joint] * (counts[joint] + 1) // 2
    own = columns[ends[joint] : ends[joint + 1]]
    return own, np.array([0, len(own)], np.intp), lower[last - size : last]


@compiled
def add_normal(packed: Packed, weights: Array, gram: Array) -> None:
    """Add the weighted AᵀA of all joints to a symmetric matrix (n, n)."""
    columns, ends, lower = packed
    at = 0
    for j in range(len(weights)):
        own = columns[ends[j] : ends[j + 1]]
        for i in range(len(own)):
            row = gram[own[i]]
            for k in range(i + 1):
                row[own[k]] += weights[j] * lower[at + k]
            at += i + 1
    for i in range(len(gram)):
        for k in range(i):
            gram[k, i] = gram[i, k]


@compiled
def calc_squares(joints: Normal, x: Array) -> Array:
    """Return sums (J,) of squared residuals with parameters (n,)."""
    (columns, ends, lower), moments, powers = joints
    squares, at = np.empty(len(powers)), 0
    for j in range(len(powers)):
        own = columns[ends[j] : ends[j + 1]]
        squares[j] = powers[j]
        for i in range(len(own)):
            product = 0.0
            for k in range(i):
                product += lower[at + k] * x[own[k]]
            value = x[own[i]]
            product = 2.0 * (product - moments[j, own[i]]) + lower[at + i] * value
            squares[j] += product * value
            at += i + 1
    return squares


@compiled
def calc_most_probable(
    joints: Normal,
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
    packed, moments, _ = joints
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
            for i in range(n):
                right[i] += weights[j] * moments[j, i]
        add_normal(packed, weights, gram)
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
