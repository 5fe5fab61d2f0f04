"""What model files and simulators have of their own of what geodrake calls effects."""

from geodrake.effects import CoulombFriction as DryFriction
from geodrake.effects import EffortDelay as Delay
from geodrake.effects import EffortOffset as Offset
from geodrake.effects import GravityTilt as Tilt
from geodrake.effects import JointSpring as Spring
from geodrake.effects import NonlinearViscousFriction as Drag
from geodrake.effects import RotorInertia as Rotor
from geodrake.effects import StribeckFriction as StaticFriction
from geodrake.effects import ViscousFriction as Damping

__all__ = [
    "Damping",
    "Delay",
    "Drag",
    "DryFriction",
    "Offset",
    "Rotor",
    "Spring",
    "StaticFriction",
    "Tilt",
]
