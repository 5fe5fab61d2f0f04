"""Dry friction that does not jump where a joint turns round, in a formula of its own."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from pinocchio_logs import MODELS, effort_log
from scipy.special import erf

from geodrake import load_model, save_model
from geodrake.control import ControlModel
from geodrake.diagnosis import add, compare, explain
from geodrake.effects import CoulombFriction, FittedEffect
from geodrake.logs import Motion

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


def test_gradual_friction_is_dry_friction_alone_with_a_speed_that_is_told(faded):
    (step,) = faded.steps
    assert (step.effect, set(step.where)) == ("coulomb_friction", {"shoulder", "elbow"})
    for joint, height in zip(faded.model.joints, HEIGHT, strict=True):
        assert step.parameters[joint]["coulomb"] == pytest.approx(height, rel=0.03)
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


@pytest.mark.parametrize("seed", [3, 4])
def test_another_log_needs_nothing_more(faded, seed):
    found = explain(faded.model, [rubbing(seed, 0.02).log])
    assert found.steps == ()
    np.testing.assert_array_equal(found.model.fading_speed, faded.model.fading_speed)
    assert found.end.nrms < 0.02


def test_one_effect_alone_is_not_said_to_fade(model):
    # What the others are is not known yet: at low speeds the error may be theirs.
    assert add("coulomb_friction", model, [rubbing(1, 0.02).log]).model.fading_speed is None


def test_speed_of_a_joint_that_this_log_does_not_show_is_kept(model):
    known = replace(model, fading_speed=np.array([0.0, 2e-4]))
    log = effort_log(
        "double_pendulum",
        1,
        lambda seen: {0: HEIGHT[0] * erf(seen.v[:, 0] / 0.02)},
        share=0.01,
        pace=0.1,
    ).log
    found = explain(known, [log])
    assert {step.effect: step.where for step in found.steps} == {"coulomb_friction": ("shoulder",)}
    assert 0.01 < found.model.fading_speed[0] < 0.025
    assert found.model.fading_speed[1] == 2e-4
    assert [note for note in found.notes if "elbow" in note and "fades below" in note] == []


def test_controllers_know_it(model):
    fitted = replace(
        model,
        fading_speed=np.array([0.05, 0.0]),
        effects=tuple(
            FittedEffect(CoulombFriction(joint), np.ones(1), np.ones(1)) for joint in model.joints
        ),
    )
    control, still = ControlModel.of(fitted, sign_width=1e-2), np.zeros(2)
    slow = np.array([0.02, 0.02])
    regressor = control.at(still, slow, slow, still).regressor
    motion = Motion(still[None], slow[None], still[None])
    expected = fitted.effort(motion, sign_width=1e-2)[0]
    np.testing.assert_allclose(regressor @ control.prior, expected, rtol=1e-9)


def test_what_is_more_at_low_speeds_is_stribeck_friction_where_directions_fade_below(model):
    """Its curve in another formula: it is not taken for what no log tells of reversals."""

    def hidden(seen):
        height = 0.075 + 0.08 / (1.0 + (seen.v / 0.03) ** 2)
        return height * np.tanh(seen.v / 0.012) * [1.0, 0.0]

    found = explain(model, [effort_log("double_pendulum", 2, hidden, share=0.02, pace=0.1).log])
    assert {step.effect for step in found.steps} == {"coulomb_friction", "stribeck_friction"}
    assert found.verdict == "explained"
