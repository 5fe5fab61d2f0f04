"""Inertial parameters of a rigid body, and the maps between their representations.

One body has ten inertial parameters, in this order everywhere in geodrake ([Lee2019] Eq. (3.2.1)):

    φ = [m, hx, hy, hz, Ixx, Iyy, Izz, Ixy, Iyz, Izx]

about the body origin Bo, expressed in the body frame B: mass m in kg, first mass moment
h = m p_BoBcm_B in kg·m, rotational inertia I_BBo_B in kg·m². φ is a linear image of the
pseudo-inertia P(φ) = ∫ [x;1][x;1]ᵀ dm, and is physical if and only if P(φ) ≻ 0 (Eq. (3.2.7)).

All functions broadcast over leading axes.
"""

from geodrake.inertia.body_distances import (
    entropic_divergence,
    pullback_distance,
    riemannian_distance,
)
from geodrake.inertia.ellipsoids import Ellipsoid, equivalent_ellipsoid, is_realizable
from geodrake.inertia.kernels import PARAMETERS_PER_BODY, Array
from geodrake.inertia.parameters import (
    change_frame,
    change_units,
    from_mass_com_inertia,
    from_pseudo_inertia,
    is_physical,
    pseudo_inertia,
    pullback_metric,
    to_mass_com_inertia,
)
from geodrake.inertia.perturbation import perturb
from geodrake.inertia.positive_definite import karcher_mean
from geodrake.inertia.spatial import from_spatial_inertia, inertial_parameters, to_spatial_inertia

__all__ = [
    "PARAMETERS_PER_BODY",
    "Array",
    "Ellipsoid",
    "change_frame",
    "change_units",
    "entropic_divergence",
    "equivalent_ellipsoid",
    "from_mass_com_inertia",
    "from_pseudo_inertia",
    "from_spatial_inertia",
    "inertial_parameters",
    "is_physical",
    "is_realizable",
    "karcher_mean",
    "perturb",
    "pseudo_inertia",
    "pullback_distance",
    "pullback_metric",
    "riemannian_distance",
    "to_mass_com_inertia",
    "to_spatial_inertia",
]
