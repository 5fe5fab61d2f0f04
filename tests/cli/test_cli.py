"""The command on logs that it can use: tables, sentences, files, progress."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pendulum_logs import PENDULUM as MODEL
from pendulum_logs import sines
from typer.testing import CliRunner

import geodrake
from geodrake.cli.app import app
from geodrake.diagnosis import Step
from geodrake.effects import CoulombFriction, JointEffect, Parameter
from geodrake.logs.files import write_log
from geodrake.logs.motion import JointLog, Motion
from geodrake.model.saved_model import load_model
from geodrake.report.numbers import Units
from geodrake.report.words import finding, step_parameters

APART = {**os.environ, "PYTHONPATH": str(Path(geodrake.__file__).parents[1])}
"""Variables of a process that finds the same geodrake as this one, with all that is compiled."""
COULOMB = {"shoulder": 0.3, "elbow": 0.2}


def pendulum_log(path, *, friction=True, seed=0, seconds=20.0):
    """A log of the double pendulum with dry and viscous friction and sensor noise."""
    rng, model = np.random.default_rng(seed + 100), load_model(MODEL)
    time, motion = sines(seconds, seed)
    effort = model.effort(motion)
    if friction:
        effort += np.sign(motion.v) * list(COULOMB.values()) + 0.1 * motion.v
    effort += 0.02 * rng.normal(size=effort.shape)
    write_log(JointLog("log", model.joints, time, motion.q, effort), path)
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return pendulum_log(tmp_path_factory.mktemp("logs") / "log.csv")


def geodrake_command(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_explain_tells_saves_and_writes_the_schema(log, tmp_path):
    saved, numbers = tmp_path / "model.yaml", tmp_path / "out.json"
    result = geodrake_command("explain", MODEL, log, "--save", saved, "--json", numbers)
    assert result.exit_code == 0, result.output
    for words in ("coulomb_friction", "Verdict: ", "Joint by joint", "bandwidth", str(saved)):
        assert words in result.output
    assert not re.search("[─━│\x1b]", result.output)

    found = json.loads(numbers.read_text())
    assert found["verdict"] in ("adequate", "explained", "unexplained")
    assert found["command"] == "explain"
    coulomb = next(step for step in found["steps"] if step["effect"] == "coulomb_friction")
    assert set(coulomb["where"]) == set(COULOMB)
    for joint, value in COULOMB.items():
        assert coulomb["parameters"][joint]["coulomb"] == pytest.approx(value, rel=0.15)
    assert coulomb["error_after"] < coulomb["error_before"]
    assert found["certificate"]["holds"] and found["certificate"]["solver"] == "clarabel"
    assert "the fit is certified by clarabel" in result.output
    assert isinstance(coulomb["indistinguishable_from"], list)
    assert 0 <= coulomb["false_alarm_probability"] <= 1
    error = found["error"]
    for table in ("start", "end", "floor", "refit"):
        assert set(error[table]) == set(COULOMB)
    assert error["end_nrms"] < error["start_nrms"]
    assert error["floor_nrms"] > 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.yaml", "out.json"]

    again = geodrake_command("compare", saved, log, "--json", "-")
    assert again.exit_code == 0, again.output
    compared = json.loads(again.stdout)  # the tables go to stderr
    assert compared["error"]["nrms"] == pytest.approx(error["end_nrms"], rel=0.3)
    assert set(compared["joints"]["elbow"]) == {"rms", "std", "nrms", "floor", "removable"}
    assert "Verdict: The error is" in again.stderr


def test_diagnose_ranks_and_saves_the_model_as_loaded(log, tmp_path):
    saved, numbers = tmp_path / "model.yml", tmp_path / "d.json"
    result = geodrake_command("diagnose", MODEL, log, "--save", saved, "--json", numbers)
    assert result.exit_code == 0, result.output
    assert "Missing: " in result.output
    found = json.loads(numbers.read_text())
    assert found["candidates"][0]["effect"] in ("coulomb_friction", "viscous_friction")
    assert found["error"]["start_nrms"] > found["candidates"][0]["error_after"]
    assert geodrake.load_model(saved).effects == ()


def test_add_takes_a_place_and_a_saved_model(log, tmp_path):
    saved = tmp_path / "model.yaml"
    result = geodrake_command(
        "add", "coulomb_friction", MODEL, log, "--where", "elbow", "--save", saved
    )
    assert result.exit_code == 0, result.output
    effects = [fitted.effect for fitted in geodrake.load_model(saved).effects]
    assert CoulombFriction("elbow") in effects
    assert CoulombFriction("shoulder") not in effects
    assert re.search(
        r"Added: Coulomb friction \(elbow, [\d.]+ ± [\d.]+ ± [\d.]+ N·m\)", result.output
    )


def test_no_step_is_told_of_a_model_that_is_right(tmp_path):
    log = pendulum_log(tmp_path / "log.csv", friction=False)
    result = geodrake_command("explain", MODEL, log)
    assert result.exit_code == 0, result.output
    assert "Verdict: Adequate. The model is adequate" in result.output


def test_own_effects_are_tried(log, tmp_path):
    own = tmp_path / "own.py"
    own.write_text(OWN_EFFECT)
    arguments = ("add", "cosine_friction", MODEL, log, "--where", "elbow", "--effects", own)
    result = geodrake_command(*arguments)
    assert result.exit_code == 0, result.output
    assert "Added: cosine friction (elbow" in result.output


OWN_EFFECT = """
from dataclasses import dataclass
import numpy as np
from geodrake.effects import JointEffect, Parameter

@dataclass(frozen=True)
class CosineFriction(JointEffect):
    name = "cosine_friction"
    parameters = (Parameter("strength", "N·m"),)

    def columns(self, motion):
        return [np.cos(motion.q) * motion.sign_v]
"""


def test_report_is_one_page(log, tmp_path):
    page = tmp_path / "page.html"
    assert geodrake_command("compare", MODEL, log, "--report", page).exit_code == 0
    assert "<html" in page.read_text(encoding="utf-8")


def test_module_runs_piped_in_ascii_with_no_more_than_a_word_now_and_then(log, tmp_path):
    """Words and numbers come from where pages do, and pages alone need matplotlib."""
    environment = {**APART, "PYTHONIOENCODING": "ascii", "COLUMNS": "80"}
    run = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "geodrake", "compare", MODEL, log],
        capture_output=True,
        text=True,
        env=environment,
        cwd=tmp_path,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    imported, said = [], []
    for line in run.stderr.splitlines():
        (imported if line.startswith("import time:") else said).append(line)
    for line in said:  # which a busy machine needs, and an idle one does not
        assert re.fullmatch(r"[ -~]+ \([^()]+ s(?: left)?\)", line), run.stderr
    assert "shoulder" in run.stdout
    modules = {line.split("|")[-1].strip() for line in imported}
    assert "geodrake.cli.app" in modules and "matplotlib" not in modules


def test_version_and_help():
    told = geodrake_command("--version").output
    assert re.match(r"geodrake \S+ \(drake \d.*numpy \d.*Python 3", told)
    text = geodrake_command("--help").output
    for command in ("compare", "diagnose", "add", "explain", "demo"):
        assert command in text
        assert geodrake_command(command, "--help").exit_code == 0


def test_delays_are_shown_in_milliseconds_with_their_deviation():
    found = {"elbow": {"delay": 0.01161}}, {"elbow": {"delay": 0.00034}}
    step = Step("effort_delay", ("elbow",), 0.2, 0.1, *found, (), 0.0, 1.0, {}, {})
    units = Units.of(load_model(MODEL))
    assert step_parameters(step, units) == ("delay 11.6 ± 0.3 ms",)
    assert "11.6 ± 0.3 ms" in finding(step, units)


def test_what_is_called_delay_and_is_no_time_is_shown_as_it_is():
    class Sluggish(JointEffect):
        name = "sluggish"
        parameters = (Parameter("delay", "N·m"),)

    model = load_model(MODEL)
    found = {"elbow": {"delay": 2.0}}, {"elbow": {"delay": 0.1}}
    step = Step("sluggish", ("elbow",), 0.2, 0.1, *found, (), 0.0, 1.0, {}, {})
    assert step_parameters(step, Units.of(model, [Sluggish])) == ("delay 2.00 ± 0.10 N·m",)


def test_demo_explains_the_log_that_ships(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = geodrake_command("demo")
    assert result.exit_code == 0, result.output
    assert result.stderr.startswith("Done within about ")
    assert "geodrake_demo.html" in result.output
    assert [path.name for path in tmp_path.iterdir()] == ["geodrake_demo.html"]
    page = (tmp_path / "geodrake_demo.html").read_text(encoding="utf-8")
    assert len(page) < 500_000
    assert all(f'data-stage="{key}"' in page for key in ("before", "step1", "step2", "after"))
    assert "With --details: " in result.output


def test_a_joint_at_rest_is_held_unless_it_is_to_be_kept(tmp_path):
    """The shoulder's brake holds more than gravity asks; its encoder flickers."""
    rng, time = np.random.default_rng(3), np.arange(0.0, 20.0, 0.01)
    model = load_model(MODEL)
    q = np.stack([np.full_like(time, 0.4), np.sin(2.0 * time) + 0.4 * np.sin(5.3 * time)], 1)
    v, vd = (np.gradient(q, time, axis=0), np.gradient(np.gradient(q, time, axis=0), time, axis=0))
    effort = model.effort(Motion(q, v, vd)) + [0.7, 0.0] + 0.02 * rng.normal(size=q.shape)
    q[:, 0] += 1e-3 * rng.integers(0, 2, len(time))
    write_log(JointLog("log", model.joints, time, q, effort), tmp_path / "log.csv")
    found = {}
    for option in ([], ["--no-auto-lock"]):
        target = tmp_path / "found.json"
        done = geodrake_command("compare", MODEL, tmp_path / "log.csv", "--json", target, *option)
        assert done.exit_code == 0, done.output
        found[bool(option)] = json.loads(target.read_text())
    assert set(found[False]["joints"]) == {"elbow"} and set(found[True]["joints"]) == set(COULOMB)
    (note,) = (note for note in found[False]["notes"] if "--no-auto-lock" in note)
    assert "shoulder at 0.4" in note
    assert found[False]["error"]["nrms"] < 0.1 < found[True]["error"]["nrms"]
