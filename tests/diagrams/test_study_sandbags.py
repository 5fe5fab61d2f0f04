"""The study of sandbags on an AMBIDEX-like arm: controller, plant, and what it must show."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from diagrams.studies import ambidex_sandbags as study
from diagrams.studies.adaptive import laws
from diagrams.studies.ambidex import arm as robot
from geodrake.control.adaptation import natural_adaptation
from geodrake.inertia import is_physical
from geodrake.logs.motion import Motion


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

    def test_rotors_stay(self, true):
        law = true.law(laws.NATURAL, 1.0)
        rng = np.random.default_rng(2)
        p, b = true.control.prior, rng.normal(size=len(true.control.prior))
        moved = law.step(p, b, 1e-3)
        np.testing.assert_array_equal(moved[-7:], p[-7:])
        size = true.manifold.dimension
        free = natural_adaptation(true.manifold).step(p[:size], b[:size], 1e-3)
        np.testing.assert_allclose(moved[:-7], free)
        assert not np.isclose(moved[:-7], p[:-7]).all()

    def test_plant_carries_the_bags(self):
        bare, full = (study.make_coupled_plant(bags) for bags in ((), (2, 4, 9)))
        mass = [plant.CalcTotalMass(plant.CreateDefaultContext()) for plant in (bare, full)]
        assert mass[1] - mass[0] == pytest.approx(1.5)


class TestIdentified:
    def test_is_near_the_truth_and_not_it(self, arm):
        known = study.known_arm(0)
        assert is_physical(known.phi).all()
        mass = known.phi[:10, 0].sum() / arm.phi[:10, 0].sum() - 1.0
        assert 1e-3 < abs(mass) < 0.2
        np.testing.assert_allclose(known.coulomb, robot.COULOMB, rtol=0.3)


class TestMotion:
    def test_goes_within_reach_and_rests(self):
        motion = study.point_to_point(3, 1)
        for t in (0.0, 1.5, 3.0, 4.5):
            assert np.abs(motion.EvalDerivative(t, 1)).max() < 1e-9
            assert (np.abs(motion.value(t).ravel()) <= robot.REACH + 1e-12).all()
        assert motion.end_time() == pytest.approx(4.5)
