"""Fast Bregman projections of estimates onto slabs, compiled for robots.

    ∇h(y) = ∇h(x) + Aᵀ λ,   λᵢ > 0 only where aᵢᵀ y = lowerᵢ,   λᵢ < 0 only where aᵢᵀ y = upperᵢ

([Lee2019] Eq. (2.2.11)). The multipliers maximize the concave dual, with gradient lower − A y or
upper − A y and Hessian −A g(y)⁻¹ Aᵀ, by Newton's method on the active rows: a few unknowns for any
number of parameters. Every step starts from the last point and its metric, so that distances of
many orders of magnitude do not cost precision.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geodrake.compiling import compiled, contiguous
from geodrake.errors import GeodrakeError
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.manifolds.base import Array
from geodrake.manifolds.product import Product
from geodrake.manifolds.projections import Polyhedron, bregman_projection
from geodrake.manifolds.robot_kernels import (
    Factors,
    Places,
    calc_spanned,
    calc_whitened,
    put_body_root,
    put_congruence,
    put_dual,
)

_NEAR = 0.25  # length of a Newton step in the metric that needs no line search
_OVERSHOT = 0.1  # acceptable negative slope after a full step, relative to the initial slope
_SLIGHT = 1e-13  # relative ridge of a row's squared length, for dependent rows
_NOTHING = 1e-300  # squared length of a zero row
_ROUNDING = 4e-16  # rounding error of a row's value, relative to its terms
_MOST_STEPS = 40  # Newton steps

TOLERANCE = 1e-8
"""Certified error of the optimality conditions of a projection, in lengths of the metric."""

_SOUGHT = 0.1 * TOLERANCE


@compiled
def calc_slab_projection(
    x: Array,
    slabs: tuple[Array, Array, Array],
    factors: Factors,
    options: tuple[float, float],
    y: Array,
) -> tuple[float, int]:
    """Write the projection, or a point on the way there.

    Args:
        x: (n,) point inside of the manifold.
        slabs: Rows A (k, n), and their lower and upper limits (k,).
        options: Smallest weight of a factor, at most 1, and `share` of `slab_projection`.
        y: (n,) the projection.

    Returns:
        The error of the optimality conditions in lengths of the metric at y, and the number of
        steps. The error is infinite without convergence, for instance if no point is in all slabs.
    """
    multipliers = np.zeros(len(slabs[0]))
    error, steps = calc_whole_projection(x, slabs, factors, options[0], (y, multipliers))
    if options[1] < 1.0 and steps > 0 and error <= TOLERANCE:
        roots, whitened = np.empty((len(factors[0]), 4, 4)), np.empty(slabs[0].shape)
        calc_whitened(x, slabs[0], factors, roots, whitened)
        calc_spanned(x, (roots, whitened), options[1] * multipliers, factors, y)
    return error, steps


@compiled
def calc_whole_projection(
    x: Array,
    slabs: tuple[Array, Array, Array],
    factors: Factors,
    weight: float,
    out: tuple[Array, Array],
) -> tuple[float, int]:
    """Write the projection y (n,) and its multipliers λ (k,), initially zero."""
    (rows, lower, upper), (y, multipliers) = slabs, out
    k, n = rows.shape
    roots, trial = np.empty((len(factors[0]), 4, 4)), np.empty(n)
    gaps, over, sizes = np.empty(k), np.empty(k), np.abs(rows)
    put_scaled(1.0, x, y)
    for step in range(_MOST_STEPS + 1):
        if not put_gaps(slabs, sizes, out, gaps, over):
            return np.inf, step
        # Rows inside their limits with zero multipliers are inactive.
        active = np.flatnonzero((gaps != 0.0) | (multipliers != 0.0))
        if not len(active):
            return (calc_stationarity((x, y), (rows, multipliers), factors) if step else 0.0), step
        A, pushed, low, high = rows[active], multipliers[active], lower[active], upper[active]
        whitened, d, part = np.empty((len(active), n)), np.empty(len(active)), np.empty(len(active))
        calc_whitened(y, A, factors, roots, whitened)
        products = np.dot(whitened, whitened.T)
        error = calc_greatest(over[active], products)
        if error <= _SOUGHT and step:
            return max(error, calc_stationarity((x, y), (A, pushed), factors)), step
        if step == _MOST_STEPS or not _SOUGHT < error < np.inf:
            return (error if error <= _SOUGHT else np.inf), step
        put_direction(products, gaps[active], pushed, d)
        slope = 0.0
        for i in range(len(active)):
            slope += d[i] * gaps[active[i]]
        length = np.sqrt(max(slope, 0.0) / weight)
        kink, turned = calc_kink(pushed, d, low, high)  # length and row of a sign change
        share = min(1.0, kink)
        put_scaled(share, d, part)
        calc_spanned(y, (roots, whitened), part, factors, trial)
        if length > _NEAR and not is_short_enough((A, low, high), trial, (pushed, d), slope):
            share = min(1.0 / (1.0 + length), kink)
            put_scaled(share, d, part)
            calc_spanned(y, (roots, whitened), part, factors, trial)
        for i in range(len(active)):
            multipliers[active[i]] += part[i]
        if share == kink:
            multipliers[active[turned]] = 0.0
        put_scaled(1.0, trial, y)
    return np.inf, _MOST_STEPS


@compiled
def put_scaled(share: float, values: Array, out: Array) -> None:
    """Write a multiple of a vector; zeros for the multiple 0, even of NaN."""
    for i in range(len(out)):
        out[i] = share * values[i] if share != 0.0 else 0.0


@compiled
def put_gaps(
    slabs: tuple[Array, Array, Array],
    sizes: Array,
    point: tuple[Array, Array],
    gaps: Array,
    over: Array,
) -> bool:
    """Write the gaps of limits to the values of rows; return whether all values are finite.

    The gaps (k,) are the gradient of the dual, zero for inactive rows; `over` (k,) is their size
    beyond rounding. `sizes` (k, n) are the absolute values of the rows.
    """
    (rows, lower, upper), (y, multipliers), finite = slabs, point, True
    values, terms = np.dot(rows, y), np.dot(sizes, np.abs(y))
    for i in range(len(multipliers)):
        finite &= terms[i] < np.inf
        below, above = lower[i] - values[i], upper[i] - values[i]
        if multipliers[i] > 0.0:
            gaps[i] = below
        elif multipliers[i] < 0.0:
            gaps[i] = above
        else:
            gaps[i] = below if below > 0.0 else min(above, 0.0)
        over[i] = max(abs(gaps[i]) - _ROUNDING * len(y) * terms[i], 0.0)
        if over[i] == 0.0 and multipliers[i] == 0.0:
            gaps[i] = 0.0
    return finite


@compiled
def calc_greatest(over: Array, products: Array) -> float:
    """Return the largest error of rows in the metric with A g(y)⁻¹ Aᵀ (k, k), or inf."""
    worst = 0.0
    for i in range(len(over)):
        error = over[i] / np.sqrt(products[i, i] + _NOTHING)
        if not error < np.inf:
            return np.inf
        worst = max(worst, error)
    return worst


@compiled
def put_direction(products: Array, gaps: Array, multipliers: Array, d: Array) -> None:
    """Write Newton's step of the multipliers, without multipliers of the wrong sign."""
    count, count_left = len(gaps), 0
    rows = np.empty(count, np.int64)
    for i in range(count):
        if gaps[i] != 0.0 or multipliers[i] != 0.0:
            rows[count_left] = i
            count_left += 1
    d[:] = 0.0
    solution = np.empty(count)
    while count_left > 0:
        put_solution(products, gaps, rows[:count_left], solution)
        kept = 0
        for i in range(count_left):
            at = rows[i]
            if multipliers[at] != 0.0 or not solution[i] * gaps[at] < 0.0:
                rows[kept], solution[kept] = at, solution[i]
                kept += 1
        if kept == count_left:
            break
        count_left = kept
    for i in range(count_left):
        d[rows[i]] = solution[i]


@compiled
def put_solution(products: Array, gaps: Array, rows: Places, solution: Array) -> None:
    """Write Newton's step of some rows, by a Cholesky decomposition with unit diagonal."""
    count = len(rows)
    L, scale = np.empty((count, count)), np.empty(count)
    for i in range(count):
        scale[i] = 1.0 / np.sqrt(products[rows[i], rows[i]] + _NOTHING)
        for j in range(i + 1):
            total = products[rows[i], rows[j]] * scale[i] * scale[j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = np.sqrt(max(total, 0.0) + _SLIGHT) if i == j else total / L[j, j]
        total = gaps[rows[i]] * scale[i]
        for k in range(i):
            total -= L[i, k] * solution[k]
        solution[i] = total / L[i, i]
    for i in range(count - 1, -1, -1):
        for k in range(i + 1, count):
            solution[i] -= L[k, i] * solution[k]
        solution[i] /= L[i, i]
    for i in range(count):
        solution[i] *= scale[i]


@compiled
def calc_kink(multipliers: Array, d: Array, lower: Array, upper: Array) -> tuple[float, int]:
    """Return the fraction of a step d, or inf, at which a multiplier changes sign, and its row.

    Multipliers of equations, with equal limits, may change sign.
    """
    kink, at = np.inf, 0
    for i in range(len(multipliers)):
        if multipliers[i] * d[i] < 0.0 and lower[i] < upper[i] and -multipliers[i] / d[i] < kink:
            kink, at = -multipliers[i] / d[i], i
    return kink, at


@compiled
def is_short_enough(
    slabs: tuple[Array, Array, Array], trial: Array, step: tuple[Array, Array], slope: float
) -> bool:
    """Return whether a step does not go far beyond the maximum of the dual.

    Args:
        trial: (n,) end of the step, or NaN.
        step: Initial λ (k,) and direction d (k,).
        slope: Initial slope of the dual along d.
    """
    (rows, lower, upper), (multipliers, d), end_slope = slabs, step, 0.0
    for i in range(len(d)):
        if d[i] != 0.0:
            sign = multipliers[i] if multipliers[i] != 0.0 else d[i]
            value = 0.0
            for j in range(len(trial)):
                value += rows[i, j] * trial[j]
            end_slope += d[i] * ((lower[i] if sign > 0.0 else upper[i]) - value)
    return end_slope >= -_OVERSHOT * slope


@compiled
def calc_stationarity(
    points: tuple[Array, Array], duals: tuple[Array, Array], factors: Factors
) -> float:
    """Return the length of ∇h(x) + Aᵀ λ − ∇h(y) in the metric at y, for (x, y) and (A, λ)."""
    (x, y), (bodies, shares, places, lower, other_shares) = points, factors
    rows, multipliers = duals
    gradient = np.zeros(len(x))
    for i in range(len(rows)):
        for j in range(len(x)):
            gradient[j] += multipliers[i] * rows[i, j]
    P, X, F, d = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4)), np.empty(4)
    first_root, root, total = np.empty((4, 4)), np.empty((4, 4)), 0.0
    for body in range(len(bodies)):
        first, last = bodies[body], bodies[body] + PARAMETERS_PER_BODY
        if not (
            put_body_root(x[first:last], P, d, first_root)
            and put_body_root(y[first:last], P, d, root)
        ):
            return np.inf
        put_dual(gradient[first:last], X)
        put_congruence(root, X, F, X)
        # With F = L(x)⁻¹ L(y), the residual is 𝟙 − Fᵀ F + X / w.
        for j in range(4):
            for i in range(4):
                value = root[i, j]
                for k in range(i):
                    value -= first_root[i, k] * F[k, j]
                F[i, j] = value / first_root[i, i]
        for i in range(4):
            for j in range(4):
                rest = (1.0 if i == j else 0.0) + shares[body] * X[i, j]
                for k in range(4):
                    rest -= F[k, i] * F[k, j]
                total += rest * rest / shares[body]
    for k in range(len(places)):
        at = places[k]
        slack = y[at] - lower[k]
        rest = 1.0 - slack / (x[at] - lower[k]) + other_shares[k] * slack * gradient[at]
        total += rest * rest / other_shares[k]
    return float(np.sqrt(total))


class SlabProjection(NamedTuple):
    """A projection onto slabs, with its certificate."""

    point: Array  # (n,) the projection
    # Largest error of the optimality conditions, in lengths of the metric: distance outside of a
    # slab, or inside of an active limit, and the length of ∇h(y) − ∇h(x) − Aᵀ λ. Infinite if no
    # projection was found.
    error: float
    steps: int  # number of Newton steps; −1 if unknown

    @property
    def certified(self) -> bool:
        """Whether the projection is certified to `TOLERANCE`."""
        return self.error <= TOLERANCE


def slab_projection(
    manifold: Product,
    x: Array,
    rows: Array,
    lower: Array,
    upper: Array,
    *,
    share: float = 1.0,
) -> SlabProjection:
    """Return the point of lower ≤ A y ≤ upper that is closest to x in the manifold's divergence.

    It does not check its arguments. Robots of bodies and lower bounds use compiled kernels; others
    use `bregman_projection`, whose certificate is of the same kind.

    Args:
        x: (n,) point inside of the manifold.
        rows: (k, n) A.
        lower: (k,) lower limits, −inf for none.
        upper: (k,) upper limits, inf for none.
        share: Fraction of the way, in (0, 1]: y with ∇h(y) = ∇h(x) + share Aᵀ λ. The error is that
            of the whole projection.
    """
    if manifold.robot is not None:
        y, options = np.empty(len(x)), (manifold.least_weight, float(share))
        slabs = (contiguous(rows), contiguous(lower), contiguous(upper))
        error, steps = calc_slab_projection(contiguous(x), slabs, manifold.robot, options, y)
        return SlabProjection(y, error, steps)
    try:
        y = bregman_projection(manifold, x, Polyhedron(rows, lower, upper), tolerance=TOLERANCE)
        if share < 1.0 and y is not x:
            start, end = manifold.calc_gradient(x), manifold.calc_gradient(y)
            y = manifold.calc_point_of_gradient(start + share * (end - start), y)
    except (GeodrakeError, np.linalg.LinAlgError):
        return SlabProjection(x, np.inf, -1)
    return SlabProjection(y, TOLERANCE if y is not x else 0.0, -1)
