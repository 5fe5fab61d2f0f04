"""The Bregman projection onto one half-space: one unknown number, on a mirror line."""

from __future__ import annotations

from geodrake.manifolds.base import Array, Manifold


def half_space_projection(manifold: Manifold, x: Array, a: Array, limit: float) -> Array:
    """The projection of x onto aᵀ y ≤ limit: ∇h(y) = ∇h(x) − λ a, with λ ≥ 0 where aᵀ y = limit.

    For every sample: it trusts its arrays, and what comes out carries no certificate as that of
    `bregman_projection` does. Check that it is in the half-space.

    Args:
        x: (n,) point inside of the manifold, outside of the half-space.
        a: (n,) normal of the half-space, not zero.

    Returns:
        (n,) the projection; the last point on the way to it if the half-space is out of reach.
    """
    line = manifold.calc_mirror_line(x, -a)
    return line.point(line.time_of(-limit))
