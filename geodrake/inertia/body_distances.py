"""Distances between the inertial parameters of bodies, [Lee2019] §3.3.

Unlike the Euclidean distance of φ, the Riemannian, entropic and pullback distances do not depend on
the body frame and on units. For small differences they agree:

    riemannian² ≈ 2 entropic ≈ 2 pullback²

The factor 2 is due to (2.2.10), which omits the ½ of the metric (2.2.5).

All functions broadcast over leading axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import Sizes
from geodrake.inertia import positive_definite
from geodrake.inertia.kernels import Array
from geodrake.inertia.parameters import checked_phi, pseudo_inertia


def riemannian_distance(phi1: ArrayLike, phi2: ArrayLike) -> Array:
    """Return geodesic distances (...) √(Σ log² λᵢ(P₁⁻¹ P₂)) of physical bodies φ (..., 10).

    Without the ½ of the metric ([Lee2019] Eqs. (3.3.25), (2.2.10)).
    """
    first, second = _together(phi1=phi1, phi2=phi2)
    return positive_definite.distance(pseudo_inertia(first), pseudo_inertia(second))


def entropic_divergence(phi1: ArrayLike, phi2: ArrayLike) -> Array:
    """Return entropic divergences (...) d(φ₁‖φ₂)² of physical bodies φ (..., 10), convex in φ₁.

    They correspond to squared distances ([Lee2019] Eq. (3.3.28)).
    """
    first, second = _together(phi1=phi1, phi2=phi2)
    return positive_definite.log_det_divergence(pseudo_inertia(first), pseudo_inertia(second))


def pullback_distance(phi1: ArrayLike, phi2: ArrayLike, reference: ArrayLike) -> Array:
    """Return distances (...) √(½ tr((P₀⁻¹ P(φ₁ − φ₂))²)) in the metric at a reference.

    All are (..., 10); only the reference must be physical. Distances are finite at the boundary of
    physical bodies ([Lee2019] Eq. (3.3.33), with its ½).
    """
    first, second, reference = _together(phi1=phi1, phi2=phi2, reference=reference)
    _, inverse = positive_definite.whitening(pseudo_inertia(reference))
    step = positive_definite.congruent(inverse, pseudo_inertia(first - second))
    return np.asarray(np.sqrt(0.5 * np.square(step).sum((-2, -1))))


def _together(**phi: ArrayLike) -> list[Array]:
    """Return checked inertial parameters (..., 10), by argument name, whose axes broadcast."""
    sizes: Sizes = {}
    return [checked_phi(values, name, sizes) for name, values in phi.items()]
