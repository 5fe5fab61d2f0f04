"""Inertial parameters, pseudo inertia, and mass with centre of mass: maps between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.errors import ArgumentError

Array = NDArray[np.float64]

PARAMETERS_PER_BODY = 10
PARAMETER_NAMES = ("m", "hx", "hy", "hz", "Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Izx")
PARAMETER_UNITS = ("kg", *("kg·m",) * 3, *("kg·m²",) * 6)

_IDENTITY = np.eye(3)


def checked(values: ArrayLike, end: tuple[int, ...]) -> Array:
    """An array of shape (..., *end).

    Raises:
        ArgumentError: The shape ends otherwise.
    """
    array = np.asarray(values, float)
    if array.shape[-len(end) :] != end:
        expected = ", ".join(map(str, end))
        raise ArgumentError(
            f"Expected an array of shape (..., {expected}); got the shape {array.shape}."
        )
    return array


def rotational_inertia(phi: ArrayLike) -> Array:
    """Rotational inertia matrix I_BBo_B.

    Args:
        phi: (..., 10) inertial parameters.

    Returns:
        (..., 3, 3) symmetric matrices, kg·m² ([Lee2019] Eq. (B.1.1)).
    """
    phi = checked(phi, (PARAMETERS_PER_BODY,))
    xx, yy, zz, xy, yz, zx = np.moveaxis(phi[..., 4:], -1, 0)
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
    matrix = checked(matrix, (4, 4))
    second_moment = matrix[..., :3, :3]
    trace = np.trace(second_moment, axis1=-2, axis2=-1)[..., None]
    diagonal = trace - np.diagonal(second_moment, axis1=-2, axis2=-1)
    products = [-second_moment[..., i, j] for i, j in ((0, 1), (1, 2), (2, 0))]
    return np.concatenate(
        [matrix[..., 3:, 3], matrix[..., :3, 3], diagonal, np.stack(products, -1)], -1
    )


_BASIS = pseudo_inertia(np.eye(PARAMETERS_PER_BODY))
_DUAL_BASIS = np.einsum(
    "ij,jab->iab", np.linalg.inv(np.einsum("iab,jab->ij", _BASIS, _BASIS)), _BASIS
)


def pseudo_inertia_basis() -> Array:
    """The ten matrices P(e_i), so that P(φ) = Σ φ_i P(e_i); shape (10, 4, 4)."""
    return _BASIS.copy()


def dual(covector: ArrayLike) -> Array:
    """The matrix X(a) of a linear function aᵀφ, such that aᵀφ = tr(P(φ) X(a)).

    Args:
        covector: (..., 10) coefficients a, in the order of φ.

    Returns:
        (..., 4, 4) symmetric matrices ([Lee2019] Eqs. (B.1.8), (B.1.9)).
    """
    return np.asarray(
        np.einsum("...i,iab->...ab", checked(covector, (PARAMETERS_PER_BODY,)), _DUAL_BASIS)
    )


def from_dual(matrix: ArrayLike) -> Array:
    """The covector a of a symmetric matrix X(a), the inverse of `dual`.

    Args:
        matrix: (..., 4, 4) symmetric matrices, such as the Q of an ellipsoid.

    Returns:
        (..., 10) coefficients tr(P(eᵢ) X).
    """
    return np.asarray(np.einsum("...ab,iab->...i", checked(matrix, (4, 4)), _BASIS))


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
    mass, com = np.asarray(mass, float), checked(com, (3,))
    squared = (com * com).sum(-1)[..., None, None] * _IDENTITY - com[..., :, None] * com[
        ..., None, :
    ]
    inertia = checked(inertia_com, (3, 3)) + mass[..., None, None] * squared
    moments = [inertia[..., i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))]
    return np.concatenate([mass[..., None], mass[..., None] * com, np.stack(moments, -1)], -1)


def to_mass_com_inertia(phi: ArrayLike) -> tuple[Array, Array, Array]:
    """Mass, centre of mass and central inertia, the inverse of `from_mass_com_inertia`.

    Args:
        phi: (..., 10) inertial parameters with mass other than zero.

    Returns:
        mass (...), com (..., 3) and inertia_com (..., 3, 3).
    """
    phi = checked(phi, (PARAMETERS_PER_BODY,))
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
    R_AB, p_AoBo_A = checked(R_AB, (3, 3)), checked(p_AoBo_A, (3,))
    H_AB = np.zeros((*np.broadcast_shapes(R_AB.shape[:-2], p_AoBo_A.shape[:-1]), 4, 4))
    H_AB[..., :3, :3], H_AB[..., :3, 3], H_AB[..., 3, 3] = R_AB, p_AoBo_A, 1.0
    return from_pseudo_inertia(H_AB @ pseudo_inertia(phi) @ np.swapaxes(H_AB, -1, -2))


def change_units(phi: ArrayLike, *, metre: float, kilogram: float) -> Array:
    """Inertial parameters in other units of length and mass.

    Args:
        phi: (..., 10) inertial parameters in SI.
        metre: One metre in the new unit, such as 39.37 for inches.
        kilogram: One kilogram in the new unit.

    Returns:
        (..., 10) the numbers of the same bodies in the new units ([Lee2019] Eq. (3.3.24)).

    Raises:
        ArgumentError: A unit is not above zero.
    """
    if not (metre > 0 and kilogram > 0):
        raise ArgumentError(
            f"Units are above zero; got metre={metre:g} and kilogram={kilogram:g}.",
            advice="Give one metre and one kilogram in the new units.",
        )
    return (
        checked(phi, (PARAMETERS_PER_BODY,)) * kilogram * metre ** np.repeat([0, 1, 2], [1, 3, 6])
    )


def from_point_masses(masses: ArrayLike, positions: ArrayLike) -> Array:
    """Inertial parameters of a set of point masses.

    Args:
        masses: (..., k) masses, kg; negative ones take mass away.
        positions: (..., k, 3) positions from Bo, expressed in B, m.

    Returns:
        (..., 10) parameters of Σ mₖ [xₖ;1][xₖ;1]ᵀ ([Lee2019] Eq. (3.2.5)).
    """
    x, masses = checked(positions, (3,)), np.asarray(masses, float)
    if not masses.ndim or masses.shape[-1:] != x.shape[-2:-1]:
        raise ArgumentError(
            f"Expected a mass for each position; got masses {masses.shape} and positions {x.shape}."
        )
    points = np.concatenate([x, np.ones((*x.shape[:-1], 1))], -1)
    matrix = np.einsum("...k,...ki,...kj->...ij", masses, points, points)
    return from_pseudo_inertia(matrix)


def pullback_metric(phi: ArrayLike) -> Array:
    """Metric g(φ) of the affine-invariant distance, pulled back to inertial parameters.

    Args:
        phi: (..., 10) physical inertial parameters.

    Returns:
        (..., 10, 10) matrices ½ tr(P⁻¹ P(e_i) P⁻¹ P(e_j)) ([Lee2019] Eq. (B.1.7)).

    Raises:
        ArgumentError: A body's P(φ) is singular, so that there is no metric.
    """
    try:
        solved = np.linalg.solve(pseudo_inertia(phi)[..., None, :, :], _BASIS)
    except np.linalg.LinAlgError:
        bad = np.flatnonzero(~np.atleast_1d(is_physical(phi)).ravel()).tolist()
        raise ArgumentError(
            f"There is no metric at bodies {bad}: they are not physical.",
            advice="The metric exists at parameters that a solid body can have.",
            bodies=bad,
        ) from None
    return 0.5 * np.einsum("...iab,...jba->...ij", solved, solved)
