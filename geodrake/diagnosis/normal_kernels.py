"""Compiled kernels of `LogModel`: weighted normal matrices and the most probable parameters.

Block j contains rows of one joint. Its normal matrix G_j covers all columns that affect the joint,
and `places` (j, a) is the index in G_j of column a of a fit, negative if the column does not affect
the joint. All G_j are stored one after another.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, inlined
from geodrake.diagnosis.block_solution import (
    Packed,
    Prior,
    shared_prior,
    solve_blocks,
    structure_of,
)
from geodrake.identification.logs.dataset import LEAST_INERTIA

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

Grams = tuple[Array, Indices, Indices]
"""Entries of the normal matrices of all blocks, row by row; the first one and width of each."""
Normal = tuple[Packed, Array, Array]
"""Packed normal matrices, with Aᵀb (J, n) and bᵀb (J,) of all blocks."""

RIDGE = 1e-11
_TOLERANCE = 0.02  # change of the logarithm of a variance at convergence
_MOST_FITS = 8
# Three deviations of the change in the sum of squares, over √K, of K rows of unit white noise,
# filtered by `design_filter`, if they are shifted by half a period.
_MOST_NOISE = 1.07
_LEAST_BARRIER = 0.05  # weight of log det at the end of a path, whose error is four times that
_NEAR = 0.3  # Newton decrement below which the barrier is reduced
_MOST_STEPS, _MOST_BARRIERS, _MOST_HALVINGS = 30, 20, 60
_ROUNDING = 1e-12  # least pivot of a pseudo-inertia over its trace; least step
_LATE_ROW = 0.1  # of a period, by which the instants of consecutive rows may be off


@compiled
def calc_packed(grams: Grams, places: Indices, known: Packed) -> Packed:
    """Gather the normal-matrix entries of columns at places (J, n) into contiguous storage.

    Repeated fits then avoid the gather. Entries of the first columns, which many fits share, are
    copied from `known`.
    """
    (entries, starts, widths), (_, known_ends, known_lower) = grams, known
    count, size = 0, 0
    for j in range(len(places)):
        affected = 0
        for k in range(places.shape[1]):
            affected += places[j, k] >= 0
        count, size = count + affected, size + affected * (affected + 1) // 2
    columns, ends = np.empty(count, np.intp), np.zeros(len(places) + 1, np.intp)
    lower, at, known_at = np.empty(size), 0, 0
    for j in range(len(places)):
        end = ends[j]
        for k in range(places.shape[1]):
            if places[j, k] >= 0:
                columns[end] = k
                end += 1
        ends[j + 1] = end
        first = known_ends[j + 1] - known_ends[j]
        shared = first * (first + 1) // 2
        for k in range(shared):
            lower[at + k] = known_lower[known_at + k]
        at, known_at = at + shared, known_at + shared
        for i in range(ends[j] + first, end):
            row = starts[j] + widths[j] * places[j, columns[i]]
            for k in range(ends[j], i + 1):
                lower[at + k - ends[j]] = entries[row + places[j, columns[k]]]
            at += i + 1 - ends[j]
    return columns, ends, lower


def empty_packed(blocks: int) -> Packed:
    """Return packed normal matrices without columns."""
    return np.empty(0, np.intp), np.zeros(blocks + 1, np.intp), np.empty(0)


def packed_blocks(packed: Packed, blocks: Indices) -> Packed:
    """Return the packed normal matrices of some blocks."""
    columns, ends, lower = packed
    counts = np.diff(ends)
    sizes = np.concatenate([[0], np.cumsum(counts * (counts + 1) // 2)])
    parts = [columns[ends[k] : ends[k + 1]] for k in blocks]
    return (
        np.concatenate(parts),
        np.cumsum([0, *map(len, parts)]),
        np.concatenate([lower[sizes[k] : sizes[k + 1]] for k in blocks]),
    )


@compiled
def add_normal(packed: Packed, weights: Array, gram: Array) -> None:
    """Add the weighted AᵀA of all blocks to a symmetric matrix (n, n)."""
    columns, ends, lower = packed
    at = 0
    for j in range(len(weights)):
        indices = columns[ends[j] : ends[j + 1]]
        for i in range(len(indices)):
            row = gram[indices[i]]
            for k in range(i + 1):
                row[indices[k]] += weights[j] * lower[at + k]
            at += i + 1
    for i in range(len(gram)):
        for k in range(i):
            gram[k, i] = gram[i, k]


@compiled
def calc_squares(joints: Normal, x: Array) -> Array:
    """Return the sums (J,) of squared residuals with parameters (n,)."""
    (columns, ends, lower), moments, powers = joints
    squares, at = np.empty(len(powers)), 0
    for j in range(len(powers)):
        indices = columns[ends[j] : ends[j + 1]]
        values = x[indices]
        squares[j] = powers[j]
        for i in range(len(indices)):
            product = lower[at : at + i] @ values[:i]
            product = 2.0 * (product - moments[j, indices[i]]) + lower[at + i] * values[i]
            squares[j] += product * values[i]
            at += i + 1
    return squares


@compiled
def calc_most_probable(
    blocks: Normal,
    prior: Prior,
    noise: tuple[Array, Array, Array],  # (J,) independent samples, rows, least variance
    # (J, n) `Dataset.passive_shares`; (J,) a block with no more noise and the same columns, or the
    # block itself; (n,) the only such block that an unknown affects, or −1
    joints: tuple[Array, Indices, Indices],
    variance: Array,  # (J,) initial variances
) -> tuple[Array, Array, tuple[Array, Array, Array, float]]:
    """Return the parameters (n,), variances (J,), and the intermediate results.

    These are weights (J,), inertias of joints without motors (J,), the Cholesky factor (S, S) of
    the normal matrix of shared unknowns without the others, and the log-determinant of all.
    """
    (samples, rows, floor), (inertias, quieter, groups) = noise, joints
    (packed, moments, _), n, count = blocks, len(groups), len(rows)
    weights, inertia, passive = np.empty(count), np.ones(count), np.zeros(count, np.bool_)
    for j in range(count):
        for i in range(n):
            passive[j] |= inertias[j, i] != 0.0
    structure, logarithm = structure_of(groups, quieter), 0.0
    known, x = shared_prior(prior, structure), np.zeros(n)
    factor = known
    for _ in range(_MOST_FITS):
        factor, x = known.copy(), prior[3].copy()
        for j in range(count):
            weights[j] = samples[j] / rows[j] / max(variance[j], floor[j])
            for i in range(n):
                x[i] += weights[j] * moments[j, i]
                if passive[j]:
                    x[i] += samples[j] / inertia[j] * inertias[j, i]
        logarithm = solve_blocks((packed, weights), prior, structure, (factor, x), RIDGE)
        squares, before, settled = calc_squares(blocks, x), variance, True
        variance = np.empty(count)
        for j in range(count):
            i, variance[j] = quieter[j], squares[j] / rows[j]
            if variance[j] < variance[i]:
                variance[i] = variance[j] = (squares[i] + squares[j]) / (rows[i] + rows[j])
        for j in range(count):
            if passive[j]:
                inertia[j] = max(inertias[j] @ x, LEAST_INERTIA)
            variance[j] = max(variance[j], floor[j])
            settled = settled and abs(np.log(variance[j] / before[j])) < _TOLERANCE
        if settled:
            break
    return x, variance, (weights, inertia, factor, logarithm)


@inlined
def _solve_positive(gram: Array, x: Array) -> tuple[float, float]:
    """Replace x (n,) by G⁻¹x, and the lower triangle of G (n, n) by its Cholesky factor.

    Return xᵀG⁻¹x and log |G|; the latter is NaN if G is not positive definite.
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
def _is_infeasible(x: Array, owner: Indices, positive: NDArray[np.bool_]) -> bool:
    """Return whether all positive parameters of some term are negative."""
    for a in range(len(x)):
        is_feasible = not positive[a]
        for b in range(len(x)):
            is_feasible = is_feasible or (positive[b] and owner[b] == owner[a] and x[b] > 0.0)
        if not is_feasible:
            return True
    return False


@compiled
def calc_products(grams: Grams, weights: Array, places: tuple[Indices, Indices]) -> Array:
    """Return the weighted products (n, m) of columns at places (J, n) with others at (J, m)."""
    (entries, starts, widths), (ones, others) = grams, places
    products = np.zeros((ones.shape[1], others.shape[1]))
    felt = np.empty(others.shape[1], np.intp)
    for j in range(len(weights)):
        count = 0
        for b in range(others.shape[1]):
            if others[j, b] >= 0:
                felt[count] = b
                count += 1
        for a in range(ones.shape[1]):
            if ones[j, a] >= 0:
                row, total = starts[j] + widths[j] * ones[j, a], products[a]
                for k in range(count):
                    total[felt[k]] += weights[j] * entries[row + others[j, felt[k]]]
    return products


Schur = tuple[Array, tuple[Grams, Array, Indices], Array]
"""Schur complement (D, D) of distinct columns beside a fit, zero where not computed yet; its normal
matrices, weights (J,) and places (J, D); and rows (D, n), whose products are subtracted."""


@inlined
def _schur_complement(schur: Schur, a: int, b: int) -> float:
    known, ((entries, starts, widths), weights, places), rows = schur
    if known[a, b] == 0.0:
        total = 0.0
        for j in range(len(weights)):
            if places[j, a] >= 0 and places[j, b] >= 0:
                entry = starts[j] + widths[j] * places[j, a] + places[j, b]
                total += weights[j] * entries[entry]
        known[a, b] = known[b, a] = total - rows[a] @ rows[b]
    return known[a, b]


@compiled
def calc_gains(
    schur: Schur,
    scores_of: tuple[Array, Array],  # pull (P,) of all columns, and prior scores (P,)
    # (P,) whether a column is positive; (T,) first column, end and only joint of each term, or −1
    of_terms: tuple[NDArray[np.bool_], tuple[Indices, Indices, Indices]],
    # (P,) index of its distinct column; (P, w) its information, from its term's first column on;
    # (i, D) rows of dropped parameters, (i, i) inverse, (i,) values; i may be 0
    priors: tuple[tuple[Indices, Array], tuple[Array, Array, Array]],
    packages: tuple[Indices, Indices],  # terms of all packages, and the end of each
) -> tuple[Array, Array, Indices]:
    """Return of each package its gain in score without prior odds, xᵀG⁻¹x, and its only joint.

    xᵀG⁻¹x is the reduction of the weighted squared errors. A gain is −∞ if all positive parameters
    of a term would be negative, and a joint is −1 if several are affected.
    """
    (pull, scores), (positive, spans), (terms, ends) = scores_of, of_terms, packages
    (same_as, information), (rows, inverse, values) = priors
    starts, stops, joint_of = spans
    dropped = len(values)
    scaled_rows, shift = inverse @ rows, inverse @ values
    gains, squares = np.full(len(ends) - 1, -np.inf), np.zeros(len(ends) - 1)
    joints = np.full(len(gains), -1)
    for p in range(len(gains)):
        package, size, count = terms[ends[p] : ends[p + 1]], 0, 0
        for t in package:
            size += stops[t] - starts[t]
        at, owner = np.empty(size, np.intp), np.empty(size, np.intp)
        joints[p] = joint_of[package[0]]
        for t in package:
            joints[p] = joints[p] if joint_of[t] == joints[p] else -1
            for column in range(starts[t], stops[t]):
                at[count], owner[count] = column, t
                count += 1
        gram, x, prior = np.empty((len(at), len(at))), pull[at], 0.0
        same, first = same_as[at], 0
        for a in range(len(at)):
            prior += scores[at[a]]
            if owner[a] != owner[first]:
                first = a
            for i in range(dropped):
                x[a] += rows[i, same[a]] * shift[i]
            for b in range(a + 1):
                gram[a, b] = _schur_complement(schur, same[a], same[b])
                if b >= first:
                    gram[a, b] += information[at[a], b - first]
                for i in range(dropped):
                    gram[a, b] += rows[i, same[a]] * scaled_rows[i, same[b]]
        square, logarithm = _solve_positive(gram, x)
        if not np.isnan(logarithm) and not _is_infeasible(x, owner, positive[at]):
            gains[p], squares[p] = square - logarithm + prior, square
    return gains, squares, joints


@compiled
def calc_noise_changes(
    signals: tuple[Array, Array, Array, Array],
    rows: Indices,
    current: int,
    lags: Array,
    period: float,
) -> Array:
    """Return (d,) the part of each fall in squared errors due to noise at other instants; ≤ 0.

    Signals are instants (K,), s, predictions (K,), efforts (K, d) at each lag (d,), s, relative to
    column `current`, and squared errors (K, d). Only `rows` count; `period` is the typical time
    between them, s. For equal noise, the efforts of the current column are compared with
    predictions that are earlier by the lag, interpolated between four consecutive rows.
    """
    (time, predicted, efforts, squares), changes, bound = signals, np.zeros(len(lags)), 0.0
    for i in rows:
        bound += _MOST_NOISE * squares[i, current] / np.sqrt(len(rows))
    for d in range(len(lags)):
        if lags[d] == 0.0:
            continue
        count, change, all_rows = 0, 0.0, 0.0
        for i in rows:
            all_rows += squares[i, d] - squares[i, current]
            own_period = time[i] - time[i - 1] if i > 0 else 0.0
            if own_period <= 0.0:  # the next stretch
                continue
            steps = int(np.floor(lags[d] / own_period))
            first, x = i - steps - 2, 1.0 + steps - lags[d] / own_period
            if first < 0 or first + 3 >= len(time):
                continue
            low, high = min(first, i - 1), max(first + 3, i)
            if abs(time[high] - time[low] - (high - low) * own_period) > _LATE_ROW * own_period:
                continue
            p, q, r, s = predicted[first : first + 4]
            inner = (x - 2.0) * ((x + 1.0) * (x - 1.0) * q - (x + 1.0) * x * r) / 2.0
            shifted = inner + x * (x - 1.0) * ((x + 1.0) * s - (x - 2.0) * p) / 6.0
            change += (efforts[i, current] - shifted) ** 2 - squares[i, current]
            count += 1
        if count:
            limit = bound * abs(np.sin(np.pi * lags[d] / period))
            changes[d] = min(max(all_rows - change * len(rows) / count, -limit), 0.0)
    return changes


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


@inlined
def _write_pseudo_inertia(x: Array, basis: Array, out: Array) -> Array:
    """Write and return the pseudo-inertia (4, 4), parameters (10,) times a basis (10, 4, 4)."""
    for i in range(4):
        for j in range(4):
            out[i, j] = 0.0
            for a in range(len(x)):
                out[i, j] += x[a] * basis[a, i, j]
    return out


@compiled
def calc_physical_share(parameters: Array, basis: Array) -> float:
    """Return the share of parameters (N, 10) of physical bodies, with a basis (10, 4, 4)."""
    physical, matrix = 0, np.empty((4, 4))
    for n in range(len(parameters)):
        physical += _is_body(_write_pseudo_inertia(parameters[n], basis, matrix))
    return physical / len(parameters)


@inlined
def _whiten(root: Array, matrix: Array) -> None:
    """Replace a symmetric matrix A (4, 4) by L⁻¹ A L⁻ᵀ, with the lower triangle L of `root`."""
    for _ in range(2):  # L⁻¹ A, transposed, and once more
        for c in range(4):
            for i in range(4):
                for k in range(i):
                    matrix[i, c] -= root[i, k] * matrix[k, c]
                matrix[i, c] /= root[i, i]
        for i in range(4):
            for k in range(i):
                matrix[i, k], matrix[k, i] = matrix[k, i], matrix[i, k]


@inlined
def _squared_distance(x: Array, y: Array, metric: Array) -> float:
    total = 0.0
    for a in range(len(x)):
        for b in range(len(x)):
            total += (x[a] - y[a]) * metric[a, b] * (x[b] - y[b])
    return total


@compiled
def calc_distance(mean: Array, inside: Array, precision: Array, basis: Array) -> float:
    """Return the squared distance from parameters (10,) to the nearest physical body.

    The metric is a precision (10, 10). Newton's method follows the central path of log det from
    parameters `inside` (10,) of a physical body, to within some tenths; the distance of `inside` is
    the upper bound. Parameters times a basis (10, 4, 4) are pseudo-inertias.
    """
    x, farthest = inside.copy(), _squared_distance(inside, mean, precision)
    barrier, matrix = max(farthest, _LEAST_BARRIER), np.empty((4, 4))
    step, trial = np.empty(len(x)), np.empty(len(x))
    if not _is_body(_write_pseudo_inertia(x, basis, matrix)):
        return farthest
    for _ in range(_MOST_BARRIERS):
        for _ in range(_MOST_STEPS):
            decrement = calc_newton_step(x, (mean, precision, basis, barrier), step)
            share, change = 1.0 / (1.0 + decrement), 0.0
            for _ in range(_MOST_HALVINGS):
                for a in range(len(x)):
                    trial[a] = x[a] + share * step[a]
                if _is_body(_write_pseudo_inertia(trial, basis, matrix)):
                    x, trial = trial, x
                    break
                share *= 0.5
            _write_pseudo_inertia(step, basis, matrix)
            for i in range(16):
                change = max(change, share * abs(matrix[i // 4, i % 4]))
            if decrement < _NEAR or change < _ROUNDING:
                break
        if barrier <= _LEAST_BARRIER:
            break
        barrier = max(0.1 * barrier, _LEAST_BARRIER)
    return min(_squared_distance(x, mean, precision), farthest)


@compiled
def calc_newton_step(x: Array, problem: tuple[Array, Array, Array, float], step: Array) -> float:
    """Write the Newton step (10,) of `calc_distance`, and return the decrement.

    The problem is the mean, the precision, the basis and the weight of log det.
    """
    (mean, precision, basis, barrier), root, gram = problem, np.empty((4, 4)), np.empty((10, 10))
    white = basis.copy()
    _solve_positive(_write_pseudo_inertia(x, basis, root), np.zeros(4))
    for a in range(len(x)):
        _whiten(root, white[a])
        step[a] = barrier * np.trace(white[a])
        for b in range(len(x)):
            step[a] -= precision[a, b] * (x[b] - mean[b])
        for b in range(a + 1):
            gram[a, b] = precision[a, b]
            for i in range(4):
                for j in range(4):
                    gram[a, b] += barrier * white[a, i, j] * white[b, i, j]
    return float(np.sqrt(_solve_positive(gram, step)[0] / barrier))
