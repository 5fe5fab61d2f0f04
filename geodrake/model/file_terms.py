"""Effects that model files, simulators and servos define differently from geodrake."""

from geodrake.effects import CoulombFriction as DryFriction
from geodrake.effects import CoupledFriction as CoupledDry
from geodrake.effects import CoupledRotorInertia as CoupledRotor
from geodrake.effects import EffortDelay as Delay
from geodrake.effects import EffortOffset as Offset
from geodrake.effects import GravityTilt as Tilt
from geodrake.effects import JointSpring as Spring
from geodrake.effects import NonlinearViscousFriction as Drag
from geodrake.effects import RotorInertia as Rotor
from geodrake.effects import StribeckFriction as StaticFriction
from geodrake.effects import ViscousFriction as Damping
from geodrake.effects.of_files import CarriedWeight as Carried
from geodrake.effects.of_files import EllipsoidDrag as Ellipsoid
from geodrake.effects.of_files import JointCoupling as Coupling
from geodrake.effects.of_files import MediumDrag as Medium
from geodrake.effects.of_files import PolynomialSpring as Polynomial
from geodrake.effects.of_files import SquaredLoadFriction as LoadFriction
from geodrake.effects.of_files import Strut as StrutEffect

__all__ = [
    "Carried",
    "CoupledDry",
    "CoupledRotor",
    "Coupling",
    "Damping",
    "Delay",
    "Drag",
    "DryFriction",
    "Ellipsoid",
    "LoadFriction",
    "Medium",
    "Offset",
    "Polynomial",
    "Rotor",
    "Spring",
    "StaticFriction",
    "StrutEffect",
    "Tilt",
]
