"""Robots for the tests of excitation, in any body frames and units."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PrismaticJoint,
    RevoluteJoint,
    SpatialInertia,
    UnitInertia,
)

from geodrake.inertia import inertial_parameters
from geodrake.logs import Motion
from geodrake.model import RobotModel

MODELS = Path(__file__).parents[1] / "models"


def random_pose(rng):
    return RigidTransform(RollPitchYaw(rng.uniform(-3, 3, 3)), rng.uniform(-0.5, 0.5, 3))


def arm(seed=0, *, joints="RRR", frames=None, length=1.0, mass=1.0, time=1.0, effects=()):
    """Return a chain of revolute (R) and prismatic (P) joints.

    The same seed is the same robot, whatever the poses of its body frames and the units (of one
    metre, kilogram and second).
    """
    rng, plant = np.random.default_rng(seed), MultibodyPlant(0.0)
    P, X_PP2 = plant.world_body(), RigidTransform()
    for number, kind in enumerate(joints):
        X_PF, X_BM, axis = random_pose(rng), random_pose(rng), rng.normal(size=3)
        m, com, box = rng.uniform(0.5, 5), rng.uniform(-0.3, 0.3, 3), rng.uniform(0.1, 0.6, 3)
        X_BB2 = RigidTransform() if frames is None else frames[number]
        X_BB2, X_PF, X_BM = (
            RigidTransform(X.rotation(), length * X.translation()) for X in (X_BB2, X_PF, X_BM)
        )
        inertia = SpatialInertia.MakeFromCentralInertia(
            mass * m, length * com, mass * m * length**2 * UnitInertia.SolidBox(*box)
        )
        moved = inertia.Shift(X_BB2.translation()).ReExpress(X_BB2.rotation().inverse())
        B = plant.AddRigidBody(f"body_{number}", moved)
        X_P2F, X_B2M = X_PP2.inverse() @ X_PF, X_BB2.inverse() @ X_BM
        F = plant.AddFrame(FixedOffsetFrame(f"F{number}", P.body_frame(), X_P2F))
        M = plant.AddFrame(FixedOffsetFrame(f"M{number}", B.body_frame(), X_B2M))
        joint = {"R": RevoluteJoint, "P": PrismaticJoint}[kind]
        plant.AddJoint(joint(f"joint_{number}", F, M, axis / np.linalg.norm(axis)))
        P, X_PP2 = B, X_BB2
    gravity = length / time**2 * np.array([1.0, 2.0, -9.0])
    plant.mutable_gravity_field().set_gravity_vector(gravity)
    plant.Finalize()
    model = RobotModel(plant, Path("arm"), False, inertial_parameters(plant))
    return replace(model, effects=tuple(effects))


def motion_of(model, seed=0, count=40, *, time=1.0):
    q, v, vd = np.random.default_rng(seed).uniform(-2, 2, (3, count, len(model.joints)))
    return Motion(q, v / time, vd / time**2)


def assert_gradient(function, motion, gradient, *, rtol=1e-6, step=1e-4):
    """Check the gradient of a number, or of one a sample, along random directions."""
    random = np.random.default_rng(5)
    for name in ("q", "v", "vd"):
        samples, slopes = getattr(motion, name), getattr(gradient, name)
        direction = random.normal(size=samples.shape)
        size = step * max(np.abs(samples).max(initial=0.0), 1.0)
        moved = [replace(motion, **{name: samples + k * size * direction}) for k in (-2, -1, 1, 2)]
        values = np.array([function(each) for each in moved])
        expected = np.tensordot([1, -8, 8, -1], values, 1) / (12 * size)
        found = (slopes * direction).sum(axis=1)
        found = found if np.ndim(expected) else found.sum()
        rounding = 10.0 * np.finfo(float).eps * np.abs(values).max(initial=0.0) / size
        atol = rtol * (np.abs(expected).max(initial=0.0) + 1e-2) + rounding
        np.testing.assert_allclose(found, expected, rtol=rtol, atol=atol)


def assert_jacobian(function, y, *, rtol=1e-6):
    """Check the Jacobian of values along a random direction, and return the values."""
    direction, h = np.random.default_rng(3).normal(size=y.size), 1e-6
    value, jacobian = function(y)
    assert np.isfinite(value).all()
    ends = [np.asarray(function(y + by * direction)[0]) for by in (h, -h)]
    slope = (ends[0] - ends[1]) / (2 * h)
    atol = rtol * (np.abs(slope).max() + 1e-3)
    np.testing.assert_allclose(jacobian @ direction, slope, atol=atol)
    return value
