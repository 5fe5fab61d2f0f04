"""Inertial parameters of a rigid body, and the maps between their representations.

One body has ten inertial parameters, in this order everywhere in geodrake ([Lee2019] Eq. (3.2.1)):

    φ = [m, hx, hy, hz, Ixx, Iyy, Izz, Ixy, Iyz, Izx]

about the body origin Bo, expressed in the body frame B: mass m in kg, first mass moment
h = m p_BoBcm_B in kg·m, rotational inertia I_BBo_B in kg·m². φ is the linear image of the pseudo
inertia P(φ) = ∫ [x;1][x;1]ᵀ dm, and a body can exist just when P(φ) ≻ 0 (Eq. (3.2.7)).

All functions broadcast over leading axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.framework import Context

from geodrake.bodies import Member, lumped_bodies

Array = NDArray[np.float64]

PARAMETERS_PER_BODY = 10
PARAMETER_NAMES = ("m", "hx", "hy", "hz", "Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Izx")
PARAMETER_UNITS = ("kg", *("kg·m",) * 3, *("kg·m²",) * 6)

_IDENTITY = np.eye(3)


def rotational_inertia(phi: ArrayLike) -> Array:
    """Rotational inertia matrix I_BBo_B.

    Args:
        phi: (..., 10) inertial parameters.

    Returns:
        (..., 3, 3) symmetric matrices, kg·m² ([Lee2019] Eq. (B.1.1)).
    """
    xx, yy, zz, xy, yz, zx = np.moveaxis(np.asarray(phi, float)[..., 4:], -1, 0)
    rows = [np.stack(row, -1) for row in ((xx, xy, zx), (xy, yy, yz), (zx, yz, zz))]
    return np.stack(rows, -2)


def pseudo_inertia(phi: ArrayLike) -> Array:
    """Pseudo inertia P(φ) of inertial parameters.

    Args:
        phi: (..., 10) inertial parameters.

    Returns:
        (..., 4, 4) symmetric matrices [[Σ, h], [hᵀ, m]] ([Lee2019] Eq. (B.1.4)).
    """
    phi = np.asarray(phi, float)
    inertia = rotational_inertia(phi)
    half_trace = 0.5 * np.trace(inertia, axis1=-2, axis2=-1)
    matrix = np.empty((*phi.shape[:-1], 4, 4))
    matrix[..., :3, :3] = half_trace[..., None, None] * _IDENTITY - inertia
    matrix[..., :3, 3] = matrix[..., 3, :3] = phi[..., 1:4]
    matrix[..., 3, 3] = phi[..., 0]
    return matrix


def from_pseudo_inertia(matrix: ArrayLike) -> Array:
    """Inertial parameters of a pseudo inertia, the inverse of `pseudo_inertia`.

    Args:
        matrix: (..., 4, 4) symmetric matrices.

    Returns:
        (..., 10) inertial parameters ([Lee2019] Eq. (B.1.6)).
    """
    matrix = np.asarray(matrix, float)
    second_moment = matrix[..., :3, :3]
    trace = np.trace(second_moment, axis1=-2, axis2=-1)[..., None]
    diagonal = trace - np.diagonal(second_moment, axis1=-2, axis2=-1)
    products = [-second_moment[..., i, j] for i, j in ((0, 1), (1, 2), (2, 0))]
    return np.concatenate(
        [matrix[..., 3:, 3], matrix[..., :3, 3], diagonal, np.stack(products, -1)], -1
    )


_BASIS = pseudo_inertia(np.eye(PARAMETERS_PER_BODY))


def pseudo_inertia_basis() -> Array:
    """The ten matrices P(e_i), so that P(φ) = Σ φ_i P(e_i); shape (10, 4, 4)."""
    return _BASIS.copy()


def is_physical(phi: ArrayLike, *, tolerance: float = 0.0) -> NDArray[np.bool_]:
    """Whether P(φ) ≻ 0, so that a body of positive density can have these parameters.

    Args:
        phi: (..., 10) inertial parameters.
        tolerance: Least ratio of P's smallest to its largest eigenvalue that counts, in units
            where the largest diagonal second moment is the mass (so it does not depend on units).

    Returns:
        (...) booleans ([Lee2019] Eq. (3.2.7)).
    """
    matrix = pseudo_inertia(phi)
    finite = np.asarray(np.isfinite(matrix).all((-2, -1)))
    matrix = np.where(finite[..., None, None], matrix, 0.0)
    moments = np.diagonal(matrix, axis1=-2, axis2=-1)[..., :3].max(-1, initial=0.0)
    mass = matrix[..., 3, 3]
    usable = finite & (mass > 0) & (moments > 0)
    length = np.sqrt(np.where(usable, moments, 1.0) / np.where(usable, mass, 1.0))
    scale = np.concatenate(
        [np.repeat(1.0 / length[..., None], 3, axis=-1), np.ones((*length.shape, 1))], -1
    )
    eigenvalues = np.linalg.eigvalsh(matrix * scale[..., :, None] * scale[..., None, :])
    return usable & (eigenvalues[..., 0] > tolerance * eigenvalues[..., -1])


def from_mass_com_inertia(mass: ArrayLike, com: ArrayLike, inertia_com: ArrayLike) -> Array:
    """Inertial parameters from mass, centre of mass and central inertia.

    Args:
        mass: (...) masses, kg.
        com: (..., 3) centres of mass p_BoBcm_B, m.
        inertia_com: (..., 3, 3) rotational inertias I_BBcm_B about the centre of mass, kg·m².

    Returns:
        (..., 10) inertial parameters about Bo.
    """
    mass, com = np.asarray(mass, float), np.asarray(com, float)
    squared = (com * com).sum(-1)[..., None, None] * _IDENTITY - com[..., :, None] * com[
        ..., None, :
    ]
    inertia = np.asarray(inertia_com, float) + mass[..., None, None] * squared
    moments = [inertia[..., i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))]
    return np.concatenate([mass[..., None], mass[..., None] * com, np.stack(moments, -1)], -1)


def to_mass_com_inertia(phi: ArrayLike) -> tuple[Array, Array, Array]:
    """Mass, centre of mass and central inertia, the inverse of `from_mass_com_inertia`.

    Args:
        phi: (..., 10) inertial parameters with mass other than zero.

    Returns:
        mass (...), com (..., 3) and inertia_com (..., 3, 3).
    """
    phi = np.asarray(phi, float)
    mass, com = phi[..., 0], phi[..., 1:4] / phi[..., :1]
    squared = (com * com).sum(-1)[..., None, None] * _IDENTITY - com[..., :, None] * com[
        ..., None, :
    ]
    return mass, com, rotational_inertia(phi) - mass[..., None, None] * squared


def change_frame(phi: ArrayLike, R_AB: ArrayLike, p_AoBo_A: ArrayLike) -> Array:
    """Inertial parameters about Ao, expressed in A, of a body known about Bo in B.

    Args:
        phi: (..., 10) inertial parameters in B.
        R_AB: (..., 3, 3) rotation of B in A.
        p_AoBo_A: (..., 3) position of Bo from Ao, expressed in A, m.

    Returns:
        (..., 10) inertial parameters in A ([Lee2019] Eq. (3.3.24)).
    """
    R_AB, p_AoBo_A = np.asarray(R_AB, float), np.asarray(p_AoBo_A, float)
    H_AB = np.zeros((*np.broadcast_shapes(R_AB.shape[:-2], p_AoBo_A.shape[:-1]), 4, 4))
    H_AB[..., :3, :3], H_AB[..., :3, 3], H_AB[..., 3, 3] = R_AB, p_AoBo_A, 1.0
    return from_pseudo_inertia(H_AB @ pseudo_inertia(phi) @ np.swapaxes(H_AB, -1, -2))


def pullback_metric(phi: ArrayLike) -> Array:
    """Metric g(φ) of the affine-invariant distance, pulled back to inertial parameters.

    Args:
        phi: (..., 10) physical inertial parameters.

    Returns:
        (..., 10, 10) matrices ½ tr(P⁻¹ P(e_i) P⁻¹ P(e_j)) ([Lee2019] Eq. (B.1.7)).
    """
    solved = np.linalg.solve(pseudo_inertia(phi)[..., None, :, :], _BASIS)
    return 0.5 * np.einsum("...iab,...jba->...ij", solved, solved)


def from_spatial_inertia(spatial: SpatialInertia) -> Array:
    """Inertial parameters of Drake's M_BBo_B; shape (10,)."""
    inertia = spatial.get_mass() * spatial.get_unit_inertia().CopyToFullMatrix3()
    moments = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))]
    return np.array([spatial.get_mass(), *spatial.CalcComMoment(), *moments])


def to_spatial_inertia(phi: ArrayLike) -> SpatialInertia:
    """Drake's M_BBo_B of one body's inertial parameters (10,); a zero mass gives zero inertia."""
    phi = np.asarray(phi, float)
    mass = phi[0]
    if mass == 0.0:
        return SpatialInertia.Zero()
    unit = UnitInertia(*(phi[4:7] / mass), *(phi[[7, 9, 8]] / mass))
    return SpatialInertia(mass, phi[1:4] / mass, unit, skip_validity_check=True)


def inertial_parameters(plant: MultibodyPlant, context: Context | None = None) -> Array:
    """Inertial parameters of a plant's bodies.

    Args:
        plant: A finalized plant.
        context: Where to read the parameters; the plant's default values if None.

    Returns:
        (nb, 10) parameters of `geodrake.bodies.lumped_bodies(plant)`, each in the frame of its
        representative.
    """
    if context is None:
        context = plant.CreateDefaultContext()

    def parameters(member: Member) -> Array:
        spatial = plant.get_body(member.index).CalcSpatialInertiaInBodyFrame(context)
        return change_frame(
            from_spatial_inertia(spatial),
            member.X_RB.rotation().matrix(),
            member.X_RB.translation(),
        )

    lumps = [sum(map(parameters, body.members)) for body in lumped_bodies(plant)]
    return np.array(lumps).reshape(-1, PARAMETERS_PER_BODY)
