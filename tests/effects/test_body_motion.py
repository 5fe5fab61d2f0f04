"""Poses, Jacobians and weights of bodies, against Drake."""

import numpy as np
import pytest
from excitation_robots import MODELS
from pydrake.multibody.tree import JacobianWrtVariable

from geodrake import load_model
from geodrake.effects.body_motion import RobotBodies
from geodrake.errors import ArgumentError


@pytest.mark.parametrize("robot", ["arm6", "double_pendulum", "ambidex_like"])
def test_poses_jacobians_and_weights(robot):
    model = load_model(MODELS / f"{robot}.urdf")
    plant, of_v, point = model.plant, JacobianWrtVariable.kV, np.array([0.1, -0.2, 0.3])
    q = np.random.default_rng(1).normal(size=(3, plant.num_positions()))
    bodies = RobotBodies(model.tree, q, model.phi)
    context, world = plant.CreateDefaultContext(), plant.world_frame()
    weights = bodies.gravity_efforts(bodies.gravity[:, None])[..., 0]
    for i in range(len(q)):
        plant.SetPositions(context, q[i])
        held = -plant.CalcGravityGeneralizedForces(context)
        np.testing.assert_allclose(weights[i], held, atol=1e-9 * np.abs(held).max())
        for name in bodies.tree.bodies:
            motion, frame = bodies.motion(name), plant.GetFrameByName(name)
            X_WB = frame.CalcPoseInWorld(context)
            np.testing.assert_allclose(motion.rotation[i], X_WB.rotation().matrix(), atol=1e-12)
            np.testing.assert_allclose(motion.position[i], X_WB.translation(), atol=1e-12)
            for at, linear in ((np.zeros(3), motion.linear), (point, motion.jacobian_at(point))):
                J = plant.CalcJacobianSpatialVelocity(context, of_v, frame, at, world, world)
                np.testing.assert_allclose(np.vstack([motion.angular[i], linear[i]]), J, atol=1e-12)
            assert set(np.flatnonzero(np.abs(J).max(0)).tolist()) <= set(motion.dofs)
    for name in bodies.tree.bodies:
        welded = [b.index() for b in plant.GetBodiesWeldedTo(plant.GetBodyByName(name))]
        inertia = plant.CalcSpatialInertia(context, plant.GetFrameByName(name), welded)
        np.testing.assert_allclose(bodies.mass_center(name), inertia.get_com(), atol=1e-12)
    with pytest.raises(ArgumentError, match="no moving body 'moon'"):
        bodies.motion("moon")
