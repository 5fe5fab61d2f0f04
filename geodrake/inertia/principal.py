"""Principal axes and moments of a body about its centre of mass, and what limits them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.inertia.kernels import Array
from geodrake.inertia.parameters import checked_phi, pseudo_inertia


@dataclass(frozen=True, eq=False)
class PrincipalAxes(Short):
    """A body about its centre of mass, along its principal axes.

    Attributes:
        mass: (...) masses, kg.
        center: (..., 3) centres of mass p_BoBcm_B, m.
        rotation: (..., 3, 3) right-handed rotations R_BP, whose columns are the axes.
        moments: (..., 3) principal moments of inertia, kg·m², in descending order.
        second_moments: (..., 3) principal second moments ∫ x² dm, kg·m², in ascending order.
    """

    mass: Array
    center: Array
    rotation: Array
    moments: Array
    second_moments: Array


def central_second_moment(phi: ArrayLike) -> Array:
    """Second moment matrix about the centre of mass, Σᶜ = Σ − m p pᵀ.

    Args:
        phi: (..., 10) inertial parameters with mass other than zero.

    Returns:
        (..., 3, 3) symmetric matrices, kg·m² ([Lee2019] Eq. (3.3.17)).

    Raises:
        ArgumentError: A body has no mass, so no centre, or a value is not finite.
    """
    matrix = pseudo_inertia(phi)
    h, mass = matrix[..., :3, 3], matrix[..., 3, 3]
    if not mass.all():
        bad = np.asarray(phi, float).reshape(-1, 10)[int(np.argmin(np.abs(mass).ravel()))]
        raise ArgumentError(f"A body without mass has no centre of mass; got {bad.tolist()}.")
    squared = h[..., :, None] * h[..., None, :] / mass[..., None, None]
    return np.asarray(matrix[..., :3, :3] - squared)


def principal_axes(phi: ArrayLike) -> PrincipalAxes:
    """Principal axes of bodies.

    Args:
        phi: (..., 10) inertial parameters with mass other than zero.

    Raises:
        ArgumentError: A body has no mass, or a value is not finite.
    """
    phi = checked_phi(phi)
    values, axes = np.linalg.eigh(central_second_moment(phi))
    handedness = np.where(np.linalg.det(axes) < 0, -1.0, 1.0)
    rotation = np.concatenate([axes[..., :2], handedness[..., None, None] * axes[..., 2:]], -1)
    moments = values.sum(-1, keepdims=True) - values
    return PrincipalAxes(phi[..., 0], phi[..., 1:4] / phi[..., :1], rotation, moments, values)


def triangle_margins(phi: ArrayLike) -> Array:
    """By how much each principal moment is less than the sum of the other two.

    Args:
        phi: (..., 10) inertial parameters with mass other than zero.

    Returns:
        (..., 3) margins (J₂ + J₃ − J₁) / (J₁ + J₂ + J₃) and so on, in ascending order: all above
        zero for a body that can exist, zero for a flat one, and they add up to one ([Lee2019]
        Eqs. (3.2.8)–(3.2.10)).

    Raises:
        ArgumentError: A body has no mass or no extent, or a value is not finite.
    """
    values = principal_axes(phi).second_moments
    if not (extent := values.sum(-1) > 0).all():
        bad = np.asarray(phi, float).reshape(-1, 10)[int(np.argmin(extent.ravel()))]
        raise ArgumentError(f"A body without extent has no margins; got {bad.tolist()}.")
    return np.asarray(values / values.sum(-1, keepdims=True))
