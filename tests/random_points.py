"""Random bodies, points of manifolds, and other frames and units of bodies."""

import numpy as np

from geodrake.inertia import Ellipsoid, change_frame, change_units, from_pseudo_inertia
from geodrake.inertia.ellipsoids import realizability_row
from geodrake.manifolds import (
    ConstrainedInertia,
    Free,
    Interval,
    PhysicalInertia,
    Positive,
    Product,
)

HULL = Ellipsoid(np.array([0.2, -0.1, 0.0]), np.array([14.0, 15.0, 16.0]), np.eye(3))
CONSTRAINED = ConstrainedInertia(  # inside of the hull, and lighter than 50 kg
    np.stack([realizability_row(HULL.quadric), -np.eye(10)[0]]), np.array([0.0, -50.0]), 0.7
)
PRODUCT = Product(  # of kinds that are taken together, among others
    (
        PhysicalInertia(),
        Positive(2),
        PhysicalInertia(),
        Interval((0.0, -1.0), (np.inf, 2.0)),
        CONSTRAINED,
        Free(1),
        PhysicalInertia(),
        Interval((0.5,), (np.inf,)),
    ),
    (1.0, 0.5, 1.0, 0.5, 2.0, 1.0, 3.0, 0.5),
)


def random_rotation(rng):
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return axes * np.sign(np.linalg.det(axes))


def random_matrices(rng, *size, n=4):
    """Return symmetric positive-definite matrices."""
    root = rng.normal(size=(*size, n, n))
    return root @ np.swapaxes(root, -1, -2) + 0.1 * np.eye(n)


def random_inertia(rng, *size):
    return from_pseudo_inertia(random_matrices(rng, *size))


def round_inertia(rng, *size):
    """Return bodies similar to a ball, whose rounding stays small in other frames and units."""
    return from_pseudo_inertia(np.eye(4) + 0.1 * random_matrices(rng, *size))


def random_point(manifold, rng, *size):
    if isinstance(manifold, Product):
        return np.concatenate([random_point(m, rng, *size) for m in manifold.manifolds], -1)
    if isinstance(manifold, PhysicalInertia | ConstrainedInertia):
        return random_inertia(rng, *size)
    lower = np.maximum(manifold.lower, np.minimum(np.subtract(manifold.upper, 5.0), -5.0))
    upper = np.minimum(manifold.upper, lower + 5.0)
    return rng.uniform(lower + 0.1, upper - 0.1, (*size, manifold.dimension))


def other_view(rng, metre, kilogram):
    """Return the matrix (10, 10) that expresses φ in another frame and other units."""
    seen = change_frame(np.eye(10), random_rotation(rng), rng.uniform(-1, 1, 3))
    return change_units(seen, metre=metre, kilogram=kilogram).T
