"""What bodies could take in is named where bodies may stay as the model has them, and only there.

Logs are Pinocchio's inverse dynamics of another robot than that of the model file.
"""

from functools import cache

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import pinocchio as pin
from effort_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.diagnosis import diagnose, explain


@cache
def model_file(name):
    return load_model(MODELS / f"{name}.urdf")


def with_last_link(change):
    """Effort that another last link makes, by Pinocchio."""

    def hidden(seen):
        model, last = pin.Model(seen.model), seen.model.njoints - 1
        model.inertias[last] = change(model.inertias[last])
        data = model.createData()
        samples = zip(seen.q, seen.v, seen.a, strict=True)
        return np.array([pin.rnea(model, data, *sample) for sample in samples]) - seen.load

    return hidden


def holding(mass):
    """A link and a ball."""
    return lambda link: (
        link + pin.Inertia(mass, np.array([0.02, 0, 0.1]), 1.6e-3 * mass * np.eye(3))
    )


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [1, 2])
def test_small_payload(seed):
    """It would pass into the last link, whose mass it changes by less than the prior's width."""
    log = effort_log("arm7", seed, with_last_link(holding(0.1)), duration=16.0, share=0.02).log
    found = explain(model_file("arm7"), [log])
    (step,) = found.steps
    assert (step.effect, step.where) == ("payload", ("link_7",))
    assert step.error_before == found.refitted.nrms > step.error_after
    first = diagnose(model_file("arm7"), [log]).candidates[0]
    assert (first.effect, first.where, first.tied) == ("payload", ("link_7",), True)
    mass, deviation = (v["link_7"]["mass"] for v in (step.parameters, step.deviations))
    assert mass == pytest.approx(0.1, abs=2.0 * deviation)
    assert mass == pytest.approx(0.1, rel=0.2)


@pytest.mark.parametrize(
    ("size", "seed", "named"),
    [(4.0, 4, True), (1.5, 5, False)],
)
@pytest.mark.thorough
def test_compensator_beside_bodies_that_are_off(size, seed, named):
    """Bodies must move, but not as improbably far; a small one is named beside them at most."""

    def compensator(seen):
        return {1: size * np.sin(seen.q[:, 1] - 0.7)}

    log = effort_log("arm7", seed, compensator, off=0.2, duration=16.0, share=0.02).log
    step = explain(model_file("arm7"), [log]).steps[0]
    assert step.effect == ("gravity_compensator" if named else "wrong_inertia")
    assert step.false_alarm_probability <= 0.01
    assert step.error_after < step.error_before


@pytest.mark.thorough
def test_compensator_in_place_of_a_wrong_link():
    """Its sine is that of a first moment of the link, which stays where nothing else moves."""

    def compensator(seen):
        return {1: 2.0 * np.sin(seen.q[:, 1] - 0.7)}

    log = effort_log("arm7", 6, compensator, duration=16.0, share=0.01, pace=0.3).log
    (step,) = explain(model_file("arm7"), [log]).steps
    assert (step.effect, step.where) == ("gravity_compensator", ("joint_2",))
    values = step.parameters["joint_2"]
    assert np.hypot(values["sine"], values["cosine"]) == pytest.approx(2.0, rel=0.05)


def another(seen, joint, change):
    """What the joints need more if the body of a joint is another one."""
    model = seen.model.copy()
    model.inertias[joint] = change(model.inertias[joint])
    data, motion = model.createData(), zip(seen.q, seen.v, seen.a, strict=True)
    return np.array([pin.rnea(model, data, *sample) for sample in motion]) - seen.load


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [1, 2])
def test_effects_that_explain_as_much_as_bodies_that_go_far_are_the_answer(seed):
    """A payload, a compensator, dry friction, and an effort that the catalogue does not have."""
    payload = pin.Inertia(12.0, np.array([0.05, 0.02, 0.15]), 0.24 * np.eye(3))

    def loaded(seen):
        effort = another(seen, 6, lambda inertia: inertia + payload)
        effort += 0.1 * np.sign(seen.v) * np.abs(seen.load).std(0)
        effort[:, 1] -= 60.0 * np.sin(seen.q[:, 1])
        effort[:, 2] += 0.15 * seen.load[:, 2].std() * np.sin(3.0 * seen.q[:, 1])
        return effort

    found = explain(model_file("arm6"), [effort_log("arm6", seed, loaded, off=0.1).log])
    places = {step.effect: step.where for step in found.steps}
    assert places["payload"] == ("flange",)
    assert "shoulder_pitch" in places["gravity_compensator"]
    assert "wrong_inertia" not in places


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [1, 2])
def test_a_body_that_is_another_one_goes_there(seed):
    """A forearm of ten times its mass, and an effort that the catalogue does not have."""

    def heavy(seen):
        effort = another(
            seen, 3, lambda one: pin.Inertia(10.0 * one.mass, one.lever, 10.0 * one.inertia)
        )
        effort[:, 4] += 0.3 * seen.load[:, 4].std() * np.sin(3.0 * seen.q[:, 1])
        return effort

    found = explain(model_file("arm6"), [effort_log("arm6", seed, heavy, off=0.1).log])
    assert found.steps[0].effect == "wrong_inertia"
    assert "forearm" in found.steps[0].where
    mass = found.model.phi[found.model.bodies.index("forearm"), 0]
    assert mass == pytest.approx(10.0 * model_file("arm6").phi[2, 0], rel=0.3)
