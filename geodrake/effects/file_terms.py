"""Names for effects in terms of model files, simulators and servos."""

from geodrake import effects
from geodrake.effects import of_files

AddedMass = of_files.AddedMass
Ball = of_files.BallSpring
Carried = of_files.CarriedWeight
CoupledDry = effects.CoupledFriction
CoupledRotor = effects.CoupledRotorInertia
Coupling = of_files.JointCoupling
Damping = effects.ViscousFriction
Delay = effects.EffortDelay
Drag = effects.NonlinearViscousFriction
DryFriction = effects.CoulombFriction
Ellipsoid = of_files.EllipsoidDrag
Medium = of_files.MediumDrag
Offset = effects.EffortOffset
Polynomial = of_files.PolynomialSpring
Rotor = effects.RotorInertia
Spring = effects.JointSpring
StaticFriction = effects.StribeckFriction
StrutEffect = of_files.Strut
TendonPath = of_files.Tendon
Tilt = effects.GravityTilt
