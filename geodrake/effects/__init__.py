"""Physical effects: what a rigid-body model lacks, one effect a file.

The effort that a robot needs is that of its rigid bodies and a sum of effects, DESIGN's Eq. (1).
`catalogue` lists the effects that come with geodrake. One of your own is a frozen dataclass with a
name, its parameters with units and bounds, and the regressor columns that multiply them. A hose
that hangs from a link, and turns with it, takes ten lines:

    from dataclasses import dataclass
    import numpy as np
    from geodrake.effects import JointEffect, Parameter

    @dataclass(frozen=True)
    class HangingHose(JointEffect):
        name = "hanging_hose"
        parameters = (Parameter("cosine", "N·m"), Parameter("sine", "N·m"))

        def columns(self, joint):
            return [np.cos(joint.q), np.sin(joint.q)]

`HangingHose("elbow")` then works wherever an effect does; `load_effect_file` reads such a file, and
its effects are passed on as `extra`. Further fields are shape parameters, and `candidates` says
which values of them to try (see `StribeckFriction`). What an effect needs to know of more than one
joint it gets by overriding `rows` (see `CoupledFriction`); what acts on a body derives from
`BodyEffect` (see `Payload`). Excitation needs derivatives of the columns; `slopes` gives them, and
without it they are taken by differences.
"""

from __future__ import annotations

from geodrake.effects.aerodynamic_drag import AerodynamicDrag
from geodrake.effects.asymmetric_friction import AsymmetricFriction
from geodrake.effects.backlash import Backlash
from geodrake.effects.base import (
    BodyEffect,
    Effect,
    JointEffect,
    JointMotion,
    JointPairEffect,
    Parameter,
    RobotMotion,
)
from geodrake.effects.contact import Contact
from geodrake.effects.coulomb_friction import CoulombFriction
from geodrake.effects.coupled_friction import CoupledFriction
from geodrake.effects.coupled_rotor_inertia import CoupledRotorInertia
from geodrake.effects.effort_delay import EffortDelay
from geodrake.effects.effort_offset import EffortOffset
from geodrake.effects.effort_scale import EffortScale
from geodrake.effects.friction_drift import FrictionDrift
from geodrake.effects.gravity_compensator import GravityCompensator
from geodrake.effects.gravity_tilt import GravityTilt
from geodrake.effects.hysteresis import Hysteresis
from geodrake.effects.joint_elasticity import JointElasticity
from geodrake.effects.joint_spring import JointSpring
from geodrake.effects.load_dependent_friction import LoadDependentFriction
from geodrake.effects.lookup import catalogue, effect_class, load_effect_file, make_effect
from geodrake.effects.nonlinear_viscous_friction import NonlinearViscousFriction
from geodrake.effects.payload import Payload
from geodrake.effects.robot_effect import RobotEffect
from geodrake.effects.rotor_inertia import RotorInertia
from geodrake.effects.stribeck_friction import StribeckFriction
from geodrake.effects.torque_ripple import TorqueRipple
from geodrake.effects.viscous_friction import ViscousFriction

__all__ = [
    "AerodynamicDrag",
    "AsymmetricFriction",
    "Backlash",
    "BodyEffect",
    "Contact",
    "CoulombFriction",
    "CoupledFriction",
    "CoupledRotorInertia",
    "Effect",
    "EffortDelay",
    "EffortOffset",
    "EffortScale",
    "FrictionDrift",
    "GravityCompensator",
    "GravityTilt",
    "Hysteresis",
    "JointEffect",
    "JointElasticity",
    "JointMotion",
    "JointPairEffect",
    "JointSpring",
    "LoadDependentFriction",
    "NonlinearViscousFriction",
    "Parameter",
    "Payload",
    "RobotEffect",
    "RobotMotion",
    "RotorInertia",
    "StribeckFriction",
    "TorqueRipple",
    "ViscousFriction",
    "catalogue",
    "effect_class",
    "load_effect_file",
    "make_effect",
]
