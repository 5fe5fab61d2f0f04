"""Inertial parameters as 6×6 spatial inertia, as Drake's SpatialInertia, and of a Drake plant."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.framework import Context

from geodrake.boundary.arguments import instance, real_array
from geodrake.inertia.bodies import Member, check_context, check_plant, lumped_bodies
from geodrake.inertia.kernels import PARAMETERS_PER_BODY, Array
from geodrake.inertia.parameters import (
    change_frame,
    checked_phi,
    rotational_inertia,
)


def spatial_inertia_matrix(phi: ArrayLike) -> Array:
    """Spatial inertia G(φ) = [[I, [h]], [[h]ᵀ, m 𝟙]] (..., 6, 6) about Bo, of φ (..., 10).

    T = ½ Vᵀ G V for V = (ω, v) ([Lee2019] Eq. (3.2.3)): rotation first, as in Drake.
    """
    phi = checked_phi(phi)
    matrix = np.zeros((*phi.shape[:-1], 6, 6))
    matrix[..., :3, :3] = rotational_inertia(phi)
    for (i, j), k, sign in (((0, 1), 3, -1), ((0, 2), 2, 1), ((1, 2), 1, -1)):
        matrix[..., i, 3 + j] = matrix[..., 3 + j, i] = sign * phi[..., k]
        matrix[..., j, 3 + i] = matrix[..., 3 + i, j] = -sign * phi[..., k]
    matrix[..., range(3, 6), range(3, 6)] = phi[..., :1]
    return matrix


def from_spatial_inertia_matrix(matrix: ArrayLike) -> Array:
    """Inertial parameters (..., 10) of G (..., 6, 6), the inverse of `spatial_inertia_matrix`."""
    matrix = real_array(matrix, "matrix", ("...", 6, 6))
    places = ((5, 5), (2, 4), (0, 5), (1, 3), (0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))
    return np.stack([matrix[..., i, j] for i, j in places], -1)


def from_spatial_inertia(spatial: SpatialInertia) -> Array:
    """Return inertial parameters of Drake's M_BBo_B; shape (10,)."""
    instance(spatial, "spatial", SpatialInertia)
    inertia = spatial.get_mass() * spatial.get_unit_inertia().CopyToFullMatrix3()
    moments = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))]
    return np.array([spatial.get_mass(), *spatial.CalcComMoment(), *moments])


def to_spatial_inertia(phi: ArrayLike) -> SpatialInertia:
    """Drake's M_BBo_B of one body's inertial parameters (10,); a zero mass gives zero inertia."""
    phi = real_array(phi, "phi", (PARAMETERS_PER_BODY,))
    mass = phi[0]
    if mass == 0.0:
        return SpatialInertia.Zero()
    unit = UnitInertia(*(phi[4:7] / mass), *(phi[[7, 9, 8]] / mass))
    return SpatialInertia(mass, phi[1:4] / mass, unit, skip_validity_check=True)


def inertial_parameters(plant: MultibodyPlant, context: Context | None = None) -> Array:
    """Inertial parameters (nb, 10) of `lumped_bodies(plant)`, each in its representative's frame.

    They are those of a Context; the plant's default values if None.
    """
    check_plant(plant)
    if context is None:
        context = plant.CreateDefaultContext()
    else:
        check_context(plant, context)

    def parameters(member: Member) -> Array:
        spatial = plant.get_body(member.index).CalcSpatialInertiaInBodyFrame(context)
        return change_frame(
            from_spatial_inertia(spatial),
            member.X_RB.rotation().matrix(),
            member.X_RB.translation(),
        )

    lumps = [sum(map(parameters, body.members)) for body in lumped_bodies(plant)]
    return np.array(lumps).reshape(-1, PARAMETERS_PER_BODY)
