"""Bregman projections onto half-spaces, affine sets, slabs and polyhedra, [Lee2019] Eq. (2.2.11).

    Proj_C(x) = argmin D(y‖x)  over y in C

The projection of an estimate onto any convex set that holds the truth p brings it nearer to p, in
the divergence of the manifold (the Pythagorean inequality, Eq. (2.2.12)):

    D(p‖x) ≥ D(p‖Proj_C(x)) + D(Proj_C(x)‖x)

It is found by a primal-dual interior-point method in the coordinates in which the metric at x is
the identity, so that units and frames cost no precision.
"""

from geodrake.manifolds.projections.bregman import bregman_projection
from geodrake.manifolds.projections.polyhedron import Polyhedron, affine_set, halfspace, slab

__all__ = [
    "Polyhedron",
    "affine_set",
    "bregman_projection",
    "halfspace",
    "slab",
]
