"""Bristles that deflect before they slip, in logs, in parts of logs and in simulations.

The oracle is Dahl's equation in time, integrated by SciPy.
"""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput
from scipy.integrate import solve_ivp

pytest.importorskip("pinocchio")

from pinocchio_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.control import EffectForce
from geodrake.effects import Hysteresis
from geodrake.identification.logs.bandwidth import prepare_for_model
from geodrake.identification.logs.reduce import reduce_logs
from geodrake.logs import Motion
from geodrake.logs.folds import validation_blocks

PENDULUM = load_model(MODELS / "double_pendulum.urdf")


def swing(time):
    """Return position and velocity of a joint that reverses at many places."""
    q = np.sin(1.3 * time) + 0.4 * np.sin(3.1 * time + 1.0)
    return q, 1.3 * np.cos(1.3 * time) + 1.24 * np.cos(3.1 * time + 1.0)


def dahl(time, angle):
    """Return the deflection of the bristles by an ordinary differential equation in time."""

    def rate(t, z):
        v = swing(t)[1]
        return v / angle * (1.0 - z * np.sign(v))

    step = min(0.05 * angle, 2e-3)
    return solve_ivp(rate, time[[0, -1]], [0.0], "RK45", time, max_step=step, rtol=1e-8).y[0]


@pytest.mark.parametrize("angle", [0.02, 0.5])
def test_bend(angle):
    time = np.arange(0.0, 6.0, 0.002)
    bend = Hysteresis("joint", angle).bend(swing(time)[0])
    # A reversal between two samples is off by what the joint moves there.
    np.testing.assert_allclose(bend, dahl(time, angle), atol=1e-5 / angle)


def test_bend_at_rest_and_of_nothing():
    bristles = Hysteresis("joint", 0.1)
    np.testing.assert_array_equal(bristles.bend(np.full(7, 3.0)), 0.0)
    assert bristles.bend(np.zeros(0)).shape == (0,)
    np.testing.assert_allclose(bristles.bend(np.array([0.0, 100.0, 100.0])), [0.0, 1.0, 1.0])
    np.testing.assert_allclose(bristles.bend(np.full(3, 2.0), -0.4), -0.4)
    held = bristles.bend(np.array([0.0, 1e-4]))[1]
    assert held == pytest.approx(1e-4 / 0.1, rel=1e-3)  # a spring of stiffness F / θ


def series(seconds=4.0, period=0.004):
    time = np.arange(0.0, seconds, period)
    q, v = swing(time[:, None] + np.arange(2.0))
    return Motion(q, v, np.zeros_like(q), time)


class TestMemory:
    effect = Hysteresis("elbow", 0.2)

    def test_slices_remember(self):
        motion = series()
        whole = replace(motion, before=motion.q[:0])
        expected = self.effect.bend(motion.q[:, 1], np.sign(motion.v[0, 1]))
        for low, high in [(0, 300), (300, 302), (302, 1000)]:
            seen = PENDULUM.motion(whole[low:high])
            found = self.effect.regressor(seen)[:, 1, 0]
            np.testing.assert_allclose(found, expected[low:high], atol=1e-12)
        twice = PENDULUM.motion(whole[200:][300:400])
        found = self.effect.regressor(twice)[:, 1, 0]
        np.testing.assert_allclose(found, expected[500:600], atol=1e-12)

    def test_logs_in_chunks(self, monkeypatch):
        """Reduction in many chunks gives what it gives in one."""
        trajectories, _ = prepare_for_model(PENDULUM, [effort_log("double_pendulum", 3).log])
        folds = validation_blocks(trajectories)

        def rows():
            dataset = reduce_logs(PENDULUM, trajectories, folds, effects=[self.effect])
            data = dataset.data[1]
            at = data.local(dataset.effect_columns(self.effect))[0]
            return np.concatenate([part.A[:, at] for fold in data.rows for part in fold])

        whole = rows()
        monkeypatch.setattr("geodrake.identification.logs.reduce.CHUNK", 400)
        np.testing.assert_allclose(rows(), whole, atol=1e-9)
        assert np.ptp(whole) > 1.5


def cart(effects):
    """Return a cart of 2 kg on a rail with effects, and its simulator."""
    plant = MultibodyPlant(0.0)
    body = plant.AddRigidBody("cart", SpatialInertia.SolidSphereWithMass(2.0, 0.1))
    plant.AddJoint(PrismaticJoint("rail", plant.world_frame(), body.body_frame(), [1.0, 0.0, 0.0]))
    plant.Finalize()
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    force = EffectForce.AddToBuilder(builder, plant, effects)
    log = LogVectorOutput(plant.get_state_output_port(), builder, publish_period=0.01)
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_target_accuracy(1e-8)
    return plant, force, log, simulator


class TestSimulation:
    def test_against_scipy(self):
        """A cart that is pushed once swings on the bristles and comes to rest."""
        size, angle, mass = 3.0, 0.05, 2.0
        plant, force, log, simulator = cart([(Hysteresis("rail", angle), [size])])
        context = simulator.get_mutable_context()
        assert force.GetMyContextFromRoot(context).num_continuous_states() == 1
        plant.SetVelocities(plant.GetMyContextFromRoot(context), [0.6])
        simulator.AdvanceTo(2.0)

        def rate(_, x):
            return [x[1], -size * x[2] / mass, x[1] / angle * (1.0 - x[2] * np.sign(x[1]))]

        found = log.FindLog(context)
        expected = solve_ivp(
            rate,
            (0.0, 2.0),
            [0.0, 0.6, 0.0],
            "RK45",
            found.sample_times(),
            rtol=1e-9,
            atol=1e-11,
            max_step=1e-3,
        )
        np.testing.assert_allclose(found.data(), expected.y[:2], atol=2e-5)
        assert found.data()[1].min() < -0.01  # it springs back, which no Coulomb friction does
