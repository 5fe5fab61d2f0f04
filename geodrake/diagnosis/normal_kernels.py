"""Kernels of `LogModel`: weighted normal matrices of all joints, and the most probable parameters.

Block j, rows of one joint, has a normal matrix G_j of all that the joint may feel, and column a of
a fit stands at its place (j, a) in there; places are negative where the joint does not feel it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, inlined
from geodrake.identification.logs.dataset import LEAST_INERTIA
from geodrake.identification.normal_equations import calc_solution

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

Packed = tuple[Indices, Indices, Array]
"""Columns that blocks feel, ascending, where those of each end, and lower triangles, row by row."""
Normal = tuple[Packed, Array, Array]
"""With these, Aᵀb (J, n) and bᵀb (J,) of all joints."""

RIDGE = 1e-11
_ALIKE = 0.02  # noise is settled if no logarithm of a variance changes by more
_MOST_FITS = 8
# Three deviations of how much the sum of squares of K rows of white noise, of unit variance and as
# `design_filter` filters them, changes over √K if they are half of a period later.
_MOST_NOISE = 1.07
_LEAST_BARRIER = 0.05  # weight of log det at the end of a path, which is off by its fourfold
_NEAR = 0.3  # Newton decrement below which the next barrier follows
_MOST_STEPS, _MOST_BARRIERS, _MOST_HALVINGS = 30, 20, 60
_ROUNDING = 1e-12  # least pivot of a pseudo-inertia over its trace; least step of one
_LATE_ROW = 0.1  # of a period: rows that are farther apart are not consecutive


@compiled
def calc_packed(grams: Array, places: Indices, known: Packed) -> Packed:
    """Return what normal matrices (J, M, M) hold of columns at places (J, n), close together.

    Fits go through it again and again, and do not have to gather it each time; nor do they gather
    what is `known` of their first columns, which many of them share.
    """
    _, known_ends, known_lower = known
    count, size = 0, 0
    for j in range(len(places)):
        felt = np.sum(places[j] >= 0)
        count, size = count + felt, size + felt * (felt + 1) // 2
    columns, ends = np.empty(count, np.intp), np.zeros(len(places) + 1, np.intp)
    lower, at, known_at = np.empty(size), 0, 0
    for j in range(len(places)):
        own = np.flatnonzero(places[j] >= 0)
        local = places[j][own]
        ends[j + 1] = ends[j] + len(own)
        columns[ends[j] : ends[j + 1]] = own
        first = known_ends[j + 1] - known_ends[j]
        same = first * (first + 1) // 2
        lower[at : at + same] = known_lower[known_at : known_at + same]
        at, known_at = at + same, known_at + same
        for i in range(first, len(own)):
            row = grams[j, local[i]]
            for k in range(i + 1):
                lower[at + k] = row[local[k]]
            at += i + 1
    return columns, ends, lower


def nothing_packed(blocks: int) -> Packed:
    """Return what is there of no column."""
    return np.empty(0, np.intp), np.zeros(blocks + 1, np.intp), np.empty(0)


def packed_of(packed: Packed, blocks: Indices) -> Packed:
    """Return what is there of some blocks."""
    columns, ends, lower = packed
    counts = np.diff(ends)
    sizes = np.concatenate([[0], np.cumsum(counts * (counts + 1) // 2)])
    own = [columns[ends[k] : ends[k + 1]] for k in blocks]
    return (
        np.concatenate(own),
        np.cumsum([0, *map(len, own)]),
        np.concatenate([lower[sizes[k] : sizes[k + 1]] for k in blocks]),
    )


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
        values = x[own]
        squares[j] = powers[j]
        for i in range(len(own)):
            product = lower[at : at + i] @ values[:i]
            product = 2.0 * (product - moments[j, own[i]]) + lower[at + i] * values[i]
            squares[j] += product * values[i]
            at += i + 1
    return squares


@compiled
def calc_most_probable(
    blocks: Normal,
    prior: tuple[Array, Array],  # information (n, n), and its product with the mean (n,)
    noise: tuple[Array, Array, Array],  # (J,) independent samples, rows, least variance
    # (J, n) as `Dataset.passive_shares`; (J,) a block that has no more noise, or the block itself;
    # (n,) groups as of `calc_solution`
    joints: tuple[Array, Indices, Indices],
    variance: Array,  # (J,) to begin with
) -> tuple[Array, Array, tuple[Array, Array, Array, Array, float]]:
    """Return the parameters (n,) and variances (J,), and what they follow from.

    That are weights (J,), the inertias of joints without motors (J,), the normal matrix (n, n) with
    the prior, its Cholesky factor, shared parameters last, and the logarithm of its determinant.
    """
    (information, pull), (samples, rows, floor) = prior, noise
    (inertias, quieter, groups), (packed, moments, _) = joints, blocks
    n, count = len(pull), len(rows)
    weights, inertia, passive = np.empty(count), np.ones(count), np.zeros(count, np.bool_)
    for j in range(count):
        passive[j] = np.any(inertias[j] != 0.0)
    x, logarithm, gram, factor = np.zeros(n), 0.0, information.copy(), information
    for _ in range(_MOST_FITS):
        gram, right = information.copy(), pull.copy()
        for j in range(count):
            weights[j] = samples[j] / rows[j] / max(variance[j], floor[j])
            if passive[j]:
                right += samples[j] / inertia[j] * inertias[j]
            for i in range(n):
                right[i] += weights[j] * moments[j, i]
        add_normal(packed, weights, gram)
        x, logarithm, factor = calc_solution(gram, right, RIDGE, groups)
        squares, before, settled = calc_squares(blocks, x), variance, True
        variance = squares / rows
        for j in range(count):
            i = quieter[j]
            if variance[j] < variance[i]:
                variance[i] = variance[j] = (squares[i] + squares[j]) / (rows[i] + rows[j])
        for j in range(count):
            if passive[j]:
                inertia[j] = max(np.sum(inertias[j] * x), LEAST_INERTIA)
            variance[j] = max(variance[j], floor[j])
            settled = settled and abs(np.log(variance[j] / before[j])) < _ALIKE
        if settled:
            break
    return x, variance, (weights, inertia, gram, factor, logarithm)


@inlined
def _solve_positive(gram: Array, x: Array) -> tuple[float, float]:
    """Replace x (n,) by G⁻¹x, and the lower triangle of G (n, n) by its Cholesky factor.

    Return xᵀG⁻¹x and log |G|; a determinant that is not positive has none.
    """
    n, square, logarithm = len(x), 0.0, 0.0
    for a in range(n):
        for b in range(a + 1):
            for k in range(b):
                gram[a, b] -= gram[a, k] * gram[b, k]
            if b < a:
                gram[a, b] /= gram[b, b]
        if gram[a, a] <= 0.0:
            return square, np.nan
        gram[a, a] = np.sqrt(gram[a, a])
        for k in range(a):
            x[a] -= gram[a, k] * x[k]
        x[a] /= gram[a, a]
        square, logarithm = square + x[a] * x[a], logarithm + 2.0 * np.log(gram[a, a])
    for a in range(n - 1, -1, -1):
        for k in range(a + 1, n):
            x[a] -= gram[k, a] * x[k]
        x[a] /= gram[a, a]
    return square, logarithm


@inlined
def _has_nothing(x: Array, owner: Indices, positive: NDArray[np.bool_]) -> bool:
    """Return whether all that must be positive of some term is not."""
    for a in range(len(x)):
        left = not positive[a]
        for b in range(len(x)):
            left = left or (positive[b] and owner[b] == owner[a] and x[b] > 0.0)
        if not left:
            return True
    return False


@compiled
def calc_products(grams: Array, weights: Array, places: tuple[Indices, Indices]) -> Array:
    """Return the weighted products (n, m) of columns at places (J, n) with others at (J, m)."""
    ones, others = places
    products = np.zeros((ones.shape[1], others.shape[1]))
    for j in range(len(grams)):
        felt = np.flatnonzero(others[j] >= 0)
        local = others[j][felt]
        for a in np.flatnonzero(ones[j] >= 0):
            row, total = grams[j, ones[j, a]], products[a]
            for k in range(len(felt)):
                total[felt[k]] += weights[j] * row[local[k]]
    return products


Beside = tuple[Array, tuple[Array, Array, Indices], Array]
"""Schur complement (D, D) of distinct columns beside a fit, NaN where nobody asked for it yet; the
normal matrices, weights (J,) and places (J, D) that it is of; and rows (D, n) whose products are
what the fit takes away."""


@inlined
def _schur_complement(beside: Beside, a: int, b: int) -> float:
    known, (grams, weights, places), rows = beside
    if np.isnan(known[a, b]):
        total = 0.0
        for j in range(len(weights)):
            if places[j, a] >= 0 and places[j, b] >= 0:
                total += weights[j] * grams[j, places[j, a], places[j, b]]
        known[a, b] = known[b, a] = total - rows[a] @ rows[b]
    return known[a, b]


@compiled
def calc_gains(
    beside: Beside,
    around: tuple[Array, Array],  # the pull (P,) of all columns, and prior scores (P,)
    owners: tuple[Indices, NDArray[np.bool_]],  # (P,) term of each column; what must be positive
    # (P,) which distinct column each is; (P, w) its information, from its term's first column on;
    # (i, D) rows of what is dropped, (i, i) inverse, (i,) values; i may be 0
    priors: tuple[tuple[Indices, Array], tuple[Array, Array, Array]],
    packages: tuple[Indices, Indices],  # columns of all packages, and where those of each end
) -> tuple[Array, Array]:
    """Return what each package of columns adds to the score of a fit, without prior odds.

    It is −∞ where a term has nothing left that is positive as it must be. Returned with it is by
    how much weighted squared errors fall.
    """
    (pull, scores), (owner, positive), (columns, ends) = around, owners, packages
    (same_as, information), (rows, inverse, values) = priors
    gone = len(values)
    turned, shift = inverse @ rows, inverse @ values
    gains, squares = np.full(len(ends) - 1, -np.inf), np.zeros(len(ends) - 1)
    for p in range(len(gains)):
        at = columns[ends[p] : ends[p + 1]]
        gram, x, prior = np.empty((len(at), len(at))), pull[at], 0.0
        same, first = same_as[at], 0
        for a in range(len(at)):
            prior += scores[at[a]]
            if owner[at[a]] != owner[at[first]]:
                first = a
            for i in range(gone):
                x[a] += rows[i, same[a]] * shift[i]
            for b in range(a + 1):
                gram[a, b] = _schur_complement(beside, same[a], same[b])
                if b >= first:
                    gram[a, b] += information[at[a], b - first]
                for i in range(gone):
                    gram[a, b] += rows[i, same[a]] * turned[i, same[b]]
        square, logarithm = _solve_positive(gram, x)
        if not np.isnan(logarithm) and not _has_nothing(x, owner[at], positive[at]):
            gains[p], squares[p] = square - logarithm + prior, square
    return gains, squares


@compiled
def calc_noise_changes(
    signals: tuple[Array, Array, Array, NDArray[np.bool_]], own: int, lags: Array
) -> Array:
    """Return (d,) how much of a fall in squared errors is due to noise at other instants; ≤ 0.

    Rows are at instants (K,), s, with predictions (K,), efforts (K, d), each later by a lag (d,),
    s, than those in column `own`, and whether they count (K,). To keep the noise the same, those
    efforts are compared with predictions that are earlier by the lag, interpolated between four
    consecutive rows.
    """
    time, predicted, efforts, counted = signals
    found, errors = np.zeros(len(lags)), np.square(efforts[:, own] - predicted)
    rows = np.flatnonzero(counted)
    usual = np.median(np.diff(time))
    most = _MOST_NOISE * np.sqrt(len(rows)) * np.mean(errors[rows])
    for d in range(len(lags)):
        if lags[d] == 0.0:
            continue
        seen, change = 0, 0.0
        for i in rows:
            if i == 0:
                continue
            period = time[i] - time[i - 1]
            if period <= 0.0:  # another stretch
                continue
            steps = int(np.floor(lags[d] / period))
            first, x = i - steps - 2, 1.0 + steps - lags[d] / period
            if first < 0 or first + 3 >= len(time):
                continue
            low, high = min(first, i - 1), max(first + 3, i)
            if abs(time[high] - time[low] - (high - low) * period) > _LATE_ROW * period:
                continue
            p, q, r, s = predicted[first : first + 4]
            inner = (x - 2.0) * ((x + 1.0) * (x - 1.0) * q - (x + 1.0) * x * r) / 2.0
            moved = inner + x * (x - 1.0) * ((x + 1.0) * s - (x - 2.0) * p) / 6.0
            change += (efforts[i, own] - moved) ** 2 - errors[i]
            seen += 1
        if seen:
            all_rows = np.sum((np.square(efforts[:, d] - predicted) - errors)[rows])
            limit = most * abs(np.sin(np.pi * lags[d] / usual))
            found[d] = min(max(all_rows - change * len(rows) / seen, -limit), 0.0)
    return found


@inlined
def _is_body(matrix: Array) -> bool:
    """Return whether a pseudo-inertia (4, 4) is positive definite beyond rounding; overwrite it."""
    least = max(_ROUNDING * np.trace(matrix), 0.0)
    for k in range(4):
        if not matrix[k, k] > least:  # or it is NaN
            return False
        for i in range(k + 1, 4):
            share = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, 4):
                matrix[i, j] -= share * matrix[k, j]
    return True


@compiled
def calc_physical_share(parameters: Array, basis: Array) -> float:
    """Return the share of parameters (N, 10) with which bodies can exist.

    Parameters times a basis (10, 16) are pseudo-inertias.
    """
    physical = 0
    for n in range(len(parameters)):
        physical += _is_body((parameters[n] @ basis).reshape(4, 4))
    return physical / len(parameters)


@compiled
def calc_distance(mean: Array, inside: Array, precision: Array, basis: Array) -> float:
    """Return the squared distance from parameters (10,) to the nearest body that can exist.

    Distances are by a precision (10, 10). Newton's method follows the central path of log det, from
    parameters `inside` (10,) of a body, to within some tenths; their own distance is the largest
    that is returned. Parameters times a basis (10, 4, 4) are pseudo-inertias.
    """
    x, way = inside.copy(), inside - mean
    farthest = float(way @ (precision @ way))
    flat, barrier = basis.copy().reshape(len(x), -1), max(farthest, _LEAST_BARRIER)
    if not _is_body((x @ flat).reshape(4, 4)):
        return farthest
    for _ in range(_MOST_BARRIERS):
        for _ in range(_MOST_STEPS):
            inverse = np.linalg.inv((x @ flat).reshape(4, 4))
            turned = np.empty_like(flat)
            for a in range(len(x)):
                turned[a] = (inverse @ basis[a] @ inverse).copy().reshape(-1)
            slope = precision @ (x - mean) - barrier * (flat @ inverse.copy().reshape(-1))
            step = -np.linalg.solve(precision + barrier * (turned @ flat.T), slope)
            decrement = np.sqrt(max(-float(slope @ step) / barrier, 0.0))
            step /= 1.0 + decrement
            for _ in range(_MOST_HALVINGS):
                if _is_body(((x + step) @ flat).reshape(4, 4)):
                    x += step
                    break
                step *= 0.5
            if decrement < _NEAR or np.abs(step @ flat).max() < _ROUNDING:
                break
        if barrier <= _LEAST_BARRIER:
            break
        barrier = max(0.1 * barrier, _LEAST_BARRIER)
    way = x - mean
    return min(float(way @ (precision @ way)), farthest)
