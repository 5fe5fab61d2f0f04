"""The AMBIDEX study: its arm, measurements and priors, and what its quick form must show."""

import numpy as np
import pytest

from diagrams.studies import ambidex_arm as draws
from diagrams.studies.ambidex import arm as robot
from geodrake.inertia import equivalent_ellipsoid
from geodrake.logs import Motion

PLAN = draws.Plan(draws=1, counts=(30,), gamma=0.03, delta=0.5, hull=2.0, seed=4)


@pytest.fixture(scope="module")
def arm():
    return robot.Arm.load()


@pytest.fixture(scope="module")
def measured(arm):
    return robot.measure(arm, seed=PLAN.seed, hull=PLAN.hull)


class TestArm:
    def test_rolling_joints_and_shared_wrist(self, arm):
        turns = np.random.default_rng(0).uniform(-1, 1, (5, 7))
        theta = arm.transmission.joint_positions(arm.motors(turns))
        single = [0, 1, 2, 5]
        np.testing.assert_allclose(theta[:, single], turns[:, [0, 1, 2, 4]], atol=1e-14)
        for first, turn in ((3, 3), (6, 5), (8, 6)):
            np.testing.assert_allclose(theta[:, first], theta[:, first + 1], atol=1e-14)
            np.testing.assert_allclose(2 * theta[:, first], turns[:, turn], atol=1e-14)

    def test_regressor_gives_what_drake_needs(self, arm):
        """Drake's inverse dynamics of the ten joints, virtual work, and rotors."""
        rng = np.random.default_rng(1)
        q, v, vd = (30.0 * rng.uniform(-1, 1, (6, 7)) for _ in range(3))
        torque = arm.regressor(Motion(q, v, vd)) @ arm.phi.ravel()
        J = np.zeros((10, 7))
        for joint, motor in zip((0, 1, 2, 5), (0, 1, 2, 4), strict=True):
            J[joint, motor] = 1 / 30
        J[3:5, 3] = 1 / 60
        J[6:8, 5:] = 1 / 120
        J[8:10, 5:] = [1 / 120, -1 / 120]
        context = arm.plant.CreateDefaultContext()
        for k in range(len(q)):
            arm.plant.SetPositions(context, J @ q[k])
            arm.plant.SetVelocities(context, J @ v[k])
            needed = arm.plant.CalcInverseDynamics(
                context, J @ vd[k], _no_forces(arm.plant)
            ) - arm.plant.CalcGravityGeneralizedForces(context)
            expected = J.T @ needed + robot.ROTOR_INERTIA * vd[k]
            np.testing.assert_allclose(torque[k], expected, rtol=1e-10, atol=1e-12)


def _no_forces(plant):
    from pydrake.multibody.tree import MultibodyForces

    return MultibodyForces(plant)


class TestMeasurements:
    def test_truth_explains_all_but_uneven_friction_and_noise(self, measured):
        friction = np.concatenate([robot.COULOMB, robot.VISCOUS])
        explained = measured.bodies @ measured.truth.ravel() + measured.friction @ friction
        rest = (measured.torque - explained).std(0)
        expected = np.hypot(robot.TORQUE_NOISE, robot.UNEVEN * robot.COULOMB)
        np.testing.assert_allclose(rest, expected, rtol=0.15)
        assert (rest[:2] < 0.2 * measured.torque.std(0)[:2]).all()


class TestPriors:
    def test_653_point_masses_have_its_parameters(self, measured):
        rng, prior = draws.prior_of(0, PLAN, measured)
        hulls = equivalent_ellipsoid(measured.truth).scaled(PLAN.hull)
        points = robot.point_masses(prior, hulls, rng)
        assert len(points.prior) == 653
        assert (points.prior > 0).all()
        np.testing.assert_allclose(points.parameters(), prior, rtol=1e-9, atol=1e-12)
        for body in range(10):
            lifted = np.column_stack([points.positions[body], np.ones(59)])
            inside = np.einsum("ni,ij,nj->n", lifted, hulls.quadric[body], lifted)
            assert inside.min() >= -1e-12
