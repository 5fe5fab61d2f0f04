"""Weights that a fit finds for itself: a fixed point, which is kept."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum_logs import PENDULUM, friction, pendulum_log

from geodrake import load_model
from geodrake.effects import CoulombFriction
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.cross_validation import CrossValidation
from geodrake.identification.logs.evidence import log_likelihood_gain
from geodrake.identification.logs.hypothesis import first_hypothesis, settle
from geodrake.identification.logs.model_fit import model_unknowns


def test_first_hypothesis_is_settled():
    """Weights that it begins with are far from those that its errors deserve."""

    def compensator(q, v, vd, load):
        return [0.4, 0.0] * np.sin(q - 1.0)

    model, log = load_model(PENDULUM), pendulum_log(1, compensator, seconds=16.0)
    case = open_case(model, [log], candidates=False)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    again = settle(start, iterations=20)
    assert again.nrms == pytest.approx(start.nrms, rel=0.01)


def test_what_is_asked_again_is_what_it_was():
    """A dataset without a memory gives the same, and nobody can change what is kept."""
    model, log = load_model(PENDULUM), pendulum_log(1, friction((0.2, 0.1)), seconds=16.0)
    case = open_case(model, [log], candidates=True, bandwidth=6.0)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    effects = [CoulombFriction("shoulder"), CoulombFriction("elbow")]
    first = start.with_effects(effects)
    count = len(case.dataset.settled)
    again = start.with_effects(effects)
    assert len(case.dataset.settled) == count > 0
    fresh = replace(start, dataset=replace(case.dataset)).with_effects(effects)
    for other in (again, fresh):
        np.testing.assert_array_equal(other.weights, first.weights)
        np.testing.assert_array_equal(other.effective, first.effective)
        np.testing.assert_array_equal(other.held_out.sse, first.held_out.sse)
        np.testing.assert_array_equal(other.held_out.x, first.held_out.x)
        np.testing.assert_array_equal(other.cv.weights, first.cv.weights)
        np.testing.assert_array_equal(other.cv.fit_all(), first.cv.fit_all())
    for kept in (again.weights, again.effective, again.held_out.sse, again.held_out.x):
        with pytest.raises(ValueError, match="read-only"):
            kept[0] = 1.0


def test_quick_gains_of_a_delay_are_those_of_a_fit_to_it():
    model, log = load_model(PENDULUM), pendulum_log(2, seconds=16.0)
    case = open_case(model, [log], candidates=True, bandwidth=6.0)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    fits = [
        CrossValidation(case.dataset, start.unknowns, start.cv.weights, delay=delay)
        for delay in (0, 1)
    ]
    gains = start.quick_gains([0, 1])
    for fit, gain in zip(fits, gains, strict=True):
        mse = fit.held_out.mse
        expected = log_likelihood_gain(start.held_out.mse, mse, start.effective).sum()
        assert gain == pytest.approx(expected, rel=1e-6, abs=1e-6)
    assert gains[1] < gains[0]
