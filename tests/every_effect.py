"""Every effect with parameters, at the arms of the demo and of arm6.urdf."""

from geodrake import effects
from geodrake.effects.of_files import (
    AddedMass,
    BallSpring,
    CarriedWeight,
    EllipsoidDrag,
    JointCoupling,
    MediumDrag,
    PolynomialSpring,
    SquaredLoadFriction,
    Strut,
    Tendon,
)

EFFECTS = [
    (effects.ViscousFriction("base_yaw"), [2.0]),
    (effects.CoulombFriction("shoulder_pitch"), [3.0]),
    (effects.AsymmetricFriction("wrist_spin"), [1.0, 2.0, 3.0, 4.0]),
    (effects.StribeckFriction("shoulder_pitch", 0.3, 2.0), [1.0]),
    (effects.NonlinearViscousFriction("elbow_pitch", 1.5), [2.0]),
    (effects.LoadDependentFriction("shoulder_pitch"), [0.1]),
    (effects.CoupledFriction(("wrist_pitch", "wrist_spin"), -1), [1.0, 2.0]),
    (effects.FrictionDrift("base_yaw", 30.0), [1.0, 1.0]),
    (effects.Hysteresis("wrist_roll", 0.02), [1.0]),
    (effects.EffortOffset("wrist_roll"), [1.0]),
    (effects.EffortScale("elbow_pitch"), [0.1]),
    (effects.JointSpring("elbow_pitch", 3, 0.2), [2.0, 1.0]),
    (effects.GravityCompensator("shoulder_pitch"), [2.0, 3.0]),
    (effects.TorqueRipple("base_yaw", 12.5), [0.1, 0.2]),
    (effects.RotorInertia("wrist_spin"), [0.3]),
    (effects.CoupledRotorInertia(("base_yaw", "wrist_roll")), [0.2]),
    (effects.GravityTilt(0.1, 0.05), [0.11, 0.04]),
    (effects.AerodynamicDrag("wrist"), [0.4, 0.1, 0.2, 0.3]),
    (effects.AerodynamicDrag("flange", 0.1, 0.2, 0.3), [0.4, 0.1, 0.2, 0.3]),
    (PolynomialSpring("elbow_pitch", 0.2), [1.0, -2.0, 3.0, -1.0]),
    (JointCoupling(("base_yaw", "elbow_pitch")), [2.0, -0.4]),
    (CarriedWeight(("wrist", "world"), 0.1, 0.2, -0.1), [1.5]),
    (CarriedWeight(("wrist", "column"), 0.1, 0.2, -0.1), [1.5]),
    (MediumDrag("wrist", 0.3, 0.2, 0.1, 0.1, 0.0, 0.2, 0.5, 0.5, -0.5, 0.5, 1.0, 2.0), [900, 3]),
    (EllipsoidDrag("wrist", 0.3, 0.2, 0.1, 0.1, 0.0, 0.2, mass_x=0.02, inertia_z=1e-3), [900, 3]),
    (
        AddedMass("wrist", (3, 0.2, 0.1, 0, 0, 0, 1, 0, 0, 0, 0.1, 2, *[0] * 3, 1, 0, 0, 2, 0, 3)),
        [0.9],
    ),
    (Strut(("column", "wrist"), 0.1, 0.2, 0.3, 0.1, 0.0, 0.2), [30.0, -5.0, 2.0]),
    (Strut(("world", "wrist"), 0.5, 0.2, 1.3, 0.1, 0.0, 0.2), [30.0, -5.0, 2.0]),
    (
        Tendon(
            bodies=("world", "wrist", "column", "column", "wrist", "world"),
            numbers=(0.6, 0.9)
            + (0.5, 0.2, 1.3, 0.1, 0, 0.2, 1, 0.1, 1, 0.1, 0, 0.3, 1, 0, 0, 0, 0, 0.2, 0)
            + (0.1, 0.2, 0.3, 0.1, 0, 0.2, 0.5)
            + 12 * (0,),
        ),
        [30.0, -3.0, 2.0],
    ),
    (
        Tendon(
            bodies=("world", "wrist", "world"),
            numbers=(
                *(0, 0, 0.5, 0.2, 1.3, 0.1, 0, 0.2, 1),
                0.3,
                0,
                0.2,
                0,
                0.6,
                1,
                *5 * (0,),
                0.4,
            ),
        ),
        [30.0, -3.0, 2.0],
    ),
    (BallSpring(("column", "wrist"), 0.5, 0.5, -0.5, 0.5), [3.0]),
    (BallSpring(("wrist", "world"), 0.8, 0.0, 0.6, 0.0), [3.0]),
    (SquaredLoadFriction("elbow_pitch", 4.0), [0.1]),
    (effects.Payload("flange"), [1.0, 0.1, 0.0, 0.05, 0.05, 0.06, 0.07, 0.0, 0.0, 0.001]),
]
LEFT_OUT = [  # of source code
    (effects.EffortDelay(0.01), []),
    (effects.JointElasticity("base_yaw"), [1e-4]),
    (effects.Backlash("elbow_pitch", 1e-3), [1.0]),
    (effects.Contact("flange", 1.0, 2.0), [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
]
