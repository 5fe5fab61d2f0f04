"""Drives that follow a motion, and the limits that a controller takes from a plant."""

import numpy as np
import pytest
from adaptive_loops import motion, pendulum_plant, simulator
from chain_logs import inverse_dynamics
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from geodrake.control.systems import Safeguards, add_tracking_drives
from geodrake.errors import ArgumentError

STEP = 1e-3
GAINS = {"time_step": STEP, "damping": 0.0, "gains": {"p": 1e3, "d": 30.0}}


def test_drives_follow_a_motion_with_the_effort_of_inverse_dynamics():
    builder = DiagramBuilder()
    plant, known = builder.AddSystem(pendulum_plant(**GAINS)), pendulum_plant(**GAINS)
    path = motion(0.5, 4.0)
    effort = LogVectorOutput(
        add_tracking_drives(builder, plant, path, controller_plant=known), builder, 0.02
    )
    state = LogVectorOutput(plant.get_state_output_port(), builder, 0.02)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    start = np.concatenate([path.value(0.0), path.EvalDerivative(0.0)]).ravel()
    plant.SetPositionsAndVelocities(plant.GetMyContextFromRoot(context), start)
    found = simulator(diagram, context)
    found.AdvanceTo(1.0)
    logs = [sink.FindLog(found.get_context()) for sink in (state, effort)]
    t, (x, u) = logs[0].sample_times(), (log.data().T for log in logs)
    assert np.abs(x[:, :2] - path.vector_values(t).T).max() < 2e-3
    before = t[5::9] - STEP
    q, v, a = (np.array([path.EvalDerivative(s, k).ravel() for s in before]) for k in range(3))
    needed = inverse_dynamics(known, q, v, a)
    np.testing.assert_allclose(u[5::9], needed, atol=0.05 * np.abs(u).max())


@pytest.mark.parametrize(
    ("options", "size", "message"),
    [
        ({"gains": None}, 2, "without gains are"),
        ({"reverse": True}, 2, "is elbow, shoulder"),
        ({}, 3, "3 positions"),
    ],
)
def test_drives_that_do_not_fit_are_refused(options, size, message):
    builder = DiagramBuilder()
    plant = builder.AddSystem(pendulum_plant(**GAINS | options))
    path = motion() if size == 2 else type(motion())(np.zeros((size, 1)))
    with pytest.raises(ArgumentError, match=message):
        add_tracking_drives(builder, plant, path, controller_plant=pendulum_plant(**GAINS))


def test_effort_limits_of_a_plant_are_by_joint():
    assert np.isinf(Safeguards.of_plant(pendulum_plant()).limits(2)).all()
    plant = pendulum_plant(limits={"shoulder": 5.0, "elbow": 2.0}, reverse=True)
    guards = Safeguards.of_plant(plant, stale_time=0.1)
    assert guards.limits(2).tolist() == [5.0, 2.0]
    assert guards.stale_time == 0.1
