"""Physical effects that a rigid-body model lacks, one class each, in files by family.

The effort that a robot needs is that of its rigid bodies plus a sum of effects (docs/design.md).
`catalogue` lists the effects that come with geodrake. A user-defined effect is a frozen dataclass
with a name, parameters with units and bounds, and the regressor columns that multiply them. A hose
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

`HangingHose("elbow")` then works wherever an effect does. `load_effect_file` reads such a file;
pass its effects on as `extra`. Further fields are shape parameters, with candidate values listed in
`shapes` (see `StribeckFriction`). An effect that uses the motion of several joints overrides `rows`
(see `CoupledFriction`); an effect on a body derives from `BodyEffect` (see `Payload`). Excitation
needs derivatives of the columns: define `slopes`, or they are computed by finite differences.
`Effect` lists everything that an effect may declare. To extend the catalogue, add a class to the
file of its family.
"""

from geodrake.effects.base import (
    BodyEffect,
    Effect,
    FittedEffect,
    JointEffect,
    JointMotion,
    JointPairEffect,
    Parameter,
    Proposer,
    RobotEffect,
    RobotMotion,
    Role,
    Shape,
)
from geodrake.effects.bodies import Payload, TemporaryPayload, WrongInertia
from geodrake.effects.environment import AerodynamicDrag, Contact, GravityTilt
from geodrake.effects.friction import (
    AsymmetricFriction,
    CoulombFriction,
    CoupledFriction,
    FrictionDrift,
    FrictionOvercompensation,
    GearEfficiency,
    Hysteresis,
    LoadDependentFriction,
    NonlinearViscousFriction,
    StribeckFriction,
    ThermalFriction,
    ViscousFriction,
)
from geodrake.effects.lookup import catalogue, effect_class, make_effect
from geodrake.effects.motor_and_transmission import (
    Backlash,
    CoupledRotorInertia,
    GravityCompensator,
    JointElasticity,
    JointSpring,
    RotorInertia,
    TorqueRipple,
)
from geodrake.effects.sensors import (
    EffortDelay,
    EffortOffset,
    EffortScale,
    ThermalOffset,
    WrenchOffset,
)
from geodrake.effects.user_effects import load_effect_file

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
    "WrenchOffset",
    "WrongInertia",
    "catalogue",
    "effect_class",
    "load_effect_file",
    "make_effect",
]
