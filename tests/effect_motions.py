"""A robot with hands, random motions, and an instance of every effect."""

from functools import cache

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, SpatialInertia, UnitInertia

from geodrake import effects
from geodrake.effects import RobotMotion
from geodrake.effects.body_motion import RobotBodies
from geodrake.inertia import inertial_parameters
from geodrake.robot import KinematicTree

JOINTS = ("shoulder", "elbow", "wrist")


@cache
def hand_robot():
    """Return a chain of three joints, whose last body is the hand, and its bodies' parameters."""
    plant = MultibodyPlant(0.0)
    parent = plant.world_frame()
    inertia = SpatialInertia(2.0, [0.1, 0.02, 0.2], UnitInertia.SolidSphere(1.0))
    for i, name in enumerate(("arm", "forearm", "hand")):
        body = plant.AddRigidBody(name, inertia)
        X = RigidTransform(RollPitchYaw(0.4 * i, 0.3, 0.0), [0.1, 0.0, 0.3])
        mount = plant.AddFrame(FixedOffsetFrame(f"mount{i}", parent, X))
        axis = np.roll([0.0, 1.0, 0.0], i)
        plant.AddJoint(RevoluteJoint(JOINTS[i], mount, body.body_frame(), axis))
        parent = body.body_frame()
    plant.Finalize()
    return plant, KinematicTree.from_plant(plant), inertial_parameters(plant)


def random_motion(n=20, *, width=0.0, seed=0):
    rng = np.random.default_rng(seed)
    q, v, vd, load = rng.normal(size=(4, n, 3))
    body = rng.normal(size=(n, 3, 10))
    _, tree, phi = hand_robot()
    return RobotMotion(
        JOINTS,
        q,
        v,
        vd,
        load,
        np.full(3, width),
        {"hand": body}.__getitem__,
        RobotBodies(tree, q, phi),
        np.arange(n) * 0.01,
        temperature=30.0 + 5.0 * np.random.default_rng(seed + 1).normal(size=(n, 3)),
    )


def instances():
    return [
        effects.ViscousFriction("elbow"),
        effects.CoulombFriction("elbow"),
        effects.FrictionOvercompensation("elbow"),
        effects.AsymmetricFriction("elbow"),
        effects.StribeckFriction("elbow", 0.1, 2.0),
        effects.NonlinearViscousFriction("elbow", 0.5),
        effects.LoadDependentFriction("elbow"),
        effects.GearEfficiency("elbow"),
        effects.CoupledFriction(("elbow", "wrist"), -1),
        effects.FrictionDrift("elbow", 5.0),
        effects.ThermalFriction("elbow", 30.0),
        effects.Hysteresis("elbow", 0.3),
        effects.EffortOffset("elbow"),
        effects.ThermalOffset("elbow", 30.0),
        effects.EffortScale("elbow"),
        effects.EffortDelay(0.01),
        effects.JointSpring("elbow", 3, 0.2),
        effects.GravityCompensator("elbow"),
        effects.TorqueRipple("elbow", 12.5),
        effects.RotorInertia("elbow"),
        effects.CoupledRotorInertia(("elbow", "wrist")),
        effects.JointElasticity("elbow"),
        effects.Backlash("elbow", 1e-3),
        effects.Payload("hand"),
        effects.TemporaryPayload("hand", 0.05, 0.12, 0.02),
        effects.GravityTilt(),
        effects.Contact("hand", 0.05, 0.12, 0.02, 0, 0.1),
        effects.AerodynamicDrag("hand"),
        effects.AerodynamicDrag("forearm", 0.1, -0.2, 0.3),
    ]
