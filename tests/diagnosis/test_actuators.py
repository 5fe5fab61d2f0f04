"""What actuators do to efforts is found, named and sized.

Logs are inverse dynamics by Pinocchio of bodies that are 20 % off, with what the actuator does in a
formula of its own on top.
"""

import dataclasses

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from effort_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.diagnosis import add, explain
from geodrake.errors import ArgumentError
from geodrake.logs.motion import Motion
from geodrake.model.exporting.held import held_by, reasons
from geodrake.model.file_terms import Damping

ELBOW, NAME = 2, "elbow_pitch"
MOTIONS = [Motion(*np.random.default_rng(0).normal(size=(3, 50, 2)))]


def smooth_sign(v):
    return v / np.hypot(v, 5e-3)


@pytest.fixture(scope="module")
def arm():
    return load_model(MODELS / "arm6.urdf")


def steps_of(found):
    return {step.effect: step.parameters for step in found.steps}


@pytest.fixture(scope="module")
def pendulum():
    return load_model(MODELS / "double_pendulum.urdf")


def short_log(seed, hidden):
    return effort_log("double_pendulum", seed, hidden, duration=16.0, rate=125.0, share=0.01).log


class TestOvercompensation:
    """Drives that add more against dry friction than there is, in efforts that do not show it."""

    DRY, WET = np.array([-0.25, -0.12]), np.array([0.4, 0.25])

    def hidden(self, seen):
        return self.DRY * smooth_sign(seen.v) + self.WET * seen.v

    def test_named(self, pendulum):
        found = explain(pendulum, [short_log(1, self.hidden)])
        steps = steps_of(found)
        assert set(steps) == {"friction_overcompensation", "viscous_friction"}
        assert found.verdict == "explained"
        excess = [steps["friction_overcompensation"][j]["excess"] for j in pendulum.joints]
        viscous = [steps["viscous_friction"][j]["viscous"] for j in pendulum.joints]
        np.testing.assert_allclose(excess, -self.DRY, rtol=0.05)
        np.testing.assert_allclose(viscous, self.WET, rtol=0.05)
        (lost,) = held_by(found.model, lambda effect: isinstance(effect, Damping), MOTIONS).lost
        assert (lost.effect, lost.into) == ("friction_overcompensation", ())
        (told,) = reasons(found.model.effects)
        assert "friction_overcompensation of shoulder, elbow is not in the files" in told
        assert "what the drive does" in told

    @pytest.mark.thorough
    def test_friction_that_grows_with_speed_is_none(self, pendulum):
        def drag(seen):
            return np.array([0.3, 0.2]) * np.abs(seen.v) * seen.v

        steps = steps_of(explain(pendulum, [short_log(3, drag)]))
        assert set(steps) == {"nonlinear_viscous_friction"}


class TestThermalOffset:
    """An offset of 0.06 N·m/°C that goes with the logged temperature, of 8 °C in a log."""

    @staticmethod
    def temperature(time):
        return 31.0 + 8.0 * (1.0 - np.exp(-time / 7.0))

    def log(self, seed, readings):
        def hidden(seen):
            offset = 0.06 * (self.temperature(seen.time) - 30.0)[:, None] * [0.0, 1.0]
            return 0.3 * smooth_sign(seen.v) + 0.2 * seen.v + offset

        log = short_log(seed, hidden)
        return dataclasses.replace(log, temperature=readings(log.time))

    def test_named(self, pendulum):
        def readings(time):
            return np.stack([np.full_like(time, 255.0), self.temperature(time)], -1)

        found = explain(pendulum, [self.log(1, readings)])
        steps = steps_of(found)
        assert set(steps) == {"coulomb_friction", "viscous_friction", "thermal_offset"}
        assert found.verdict == "explained"
        ((joint, values),) = steps["thermal_offset"].items()
        assert joint == pendulum.joints[1]
        np.testing.assert_allclose(values["slope"], 0.06, rtol=0.03)
        at_30 = values["offset"] + (30.0 - values["reference"]) * values["slope"]
        assert abs(at_30) < 0.02
        assert any("the sensor fails" in note for note in found.notes)

    @pytest.mark.thorough
    @pytest.mark.parametrize("code", [0.0, -1.0])
    def test_not_named_where_the_sensor_fails(self, pendulum, code):
        def readings(time):
            failing = np.where(time[:, None] < 5.0, code, np.nan)
            return np.tile(failing, (1, 2))

        found = explain(pendulum, [self.log(1, readings)])
        assert "thermal_offset" not in steps_of(found)


def test_effort_commands_that_act_late_are_a_negative_delay():
    """The column says at t what acts at t + 12 ms, so it is ahead of the motion."""
    late, log = 3, effort_log("double_pendulum", 3, duration=10.0).log
    told = dataclasses.replace(
        log,
        time=log.time[:-late],
        position=log.position[:-late],
        velocity=log.velocity[:-late],
        effort=log.effort[late:],
    )
    (step,) = explain(load_model(MODELS / "double_pendulum.urdf"), [told]).steps
    assert step.effect == "effort_delay"
    (values,) = step.parameters.values()
    np.testing.assert_allclose(list(values.values()), -0.012, atol=1e-3)


class TestTemperature:
    """A gear that warms up, cools down and warms up again: time says nothing of it."""

    @staticmethod
    def temperature(time):
        return 38.0 - 12.0 * np.cos(2.0 * np.pi * time / 16.0)

    def recording(self, seed):
        def friction(seen):
            share = 1.0 - 0.02 * (self.temperature(seen.time) - 38.0)
            v = seen.v[:, ELBOW]
            return {ELBOW: share * (6.0 * smooth_sign(v) + 4.0 * v)}

        return effort_log("arm6", seed, friction, off=0.2)

    @pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.thorough)])
    def test_found_where_the_log_has_it(self, arm, seed):
        log = self.recording(seed).log
        readings = np.tile(np.round(self.temperature(log.time))[:, None], (1, len(log.joints)))
        found = explain(arm, [dataclasses.replace(log, temperature=readings)])
        steps = steps_of(found)
        assert set(steps) == {"coulomb_friction", "viscous_friction", "thermal_friction"}
        assert all(step.where == (NAME,) for step in found.steps)
        assert found.verdict == "explained"
        values = steps["thermal_friction"][NAME]
        np.testing.assert_allclose(values["coulomb_slope"], -0.12, rtol=0.15)
        np.testing.assert_allclose(values["viscous_slope"], -0.08, rtol=0.25)
        away = values["reference"] - 38.0
        coulomb = steps["coulomb_friction"][NAME]["coulomb"]
        np.testing.assert_allclose(coulomb - away * values["coulomb_slope"], 6.0, rtol=0.05)

    def test_cannot_be_added_without(self, arm):
        log = effort_log("arm6", 1, duration=4.0, rate=100.0).log
        with pytest.raises(ArgumentError, match=r"no log has a temperature.*<joint>\.temperature"):
            add("thermal_friction", arm, [log])

    @pytest.mark.thorough
    def test_not_named_where_nobody_measured_it(self, arm):
        assert "thermal_friction" not in steps_of(explain(arm, [self.recording(1).log]))
