"""Efforts of a robot model, and whether it is admissible."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from chain_logs import inverse_dynamics
from own_code import own_effect
from pendulum_logs import PENDULUM, friction, pendulum_log

from geodrake import load_model
from geodrake.diagnosis import add
from geodrake.effects import (
    CoulombFriction,
    EffortDelay,
    FittedEffect,
    JointSpring,
    LoadDependentFriction,
    Parameter,
    Payload,
)
from geodrake.errors import ModelError
from geodrake.inertia import from_mass_com_inertia
from geodrake.logs.motion import Motion
from geodrake.model.saved_model import check_model, save_model

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
    """Return the inverse dynamics of Drake's plant with the model's bodies."""
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


def test_delays_of_joints_and_of_all_add_up(arm):
    assert not arm.delays.any()
    late = [EffortDelay(0.01, "elbow_pitch"), EffortDelay(0.002), EffortDelay(-0.001)]
    effects = tuple(FittedEffect(effect, np.empty(0)) for effect in late)
    expected = np.where(np.array(arm.joints) == "elbow_pitch", 0.011, 0.001)
    np.testing.assert_allclose(replace(arm, effects=effects).delays, expected)


DRIVEN = friction((-0.5, -0.3), (-0.2, -0.1))  # against all bounds


@cache
def log(seed, hidden):
    found = pendulum_log(seed, hidden, seconds=8.0, rate=100.0)
    return replace(found, temperature=30.0 + 0.5 * found.time[:, None] + 0.0 * found.position)


def comes_back(model, path):
    """Saved, loaded and saved again, a model is the same."""
    save_model(model, path)
    again = load_model(path)
    for name in ("phi", "information", "effort_noise"):
        np.testing.assert_array_equal(getattr(again, name), getattr(model, name))
    assert [f.effect for f in again.effects] == [f.effect for f in model.effects]
    for before, after in zip(model.effects, again.effects, strict=True):
        np.testing.assert_array_equal(after.parameters, before.parameters)
    text = path.read_bytes()
    save_model(again, path)
    assert path.read_bytes() == text


def test_fits_come_back_from_any_edge(tmp_path):
    first = add("coulomb_friction", load_model(PENDULUM), [log(1, DRIVEN)]).model
    comes_back(first, tmp_path / "first.yaml")
    for effect in ("viscous_friction", "thermal_friction", "joint_elasticity", "wrong_inertia"):
        comes_back(add(effect, first, [log(2, DRIVEN)]).model, tmp_path / "second.yaml")


@pytest.fixture
def model():
    return load_model(PENDULUM)


def with_effect(model, effect, *values, deviations=None):
    return replace(model, effects=(FittedEffect(effect, np.array(values), deviations),))


def refused(model):
    with pytest.raises(ModelError) as caught:
        check_model(model)
    return str(caught.value)


def test_what_rounding_does_is_admitted(model):
    p = model.phi.size
    root = np.random.default_rng(4).normal(size=(3, p)) * np.logspace(-6, 6, p)
    matrix = root.T @ root  # of rank 3, so that eigenvalues are zero up to rounding
    check_model(replace(model, information=matrix * (1 + 1e-10 * np.triu(np.ones((p, p))))))
    check_model(with_effect(model, CoulombFriction("elbow"), -1e-12))
    check_model(with_effect(model, CoulombFriction("elbow"), 0.0, deviations=np.array([np.inf])))
    check_model(with_effect(model, EffortDelay(0.1)))
    point = from_mass_com_inertia(1.0, np.array([0.0, 0.0, 0.3]), np.zeros((3, 3)))
    check_model(with_effect(model, Payload("lower_link"), *point))


def test_information_says_something_of_each_parameter(model):
    p = model.phi.size
    for none in (np.zeros((p, p)), np.diag(np.arange(float(p)))):
        assert "has 0 at 0, 0: entries on the diagonal" in refused(replace(model, information=none))


def test_messages_have_the_field_and_the_value(model):
    assert "coulomb_friction at elbow have coulomb = -0.5, outside [0, inf]" in refused(
        with_effect(model, CoulombFriction("elbow"), -0.5)
    )
    at_most = (Parameter("part", "1", upper=1.0),)
    share = own_effect("share", parameters=at_most, columns=lambda self, joint: [joint.q])
    assert "share at elbow have part = 1.5, outside [-inf, 1]" in refused(
        with_effect(model, share("elbow"), 1.5)
    )
    phi = model.phi.copy()
    phi[1, 0] = -2.0
    assert "inertial_parameters of 'lower_link' have a mass of -2 kg" in refused(
        replace(model, phi=phi)
    )
    assert "effort_noise of 'elbow' is nan" in refused(
        replace(model, effort_noise=np.array([0.1, np.nan]))
    )
