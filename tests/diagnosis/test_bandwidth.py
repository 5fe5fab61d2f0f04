"""What the bandwidth of a motion shows, and what it leaves out."""

from dataclasses import replace

import numpy as np
import pytest
from elbow_logs import MODEL, loose_log, soft_log
from pendulum_logs import pendulum_log
from scipy.special import expit

from geodrake.diagnosis import explain

PLAY = 3e-4  # rad to either side, of which the motion's own bandwidth shows nothing
ELBOW = np.array([0.0, 1.0])


def told(log, model=MODEL, **options):
    """Places of the effects that explain a log, and the verdict."""
    found = explain(model, [log], **options)
    return {step.effect: step.where for step in found.steps}, found.verdict


def pushed(log):
    """A log with a push at the tip of the lower link that lasts for three seconds."""
    on = expit(20.0 * (log.time - 10.0)) - expit(20.0 * (log.time - 13.0))
    inner, outer = log.position[:, 0], log.position.sum(1)
    lower = 0.3 * np.stack([-np.cos(outer), np.sin(outer)], 1)
    upper = lower + 0.2 * np.stack([-np.cos(inner), np.sin(inner)], 1)
    moments = np.stack([upper, lower], 1) @ [2.0, 1.0]
    return replace(log, effort=log.effort - on[:, None] * moments)


def test_what_is_above_half_the_bandwidth_is_not_filtered_away():
    """A torque that no effect explains is unexplained, though at half the bandwidth it is gone."""

    def oscillation(q, v, vd, load):
        wave = 0.6 * np.sin(2 * np.pi * 3.5 / 200.0 * np.arange(len(q)))
        return np.stack([wave, 0.5 * wave], 1)

    log = pendulum_log(3, oscillation, seconds=20.0)
    assert told(log)[1] == "unexplained"
    assert told(log, bandwidth=2.5)[1] == "adequate"


@pytest.mark.thorough
def test_a_log_with_a_contact_keeps_its_bandwidth():
    """Its pieces were dealt out to the blocks that are held out; play would show elsewhere."""
    places = {"contact": ("lower_link",)}
    assert told(pushed(loose_log(12e-3, noise=0.01))) == (places, "explained")


class TestPlay:
    @pytest.mark.thorough
    @pytest.mark.parametrize(
        "more",
        [
            pytest.param(
                lambda log: 0.01 * np.sin(40.0 * log.position),
                id="ripple",
                marks=pytest.mark.thorough,
            ),
            pytest.param(
                lambda log: 0.01 * np.sin(12.0 * np.pi * log.time)[:, None], id="oscillation"
            ),
        ],
    )
    def test_not_beside_what_is_new_too_or_unexplained(self, more):
        """Where play would show, something else does, which the motion's bandwidth leaves out."""
        log = loose_log(PLAY, noise=0.01)
        log = replace(log, effort=log.effort + more(log) * log.effort.std(0) * ELBOW)
        assert told(log) == ({}, "adequate")

    @pytest.mark.thorough
    def test_not_in_the_place_of_what_was_explained(self):
        """A small offset that shows where there is less noise."""
        log = loose_log(PLAY, noise=0.003)
        log = replace(log, effort=log.effort + 4e-4 * log.effort.std(0) * ELBOW)
        places, verdict = told(log)
        assert "effort_offset" in places
        assert "backlash" not in places
        assert verdict == "explained"


class TestSoftness:
    @pytest.mark.parametrize(
        ("size", "taken"), [(0.0, True), pytest.param(0.01, False, marks=pytest.mark.thorough)]
    )
    @pytest.mark.thorough
    def test_must_take_half_of_what_is_unexplained(self, size, taken):
        """A breeze at both joints leaves more than that."""

        def wind(time):
            gusts = np.random.default_rng(9).normal(size=22)
            return size * np.interp(time, np.arange(22), gusts)[:, None] * np.ones(2)

        places, _ = told(soft_log(wind))
        assert places == ({"joint_elasticity": ("elbow",)} if taken else {})
