# Written by geodrake.effects.generated.stub(), as effects are found at run time.

from geodrake.effects.aerodynamic_drag import AerodynamicDrag
from geodrake.effects.asymmetric_friction import AsymmetricFriction
from geodrake.effects.backlash import Backlash
from geodrake.effects.base import BodyEffect, Effect, JointEffect, JointPairEffect
from geodrake.effects.contact import Contact
from geodrake.effects.coulomb_friction import CoulombFriction
from geodrake.effects.coupled_friction import CoupledFriction
from geodrake.effects.coupled_rotor_inertia import CoupledRotorInertia
from geodrake.effects.effort_delay import EffortDelay
from geodrake.effects.effort_offset import EffortOffset
from geodrake.effects.effort_scale import EffortScale
from geodrake.effects.fitted_effect import FittedEffect
from geodrake.effects.friction_drift import FrictionDrift
from geodrake.effects.friction_overcompensation import FrictionOvercompensation
from geodrake.effects.gear_efficiency import GearEfficiency
from geodrake.effects.gravity_compensator import GravityCompensator
from geodrake.effects.gravity_tilt import GravityTilt
from geodrake.effects.hysteresis import Hysteresis
from geodrake.effects.joint_elasticity import JointElasticity
from geodrake.effects.joint_spring import JointSpring
from geodrake.effects.load_dependent_friction import LoadDependentFriction
from geodrake.effects.lookup import catalogue, effect_class, make_effect
from geodrake.effects.nonlinear_viscous_friction import NonlinearViscousFriction
from geodrake.effects.parameter import Parameter
from geodrake.effects.payload import Payload
from geodrake.effects.robot_effect import RobotEffect
from geodrake.effects.robot_motion import JointMotion, RobotMotion
from geodrake.effects.role import Proposer, Role
from geodrake.effects.rotor_inertia import RotorInertia
from geodrake.effects.shape import Shape
from geodrake.effects.stribeck_friction import StribeckFriction
from geodrake.effects.temporary_payload import TemporaryPayload
from geodrake.effects.thermal_friction import ThermalFriction
from geodrake.effects.thermal_offset import ThermalOffset
from geodrake.effects.torque_ripple import TorqueRipple
from geodrake.effects.user_code import load_effect_file
from geodrake.effects.viscous_friction import ViscousFriction
from geodrake.effects.wrong_inertia import WrongInertia

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
    "FittedEffect",
    "FrictionDrift",
    "FrictionOvercompensation",
    "GearEfficiency",
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
    "Proposer",
    "RobotEffect",
    "RobotMotion",
    "Role",
    "RotorInertia",
    "Shape",
    "StribeckFriction",
    "TemporaryPayload",
    "ThermalFriction",
    "ThermalOffset",
    "TorqueRipple",
    "ViscousFriction",
    "WrongInertia",
    "catalogue",
    "effect_class",
    "load_effect_file",
    "make_effect",
]
