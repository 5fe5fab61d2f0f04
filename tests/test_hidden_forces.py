"""Forces that a robot has and its model lacks are found, named and placed.

Logs are inverse dynamics by Pinocchio of bodies that are 20 % off, with the force in a formula of
its own on top. Friction and other effects of older date are in test_hidden_effects.py.
"""

from functools import cache

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from effort_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.diagnosis import add, diagnose, explain
from geodrake.identification.coherent_bandwidth import prepare_for_model
from geodrake.saved_model import save_model

MARGIN = 1.15
"""Largest held-out error, as a multiple of the error that the noise alone makes."""

SEEDS = (1, 2)


@cache
def model_file(name):
    return load_model(MODELS / f"{name}.urdf")


def assert_found(model, recording, expected, *, margin=MARGIN):
    """The expected effects, at their places and no others, and only the noise is left."""
    found = explain(model, [recording.log])
    assert {step.effect: set(step.where) for step in found.steps} == {
        effect: set(where) for effect, where in expected.items()
    }
    trajectories, _ = prepare_for_model(model, [recording.log])
    noise = recording.noise * trajectories[0].filter.noise_gain
    stds = [joint.std for joint in found.end.joints]
    floor = np.sqrt(np.mean((noise / stds) ** 2))
    assert found.end.nrms < margin * floor
    assert found.verdict == "explained"
    return {step.effect: step.parameters for step in found.steps}, found


def size_of(values):
    """Amplitude of the waves of two parameters."""
    return np.hypot(values["sine"], values["cosine"])


def wave(joint, amplitude, order, phase=0.4):
    return lambda seen: {joint: amplitude * np.sin(order * seen.q[:, joint] - phase)}


class TestGravityCompensator:
    @pytest.mark.parametrize("seed", SEEDS)
    @pytest.mark.parametrize(("joint", "name"), [(0, "base_yaw"), (1, "shoulder_pitch")])
    def test_found(self, joint, name, seed):
        recording = effort_log("arm6", seed, wave(joint, (6.0, 20.0)[joint], 1.0), off=0.2)
        steps, _ = assert_found(model_file("arm6"), recording, {"gravity_compensator": (name,)})
        values = steps["gravity_compensator"][name]
        assert size_of(values) == pytest.approx((6.0, 20.0)[joint], rel=0.05)


class TestTorqueRipple:
    @pytest.mark.parametrize("seed", SEEDS)
    @pytest.mark.parametrize(("order", "size"), [(7.0, 3.0), (23.4, 1.0), (101.0, 1.0)])
    def test_found(self, order, size, seed):
        recording = effort_log("arm6", seed, wave(1, size, order), off=0.2)
        steps, _ = assert_found(
            model_file("arm6"), recording, {"torque_ripple": ("shoulder_pitch",)}
        )
        values = steps["torque_ripple"]["shoulder_pitch"]
        assert values["order"] == pytest.approx(order, abs=0.06)
        assert size_of(values) == pytest.approx(size, rel=0.06)

    def test_under_friction(self, tmp_path):
        """Ripple of an eighteenth of the friction; the model is saved and holds."""

        def hidden(seen):
            return {0: 0.3 * np.cos(23.4 * seen.q[:, 0]) + 4.0 * np.tanh(seen.v[:, 0] / 0.01)}

        recording = effort_log("arm6", 1, hidden, off=0.2)
        _, found = assert_found(
            model_file("arm6"),
            recording,
            {"coulomb_friction": ("base_yaw",), "torque_ripple": ("base_yaw",)},
        )
        save_model(found.model, tmp_path / "arm.yaml")
        again = load_model(tmp_path / "arm.yaml")
        assert [f.effect for f in again.effects] == [f.effect for f in found.model.effects]
        other = explain(again, [effort_log("arm6", 1, hidden, off=0.2, share=0.031).log])
        assert other.steps == ()

    def test_named_by_one_diagnosis(self):
        recording = effort_log("double_pendulum", 3, wave(1, 0.05, 40.0), duration=40.0)
        found = diagnose(model_file("double_pendulum"), [recording.log])
        assert found.candidates[0].effect == "torque_ripple"
        assert found.candidates[0].where == ("elbow",)

    def test_added_by_name(self):
        recording = effort_log("double_pendulum", 3, wave(1, 0.05, 40.0), duration=40.0)
        found = add("torque_ripple", model_file("double_pendulum"), [recording.log])
        (step,) = found.steps
        assert step.where == ("elbow",)
        assert step.parameters["elbow"]["order"] == pytest.approx(40.0, abs=0.1)
        assert found.end.nrms < 0.5 * found.start.nrms
