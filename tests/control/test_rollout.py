"""The model simulated under logged efforts: it stays with the motion once the effects are in."""

import json
import sys
from importlib.resources import as_file, files

import numpy as np
import pytest
from scipy.linalg.lapack import dgesv
from typer.testing import CliRunner

from geodrake import load_model, save_model
from geodrake.cli.app import app
from geodrake.control.rollout import roll_out
from geodrake.diagnosis import explain
from geodrake.errors import ArgumentError, LogError
from geodrake.logs.files import read_log, write_log
from geodrake.logs.motion import JointLog

pytest.importorskip("pinocchio")

import pinocchio as pin
from pinocchio_logs import MODELS, random_motion, robot

rolling = sys.modules["geodrake.control.rollout.roll_out"]
ARM, PENDULUM = MODELS / "arm6.urdf", MODELS / "double_pendulum.urdf"
STEP, BANDWIDTH, BREAKAWAY_SPEED = 5e-4, 120.0, 5e-3


def simulate(model, motion, duration, dry, wet):
    """Positions, velocities and applied efforts, a row a step, of a robot that tracks a motion.

    Drives with stiff PD control beside inverse dynamics meet dry friction F v / √(v² + ε²) and
    viscous friction, F and c (n,). Steps are linearly implicit in friction and PD, and take the
    rest at their middle: stable however stiff they are.
    """
    n, data, inverse = model.nv, model.createData(), model.createData()
    steps = round(duration / STEP)
    q_ref, v_ref, a_ref = motion(STEP * np.arange(steps + 1))
    inertia = 0.1 + np.diag(pin.crba(model, inverse, motion.center))
    damping = 2 * 0.7 * BANDWIDTH * inertia
    stiffness = BANDWIDTH**2 * inertia
    implicit, ahead = STEP * np.diag(damping + STEP * stiffness), 0.5 * STEP
    q, v, a = q_ref[0].copy(), v_ref[0].copy(), a_ref[0].copy()
    rows = np.empty((3, steps, n))
    for k in range(steps):
        u = pin.rnea(model, inverse, q_ref[k], v_ref[k], a_ref[k])
        u += stiffness * (q_ref[k + 1] - q - STEP * v) + damping * (v_ref[k + 1] - v)
        root = np.hypot(v, BREAKAWAY_SPEED)
        friction = dry * v / root + wet * v
        slope = STEP * np.diag(dry * BREAKAWAY_SPEED**2 / root**3 + wet)
        mass = pin.crba(model, data, q + ahead * v)
        bias = pin.nle(model, data, q + ahead * v, v + ahead * a)
        a = dgesv(mass + slope + implicit, u - friction - bias)[2]
        rows[:, k] = q, v, u - implicit @ a
        q, v = q + STEP * (v + ahead * a), v + STEP * a
    return rows


def recording(name, friction, *, share, seconds):
    """A log of every eighth step, of which an effort is the mean before and after it."""
    rng, file = np.random.default_rng(2), robot(name)
    q, v, u = simulate(file, random_motion(file, rng), seconds, *np.outer([1.0, 1.0], friction))
    at = np.arange(1, len(q), 8)
    u = 0.5 * (u[at] + u[at - 1])
    noise = rng.normal(size=(3, *u.shape)) * np.array([1e-6, share, 2e-5])[:, None, None]
    logged = q[at] + noise[0], u + u.std(0) * noise[1], v[at] + noise[2]
    return JointLog(name, tuple(file.names[1:]), STEP * at, *logged)


@pytest.fixture(scope="module")
def plain():
    """A log of an arm without hidden effects, and without noise."""
    return recording("arm6", np.zeros(6), share=0.0, seconds=6.0)


@pytest.fixture(scope="module")
def frictional():
    """A log of a pendulum with friction, and the model that explains it."""
    log = recording("double_pendulum", [0.3, 0.15], share=0.01, seconds=16.0)
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


def test_a_robot_that_is_thrown_about_goes_as_its_diagram(monkeypatch):
    """Without its payload and friction, the demo's wrist turns some hundred times too far."""
    with as_file(files("geodrake") / "demo") as demo:
        model, log = load_model(demo / "demo.urdf"), read_log(demo / "demo.csv")
    found = roll_out(model, [log], horizon=0.1)
    monkeypatch.setattr(rolling, "steps_alone", lambda model: False)
    theirs = roll_out(model, [log], horizon=0.1)
    assert 20.0 < theirs.relative != found.relative
    for window, other in zip(found.windows, theirs.windows, strict=True):
        size = np.abs(other.departure).max()
        np.testing.assert_allclose(window.simulated, other.simulated, rtol=0.0, atol=0.02 * size)
