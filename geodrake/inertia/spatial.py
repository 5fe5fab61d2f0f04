"""Inertial parameters as Drake's SpatialInertia, and of a Drake plant."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.framework import Context

from geodrake.boundary.arguments import instance, real_array
from geodrake.inertia.bodies import Member, check_context, check_plant, lumped_bodies
from geodrake.inertia.kernels import PARAMETERS_PER_BODY, Array
from geodrake.inertia.parameters import change_frame


def from_spatial_inertia(spatial: SpatialInertia) -> Array:
    """Return inertial parameters of Drake's M_BBo_B; shape (10,)."""
    instance(spatial, "spatial", SpatialInertia)
    inertia = spatial.get_mass() * spatial.get_unit_inertia().CopyToFullMatrix3()
    moments = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))]
    return np.array([spatial.get_mass(), *spatial.CalcComMoment(), *moments])


def to_spatial_inertia(phi: ArrayLike) -> SpatialInertia:
    """Return Drake's M_BBo_B of inertial parameters (10,); a zero mass gives zero inertia."""
    phi = real_array(phi, "phi", (PARAMETERS_PER_BODY,))
    mass = phi[0]
    if mass == 0.0:
        return SpatialInertia.Zero()
    unit = UnitInertia(*(phi[4:7] / mass), *(phi[[7, 9, 8]] / mass))
    return SpatialInertia(mass, phi[1:4] / mass, unit, skip_validity_check=True)


def inertial_parameters(plant: MultibodyPlant, context: Context | None = None) -> Array:
    """Return the parameters (nb, 10) of `lumped_bodies(plant)`, in their representatives' frames.

    They are those of a Context, by default the plant's default values.
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
