"""Symmetric positive-definite matrices P(n) with the affine-invariant metric, [Lee2019] §2.2.

A change of basis P ↦ G P Gᵀ changes no distance, divergence or mean below (Eq. (2.2.4)). For pseudo
inertias this means: no choice of frame, unit of length or unit of mass does.

The source has a factor ½ in its metric (2.2.5), but none in its distance (2.2.10). Both are kept:

    distance(P, P + dP)² ≈ 2 inner_product(P, dP, dP) ≈ 2 log_det_divergence(P + dP, P)

All functions broadcast over leading axes.
"""

from geodrake.inertia.positive_definite.geometry import (
    distance,
    exponential,
    geodesic,
    inner_product,
    log_det_divergence,
    logarithm,
    relative_logarithms,
    whitening,
)
from geodrake.inertia.positive_definite.karcher import karcher_mean

__all__ = [
    "distance",
    "exponential",
    "geodesic",
    "inner_product",
    "karcher_mean",
    "log_det_divergence",
    "logarithm",
    "relative_logarithms",
    "whitening",
]
