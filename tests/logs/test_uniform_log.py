"""What a uniform log finds out by itself: its clock by velocities, and the steps of its efforts."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pendulum_logs import JOINTS, PENDULUM

from geodrake import load_model
from geodrake.diagnosis import check_columns
from geodrake.logs import JointLog
from geodrake.logs.uniform_log import effort_steps, make_uniform

SHORT = np.arange(0.0, 8.0, 0.01)
RATES = np.array([1.0, 1.7, 2.9])


def second(factors, *, clock=1.0):
    """By velocities that are off by factors, of a log whose time is off."""
    q, v = np.sin(RATES * SHORT[:, None]), RATES * np.cos(RATES * SHORT[:, None])
    log = JointLog("log", ("a", "b", "c"), SHORT / clock, q, q, velocity=v * factors)
    return make_uniform(log).time_scale


@pytest.mark.parametrize("clock", [0.1, 1.0, 20.0])
def test_velocities_tell_the_clock(clock):
    assert second([1.0, 1.0, 1.0], clock=clock) == pytest.approx(clock, rel=1e-2)
    assert second([1.0, -30.0, 1.0], clock=clock) == pytest.approx(clock, rel=1e-2)


@pytest.mark.parametrize("factors", [0.0, -1.0, 1e-3, 1e4, [1.0, -1.0, 0.0], [1.0, 20.0, 90.0]])
def test_what_no_clock_does_tells_none(factors):
    assert np.isnan(second(factors))


def test_velocities_that_are_far_too_small_cost_nothing():
    q, v = np.sin(RATES[:2] * SHORT[:, None]), np.cos(RATES[:2] * SHORT[:, None])
    log = JointLog("log", JOINTS, SHORT, q, 5.0 * q, velocity=2e-3 * v)
    assert all(found.kind for found in check_columns(load_model(PENDULUM), [log]))


TIME = np.arange(3000) / 250.0
Q = np.sin(TIME[:, None] * np.array([2.0, 3.0]))
SMOOTH = 8.0 * np.cos(TIME * 2.1) + 3.0 * np.sin(TIME * 5.3)


def log_with(effort):
    """A log with some efforts at its elbow, and smooth ones at its shoulder."""
    return JointLog("steps", JOINTS, TIME, Q, np.stack([SMOOTH, effort], 1))


@settings(max_examples=25)
@given(
    step=st.floats(0.06, 1.0),
    offset=st.floats(-1.0, 1.0),
    noise=st.sampled_from([0.0, 0.1, 0.3]),
    seed=st.integers(0, 2**31),
)
def test_the_step_of_a_converter_is_found(step, offset, noise, seed):
    """Whatever its gain and zero, while the noise before it is less than a third of a step."""
    rng = np.random.default_rng(seed)
    effort = step * np.rint((SMOOTH + noise * step * rng.normal(size=len(TIME))) / step) + offset
    assert effort_steps(log_with(effort)) == pytest.approx([0.0, step])


def test_steps_that_are_printed_with_few_digits():
    effort = np.round(0.366 * np.rint(SMOOTH / 0.366), 2)
    assert effort_steps(log_with(effort)) == pytest.approx([0.0, 0.366], abs=0.01)


def test_a_note_says_step_and_noise():
    log = log_with(0.24 * np.rint(SMOOTH / 0.24))
    (note,) = [note for note in make_uniform(log).notes if "quantized" in note]
    assert "elbow 0.24 (noise 0.069)" in note
    assert "shoulder" not in note
    plain = dataclasses.replace(log, effort=np.stack([SMOOTH, SMOOTH], 1))
    assert not any("quantized" in note for note in make_uniform(plain).notes)
