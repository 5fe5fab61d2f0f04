"""Bandwidths other than that which suits a motion: what they must not be used for."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum_logs import PENDULUM, friction, pendulum_log

from geodrake import load_model
from geodrake.diagnosis import explain
from geodrake.diagnosis.explain import _explains_more, investigate
from geodrake.diagnosis.other_bandwidth import (
    OtherBandwidth,
    errors_at,
    errors_of,
    other_bandwidths,
)
from geodrake.effects import Backlash, Contact, CoulombFriction, JointElasticity
from geodrake.identification.logs.case import open_case, reduced
from geodrake.identification.logs.evidence import Criteria
from geodrake.identification.logs.hypothesis import first_hypothesis
from geodrake.identification.logs.model_fit import model_unknowns

MODEL = load_model(PENDULUM)


def oscillation(frequency):
    """A torque at the shoulder that no effect explains, 200 samples a second."""

    def effort(q, v, vd, load):
        wave = 0.6 * np.sin(2 * np.pi * frequency / 200.0 * np.arange(len(q)))
        return np.stack([wave, 0.5 * wave], 1)

    return effort


def opened(log, effects=()):
    """A case and what is known on it: the model refitted, and some effects."""
    case = open_case(MODEL, [log], candidates=False)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, MODEL))
    moved = start.moved(reduced(case, list(effects)), delay=0)
    return case, moved.with_effects(effects) if effects else moved


def test_what_is_above_half_the_bandwidth_is_not_filtered_away():
    log = pendulum_log(3, oscillation(3.5))
    case, known = opened(log)
    bandwidth = case.trajectories[0].filter.bandwidth
    assert bandwidth / 2 < 3.5 < bandwidth
    assert errors_at(case, known, bandwidth / 2).is_noise
    found = explain(MODEL, [log])
    assert found.verdict == "unexplained"
    assert not any("Hz at which" in note for note in found.notes)


@pytest.mark.parametrize(
    ("effect", "explained"),
    [
        (Contact("lower_link", 10.0, 12.0, 0.1), True),
        (Contact("lower_link", 10.0, 12.0, 0.1), False),
        (Backlash("elbow", 1e-3), True),
        (JointElasticity("elbow"), False),
    ],
)
def test_bandwidths_that_stay(effect, explained):
    """Pieces of contacts were dealt out to the folds; what was found need not be found again."""
    case, known = opened(pendulum_log(3), [effect])
    assert not list(other_bandwidths(case, known, Criteria(), explained=explained))


def test_a_bandwidth_that_was_asked_for_stays():
    case = open_case(MODEL, [pendulum_log(3)], candidates=False, bandwidth=5.0)
    known = first_hypothesis(case.dataset, model_unknowns(case.dataset, MODEL))
    assert not list(other_bandwidths(case, known, Criteria(), explained=True))


@pytest.fixture(scope="module")
def rubbing():
    """Dry friction at both joints, found and explained."""
    log = pendulum_log(4, friction((0.2, 0.1)))
    found = investigate(open_case(MODEL, [log], candidates=True))
    assert [step.effect for step in found.explanation.steps] == ["coulomb_friction"]
    return found


def told(found, *names, verdict="explained", end=None):
    """The same investigation with further steps."""
    more = [replace(found.explanation.steps[0], effect=name) for name in names]
    steps = (*found.explanation.steps, *more)
    explanation = replace(found.explanation, steps=steps, verdict=verdict)
    return replace(found, explanation=explanation, hypothesis=end or found.hypothesis)


def play_at(found):
    return OtherBandwidth(10.0, Backlash, errors_of(found.hypothesis))


def test_play_that_comes_alone_or_with_bodies_tells_more(rubbing):
    for names in (["backlash"], ["backlash", "wrong_inertia"]):
        assert _explains_more(told(rubbing, *names), rubbing, play_at(rubbing))


@pytest.mark.parametrize(
    ("names", "verdict"),
    [
        ([], "explained"),
        (["torque_ripple"], "explained"),
        (["backlash", "torque_ripple"], "explained"),
        (["backlash"], "unexplained"),
    ],
)
def test_without_play_alone_or_without_an_explanation_nothing_more_is_told(rubbing, names, verdict):
    assert not _explains_more(told(rubbing, *names, verdict=verdict), rubbing, play_at(rubbing))


def test_what_was_explained_must_be_still(rubbing):
    """Where a bandwidth comes without the friction, it says less of the log at its own."""
    rid = [CoulombFriction(joint) for joint in ("shoulder", "elbow")]
    end = rubbing.hypothesis.without(rid)
    assert not _explains_more(told(rubbing, "backlash", end=end), rubbing, play_at(rubbing))


@pytest.mark.parametrize(("left", "more"), [(0.45, True), (0.55, False)])
def test_softness_must_take_half_of_what_is_unexplained(rubbing, left, more):
    ten_times = [
        replace(joint, rms=10 * joint.rms) for joint in errors_of(rubbing.hypothesis).joints
    ]
    known = replace(errors_of(rubbing.hypothesis), joints=tuple(ten_times))
    was = told(rubbing, verdict="unexplained")
    now = told(rubbing, "joint_elasticity", verdict="unexplained")
    part = tuple(replace(joint, rms=left * joint.rms) for joint in known.joints)
    now = replace(now, explanation=replace(now.explanation, end=replace(known, joints=part)))
    assert _explains_more(now, was, OtherBandwidth(1.0, JointElasticity, known)) == more
