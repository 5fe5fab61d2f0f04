"""A robot model: the effort it needs, against Drake and against written-out formulas."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chain_logs import inverse_dynamics

from geodrake import load_model
from geodrake.effects import (
    EffortDelay,
    FittedEffect,
    JointSpring,
    LoadDependentFriction,
    Payload,
)
from geodrake.inertia import from_mass_com_inertia
from geodrake.logs.motion import Motion
from geodrake.robot.regressor import inverse_dynamics_regressor

MODELS = Path(__file__).parents[2] / "models"


@pytest.fixture(scope="module")
def arm():
    return load_model(MODELS / "arm6.urdf")


@pytest.fixture(scope="module")
def motion(arm):
    rng = np.random.default_rng(1)
    n = len(arm.joints)
    return Motion(*(scale * rng.normal(size=(20, n)) for scale in (1.0, 2.0, 5.0)))


def drake_effort(model, motion):
    """Inverse dynamics of Drake's plant with the model's bodies."""
    samples = motion.q, motion.v, motion.vd
    return inverse_dynamics(model.plant, *samples, model.create_context())


def fitted(effect, *values):
    return FittedEffect(effect, np.array(values, float))


def test_effects_add_to_the_effort_needed(arm, motion):
    """The load is that of the rigid bodies with the payload; delays are not applied."""
    phi = from_mass_com_inertia(1.5, [0.0, 0.1, 0.0], 0.004 * np.eye(3))
    effects = (
        fitted(Payload(arm.bodies[-1]), *phi),
        fitted(LoadDependentFriction(arm.joints[1]), 0.1),
        fitted(JointSpring(arm.joints[2], exponent=3, center=0.2), 4.0, -0.5),
        fitted(EffortDelay(0.004)),
    )
    model = replace(arm, effects=effects)
    load = drake_effort(model, motion)
    expected = load.copy()
    expected[:, 1] += 0.1 * np.abs(load[:, 1]) * np.sign(motion.v[:, 1])
    expected[:, 2] += 4.0 * (motion.q[:, 2] - 0.2) ** 3 - 0.5
    np.testing.assert_allclose(model.effort(motion), expected, rtol=0, atol=1e-9)


def test_motion_with_a_load_that_is_known(arm, motion):
    seen, load = arm.motion(motion), drake_effort(arm, motion)
    known = arm.motion(motion, load=2.0 * load)
    np.testing.assert_allclose(seen.load, load, atol=1e-9)
    np.testing.assert_array_equal(known.load, 2.0 * load)
    regressor = inverse_dynamics_regressor(arm.tree, motion.q, motion.v, motion.vd)
    for body, name in enumerate(arm.bodies):
        columns = known.body_columns(name)
        np.testing.assert_allclose(columns, regressor[:, :, 10 * body : 10 * body + 10])
    assert arm.motion(motion[:0]).load.shape == (0, 6)


def test_delays_of_joints_and_of_all_add_up(arm):
    assert not arm.delays.any()
    late = [EffortDelay(0.01, "elbow_pitch"), EffortDelay(0.002), EffortDelay(-0.001)]
    effects = tuple(FittedEffect(effect, np.empty(0)) for effect in late)
    expected = np.where(np.array(arm.joints) == "elbow_pitch", 0.011, 0.001)
    np.testing.assert_allclose(replace(arm, effects=effects).delays, expected)
