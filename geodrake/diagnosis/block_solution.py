"""Normal equations of blocks of rows, most of whose unknowns affect a single block.

Such unknowns are eliminated block by block. The rest of the work is that of the shared unknowns.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import inlined

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

Packed = tuple[Indices, Indices, Array]
"""Columns of all blocks, ascending, the end of each block, and lower triangles, row by row."""
Prior = tuple[Array, Array, Indices, Array]
"""Information (r, r) of the first unknowns, which are shared. Of all n unknowns: rows (n, w) of the
others' information, from the first unknown of their term on; that first one; and the product of
information and mean (n,)."""
Structure = tuple[tuple[Indices, Indices, Indices], Indices, Indices]
"""Of unknowns (n,): the only block that they affect, or −1 if they are shared; the place among
those of the block, or the shared ones; and their order by block, shared ones last. Of blocks: the
end (J + 1,) in that order; and a second block (J,) with the same columns, −1 if there is none, and
the block itself if it is the second one."""


def prior_matrix(prior: Prior) -> Array:
    """Return the information (n, n) of a prior."""
    base, own, first, _ = prior
    matrix = np.zeros((len(own), len(own)))
    matrix[: len(base), : len(base)] = base
    rows, offsets = np.nonzero(own)
    matrix[rows, first[rows] + offsets] = own[rows, offsets]
    return matrix


def prior_distance(prior: Prior, deviation: Array) -> float:
    """Return the squared distance of a deviation (n,) from the mean."""
    base, own, first, _ = prior
    width = own.shape[1]
    padded, shared = np.append(deviation, np.zeros(width)), deviation[: len(base)]
    others = np.sum(own * padded[first[:, None] + np.arange(width)], axis=1)
    return float(shared @ base @ shared + deviation @ others)


@inlined
def structure_of(groups: Indices, first_blocks: Indices) -> Structure:
    """Return the structure of unknowns with `groups` (n,), the only block of each, or −1.

    `first_blocks` (J,) is a block with the same columns, or the block itself.
    """
    n, count, shared = len(groups), len(first_blocks), 0
    ends, places, order = np.zeros(count + 1, np.intp), np.empty(n, np.intp), np.empty(n, np.intp)
    second = np.full(count, -1, np.intp)
    for i in range(n):
        if groups[i] < 0:
            places[i], shared = shared, shared + 1
        else:
            places[i] = ends[groups[i] + 1]
            ends[groups[i] + 1] += 1
    for j in range(count):
        ends[j + 1] += ends[j]
        if first_blocks[j] != j:
            second[first_blocks[j]] = second[j] = j
    for i in range(n):
        order[places[i] + ends[count if groups[i] < 0 else groups[i]]] = i
    return (groups, places, order), ends, second


@inlined
def shared_prior(prior: Prior, structure: Structure) -> Array:
    """Return the prior information (S, S) of shared unknowns."""
    (base, own, first, _), ((groups, places, _), ends, _) = prior, structure
    size = len(groups) - ends[len(ends) - 1]
    information = np.zeros((size, size))
    for i in range(len(base)):
        for k in range(len(base)):
            information[i, k] = base[i, k]
    for i in range(len(base), len(groups)):
        if groups[i] < 0:
            for k in range(own.shape[1]):
                if own[i, k] != 0.0:
                    information[places[i], places[first[i]] + k] = own[i, k]
    return information


@inlined
def solve_blocks(
    blocks: tuple[Packed, Array],  # normal matrices, and their weights (J,)
    prior: Prior,
    structure: Structure,
    result: tuple[Array, Array],
    ridge: float,  # relative to the diagonal of A
) -> float:
    """Solve the normal equations A x = b, and return log |A|.

    The `result` is the prior information (S, S) of shared unknowns, which the factor of their
    normal matrix replaces after the others are eliminated; and b (n,), which x replaces.
    """
    ((columns, ends, lower), weights), (gram, x) = blocks, result
    (groups, places, order), group_ends, second = structure
    count, felt_counts = len(weights), np.zeros(len(weights), np.intp)
    starts, widest = _sizes(ends, group_ends)
    # Columns of the factor of each block's own unknowns; places of its shared unknowns.
    factors, felt = np.empty((group_ends[count], widest)), np.empty(len(columns), np.intp)
    matrix, part, slots = np.empty((widest, widest)), np.empty(widest), np.empty(widest, np.intp)
    shared, logarithm = order[group_ends[count] :], 0.0
    diagonal, values = np.empty(len(gram)), np.empty(len(gram))
    for i in range(len(gram)):
        diagonal[i], values[i] = gram[i, i], x[shared[i]]
    for j in range(count):
        if second[j] == j:  # it is added with the first block of its columns
            continue
        own, mine = order[group_ends[j] : group_ends[j + 1]], columns[ends[j] : ends[j + 1]]
        at = _find_shared(mine, (groups, places), len(own), slots, felt[ends[j] :])
        felt_counts[j], size = len(at), len(own) + len(at)
        _set_prior(prior, places, own, matrix[:size])
        for block in (j, second[j]):
            if block >= 0:
                _add(lower[starts[block] : starts[block + 1]], weights[block], slots, matrix)
        for i in range(size):
            if i < len(own):
                part[i] = x[own[i]]
                matrix[i, i] *= 1.0 + ridge
            else:
                part[i] = 0.0
                diagonal[at[i - len(own)]] += matrix[i, i]
        logarithm += _eliminate(matrix, part[:size], factors[group_ends[j] : group_ends[j + 1]])
        for a in range(len(own)):
            x[own[a]] = part[a]
        _add_rest(matrix[len(own) : size, len(own) : size], part[len(own) :], at, (gram, values))
    for i in range(len(gram)):
        gram[i, i] += ridge * diagonal[i]
    logarithm += _solve_dense(gram, values)
    for i in range(len(gram)):
        x[shared[i]] = values[i]
    for j in range(count):
        own, at = order[group_ends[j] : group_ends[j + 1]], felt[ends[j] : ends[j] + felt_counts[j]]
        _substitute_back(factors[group_ends[j] : group_ends[j + 1]], own, (at, values), x)
    return logarithm


@inlined
def _sizes(ends: Indices, group_ends: Indices) -> tuple[Indices, int]:
    """Return the starts (J + 1,) of the packed triangles, and the most unknowns of a block."""
    starts, widest = np.zeros(len(ends), np.intp), 0
    for j in range(len(ends) - 1):
        width = ends[j + 1] - ends[j]
        starts[j + 1] = starts[j] + width * (width + 1) // 2
        widest = max(widest, width + group_ends[j + 1] - group_ends[j])
    return starts, widest


@inlined
def _find_shared(
    columns: Indices,
    unknowns: tuple[Indices, Indices],
    first: int,
    slots: Indices,
    felt: Indices,
) -> Indices:
    """Return the places of shared unknowns of a block, also in `felt`.

    `slots` become the places of all its unknowns in its matrix, where the shared ones begin at
    `first`.
    """
    (groups, places), count = unknowns, 0
    for i in range(len(columns)):
        slots[i] = places[columns[i]]
        if groups[columns[i]] < 0:
            felt[count], slots[i] = slots[i], first + count
            count += 1
    return felt[:count]


@inlined
def _set_prior(prior: Prior, places: Indices, own: Indices, matrix: Array) -> None:
    """Set the lower triangle of a matrix to the prior information of its first unknowns."""
    _, information, first, _ = prior
    for i in range(len(matrix)):
        for k in range(i + 1):
            matrix[i, k] = 0.0
    for i in own:
        for k in range(information.shape[1]):
            if information[i, k] != 0.0 and first[i] + k <= i:
                matrix[places[i], places[first[i] + k]] = information[i, k]


@inlined
def _add(triangle: Array, weight: float, slots: Indices, matrix: Array) -> None:
    """Add a weighted packed triangle to a lower triangle, whose rows are at some slots."""
    at, i = 0, 0
    while at < len(triangle):
        for k in range(i + 1):
            row, column = slots[i], slots[k]
            if row < column:
                row, column = column, row
            matrix[row, column] += weight * triangle[at + k]
        i += 1
        at += i


@inlined
def _eliminate(matrix: Array, x: Array, factors: Array) -> float:
    """Eliminate the first unknowns of a lower triangle and right-hand side x (m,), in place.

    The columns of their factor become rows of `factors`. Return their part of log |A|.
    """
    logarithm = 0.0
    for a in range(len(factors)):
        root, column = np.sqrt(matrix[a, a]), factors[a]
        logarithm += 2.0 * np.log(root)
        x[a] /= root
        for i in range(a, len(x)):
            column[i] = matrix[i, a] / root
        for i in range(a + 1, len(x)):
            x[i] -= column[i] * x[a]
            row = matrix[i]
            for k in range(a + 1, i + 1):
                row[k] -= column[i] * column[k]
    return logarithm


@inlined
def _add_rest(matrix: Array, part: Array, at: Indices, sums: tuple[Array, Array]) -> None:
    """Add a lower triangle and right-hand side of shared unknowns to those of all, in place."""
    gram, values = sums
    for i in range(len(at)):
        values[at[i]] += part[i]
        for k in range(i + 1):
            gram[at[i], at[k]] += matrix[i, k]


@inlined
def _substitute_back(factors: Array, own: Indices, shared: tuple[Indices, Array], x: Array) -> None:
    """Solve for the own unknowns of a block, given its shared ones, in place."""
    at, values = shared
    for a in range(len(own) - 1, -1, -1):
        column, value = factors[a], x[own[a]]
        for i in range(a + 1, len(own)):
            value -= column[i] * x[own[i]]
        for i in range(len(at)):
            value -= column[len(own) + i] * values[at[i]]
        x[own[a]] = value / column[a]


@inlined
def _solve_dense(gram: Array, x: Array) -> float:
    """Replace a lower triangle by its Cholesky factor, and x (m,) by the solution; return log |A|.

    Raises:
        LinAlgError: The matrix is not positive definite.
    """
    logarithm = 0.0
    for i in range(len(gram)):
        for k in range(i):
            gram[k, i] = gram[i, k]
    factor = np.linalg.cholesky(gram)
    for i in range(len(x)):
        row = gram[i]
        for k in range(i + 1):
            row[k] = factor[i, k]
        for k in range(i):
            x[i] -= row[k] * x[k]
        x[i] /= row[i]
        logarithm += 2.0 * np.log(row[i])
    for i in range(len(x) - 1, -1, -1):
        row = gram[i]
        x[i] /= row[i]
        for k in range(i):
            x[k] -= row[k] * x[i]
            gram[k, i] = 0.0
    return logarithm
