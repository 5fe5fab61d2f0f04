"""The Bregman projection of an estimate onto slabs, once a sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geodrake.compiling import contiguous
from geodrake.errors import GeodrakeError
from geodrake.manifolds.base import Array
from geodrake.manifolds.product import Product
from geodrake.manifolds.projections import Polyhedron, bregman_projection
from geodrake.manifolds.slab_kernels import calc_slab_projection

TOLERANCE = 1e-8
"""Error of the conditions of optimality, in lengths of the metric, that certifies a projection."""

_MOST_STEPS = 40


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
        y, held = np.empty(len(x)), np.empty(len(rows))
        slabs = (contiguous(rows), contiguous(lower), contiguous(upper))
        limits = (0.1 * TOLERANCE, manifold.least_weight, _MOST_STEPS)
        error, steps = calc_slab_projection(contiguous(x), slabs, manifold.robot, limits, (y, held))
        if share < 1.0 and steps > 0 and error <= TOLERANCE:
            y = manifold.calc_mirror_span(x, slabs[0]).point(share * held)
        return SlabProjection(y, float(error), int(steps))
    try:
        y = bregman_projection(manifold, x, Polyhedron(rows, lower, upper), tolerance=TOLERANCE)
        if share < 1.0 and y is not x:
            start, end = manifold.calc_gradient(x), manifold.calc_gradient(y)
            y = manifold.calc_point_of_gradient(start + share * (end - start), y)
    except (GeodrakeError, np.linalg.LinAlgError):
        return SlabProjection(x, np.inf, -1)
    return SlabProjection(y, TOLERANCE if y is not x else 0.0, -1)
