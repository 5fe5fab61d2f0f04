"""Excitation: design of motions for identification, and identifiability of parameters.

    limits = motion_limits(model, bounded=True)               # of the robot's joints
    target = make_target(model, noise=0.1)                    # unknown parameters and noise
    result = design_excitation(target, limits, trajectory=FourierMotion(10.0, 5))
    write_trajectory(result.executed, "motion.csv", model)

The criterion of a motion is a function of the eigenvalues of its information matrix, normalized to
be independent of frames, units and the choice of base parameters ([Lee2019] Proposition 4.1), or
the separation of two effects (`geodrake.excitation.tell_apart`).
"""

from geodrake.excitation.collisions import CollisionWorld, Solid
from geodrake.excitation.design import design_excitation, random_excitation
from geodrake.excitation.families import FourierMotion, FreeSamples, SplineMotion
from geodrake.excitation.identifiable import (
    IdentifiableParameters,
    ReducedIdentification,
    identifiable_parameters,
    log_identifiability,
    measurement_factor,
    reduced_identification,
)
from geodrake.excitation.limits import MotionLimits, motion_limits
from geodrake.excitation.objective import Criterion, Objective
from geodrake.excitation.placing import make_stance
from geodrake.excitation.problem import DesignOptions
from geodrake.excitation.stance import Foot, Stance
from geodrake.excitation.target import Target, make_target
from geodrake.excitation.tell_apart import Separation, make_rival, make_separation
from geodrake.excitation.trajectory import (
    ExcitationTrajectory,
    read_drake_trajectory,
    write_trajectory,
)

__all__ = [
    "CollisionWorld",
    "Criterion",
    "DesignOptions",
    "ExcitationTrajectory",
    "Foot",
    "FourierMotion",
    "FreeSamples",
    "IdentifiableParameters",
    "MotionLimits",
    "Objective",
    "ReducedIdentification",
    "Separation",
    "Solid",
    "SplineMotion",
    "Stance",
    "Target",
    "design_excitation",
    "identifiable_parameters",
    "log_identifiability",
    "make_rival",
    "make_separation",
    "make_stance",
    "make_target",
    "measurement_factor",
    "motion_limits",
    "random_excitation",
    "read_drake_trajectory",
    "reduced_identification",
    "write_trajectory",
]
