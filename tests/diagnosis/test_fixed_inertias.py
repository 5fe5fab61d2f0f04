"""What inertias could take in is named when every body may stay as the model has it."""

from functools import cache

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import pinocchio as pin
from effort_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.diagnosis import Criteria, diagnose, explain


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


def lighter(share):
    """A link of the same shape that weighs less."""
    return lambda link: pin.Inertia(share * link.mass, link.lever, share * link.inertia)


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [1, 2])
def test_small_payload(seed):
    """It would pass into the last link, whose mass it changes by less than the prior's width."""
    log = effort_log("arm7", seed, with_last_link(holding(0.1)), duration=16.0, share=0.02).log
    found = explain(model_file("arm7"), [log])
    (step,) = found.steps
    assert (step.effect, step.where) == ("payload", ("link_7",))
    assert step.error_before == found.refitted.nrms > step.error_after
    first, other = diagnose(model_file("arm7"), [log]).candidates
    assert (first.effect, first.where, first.tied) == ("payload", ("link_7",), True)
    assert (other.effect, other.tied) == ("wrong_inertia", True)
    mass, deviation = (v["link_7"]["mass"] for v in (step.parameters, step.deviations))
    assert mass == pytest.approx(0.1, abs=2.0 * deviation)
    assert mass == pytest.approx(0.1, rel=0.2)
    assert "wrong_inertia" in step.indistinguishable_from


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
    both = {step.effect, *step.indistinguishable_from}
    assert both >= {"gravity_compensator", "wrong_inertia"}
    assert step.effect == ("gravity_compensator" if named else "wrong_inertia")
    assert step.false_alarm_probability <= Criteria().alarm
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
    assert "wrong_inertia" in step.indistinguishable_from


@pytest.mark.thorough  # test_wrong_inertia.py has a lighter link, too
def test_lighter_link_is_no_payload():
    log = effort_log("arm7", 3, with_last_link(lighter(0.7)), duration=16.0, share=0.02).log
    (step,) = explain(model_file("arm7"), [log]).steps
    assert step.effect == "wrong_inertia"


@pytest.mark.thorough  # as is tested in test_hidden_effects.py
def test_bodies_that_are_all_off_are_no_payload():
    log = effort_log("arm6", 1, off=0.2, duration=16.0).log
    (step,) = explain(model_file("arm6"), [log]).steps
    assert step.effect == "wrong_inertia"
