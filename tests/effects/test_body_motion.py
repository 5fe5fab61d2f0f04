"""Poses, Jacobians and weights of bodies, against Drake."""

from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.tree import JacobianWrtVariable

from geodrake import load_model
from geodrake.effects.body_motion import RobotBodies
from geodrake.errors import ArgumentError
from geodrake.inertia import inertial_parameters
from geodrake.robot.kinematics import KinematicTree

MODELS = Path(__file__).parents[2] / "models"
ROBOTS = ("arm6", "arm7", "double_pendulum", "ambidex_like")
COUNT = 5


@pytest.fixture(params=ROBOTS)
def plant(request):
    return load_model(MODELS / f"{request.param}.urdf").plant


@pytest.fixture
def q(plant):
    return np.random.default_rng(1).normal(size=(COUNT, plant.num_positions()))


@pytest.fixture
def bodies(plant, q):
    return RobotBodies(KinematicTree.from_plant(plant), q, inertial_parameters(plant))


def test_poses_and_jacobians(plant, q, bodies):
    context, world = plant.CreateDefaultContext(), plant.world_frame()
    point = np.array([0.1, -0.2, 0.3])
    for name in bodies.tree.bodies:
        motion, frame = bodies.motion(name), plant.GetFrameByName(name)
        at_point = motion.jacobian_at(point)
        for i in range(COUNT):
            plant.SetPositions(context, q[i])
            X_WB = frame.CalcPoseInWorld(context)
            np.testing.assert_allclose(motion.rotation[i], X_WB.rotation().matrix(), atol=1e-12)
            np.testing.assert_allclose(motion.position[i], X_WB.translation(), atol=1e-12)
            of_v = JacobianWrtVariable.kV
            for p_BoP_B, linear in ((np.zeros(3), motion.linear), (point, at_point)):
                J = plant.CalcJacobianSpatialVelocity(context, of_v, frame, p_BoP_B, world, world)
                np.testing.assert_allclose(np.vstack([motion.angular[i], linear[i]]), J, atol=1e-12)
            moved = set(np.flatnonzero(np.abs(J).max(0) > 0).tolist())
            assert moved <= set(motion.dofs)


def test_weights(plant, q, bodies):
    context = plant.CreateDefaultContext()
    for i in range(COUNT):
        plant.SetPositions(context, q[i])
        held = -plant.CalcGravityGeneralizedForces(context)
        found = bodies.gravity_efforts(bodies.gravity[:, None])[i, :, 0]
        np.testing.assert_allclose(found, held, atol=1e-9 * np.abs(held).max())


def test_mass_centres(plant, bodies):
    context = plant.CreateDefaultContext()
    for name in bodies.tree.bodies:
        indices = [b.index() for b in plant.GetBodiesWeldedTo(plant.GetBodyByName(name))]
        inertia = plant.CalcSpatialInertia(context, plant.GetFrameByName(name), indices)
        np.testing.assert_allclose(bodies.mass_center(name), inertia.get_com(), atol=1e-12)


def test_unknown_body(bodies):
    with pytest.raises(ArgumentError, match="no moving body 'moon'"):
        bodies.motion("moon")
