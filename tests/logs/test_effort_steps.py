"""Steps of efforts: said where they make the noise, and not where numbers have few digits."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geodrake.logs import JointLog
from geodrake.logs.uniform_log import effort_steps, make_uniform

TIME = np.arange(3000) / 250.0
Q = np.sin(TIME[:, None] * np.array([2.0, 3.0]))
SMOOTH = 8.0 * np.cos(TIME * 2.1) + 3.0 * np.sin(TIME * 5.3)


def log_with(effort):
    """A log with some efforts at its elbow, and smooth ones at its shoulder."""
    return JointLog("steps", ("shoulder", "elbow"), TIME, Q, np.stack([SMOOTH, effort], 1))


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
    (note,) = [note for note in make_uniform(log).notes if "steps" in note]
    assert "elbow of 0.24 (noise 0.069)" in note
    assert "shoulder" not in note
    plain = dataclasses.replace(log, effort=np.stack([SMOOTH, SMOOTH], 1))
    assert not any("steps" in note for note in make_uniform(plain).notes)
