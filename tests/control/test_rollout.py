"""The model simulated under logged efforts: it stays with the motion once the effects are in."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from geodrake import load_model, save_model
from geodrake.cli.app import app
from geodrake.control.rollout import roll_out
from geodrake.diagnosis import explain
from geodrake.errors import ArgumentError, LogError
from geodrake.logs.files import write_log

pytest.importorskip("pinocchio")

from pinocchio_logs import MODELS, HiddenEffects, random_motion, record, robot, simulate

ARM, PENDULUM = MODELS / "arm6.urdf", MODELS / "double_pendulum.urdf"


def recording(hidden, name="double_pendulum", *, share=0.01, late=0.0, seconds=16.0):
    rng, file = np.random.default_rng(2), robot(name)
    rows = simulate(file, file, random_motion(file, rng), hidden, seconds)
    return record(name, rows, rng, joints=file.names[1:], share=share, encoder=1e-6, late=late).log


@pytest.fixture(scope="module")
def plain():
    """A log of an arm without hidden effects, and without noise."""
    return recording(HiddenEffects(), "arm6", share=0.0, seconds=6.0)


@pytest.fixture(scope="module")
def frictional():
    """A log of a pendulum with friction, and the model that explains it."""
    log = recording(HiddenEffects(coulomb={0: 0.3, 1: 0.15}, viscous={0: 0.3, 1: 0.15}))
    return log, explain(load_model(PENDULUM), [log]).model


def test_the_true_model_stays_with_the_motion(plain):
    """Pinocchio's simulation, by another integrator, against Drake's."""
    rollout = roll_out(load_model(ARM), [plain], most=6)
    assert rollout.relative < 2e-3
    assert rollout.broken == 0
    assert len(rollout.windows) == 6


def test_effects_take_the_departure_away(frictional):
    log, explained = frictional
    before = roll_out(load_model(PENDULUM), [log], most=4)
    after = roll_out(explained, [log], most=4)
    assert after.relative < 0.1 < before.relative
    assert 10 * after.relative < before.relative
    departed = {joint.joint for joint in before.joints if joint.relative > 0.3}
    assert departed == {"shoulder", "elbow"}


def test_departures_are_those_of_the_windows(frictional):
    log, explained = frictional
    rollout = roll_out(explained, [log], most=3, horizon=0.3)
    departure = np.concatenate([w.departure for w in rollout.windows])
    expected = np.sqrt(np.mean(departure**2, axis=0))
    np.testing.assert_allclose([joint.rms for joint in rollout.joints], expected, rtol=1e-12)
    for window in rollout.windows:
        np.testing.assert_allclose(window.departure[0], 0.0, atol=1e-12)
        assert np.ptp(window.time) == pytest.approx(0.3, abs=0.01)


def test_command(frictional, tmp_path):
    log, explained = frictional
    write_log(log, tmp_path / "log.csv")
    save_model(explained, tmp_path / "arm.yaml")
    arguments = [
        "rollout", "arm.yaml", "log.csv", "--before", PENDULUM, "--windows", "2",
        "--horizon", "0.2", "--json", "r.json", "--report", "r.html",
    ]  # fmt: skip
    arguments = [
        str(tmp_path / a) if str(a).startswith(("arm.", "log.", "r.")) else str(a)
        for a in arguments
    ]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    numbers = json.loads((tmp_path / "r.json").read_text())
    assert numbers["relative"] < numbers["before"]["relative"]
    assert "chart-rollout" in (tmp_path / "r.html").read_text()
    absent = (
        ["--save", str(tmp_path / "x.yaml")],
        ["--blocks", "4"],
    )  # it would ignore them: only a fit saves
    for wrong in (["--horizon", "-1"], ["--windows", "0"], *absent):
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
    with pytest.raises(LogError, match="does the robot move"):
        roll_out(load_model(ARM), [plain], horizon=60.0)
