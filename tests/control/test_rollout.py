"""The model simulated under logged efforts: it stays with the motion once the effects are in."""

import json
import sys
from dataclasses import replace
from importlib.resources import as_file, files

import numpy as np
import pytest
from typer.testing import CliRunner

from geodrake import load_model, save_model
from geodrake.cli.app import app
from geodrake.control import roll_out
from geodrake.effects import CoulombFriction, FittedEffect, ViscousFriction
from geodrake.errors import ArgumentError, LogError
from geodrake.logs import read_log, write_log

pytest.importorskip("pinocchio")

from pinocchio_logs import MODELS, effort_log

ARM, PENDULUM = MODELS / "arm6.urdf", MODELS / "double_pendulum.urdf"


@pytest.fixture(scope="module")
def plain():
    """A log of an arm without hidden effects."""
    return effort_log("arm6", 2, share=0.0, duration=6.0).log


@pytest.fixture(scope="module")
def frictional():
    """A log of a pendulum with friction, and the model that has it."""
    sizes, model = {"shoulder": 0.3, "elbow": 0.15}, load_model(PENDULUM)

    def friction(seen):
        return np.array([*sizes.values()]) * (np.tanh(seen.v / 5e-3) + seen.v)

    effects = [
        FittedEffect(kind(joint), np.array([size]))
        for joint, size in sizes.items()
        for kind in (CoulombFriction, ViscousFriction)
    ]
    log = effort_log("double_pendulum", 2, friction, share=0.01, duration=8.0).log
    return log, replace(model, effects=tuple(effects))


def test_the_true_model_stays_with_the_motion(plain):
    """Pinocchio's efforts along a motion take Drake's robot along it."""
    rollout = roll_out(load_model(ARM), [plain], most=6)
    assert rollout.relative < 2e-3
    assert rollout.broken == 0
    assert len(rollout.windows) == 6


def test_effects_take_the_departure_away(frictional):
    log, having_it = frictional
    before = roll_out(load_model(PENDULUM), [log], most=4)
    after = roll_out(having_it, [log], most=4)
    assert after.relative < 0.1 < before.relative
    assert 10 * after.relative < before.relative
    departed = {joint.joint for joint in before.joints if joint.relative > 0.3}
    assert departed == {"shoulder", "elbow"}


def test_departures_are_those_of_the_windows(frictional):
    log, having_it = frictional
    rollout = roll_out(having_it, [log], most=3, horizon=0.3)
    departure = np.concatenate([w.departure for w in rollout.windows])
    expected = np.sqrt(np.mean(departure**2, axis=0))
    np.testing.assert_allclose([joint.rms for joint in rollout.joints], expected, rtol=1e-12)
    for window in rollout.windows:
        np.testing.assert_allclose(window.departure[0], 0.0, atol=1e-12)
        assert np.ptp(window.time) == pytest.approx(0.3, abs=0.01)


def test_command(frictional, tmp_path, monkeypatch):
    log, having_it = frictional
    write_log(log, tmp_path / "log.csv")
    save_model(having_it, tmp_path / "arm.yaml")
    monkeypatch.chdir(tmp_path)
    arguments = ["rollout", "arm.yaml", "log.csv", "--before", str(PENDULUM), "--windows", "2"]
    written = ["--horizon", "0.2", "--json", "r.json", "--report", "r.html"]
    result = CliRunner().invoke(app, [*arguments, *written])
    assert result.exit_code == 0, result.output
    numbers = json.loads((tmp_path / "r.json").read_text())
    assert numbers["relative"] < numbers["before"]["relative"]
    assert "chart-rollout" in (tmp_path / "r.html").read_text()
    ignored = ["--save", "x.yaml"], ["--blocks", "4"]  # only a fit saves
    for wrong in (["--horizon", "-1"], ["--windows", "0"], *ignored):
        bad = CliRunner().invoke(app, [*arguments[:3], *wrong])
        assert bad.exit_code == 2
        assert "Traceback" not in bad.output
    told = CliRunner().invoke(app, ["rollout", "--help"], env={"COLUMNS": "200"}).output
    assert "--before" in told
    assert {"--fit", "--save"} <= set(told.split())
    assert "--blocks" not in told.split()


def test_what_cannot_be_simulated(plain):
    with pytest.raises(ArgumentError, match=r"horizon must be .*0\.001 to 1000"):
        roll_out(load_model(ARM), [plain], horizon=0.0)
    with pytest.raises(LogError, match="s of motion without a gap"):
        roll_out(load_model(ARM), [plain], horizon=60.0)


def test_a_robot_that_is_thrown_about_goes_as_its_diagram(monkeypatch):
    """Without its payload and friction, the demo's wrist turns some hundred times too far."""
    with as_file(files("geodrake") / "demo") as demo:
        model, log = load_model(demo / "demo.urdf"), read_log(demo / "demo.csv")
    found = roll_out(model, [log], horizon=0.1)
    rolling = sys.modules[roll_out.__module__]
    monkeypatch.setattr(rolling, "steps_alone", lambda model: False)
    theirs = roll_out(model, [log], horizon=0.1)
    assert 20.0 < theirs.relative != found.relative
    for window, other in zip(found.windows, theirs.windows, strict=True):
        size = np.abs(other.departure).max()
        np.testing.assert_allclose(window.simulated, other.simulated, rtol=0.0, atol=0.02 * size)
