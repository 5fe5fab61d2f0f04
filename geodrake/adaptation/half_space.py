"""Bregman projection onto one half-space in closed form, up to one unknown number.

The projection of x onto aᵀ y ≤ u has ∇h(y) = ∇h(x) − λ a with λ ≥ 0. For bodies with P(x) = L Lᵀ
and the barrier weight w this is

    P(y) = L (𝟙 + λ/w Lᵀ X(a) L)⁻¹ Lᵀ,   aᵀ y = Σ s / (1 + λ s / w)

over the eigenvalues s of Lᵀ X(a) L of all bodies: λ is the root of a decreasing function.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from geodrake.inertia import PARAMETERS_PER_BODY, Array, dual, from_pseudo_inertia, pseudo_inertia
from geodrake.manifolds import Interval, PhysicalInertia, Product

_NEAR = 1e-14  # how near to the end of its interval λ is looked for, relative to the interval
_MOST_DOUBLINGS = 100
_LARGEST_CHANGE = 1e6  # of a part of P, beyond which rounding of the others would show


def half_space_projection(manifold: Product, x: Array, a: Array, limit: float) -> Array | None:
    """The projection of x onto aᵀ y ≤ limit; None where there is no such closed form.

    Args:
        manifold: A product of which `a` concerns bodies only, or one parameter of an interval.
        x: (n,) point inside of the manifold, outside of the half-space.
        a: (n,) normal.
        limit: Greatest value of aᵀ y.
    """
    ends = np.cumsum([factor.dimension for factor in manifold.manifolds])
    used = [bool(part.any()) for part in np.split(a, ends[:-1])]
    kinds = {type(f) for f, own in zip(manifold.manifolds, used, strict=True) if own}
    if kinds == {PhysicalInertia}:
        starts = np.array([e for e, own in zip(ends, used, strict=True) if own])
        places = starts[:, None] - PARAMETERS_PER_BODY + np.arange(PARAMETERS_PER_BODY)
        weights = np.array([w for w, own in zip(manifold.weights, used, strict=True) if own])
        moved = _move_bodies(x[places], a[places], weights, limit)
        if moved is None:
            return None
        y = x.copy()
        y[places] = moved
        return y
    if np.count_nonzero(a) == 1 and all(issubclass(kind, Interval) for kind in kinds):
        y, i = x.copy(), int(np.flatnonzero(a)[0])
        y[i] = limit / a[i]
        return y if bool(manifold.calc_contains(y)) else None
    return None


def _move_bodies(phi: Array, a: Array, weights: Array, limit: float) -> Array | None:
    """Inertial parameters (k, 10) with Σ aᵀ φ = limit, from ones with more; None if too far.

    Args:
        phi: (k, 10) parameters of the bodies.
        a: (k, 10) normals.
        weights: (k,) weights of their barriers.
        limit: What Σ aᵀ φ is to be.
    """
    try:
        L = np.linalg.cholesky(pseudo_inertia(phi))
    except np.linalg.LinAlgError:
        return None
    s, axes = np.linalg.eigh(L.swapaxes(-1, -2) @ dual(a) @ L)
    pairs = [(float(x), float(x / w)) for row, w in zip(s, weights, strict=True) for x in row]

    def surplus(push: float) -> float:
        return sum(x / (1.0 + push * rate) for x, rate in pairs) - limit

    least = min(rate for _, rate in pairs)
    if least < 0:
        last = (_NEAR - 1.0) / least
    else:
        last = 1.0 / max(rate for _, rate in pairs)
        for _ in range(_MOST_DOUBLINGS):
            if surplus(last) <= 0:
                break
            last *= 2.0
    if not surplus(last) <= 0:
        return None
    push = brentq(surplus, 0.0, last, xtol=1e-300, rtol=1e-15)
    change = 1.0 + push * s / weights[:, None]
    if change.max() > _LARGEST_CHANGE or change.min() < 1.0 / _LARGEST_CHANGE:
        return None
    root = (L @ axes) / np.sqrt(change)[:, None, :]
    return from_pseudo_inertia(root @ root.swapaxes(-1, -2))
