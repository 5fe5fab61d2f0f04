"""Barrier-Hessian manifolds: convex sets of parameters with the geometry of their log barrier.

Parameters in an open convex set, such as positive friction coefficients and positive definite
pseudo-inertias, get a strictly convex barrier h that is unbounded towards the boundary ([Lee2019]
§5.3). Its Hessian is a metric, Eq. (5.3.17), and its Bregman divergence measures errors:

    D(x‖y) = h(x) − h(y) − ∇h(y)ᵀ (x − y)                                          [Lee2019] (2.2.2)

Both are independent of units and frames, except for parameters without bounds.

All methods broadcast over leading axes.
"""

from geodrake.manifolds.base import Manifold
from geodrake.manifolds.constrained_inertia import ConstrainedInertia
from geodrake.manifolds.inertia import PhysicalInertia
from geodrake.manifolds.interval import Free, Interval, Positive
from geodrake.manifolds.product import Product
from geodrake.manifolds.projections import (
    Polyhedron,
    affine_set,
    bregman_projection,
    halfspace,
    slab,
)

__all__ = [
    "ConstrainedInertia",
    "Free",
    "Interval",
    "Manifold",
    "PhysicalInertia",
    "Polyhedron",
    "Positive",
    "Product",
    "affine_set",
    "bregman_projection",
    "halfspace",
    "slab",
]
