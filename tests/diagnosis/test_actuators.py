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

ELBOW, NAME = 2, "elbow_pitch"


def smooth_sign(v):
    return v / np.hypot(v, 5e-3)


@pytest.fixture(scope="module")
def arm():
    return load_model(MODELS / "arm6.urdf")


def steps_of(found):
    return {step.effect: step.parameters for step in found.steps}


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
