"""Maps between inertial parameters, pseudo-inertias, and mass with centre of mass and inertia."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import Sizes, number, positive, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.inertia.kernels import (
    BASIS,
    PARAMETERS_PER_BODY,
    Array,
    calc_change_frame,
    calc_dual,
    calc_from_mass_com_inertia,
    calc_from_pseudo_inertia,
    calc_parallel_axis,
    calc_pseudo_inertia,
    calc_rotational_inertia,
)

PARAMETER_NAMES = ("m", "hx", "hy", "hz", "Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Izx")
PARAMETER_UNITS = ("kg", *("kg·m",) * 3, *("kg·m²",) * 6)


def checked_phi(phi: ArrayLike, name: str = "phi", sizes: Sizes | None = None) -> Array:
    """Return finite inertial parameters (..., 10), or raise an ArgumentError.

    `sizes` are the lengths of the axes `...` so far, to which this array adds.
    """
    return real_array(phi, name, ("...", PARAMETERS_PER_BODY), sizes)


def pseudo_inertia(phi: ArrayLike) -> Array:
    """Return the pseudo-inertia P(φ) = [[Σ, h], [hᵀ, m]] (..., 4, 4) of φ (..., 10).

    [Lee2019] Eq. (B.1.4).
    """
    return calc_pseudo_inertia(checked_phi(phi))


def from_pseudo_inertia(matrix: ArrayLike) -> Array:
    """Return inertial parameters (..., 10) of symmetric P (..., 4, 4); inverts `pseudo_inertia`.

    [Lee2019] Eq. (B.1.6).
    """
    return calc_from_pseudo_inertia(real_array(matrix, "matrix", ("...", 4, 4)))


def pseudo_inertia_basis() -> Array:
    """Return the ten matrices P(e_i), so that P(φ) = Σ φ_i P(e_i); shape (10, 4, 4)."""
    return BASIS.copy()


def dual(covector: ArrayLike) -> Array:
    """Return the matrices X(a) (..., 4, 4) with aᵀφ = tr(P(φ) X(a)), for a (..., 10).

    [Lee2019] Eqs. (B.1.8), (B.1.9).
    """
    return calc_dual(checked_phi(covector, "covector"))


def from_dual(matrix: ArrayLike) -> Array:
    """Return the covectors tr(P(eᵢ) X) (..., 10) of symmetric X (..., 4, 4); inverts `dual`."""
    matrix = real_array(matrix, "matrix", ("...", 4, 4))
    return np.asarray(np.einsum("...ab,iab->...i", matrix, BASIS))


def is_physical(phi: ArrayLike, *, tolerance: float = 0.0) -> NDArray[np.bool_]:
    """Return whether P(φ) ≻ 0 (...), so that a body of positive density can have φ (..., 10).

    Parameters with NaN or infinity are not physical ([Lee2019] Eq. (3.2.7)).

    Args:
        tolerance: Least ratio of the smallest to the largest eigenvalue of P, in units in which the
            largest diagonal second moment equals the mass.
    """
    phi = real_array(phi, "phi", ("...", PARAMETERS_PER_BODY), finite=False)
    tolerance = number(tolerance, "tolerance")
    finite = np.asarray(np.isfinite(phi).all(-1))
    matrix = calc_pseudo_inertia(np.where(finite[..., None], phi, 0.0))
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
    """Return inertial parameters (..., 10) about Bo from mass, centre of mass and central inertia.

    Args:
        mass: (...) masses, kg.
        com: (..., 3) centres of mass p_BoBcm_B, m.
        inertia_com: (..., 3, 3) rotational inertias I_BBcm_B about the centre of mass, kg·m².
    """
    sizes: Sizes = {}
    mass = real_array(mass, "mass", ("...",), sizes)
    com = real_array(com, "com", ("...", 3), sizes)
    inertia_com = real_array(inertia_com, "inertia_com", ("...", 3, 3), sizes)
    mass, leading = np.broadcast_to(mass, sizes["..."]), sizes["..."]
    com = np.broadcast_to(com, (*leading, 3))
    return calc_from_mass_com_inertia(mass, com, inertia_com)


def to_mass_com_inertia(phi: ArrayLike) -> tuple[Array, Array, Array]:
    """Return mass (...), centre of mass (..., 3) and central inertia (..., 3, 3) of φ (..., 10).

    The inverse of `from_mass_com_inertia`, for nonzero masses.
    """
    phi = checked_phi(phi)
    mass = phi[..., 0]
    if not mass.all():
        raise ArgumentError(f"A body without mass has no centre of mass; got {mass.tolist()}.")
    com = phi[..., 1:4] / phi[..., :1]
    return mass, com, calc_rotational_inertia(phi) - calc_parallel_axis(mass, com)


def change_frame(phi: ArrayLike, R_AB: ArrayLike, p_AoBo_A: ArrayLike) -> Array:
    """Return inertial parameters (..., 10) about Ao in frame A, from those φ about Bo in frame B.

    [Lee2019] Eq. (3.3.24).

    Args:
        R_AB: (..., 3, 3) rotation of B in A.
        p_AoBo_A: (..., 3) position of Bo from Ao, expressed in A, m.
    """
    sizes: Sizes = {}
    phi = checked_phi(phi, "phi", sizes)
    R_AB = real_array(R_AB, "R_AB", ("...", 3, 3), sizes)
    p_AoBo_A = real_array(p_AoBo_A, "p_AoBo_A", ("...", 3), sizes)
    return calc_change_frame(phi, R_AB, p_AoBo_A)


def change_units(phi: ArrayLike, *, metre: float, kilogram: float) -> Array:
    """Return inertial parameters (..., 10) in other units of length and mass.

    [Lee2019] Eq. (3.3.24).

    Args:
        metre: One metre in the new unit, such as 39.37 for inches.
        kilogram: One kilogram in the new unit.
    """
    metre, kilogram = positive(metre, "metre"), positive(kilogram, "kilogram")
    return checked_phi(phi) * kilogram * metre ** np.repeat([0, 1, 2], [1, 3, 6])


def from_point_masses(masses: ArrayLike, positions: ArrayLike) -> Array:
    """Return inertial parameters (..., 10) of Σ mₖ [xₖ;1][xₖ;1]ᵀ ([Lee2019] Eq. (3.2.5)).

    Args:
        masses: (..., k) masses, kg; may be negative.
        positions: (..., k, 3) positions from Bo, expressed in B, m.
    """
    sizes: Sizes = {}
    masses = real_array(masses, "masses", ("...", "k"), sizes)
    x = real_array(positions, "positions", ("...", "k", 3), sizes)
    points = np.concatenate([x, np.ones((*x.shape[:-1], 1))], -1)
    matrix = np.einsum("...k,...ki,...kj->...ij", masses, points, points)
    return from_pseudo_inertia(matrix)


def pullback_metric(phi: ArrayLike) -> Array:
    """Return the metric g(φ) = ½ tr(P⁻¹ P(e_i) P⁻¹ P(e_j)) (..., 10, 10) of physical φ (..., 10).

    The affine-invariant metric, pulled back to inertial parameters ([Lee2019] Eq. (B.1.7)).
    """
    phi = checked_phi(phi)
    bad = np.flatnonzero(~is_physical(phi)).tolist()
    try:
        if bad:
            raise np.linalg.LinAlgError
        solved = np.linalg.solve(calc_pseudo_inertia(phi)[..., None, :, :], BASIS)
    except np.linalg.LinAlgError:
        raise ArgumentError(
            f"Bodies {bad} are not physical, so they have no metric.",
            advice="The metric needs physically valid parameters.",
            bodies=bad,
        ) from None
    return 0.5 * np.einsum("...iab,...jba->...ij", solved, solved)


@dataclass(frozen=True, eq=False)
class PrincipalAxes(Short):
    """Inertias of bodies about their centres of mass, in principal axes.

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
    """Return the second moments Σᶜ = Σ − m p pᵀ (..., 3, 3), kg·m², about the centre of mass.

    [Lee2019] Eq. (3.3.17).
    """
    matrix = pseudo_inertia(phi)
    h, mass = matrix[..., :3, 3], matrix[..., 3, 3]
    if not mass.all():
        bad = np.asarray(phi, float).reshape(-1, 10)[int(np.argmin(np.abs(mass).ravel()))]
        raise ArgumentError(f"A body without mass has no centre of mass; got {bad.tolist()}.")
    squared = h[..., :, None] * h[..., None, :] / mass[..., None, None]
    return np.asarray(matrix[..., :3, :3] - squared)


def principal_axes(phi: ArrayLike) -> PrincipalAxes:
    """Return the principal axes of bodies φ (..., 10) with nonzero mass."""
    phi = checked_phi(phi)
    values, axes = np.linalg.eigh(central_second_moment(phi))
    handedness = np.where(np.linalg.det(axes) < 0, -1.0, 1.0)
    rotation = np.concatenate([axes[..., :2], handedness[..., None, None] * axes[..., 2:]], -1)
    moments = values.sum(-1, keepdims=True) - values
    return PrincipalAxes(phi[..., 0], phi[..., 1:4] / phi[..., :1], rotation, moments, values)
