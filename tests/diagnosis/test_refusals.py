"""What was refused is asked again only where something changed."""

import pytest
from pendulum_logs import PENDULUM, friction, pendulum_log

from geodrake import load_model
from geodrake.diagnosis import Criteria
from geodrake.diagnosis.exchange import exchange
from geodrake.diagnosis.pruning import prune
from geodrake.diagnosis.refusals import Refusals
from geodrake.effects import CoulombFriction, Payload, ViscousFriction
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.hypothesis import first_hypothesis
from geodrake.identification.logs.model_fit import model_unknowns

SHOULDER = (CoulombFriction("shoulder"),)


def with_dry_shoulder(coulomb, viscous=(0.0, 0.0)):
    """What is fitted with dry friction of the shoulder to a log that hides some friction."""
    model, log = load_model(PENDULUM), pendulum_log(1, friction(coulomb, viscous))
    dataset = open_case(model, [log], candidates=True, bandwidth=6.0).dataset
    return first_hypothesis(dataset, model_unknowns(dataset, model)).with_effects(SHOULDER)


@pytest.fixture(scope="module")
def found():
    return with_dry_shoulder((0.2, 0.0), (0.1, 0.0))


def kept(found):
    refusals = Refusals()
    assert not refusals.has(found, SHOULDER, "shape")
    refusals.keep(found, SHOULDER, "shape")
    return refusals


def test_not_asked_twice(found):
    assert kept(found).has(found, SHOULDER, "shape")
    assert not kept(found).has(found, SHOULDER, "drop")


def test_noted_by_what_asks(found):
    refusals, criteria = Refusals(), Criteria()
    assert prune(found, (), criteria, refusals=refusals) is found
    assert refusals.has(found, SHOULDER, "drop")
    exchange(found, (), criteria, refusals=refusals)
    assert refusals.has(found, SHOULDER, "exchange")


def test_not_asked_for_what_is_elsewhere_and_does_nothing(found):
    assert kept(found).has(found.with_effects([CoulombFriction("elbow")]), SHOULDER, "shape")


def test_asked_again_beside_another_effect_at_its_place(found):
    after = found.with_effects([ViscousFriction("shoulder")])
    assert not kept(found).has(after, SHOULDER, "shape")


def test_asked_again_beside_a_body_that_its_joint_moves(found):
    assert not kept(found).has(found.with_effects([Payload("lower_link")]), SHOULDER, "shape")


def test_asked_again_with_another_prior(found):
    assert not kept(found).has(found.loosened(10.0), SHOULDER, "shape")


def test_asked_again_where_its_joint_errs_more(found):
    other = with_dry_shoulder((0.2, 0.0), (0.2, 0.0))
    assert not kept(found).has(other, SHOULDER, "shape")
    assert kept(found).has(other, SHOULDER, "shape", least=1e3)
