"""A nudge: one step toward the slabs of a sample."""

from __future__ import annotations

from math import sqrt

import numpy as np

from geodrake.compiling import compiled
from geodrake.inertia import Array
from geodrake.manifolds import Product
from geodrake.manifolds.slab_kernels import put_direction

_SHARING = 1e-2  # of a row's squared length, added to it
_NOTHING = 1e-300  # squared length of a row that says nothing


def slab_step(
    manifold: Product,
    p: Array,
    Y: Array,
    effort: Array,
    tolerance: Array,
    *,
    relaxation: float = 1.0,
) -> Array:
    """Take one step of Newton's method toward the slabs |Y p − effort| ≤ ε that p is outside of.

    The Bregman projection onto them, [Lee2019] Eq. (2.2.11), is the y with ∇h(y) = ∇h(p) − Yᵀ λ for
    multipliers λ of the rows that bind: a handful of unknowns, however many parameters there are.
    For one of many samples one step is enough. It has its own way to be short, at most one in the
    manifold's metric, and rows that nearly depend on each other share what they ask for, so that
    samples that contradict each other do little. With the truth in the slabs, it comes nearer.

    Args:
        p: (n,) estimate inside of the manifold.
        Y: (k, n) rows, with (k,) efforts and tolerances ε > 0.
        relaxation: Share of the step that is made, in (0, 1]: less follows noise less.

    Returns:
        The estimate (n,); itself if it is in all slabs. Rounding may leave it outside of the
        manifold, or not a number.
    """
    error = Y @ p - effort
    error -= np.minimum(np.maximum(error, -tolerance), tolerance)  # zero in the slab
    (bound,) = error.nonzero()
    if not len(bound):
        return p
    if len(bound) < len(error):
        Y, error = Y.take(bound, 0), error.take(bound)
    span = manifold.calc_mirror_span(p, Y)
    multipliers = calc_multipliers(span.products, error)
    length = sqrt(max(float(error @ multipliers) / manifold.least_weight, 0.0))
    return span.point(multipliers * (-relaxation / (1.0 + length)))


@compiled
def calc_multipliers(products: Array, error: Array) -> Array:
    """Return Newton's multipliers (k,) of rows outside of their slabs; none pulls a row farther.

    They are those of the first step of a projection (`slab_kernels`), with a share of each row's
    squared length added to it. Rows of any length do no harm. Inner products (k, k) of the rows
    are overwritten; errors (k,) are how far each is outside of its slab.
    """
    for i in range(len(error)):
        products[i, i] = products[i, i] * (1.0 + _SHARING) + _NOTHING
    multipliers = np.empty(len(error))
    put_direction(products, error, np.zeros(len(error)), multipliers)
    return multipliers
