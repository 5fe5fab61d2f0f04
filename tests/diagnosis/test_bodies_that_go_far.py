"""Bodies that go far could take in what effects do: that must be worth their way.

Logs are Pinocchio's inverse dynamics of another robot than that of the model file.
"""

from functools import cache

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import pinocchio as pin
from effort_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.diagnosis.search_rounds import searched
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.criteria import Criteria
from geodrake.identification.logs.hypothesis import first_hypothesis
from geodrake.identification.logs.model_fit import model_unknowns

LOOSE = 10.0
PAYLOAD = pin.Inertia(12.0, np.array([0.05, 0.02, 0.15]), 0.24 * np.eye(3))


@cache
def model_file():
    return load_model(MODELS / "arm6.urdf")


def effort_of(seen, joint, change):
    """What the joints need more if the body of a joint is another one."""
    model = seen.model.copy()
    model.inertias[joint] = change(model.inertias[joint])
    data, motion = model.createData(), zip(seen.q, seen.v, seen.a, strict=True)
    return np.array([pin.rnea(model, data, *sample) for sample in motion]) - seen.load


def loaded(seen):
    """A payload, a compensator, dry friction, and an effort that the catalogue does not have."""
    effort = effort_of(seen, 6, lambda inertia: inertia + PAYLOAD)
    effort += 0.1 * np.sign(seen.v) * np.abs(seen.load).std(0)
    effort[:, 1] -= 60.0 * np.sin(seen.q[:, 1])
    effort[:, 2] += 0.15 * seen.load[:, 2].std() * np.sin(3.0 * seen.q[:, 1])
    return effort


def heavy(seen):
    """A forearm of ten times its mass, and an effort that the catalogue does not have."""
    effort = effort_of(
        seen, 3, lambda one: pin.Inertia(10.0 * one.mass, one.lever, 10.0 * one.inertia)
    )
    effort[:, 4] += 0.3 * seen.load[:, 4].std() * np.sin(3.0 * seen.q[:, 1])
    return effort


def found(seed, hidden):
    """The end of a search that begins with bodies as free as they like."""
    model, log = model_file(), effort_log("arm6", seed, hidden, off=0.1).log
    case = open_case(model, [log], candidates=True)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    return searched(case, start.loosened(LOOSE), (), Criteria(), tune=True)[1].end


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [1, 2])
def test_effects_that_explain_as_much_are_the_answer(seed):
    end = found(seed, loaded)
    names = {(effect.name, effect.where) for effect in end.unknowns.effects}
    assert {("payload", ("flange",)), ("gravity_compensator", ("shoulder_pitch",))} <= names
    assert end.looseness <= 1.0


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.thorough)])
def test_a_body_that_is_another_one_goes_there(seed):
    end = found(seed, heavy)
    assert end.looseness == LOOSE
    assert not end.unknowns.effects
    moved = end.cv.fit_all()[: 10 * len(end.dataset.bodies) : 10] - model_file().phi[:, 0]
    assert end.dataset.bodies[int(np.argmax(np.abs(moved)))] == "forearm"


def test_the_way_of_bodies_does_not_depend_on_the_width_of_their_prior():
    """But on where they went: it is measured by the assumed width."""
    case = open_case(model_file(), [effort_log("arm6", 1, heavy).log], candidates=True)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model_file()))
    known = start.unknowns.information[:60, :60]
    for width in (1.0, LOOSE):
        other = start.loosened(width)
        step = other.cv.fit_all()[:60] - model_file().phi.ravel()
        assert other.inertial_penalty == pytest.approx(60.0 * np.log1p(step @ known @ step / 60.0))
    assert (
        start.loosened(LOOSE).inertial_penalty
        > start.inertial_penalty
        > start.loosened(1e-3).inertial_penalty
    )


@pytest.mark.parametrize(("hidden", "well"), [(None, True), (heavy, False)])
def test_bodies_are_where_they_may_well_be_or_not(hidden, well):
    """By the assumed width, however wide the prior of the fit is."""
    case = open_case(model_file(), [effort_log("arm6", 1, hidden).log], candidates=True)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model_file()))
    assert start.loosened(LOOSE).is_within_prior == well
