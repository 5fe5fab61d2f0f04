"""Servos and what resists them, fitted to the motion of MuJoCo's pendulum under commands."""

from dataclasses import replace

import numpy as np
import pytest
from servo_logs import LATE, PENDULUM, TRUTH, servo_log

from geodrake import load_model
from geodrake.control import fit_rollouts
from geodrake.control.rollout.results import Rollout, Window
from geodrake.effects import CoulombFriction, RotorInertia, ViscousFriction
from geodrake.errors import LogError


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("pendulum") / "pendulum.urdf"
    path.write_text(PENDULUM)
    return load_model(path)


@pytest.fixture(scope="module")
def log():
    return servo_log()


@pytest.fixture(scope="module")
def fit(model, log):
    """Of one log, cut in two."""
    half, columns = len(log) // 2, ("time", "position", "effort", "command")
    parts = {"a": slice(half), "b": slice(half, None)}
    logs = [
        replace(log, name=name, **{c: getattr(log, c)[part] for c in columns})
        for name, part in parts.items()
    ]
    return fit_rollouts(model, logs, commands=True)


def test_a_servo_and_its_joint_are_those_of_mujoco(fit):
    (servo,) = fit.model.effort_signals
    kp, _, damping, coulomb, armature, _ = TRUTH
    found = {type(each.effect): float(each.parameters[0]) for each in fit.model.effects}
    assert servo.gain == pytest.approx(kp, rel=0.01)
    assert servo.delay - servo.damping / servo.gain == pytest.approx(LATE, abs=0.002)
    assert found[ViscousFriction] + servo.damping == pytest.approx(damping, rel=0.05)
    assert found[CoulombFriction] == pytest.approx(coulomb, rel=0.05)
    assert found[RotorInertia] == pytest.approx(armature, rel=0.25)


def test_windows_that_the_fit_did_not_see_depart_less(fit):
    before, after = fit.held_out
    assert fit.taken and fit.chance < 0.02
    assert after.relative < 0.05 * before.relative
    values = {(value.effect, value.name): value for value in fit.values}
    assert values["servo", "gain"].after == pytest.approx(TRUTH[0], rel=0.02)
    assert values["coulomb_friction", "coulomb"].before == 0.0


def test_a_joint_that_no_command_moves_is_refused(model, log):
    rng = np.random.default_rng(0)
    other = replace(log, command=0.3 * rng.normal(size=log.command.shape))
    with pytest.raises(LogError, match="command"):
        fit_rollouts(model, [other], commands=True)


def test_a_joint_that_rests_has_no_share_of_its_motion():
    time = np.linspace(0.0, 0.5, 6)
    measured = np.column_stack([time, np.full(6, 0.2)])
    window = Window("log", time, measured, 1.1 * measured)
    rollout = Rollout.of(("moves", "rests"), [window], 0.5)
    moves, rests = rollout.joints
    assert np.isnan(rests.relative)
    assert rollout.relative == moves.relative == pytest.approx(0.1)
