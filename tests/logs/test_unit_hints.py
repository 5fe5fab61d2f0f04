"""Hints at units, signs and zeros: what numbers cannot be, with the likely cause."""

from dataclasses import replace

import numpy as np
import pytest

from geodrake.errors import LogError
from geodrake.logs import JointLog
from geodrake.logs.uniform_log import make_uniform
from geodrake.logs.unit_hints import (
    effort_sign_hint,
    effort_unit_hint,
    position_limit_hint,
    position_unit_hint,
)

LOW, HIGH = np.array([0.2, -2.0]), np.array([1.2, 2.0])


def log(first):
    time = np.arange(200) * 0.01
    position = np.stack([first, np.sin(3.0 * time)], 1)
    return JointLog("run", ("a", "b"), time, position, np.cos(position))


SWING = 0.7 + 0.4 * np.sin(np.arange(200) * 0.05)


@pytest.mark.parametrize(
    ("first", "words"),
    [
        (-SWING, "With the opposite sign they are within"),
        (SWING - np.pi, "Shifted by +180° they are within"),
        (np.rad2deg(SWING), "Divided by 57.3 they are within"),
        (3.0 * SWING, "the same joints, zeros and units?"),
    ],
)
def test_positions_beyond_limits_have_a_likely_cause(first, words):
    said = position_limit_hint(log(first), LOW, HIGH)
    outside = np.mean((first < 0.19) | (first > 1.21))
    assert f"a in {100 * outside:.0f} % of the samples of log 'run'" in said
    assert "beyond 0.2 … 1.2" in said
    assert words in said


@pytest.mark.parametrize("scale", [1e4, 250.0])
def test_whole_numbers_far_from_zero_are_refused_before_anything_is_made_of_them(scale):
    ticks = np.rint(scale * log(SWING).position)
    raw = replace(log(SWING), position=ticks)
    with pytest.raises(LogError, match=r"no joint reaches in rad or m\. .*mm .*rev/4096@2048"):
        make_uniform(raw)
    make_uniform(replace(raw, position=ticks + 0.5))
    assert ("neither rad nor degrees" in position_unit_hint(raw)) == (scale > 3600.0)


def test_limits_that_were_taken_for_the_wrong_unit():
    said = position_limit_hint(log(SWING), np.deg2rad(LOW), np.deg2rad(HIGH))
    assert "Within limits 57.3 times as wide" in said
    assert "joints beyond: 2" in said


def test_positions_inside_and_single_spikes_are_nothing_to_say():
    assert position_limit_hint(log(SWING), LOW, HIGH) is None
    spike = SWING.copy()
    spike[7] = 30.0
    assert position_limit_hint(log(spike), LOW, HIGH) is None
    assert position_limit_hint(log(9.0 * SWING), [-np.inf] * 2, [np.inf] * 2) is None


def test_units_of_positions_and_efforts():
    swing = log(SWING)
    swing = replace(swing, effort=100.0 * swing.effort)
    largest = np.abs(swing.effort).max(0)
    assert position_unit_hint(swing) is None
    assert "degrees" in position_unit_hint(replace(swing, position=np.degrees(swing.position)))
    assert effort_unit_hint(swing, [largest[0], np.inf]) is None
    assert effort_unit_hint(swing, [0.0, np.inf]) is None
    assert "30 times" in effort_unit_hint(swing, [largest[0], largest[1] / 30.0])
    assert "1 %" in effort_unit_hint(swing, 105.0 * largest)


@pytest.mark.parametrize("kinds", [{}, {"a": "current", "b": "current"}])
def test_efforts_without_their_sign_are_said(kinds):
    waves = np.sin(0.01 * np.arange(200)[:, None] * np.array([11.0, 13.0]))

    def hint(efforts):
        return effort_sign_hint(replace(log(SWING), effort=efforts, effort_kinds=kinds))

    assert "magnitudes" in hint(np.abs(waves))
    assert hint(waves) is None
    assert hint(2.0 + waves) is None
    assert hint(np.zeros_like(waves)) is None
