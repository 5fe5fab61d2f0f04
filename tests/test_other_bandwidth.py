"""Bandwidths other than that which suits a motion: what they must not be used for."""

import numpy as np
import pytest
from pendulum_logs import PENDULUM, pendulum_log

from geodrake import load_model
from geodrake.diagnosis import explain
from geodrake.diagnosis.case import open_case, reduced
from geodrake.diagnosis.evidence import Criteria
from geodrake.diagnosis.hypothesis import first_hypothesis
from geodrake.diagnosis.other_bandwidth import errors_at, other_bandwidths
from geodrake.effects import Backlash, Contact, JointElasticity
from geodrake.identification.model_fit import model_unknowns

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
