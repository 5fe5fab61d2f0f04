"""The study of sandbags on an AMBIDEX-like arm: controller, plant, and what it must show."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from diagrams.studies import ambidex_sandbags as study
from diagrams.studies.ambidex import arm as robot
from geodrake.logs import Motion


@pytest.fixture(scope="module")
def arm():
    return robot.Arm.load()


@pytest.fixture(scope="module")
def true(arm):
    return study.CoupledArm.of(study.Known.true(arm.phi))


class TestCoupledArm:
    def test_efforts_are_those_of_the_motors(self, arm, true):
        """Against the transmission and the friction of the identification study."""
        rng = np.random.default_rng(0)
        # Fast enough that friction is full.
        q, v, a = (
            rng.uniform(-1, 1, 7),
            rng.choice([-1.0, 1.0], 7) * [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.4],
            rng.normal(size=7),
        )
        effort = true.control.at(q, v, v, a).effort(true.control.prior)
        wrist = block_diag(np.eye(5), [[1, 1], [1, -1]])
        motors = Motion(*((robot.REDUCTION * wrist @ x)[None] for x in (q, v, a)))
        friction = np.concatenate([robot.COULOMB, robot.VISCOUS])
        torque = (arm.regressor(motors) @ arm.phi.ravel())[0]
        torque += robot.friction_regressor(motors.v)[0] @ friction
        np.testing.assert_allclose(effort, robot.REDUCTION * wrist.T @ torque, rtol=1e-9, atol=1e-9)

    def test_sample_is_consistent(self, true):
        rng = np.random.default_rng(1)
        q, qd, v, a, r = rng.normal(size=(5, 7))
        sample = true.control.at(q, qd, v, a)
        p = true.control.prior
        np.testing.assert_allclose(sample.regressor @ p, sample.effort(p), atol=1e-12)
        np.testing.assert_allclose(sample.regressor.T @ r, sample.covector(r), atol=1e-12)
        further = true.control.at(q, qd, v, a + r).effort(p) - sample.effort(p)
        np.testing.assert_allclose(sample.mass_matrix(p) @ r, further, atol=1e-10)
