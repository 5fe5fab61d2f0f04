"""Dry friction that does not jump where a joint turns round, in a formula of its own."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from effort_logs import MODELS, effort_log
from scipy.special import erf

from geodrake import load_model, save_model
from geodrake.diagnosis import compare, explain

HEIGHT = np.array([0.1, 0.04])  # N·m


def rubbing(seed, speed):
    """A slow log of a pendulum whose dry friction has its full height above a speed, rad/s."""

    def hidden(seen):
        return HEIGHT * erf(seen.v / speed)

    return effort_log("double_pendulum", seed, hidden, share=0.01, pace=0.1)


@pytest.fixture(scope="module")
def model():
    return load_model(MODELS / "double_pendulum.urdf")


@pytest.fixture(scope="module")
def faded(model):
    return explain(model, [rubbing(1, 0.02).log])


def test_gradual_friction_is_dry_friction_alone(faded):
    (step,) = faded.steps
    assert (step.effect, set(step.where)) == ("coulomb_friction", {"shoulder", "elbow"})
    for joint, height in zip(faded.model.joints, HEIGHT, strict=True):
        assert step.parameters[joint]["coulomb"] == pytest.approx(height, rel=0.03)


def test_speed_is_found_and_told(faded):
    # tanh(v / w) is nearest to erf(v / ε) for a w that is a little smaller than ε.
    assert np.all(faded.model.fading_speed > 0.01)
    assert np.all(faded.model.fading_speed < 0.025)
    assert sum("dry friction of" in note and "fades below" in note for note in faded.notes) == 2


def test_it_holds_on_another_log(faded, tmp_path):
    other = [rubbing(2, 0.02).log]
    save_model(faded.model, tmp_path / "faded.yaml")
    again = compare(load_model(tmp_path / "faded.yaml"), other).errors.nrms
    jumping = compare(replace(faded.model, fading_speed=None), other).errors.nrms
    assert again < 0.5 * jumping


def test_the_same_log_needs_nothing_more(faded):
    assert explain(faded.model, [rubbing(3, 0.02).log]).steps == ()


def test_friction_that_jumps_is_left_alone(model):
    found = explain(model, [rubbing(1, 1e-4).log])
    (step,) = found.steps
    assert step.effect == "coulomb_friction"
    assert found.model.fading_speed is None
