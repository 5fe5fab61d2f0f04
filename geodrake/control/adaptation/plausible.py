"""Limits that keep an estimate near what a robot is thought to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from geodrake.boundary.arguments import instance, number, real_array
from geodrake.control.adaptation.law import AdaptationLaw, UpdateLaw
from geodrake.control.adaptation.partial import PartialLaw
from geodrake.control.adaptation.projected import ProjectedLaw
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.manifolds import ConstrainedInertia, Interval, Manifold, PhysicalInertia, Product
from geodrake.manifolds.projections import Polyhedron


def limited(law: UpdateLaw, points: ArrayLike, factor: float) -> UpdateLaw:
    """Return a law with limits about the model's parameters and a first estimate.

    Limited are tr(P₀⁻¹ P) of each body, which is four for P = P₀ and does not depend on units and
    frames, and how far each parameter of an effect is from its bound, if it has only one. They stay
    within `factor` times what the points have. As P ≤ tr(P₀⁻¹ P) P₀, mass matrices stay below
    4 factor times the model's: sampled gains K = λ M̂ with h λ M̂ > 2 M make a loop chatter, chatter
    makes estimates grow, and such a loop would not come back.

    A law of a flat manifold, one of Euler steps and one with limits of its own stay as they are.

    Args:
        points: (k, n) the model's parameters, and the first estimate.
    """
    if not number(factor, "factor") > 1:
        raise ArgumentError(f"factor must be above one; got {factor}.")
    points = real_array(points, "points", ("k", instance(law, "law", UpdateLaw).dimension or "n"))
    if isinstance(law, PartialLaw):
        return replace(law, law=limited(law.law, points[:, law.adapted], factor))
    if not isinstance(law, AdaptationLaw) or law.integrator != "geodesic":
        return law
    product = law.manifold if isinstance(law.manifold, Product) else Product((law.manifold,))
    places = np.split(points, np.cumsum([m.dimension for m in product.manifolds])[:-1], axis=1)
    cones = [_cone(*each) for each in zip(product.manifolds, places, strict=True)]
    A, tip = block_diag(*(cone[0] for cone in cones)), np.concatenate([cone[1] for cone in cones])
    heights = (points - tip) @ A.T
    least = heights.min(0, where=heights > 0, initial=np.inf) / factor + A @ tip
    limits = Polyhedron(A, least, heights.max(0, initial=0.0) * factor + A @ tip)
    return ProjectedLaw(law, limits) if len(A) else law


def _cone(manifold: Manifold, points: Array) -> tuple[Array, Array]:
    """Return what grows inside of a manifold that is a cone, (rows, n), and its tip (n,)."""
    inside = points[manifold.contains(points)]
    if isinstance(manifold, PhysicalInertia | ConstrainedInertia) and len(inside):
        return -PhysicalInertia().gradient(inside[:1]), np.zeros(points.shape[1])
    if isinstance(manifold, Interval):
        lower, upper = np.array(manifold.lower), np.array(manifold.upper)
        sign = np.isfinite(lower).astype(float) - np.isfinite(upper)
        tip = np.where(sign > 0, lower, np.where(sign < 0, upper, 0.0))
        return np.diag(sign)[sign != 0], tip
    return np.zeros((0, points.shape[1])), np.zeros(points.shape[1])
