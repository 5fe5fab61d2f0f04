"""Random trees of every joint type, and motions of them."""

import numpy as np
from hypothesis import reject
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, InitializeAutoDiff
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    FixedOffsetFrame,
    MultibodyForces_,
    PlanarJoint,
    PrismaticJoint,
    QuaternionFloatingJoint,
    RevoluteJoint,
    RpyFloatingJoint,
    ScrewJoint,
    SpatialInertia,
    UnitInertia,
    UniversalJoint,
    WeldJoint,
)

JOINTS = {
    "revolute": RevoluteJoint,
    "revolute, reversed": lambda name, F, M, axis: RevoluteJoint(name, M, F, axis),
    "prismatic": PrismaticJoint,
    "prismatic, reversed": lambda name, F, M, axis: PrismaticJoint(name, M, F, axis),
    "screw": lambda name, F, M, axis: ScrewJoint(name, F, M, axis, 0.3, 0.0),
    "universal": lambda name, F, M, axis: UniversalJoint(name, F, M),
    "planar": lambda name, F, M, axis: PlanarJoint(name, F, M, [0.0, 0.0, 0.0]),
    "ball": lambda name, F, M, axis: BallRpyJoint(name, F, M),
    "rpy floating": lambda name, F, M, axis: RpyFloatingJoint(name, F, M),
    "quaternion floating": lambda name, F, M, axis: QuaternionFloatingJoint(name, F, M),
    "weld": lambda name, F, M, axis: WeldJoint(name, F, M, RigidTransform([0.1, 0.2, 0.3])),
    "weld, reversed": lambda name, F, M, axis: WeldJoint(name, M, F, RigidTransform([0, 0, 0.4])),
    "none": None,
}


def random_pose(rng):
    return RigidTransform(RollPitchYaw(rng.uniform(-3, 3, 3)), rng.uniform(-1, 1, 3))


def random_body(plant, rng, name, instance=None):
    box = UnitInertia.SolidBox(*rng.uniform(0.1, 1.0, 3))
    inertia = SpatialInertia.MakeFromCentralInertia(
        mass := rng.uniform(0.1, 5.0), rng.uniform(-0.5, 0.5, 3), mass * box
    )
    return plant.AddRigidBody(name, *(() if instance is None else (instance,)), inertia)


def random_plant(rng, kinds, *, chain=False):
    """Return a tree of one body a joint kind, each on a random earlier body, or a chain."""
    plant = MultibodyPlant(0.0)
    bodies = [plant.world_body()]
    for number, kind in enumerate(kinds):
        P = bodies[-1 if chain else rng.integers(len(bodies))]
        B = random_body(plant, rng, f"body{number}")
        F = plant.AddFrame(FixedOffsetFrame(f"F{number}", P.body_frame(), random_pose(rng)))
        M = plant.AddFrame(FixedOffsetFrame(f"M{number}", B.body_frame(), random_pose(rng)))
        if JOINTS[kind] is not None:
            axis = rng.normal(size=3)
            axis /= np.linalg.norm(axis)
            plant.AddJoint(JOINTS[kind](f"joint{number}", F, M, axis))
        bodies.append(B)
    plant.mutable_gravity_field().set_gravity_vector(rng.uniform(-10, 10, 3))
    plant.Finalize()
    return plant


def random_tree(rng, kinds):
    """Return `random_plant` for hypothesis, without trees that Drake cannot have.

    Drake may use the parent of a free body on a reversed joint as the base, and then refuses
    joints of several degrees of freedom that it would have to reverse.
    """
    try:
        return random_plant(rng, kinds)
    except RuntimeError as error:
        if "would have to be reversed" in str(error):
            reject()
        raise


def random_motion(plant, rng, count):
    sizes = plant.num_positions(), plant.num_velocities(), plant.num_velocities()
    return tuple(rng.uniform(-2.0, 2.0, (count, size)) for size in sizes)


def drake_slopes(plant, q, v, vd):
    """Return derivatives (N, nv, nq + 2 nv) of the effort by Drake."""
    smooth = plant.ToAutoDiffXd()
    context, forces = smooth.CreateDefaultContext(), MultibodyForces_[AutoDiffXd](smooth)
    nq, nv = q.shape[1], v.shape[1]
    slopes = np.empty((len(q), nv, nq + 2 * nv))
    for i in range(len(q)):
        x = InitializeAutoDiff(np.concatenate([q[i], v[i], vd[i]])).ravel()
        smooth.SetPositions(context, x[:nq])
        smooth.SetVelocities(context, x[nq : nq + nv])
        effort = smooth.CalcInverseDynamics(context, x[nq + nv :], forces)
        slopes[i] = ExtractGradient(effort - smooth.CalcGravityGeneralizedForces(context))
    return slopes
