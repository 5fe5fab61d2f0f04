"""Distances between the inertial parameters of bodies, [Lee2019] §3.3.

Riemannian, entropic and pullback distance do not depend on the body frame, nor on the units of
length and mass; the Euclidean distance of φ does. For small differences they agree:

    riemannian² ≈ 2 entropic ≈ 2 pullback²

where the 2 comes from (2.2.10), which leaves out the ½ of the metric (2.2.5).

All functions broadcast over leading axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import Sizes
from geodrake.errors import ArgumentError
from geodrake.inertia import positive_definite
from geodrake.inertia.kernels import Array
from geodrake.inertia.parameters import checked_phi, pseudo_inertia
from geodrake.inertia.principal import central_second_moment


@dataclass(frozen=True, eq=False)
class DistanceParts:
    """What mass, shape and position add to a squared distance.

    Attributes:
        mass: (...) from the masses.
        shape: (...) from the second moments about the centre of mass.
        position: (...) from the centres of mass.
    """

    mass: Array
    shape: Array
    position: Array

    @property
    def total(self) -> Array:
        """The squared distance (...)."""
        return np.asarray(self.mass + self.shape + self.position)


def riemannian_distance(phi1: ArrayLike, phi2: ArrayLike) -> Array:
    """Geodesic distance of two bodies, without the ½ of the metric.

    Args:
        phi1: (..., 10) physical inertial parameters.
        phi2: (..., 10) physical inertial parameters.

    Returns:
        (...) distances √(Σ log² λᵢ(P₁⁻¹ P₂)) ([Lee2019] Eqs. (3.3.25), (2.2.10)).

    Raises:
        ArgumentError: A value is something else, or not finite, or a body is not physical.
    """
    first, second = _together(phi1=phi1, phi2=phi2)
    return positive_definite.distance(pseudo_inertia(first), pseudo_inertia(second))


def entropic_divergence(phi1: ArrayLike, phi2: ArrayLike) -> Array:
    """Entropic divergence d(φ₁‖φ₂)², convex in φ₁.

    Args:
        phi1: (..., 10) physical inertial parameters.
        phi2: (..., 10) physical inertial parameters.

    Returns:
        (...) divergences, which compare to squares of distances ([Lee2019] Eq. (3.3.28)).

    Raises:
        ArgumentError: A value is something else, or not finite, or a body is not physical.
    """
    first, second = _together(phi1=phi1, phi2=phi2)
    return positive_definite.log_det_divergence(pseudo_inertia(first), pseudo_inertia(second))


def pullback_distance(phi1: ArrayLike, phi2: ArrayLike, reference: ArrayLike) -> Array:
    """Distance in the metric of one body, which stays finite at the edge of physical bodies.

    Args:
        phi1: (..., 10) inertial parameters.
        phi2: (..., 10) inertial parameters.
        reference: (..., 10) physical inertial parameters whose metric is used.

    Returns:
        (...) distances √(½ tr((P₀⁻¹ P(φ₁ − φ₂))²)) ([Lee2019] Eq. (3.3.33), with its ½).

    Raises:
        ArgumentError: A value is something else, or not finite, or the reference is not physical.
    """
    first, second, reference = _together(phi1=phi1, phi2=phi2, reference=reference)
    step = pseudo_inertia(first - second)
    squared = positive_definite.inner_product(pseudo_inertia(reference), step, step)
    return np.asarray(np.sqrt(squared))


def metric_parts(phi: ArrayLike, step: ArrayLike) -> DistanceParts:
    """Squared length of a small step in the metric (3.3.19), by mass, shape and position.

    Args:
        phi: (..., 10) physical inertial parameters.
        step: (..., 10) small change dφ.

    Returns:
        The terms ½ (dm/m)², ½ tr((Σᶜ⁻¹ dΣᶜ)²) and m dpᵀ Σᶜ⁻¹ dp ([Lee2019] Eq. (3.3.20)).

    Raises:
        ArgumentError: A value is something else, or not finite, or a body is not physical.
    """
    phi, step = np.broadcast_arrays(*_together(phi=phi, step=step))
    mass, mass_step = phi[..., 0], step[..., 0]
    if not (mass > 0).all():  # Σᶜ alone may be positive definite with a negative mass
        raise ArgumentError(f"Masses are above zero, or no body can be; got {mass.tolist()}.")
    com = phi[..., 1:4] / mass[..., None]
    com_step = (step[..., 1:4] - mass_step[..., None] * com) / mass[..., None]
    second_moment = central_second_moment(phi)
    _, inverse = positive_definite.whitening(second_moment)
    mixed = com[..., :, None] * com_step[..., None, :]
    shape_step = (
        pseudo_inertia(step)[..., :3, :3]
        - mass_step[..., None, None] * com[..., :, None] * com[..., None, :]
        - mass[..., None, None] * (mixed + np.swapaxes(mixed, -1, -2))
    )
    moved = np.einsum("...ij,...j->...i", inverse, com_step)
    return DistanceParts(
        mass=0.5 * (mass_step / mass) ** 2,
        shape=positive_definite.inner_product(second_moment, shape_step, shape_step),
        position=mass * (moved**2).sum(-1),
    )


def divergence_parts(phi1: ArrayLike, phi2: ArrayLike) -> DistanceParts:
    """Entropic divergence d(φ₁‖φ₂)² by mass, shape and position.

    Args:
        phi1: (..., 10) physical inertial parameters.
        phi2: (..., 10) physical inertial parameters.

    Returns:
        The terms d(m₁‖m₂), d(Σ₁ᶜ‖Σ₂ᶜ) and m₁ (p₁ − p₂)ᵀ (Σ₂ᶜ)⁻¹ (p₁ − p₂) ([Lee2019]
        Eq. (3.3.29)).

    Raises:
        ArgumentError: A value is something else, or not finite, or a body is not physical.
    """
    phi1, phi2 = np.broadcast_arrays(*_together(phi1=phi1, phi2=phi2))
    first, second = central_second_moment(phi1), central_second_moment(phi2)
    _, inverse = positive_definite.whitening(second)
    apart = phi1[..., 1:4] / phi1[..., :1] - phi2[..., 1:4] / phi2[..., :1]
    whitened = np.einsum("...ij,...j->...i", inverse, apart)
    masses = [phi[..., 0, None, None] for phi in (phi1, phi2)]
    return DistanceParts(
        mass=positive_definite.log_det_divergence(*masses),
        shape=positive_definite.log_det_divergence(first, second),
        position=phi1[..., 0] * (whitened**2).sum(-1),
    )


def _together(**phi: ArrayLike) -> list[Array]:
    """Inertial parameters (..., 10) whose leading axes broadcast, by the names of arguments."""
    sizes: Sizes = {}
    return [checked_phi(values, name, sizes) for name, values in phi.items()]
