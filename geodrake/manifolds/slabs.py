"""The Bregman projection of an estimate onto slabs, once a sample: of robots in a compiled loop.

    ∇h(y) = ∇h(x) + Aᵀ λ,   λᵢ > 0 only where aᵢᵀ y = lowerᵢ,   λᵢ < 0 only where aᵢᵀ y = upperᵢ

([Lee2019] Eq. (2.2.11)). The multipliers maximize the dual, which is concave with the gradient
lower − A y or upper − A y and the Hessian −A g(y)⁻¹ Aᵀ: Newton's method on the rows that bind, a
handful of unknowns however many parameters there are. With one row it finds the root of a function
of one number. Every step sets out from the last point and its metric, so that distances of many
orders of magnitude cost no precision.
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

_NEAR = 0.25  # length of a Newton step in the metric that needs no search
_OVERSHOT = 0.1  # slope that a full step may leave beyond the top, relative to the first
_SLIGHT = 1e-13  # of a row's squared length, added to it, so that rows may depend on each other
_NOTHING = 1e-300  # squared length of a row that says nothing
_ROUNDING = 4e-16  # of a row's value, relative to its terms
_MOST_STEPS = 40  # of Newton

TOLERANCE = 1e-8
"""Error of the conditions of optimality, in lengths of the metric, that certifies a projection."""

_SOUGHT = 0.1 * TOLERANCE


@compiled
def calc_slab_projection(
    x: Array,
    slabs: tuple[Array, Array, Array],
    factors: Factors,
    how: tuple[float, float],
    y: Array,
) -> tuple[float, int]:
    """Write the projection, or a point on the way there.

    Args:
        x: (n,) point inside of the manifold.
        slabs: Rows A (k, n), and their lower and upper limits (k,).
        how: Least weight of a factor or 1, and how much of the way is gone; see `slab_projection`.
        y: (n,) the projection.

    Returns:
        The error of the conditions of optimality, in lengths of the metric at y, and how many steps
        it took. Infinite where the way led nowhere, as where no point is in all slabs.
    """
    held = np.zeros(len(slabs[0]))
    error, steps = calc_whole_projection(x, slabs, factors, how[0], (y, held))
    if how[1] < 1.0 and steps > 0 and error <= TOLERANCE:
        roots, whitened = np.empty((len(factors[0]), 4, 4)), np.empty(slabs[0].shape)
        calc_whitened(x, slabs[0], factors, roots, whitened)
        calc_spanned(x, (roots, whitened), how[1] * held, factors, y)
    return error, steps


@compiled
def calc_whole_projection(
    x: Array,
    slabs: tuple[Array, Array, Array],
    factors: Factors,
    weight: float,
    out: tuple[Array, Array],
) -> tuple[float, int]:
    """Write the projection y (n,) and its multipliers λ (k,), which are zeros before."""
    (rows, lower, upper), (y, held) = slabs, out
    k, n = rows.shape
    roots, trial = np.empty((len(factors[0]), 4, 4)), np.empty(n)
    gaps, over, sizes = np.empty(k), np.empty(k), np.abs(rows)
    put_scaled(1.0, x, y)
    for step in range(_MOST_STEPS + 1):
        if not put_gaps(slabs, sizes, out, gaps, over):
            return np.inf, step
        # Rows that are inside and push nothing have no part in a step.
        at = np.flatnonzero((gaps != 0.0) | (held != 0.0))
        if not len(at):
            return (calc_stationarity((x, y), (rows, held), factors) if step else 0.0), step
        A, pushed, low, high = rows[at], held[at], lower[at], upper[at]
        whitened, d, part = np.empty((len(at), n)), np.empty(len(at)), np.empty(len(at))
        calc_whitened(y, A, factors, roots, whitened)
        products = np.dot(whitened, whitened.T)
        error = calc_greatest(over[at], products)
        if error <= _SOUGHT and step:
            return max(error, calc_stationarity((x, y), (A, pushed), factors)), step
        if step == _MOST_STEPS or not _SOUGHT < error < np.inf:
            return (error if error <= _SOUGHT else np.inf), step
        put_direction(products, gaps[at], pushed, d)
        slope = 0.0
        for i in range(len(at)):
            slope += d[i] * gaps[at[i]]
        length = np.sqrt(max(slope, 0.0) / weight)
        kink, turned = calc_kink(pushed, d, low, high)
        share = min(1.0, kink)
        put_scaled(share, d, part)
        calc_spanned(y, (roots, whitened), part, factors, trial)
        if length > _NEAR and not is_short_enough((A, low, high), trial, (pushed, d), slope):
            share = min(1.0 / (1.0 + length), kink)
            put_scaled(share, d, part)
            calc_spanned(y, (roots, whitened), part, factors, trial)
        for i in range(len(at)):
            held[at[i]] += part[i]
        if share == kink:
            held[at[turned]] = 0.0
        put_scaled(1.0, trial, y)
    return np.inf, _MOST_STEPS


@compiled
def put_scaled(share: float, values: Array, out: Array) -> None:
    """Write a multiple of a vector; for the multiple 0 zeros, even of NaN."""
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
    """Write how far limits are above the values of rows; return whether all values are finite.

    The gaps (k,) are the slope of the dual, zero where a row is inside and pushes nothing; `over`
    (k,) is what is left of their size beyond rounding. Sizes (k, n) are those of the rows' entries.
    """
    (rows, lower, upper), (y, held), finite = slabs, point, True
    values, terms = np.dot(rows, y), np.dot(sizes, np.abs(y))
    for i in range(len(held)):
        finite &= terms[i] < np.inf
        below, above = lower[i] - values[i], upper[i] - values[i]
        if held[i] > 0.0:
            gaps[i] = below
        elif held[i] < 0.0:
            gaps[i] = above
        else:
            gaps[i] = below if below > 0.0 else min(above, 0.0)
        over[i] = max(abs(gaps[i]) - _ROUNDING * len(y) * terms[i], 0.0)
        if over[i] == 0.0 and held[i] == 0.0:
            gaps[i] = 0.0
    return finite


@compiled
def calc_greatest(over: Array, products: Array) -> float:
    """Return the greatest error of rows in the metric, whose A g(y)⁻¹ Aᵀ is (k, k); or inf."""
    worst = 0.0
    for i in range(len(over)):
        error = over[i] / np.sqrt(products[i, i] + _NOTHING)
        if not error < np.inf:
            return np.inf
        worst = max(worst, error)
    return worst


@compiled
def put_direction(products: Array, gaps: Array, held: Array, d: Array) -> None:
    """Write Newton's step of the multipliers, none of them on the side of an inactive bound."""
    count, left = len(gaps), 0
    rows = np.empty(count, np.int64)
    for i in range(count):
        if gaps[i] != 0.0 or held[i] != 0.0:
            rows[left] = i
            left += 1
    d[:] = 0.0
    found = np.empty(count)
    while left > 0:
        put_solution(products, gaps, rows[:left], found)
        kept = 0
        for i in range(left):
            at = rows[i]
            if held[at] != 0.0 or not found[i] * gaps[at] < 0.0:
                rows[kept], found[kept] = at, found[i]
                kept += 1
        if kept == left:
            break
        left = kept
    for i in range(left):
        d[rows[i]] = found[i]


@compiled
def put_solution(products: Array, gaps: Array, rows: Places, found: Array) -> None:
    """Write Newton's step of some rows, by Cholesky's decomposition on a unit diagonal."""
    left = len(rows)
    L, scale = np.empty((left, left)), np.empty(left)
    for i in range(left):
        scale[i] = 1.0 / np.sqrt(products[rows[i], rows[i]] + _NOTHING)
        for j in range(i + 1):
            total = products[rows[i], rows[j]] * scale[i] * scale[j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = np.sqrt(max(total, 0.0) + _SLIGHT) if i == j else total / L[j, j]
        total = gaps[rows[i]] * scale[i]
        for k in range(i):
            total -= L[i, k] * found[k]
        found[i] = total / L[i, i]
    for i in range(left - 1, -1, -1):
        for k in range(i + 1, left):
            found[i] -= L[k, i] * found[k]
        found[i] /= L[i, i]
    for i in range(left):
        found[i] *= scale[i]


@compiled
def calc_kink(held: Array, d: Array, lower: Array, upper: Array) -> tuple[float, int]:
    """Return the share of a step d at which a multiplier first changes sign, and which; or inf.

    The limits of an equation are the same: its multiplier has either sign.
    """
    kink, at = np.inf, 0
    for i in range(len(held)):
        if held[i] * d[i] < 0.0 and lower[i] < upper[i] and -held[i] / d[i] < kink:
            kink, at = -held[i] / d[i], i
    return kink, at


@compiled
def is_short_enough(
    slabs: tuple[Array, Array, Array], trial: Array, way: tuple[Array, Array], slope: float
) -> bool:
    """Return whether a step that ends at a point does not go far beyond the top of the dual.

    Args:
        trial: (n,) its end, not a number where there is none.
        way: λ (k,) where it began, and its direction d (k,).
        slope: That of the dual where it began, along d.
    """
    (rows, lower, upper), (held, d), there = slabs, way, 0.0
    for i in range(len(d)):
        if d[i] != 0.0:
            sign = held[i] if held[i] != 0.0 else d[i]
            value = 0.0
            for j in range(len(trial)):
                value += rows[i, j] * trial[j]
            there += d[i] * ((lower[i] if sign > 0.0 else upper[i]) - value)
    return there >= -_OVERSHOT * slope


@compiled
def calc_stationarity(
    points: tuple[Array, Array], held: tuple[Array, Array], factors: Factors
) -> float:
    """Return the length of ∇h(x) + Aᵀ λ − ∇h(y) in the metric at y, of x and y, and of A and λ."""
    (x, y), (bodies, shares, places, lower, other_shares) = points, factors
    rows, multipliers = held
    push = np.zeros(len(x))
    for i in range(len(rows)):
        for j in range(len(x)):
            push[j] += multipliers[i] * rows[i, j]
    P, X, F, d = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4)), np.empty(4)
    first_root, root, total = np.empty((4, 4)), np.empty((4, 4)), 0.0
    for body in range(len(bodies)):
        first, last = bodies[body], bodies[body] + PARAMETERS_PER_BODY
        if not (
            put_body_root(x[first:last], P, d, first_root)
            and put_body_root(y[first:last], P, d, root)
        ):
            return np.inf
        put_dual(push[first:last], X)
        put_congruence(root, X, F, X)
        # F = L(x)⁻¹ L(y), and the rest is 𝟙 − Fᵀ F + X / w.
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
        rest = 1.0 - slack / (x[at] - lower[k]) + other_shares[k] * slack * push[at]
        total += rest * rest / other_shares[k]
    return float(np.sqrt(total))


class SlabProjection(NamedTuple):
    """A projection onto slabs, with its certificate."""

    point: Array  # (n,) the projection
    # Greatest error of the conditions of optimality at it, in lengths of the metric: how far it is
    # outside of a slab, or of one whose multiplier is not zero inside of its edge, and the length
    # of ∇h(y) − ∇h(x) less the multipliers' part. Infinite if none was found.
    error: float
    steps: int  # Newton steps that were taken; −1 if that is not known

    @property
    def certified(self) -> bool:
        """Whether it is the projection, to `TOLERANCE`."""
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
    """Return the point of lower ≤ A y ≤ upper that is nearest to x in a manifold's divergence.

    For every sample: it trusts its arrays. Robots of bodies and lower bounds have a compiled loop;
    others go through `bregman_projection`, whose certificate is of the same kind.

    Args:
        x: (n,) point inside of the manifold.
        rows: (k, n) A.
        lower: (k,) least values, −inf for none; below the greatest ones, `upper`.
        share: How much of the way is gone, in (0, 1]: y with ∇h(y) = ∇h(x) + share Aᵀ λ. The error
            is that of the whole way.
    """
    if manifold.robot is not None:
        y, how = np.empty(len(x)), (manifold.least_weight, float(share))
        slabs = (contiguous(rows), contiguous(lower), contiguous(upper))
        error, steps = calc_slab_projection(contiguous(x), slabs, manifold.robot, how, y)
        return SlabProjection(y, error, steps)
    try:
        y = bregman_projection(manifold, x, Polyhedron(rows, lower, upper), tolerance=TOLERANCE)
        if share < 1.0 and y is not x:
            start, end = manifold.calc_gradient(x), manifold.calc_gradient(y)
            y = manifold.calc_point_of_gradient(start + share * (end - start), y)
    except (GeodrakeError, np.linalg.LinAlgError):
        return SlabProjection(x, np.inf, -1)
    return SlabProjection(y, TOLERANCE if y is not x else 0.0, -1)
