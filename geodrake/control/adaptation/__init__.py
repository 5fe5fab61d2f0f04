"""Parameter adaptation: update laws on barrier-Hessian manifolds, [Lee2019] §5.4.

A controller provides a covector b with V̇_t ≤ (p̂ − p)ᵀ b, for its tracking error V_t, the true
parameters p and the estimate p̂. A law updates the estimate so that V_t + γ D(p‖p̂) never rises:

    p̂̇ = −γ⁻¹ g(p̂)⁻¹ b                                                     [Lee2019] Eq. (5.4.51)

Parameters are one vector [φ, μ], in the order of `geodrake.control.regressor.ControlModel`.
"""

from geodrake.control.adaptation.constraints import (
    ConvexSet,
    body_limits,
    center_of_mass_box,
    inside_ellipsoid,
    intersection,
    mass_limits,
    parameter_limits,
)
from geodrake.control.adaptation.law import (
    AdaptationLaw,
    ConstantMetric,
    UpdateLaw,
    euclidean_adaptation,
    natural_adaptation,
    pullback_adaptation,
)
from geodrake.control.adaptation.outer_laws import PartialLaw, ProjectedLaw
from geodrake.control.adaptation.robot_manifold import adapted_parameters, parameter_manifold

__all__ = [
    "AdaptationLaw",
    "ConstantMetric",
    "ConvexSet",
    "PartialLaw",
    "ProjectedLaw",
    "UpdateLaw",
    "adapted_parameters",
    "body_limits",
    "center_of_mass_box",
    "euclidean_adaptation",
    "inside_ellipsoid",
    "intersection",
    "mass_limits",
    "natural_adaptation",
    "parameter_limits",
    "parameter_manifold",
    "pullback_adaptation",
]
