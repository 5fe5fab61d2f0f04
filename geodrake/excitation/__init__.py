"""Excitation: from which motion parameters are identified best, and which from a given one.

    limits = motion_limits(model, acceleration=5.0)
    target = make_target(model, noise=0.1)                    # what is unknown, measured how well
    result = design_excitation(target, limits, trajectory=FourierMotion(10.0, 5))
    write_trajectory(result.trajectory, "motion.csv", model)

    rivals = [make_rival(name, model, limits) for name in ("coulomb_friction", "viscous_friction")]
    separation = make_separation(model, *rivals, noise=0.1)   # who is to be distinguished from whom
    result = design_separation(separation, limits)

A motion is judged by the eigenvalues of its information matrix, normalized so that neither frames
nor units nor the choice of base parameters matter ([Lee2019] Proposition 4.1).
"""

from geodrake.excitation.collision_geometry import Solid, floor_of
from geodrake.excitation.collisions import CollisionWorld
from geodrake.excitation.criteria import CRITERIA, Criterion
from geodrake.excitation.design import design_excitation
from geodrake.excitation.design_results import DesignOptions, ExcitationResult
from geodrake.excitation.families import FourierMotion, FreeSamples, MotionFamily, SplineMotion
from geodrake.excitation.identifiability import LogIdentifiability, log_identifiability
from geodrake.excitation.identifiable import (
    IdentifiableParameters,
    ReducedIdentification,
    identifiable_parameters,
    measurement_factor,
    reduced_identification,
)
from geodrake.excitation.information import Objective
from geodrake.excitation.limits import MotionLimits, motion_limits
from geodrake.excitation.normalization import NORMALIZATIONS
from geodrake.excitation.reduced_design import ReducedExcitation, design_reduced_excitation
from geodrake.excitation.rivals import make_rival
from geodrake.excitation.separation import Separation
from geodrake.excitation.target import Target, make_target
from geodrake.excitation.tell_apart import design_separation, make_separation
from geodrake.excitation.trajectory import ExcitationTrajectory
from geodrake.excitation.trajectory_files import (
    drake_trajectory,
    read_drake_trajectory,
    ros_joint_trajectory,
    write_trajectory,
)

__all__ = [
    "CRITERIA",
    "NORMALIZATIONS",
    "CollisionWorld",
    "Criterion",
    "DesignOptions",
    "ExcitationResult",
    "ExcitationTrajectory",
    "FourierMotion",
    "FreeSamples",
    "IdentifiableParameters",
    "LogIdentifiability",
    "MotionFamily",
    "MotionLimits",
    "Objective",
    "ReducedExcitation",
    "ReducedIdentification",
    "Separation",
    "Solid",
    "SplineMotion",
    "Target",
    "design_excitation",
    "design_reduced_excitation",
    "design_separation",
    "drake_trajectory",
    "floor_of",
    "identifiable_parameters",
    "log_identifiability",
    "make_rival",
    "make_separation",
    "make_target",
    "measurement_factor",
    "motion_limits",
    "read_drake_trajectory",
    "reduced_identification",
    "ros_joint_trajectory",
    "write_trajectory",
]
