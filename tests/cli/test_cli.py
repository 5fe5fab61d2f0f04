"""Commands on good logs: tables, sentences, and files."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import processes
import pytest
from commands import run, told
from pendulum_logs import PENDULUM as MODEL
from pendulum_logs import sine_log
from pinocchio_logs import effort_log

from geodrake.diagnosis import Step
from geodrake.effects import JointEffect, Parameter
from geodrake.logs import JointLog, Motion, write_log
from geodrake.model import load_model
from geodrake.report import Units
from geodrake.report.words import step_parameters

COULOMB = {"shoulder": 0.3, "elbow": 0.2}


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Return the path of a log of the double pendulum with dry and viscous friction."""
    path = tmp_path_factory.mktemp("logs") / "log.csv"
    write_log(sine_log(load_model(MODEL), seed=0), path)
    return path


def test_explain_prints_saves_and_writes_numbers(log, tmp_path):
    saved, numbers = tmp_path / "model.yaml", tmp_path / "out.json"
    output = told("explain", MODEL, log, "--save", saved, "--json", numbers)
    for words in ("coulomb_friction", "Verdict: ", "joint by joint, bodies, notes", str(saved)):
        assert words in output
    assert "clarabel" not in output  # a note, behind --details
    assert not re.search("[─━│\x1b]", output)

    found = json.loads(numbers.read_text())
    assert found["verdict"] in ("adequate", "explained", "unexplained")
    assert found["command"] == "explain"
    coulomb = next(step for step in found["steps"] if step["effect"] == "coulomb_friction")
    assert set(coulomb["where"]) == set(COULOMB)
    for joint, value in COULOMB.items():
        assert coulomb["parameters"][joint]["coulomb"] == pytest.approx(value, rel=0.15)
    assert coulomb["error_after"] < coulomb["error_before"]
    assert found["certificate"]["holds"] and found["certificate"]["solver"] == "clarabel"
    assert isinstance(coulomb["indistinguishable_from"], list)
    assert 0 <= coulomb["false_alarm_probability"] <= 1
    error = found["error"]
    for table in ("start", "end", "floor", "refit"):
        assert set(error[table]) == set(COULOMB)
    assert error["end_nrms"] < error["start_nrms"]
    assert error["floor_nrms"] > 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.yaml", "out.json"]

    again = run("compare", saved, log, "--json", "-")
    compared = json.loads(again.stdout)  # the tables go to stderr
    assert compared["error"]["nrms"] == pytest.approx(error["end_nrms"], rel=0.3)
    assert set(compared["joints"]["elbow"]) == {"rms", "std", "nrms", "floor", "removable"}
    assert "Verdict: The error is" in again.stderr


def test_diagnose_ranks_and_saves_the_model_as_loaded(log, tmp_path):
    saved, numbers = tmp_path / "model.yml", tmp_path / "d.json"
    assert " is missing." in told("diagnose", MODEL, log, "--save", saved, "--json", numbers)
    found = json.loads(numbers.read_text())
    assert found["candidates"][0]["effect"] in ("coulomb_friction", "viscous_friction")
    assert found["error"]["start_nrms"] > found["candidates"][0]["error_after"]
    assert load_model(saved).effects == ()


def test_module_runs_in_a_pipe_in_ascii_almost_silently(log):
    """Only pages need matplotlib."""
    command = [sys.executable, "-X", "importtime", "-m", "geodrake", "compare", str(MODEL), log]
    done = processes.start(command, PYTHONIOENCODING="ascii", COLUMNS="80")
    out, err = done.communicate()
    assert done.returncode == 0, err
    imported, said = [], []
    for line in err.splitlines():
        (imported if line.startswith("import time:") else said).append(line)
    for line in said:  # progress, which only a busy machine reports
        assert re.fullmatch(r"[ -~]+ \([^()]+ s(?: left)?\)", line), err
    assert "shoulder" in out
    modules = {line.split("|")[-1].strip() for line in imported}
    assert "geodrake.cli.app" in modules and "matplotlib" not in modules


def test_version_and_help():
    assert re.match(r"geodrake \S+ \(drake \d.*numpy \d.*Python 3", run("--version").output)
    text = run("--help").output
    assert all(command in text for command in ("compare", "diagnose", "add", "explain", "demo"))


def test_only_delays_in_seconds_are_shown_in_milliseconds():
    class Sluggish(JointEffect):
        name = "sluggish"
        parameters = (Parameter("delay", "N·m"),)

    def step(effect, value, deviation):
        found = {"elbow": {"delay": value}}, {"elbow": {"delay": deviation}}
        return Step(effect, ("elbow",), 0.2, 0.1, *found, (), 0.0, 1.0, {}, {})

    late, units = step("effort_delay", 0.01161, 0.00034), Units.of(load_model(MODEL), [Sluggish])
    assert step_parameters(late, units) == ("11.6 ± 0.3 ms",)
    assert step_parameters(step("sluggish", 2.0, 0.1), units) == ("2.00 ± 0.10 N·m",)


def test_demo_explains_the_log_that_ships(tmp_path):
    result = run("demo")
    assert result.exit_code == 0, result.output
    assert result.stderr.startswith("This takes about ")
    assert "geodrake_demo.html" in result.output
    assert [path.name for path in tmp_path.iterdir()] == ["geodrake_demo.html"]
    page = (tmp_path / "geodrake_demo.html").read_text(encoding="utf-8")
    assert len(page) < 500_000
    printed = [line.rstrip() for line in result.stdout.splitlines()]
    for name in ("README.md", "docs/reading_a_result.md"):
        text = (Path(__file__).parents[2] / name).read_text(encoding="utf-8")
        (quoted,) = re.findall(r"^```\n(Verdict: .*?)\n```$", text, re.M | re.S)
        assert quoted in "\n".join(printed), name
    assert all(
        f'data-stage="{words}' in page
        for words in ("as it stands", "after 1: ", "after 2: ", "final model")
    )
    assert "--details adds: " in result.output


def test_joints_at_rest_are_held_unless_told_otherwise(tmp_path):
    """The shoulder's brake holds more than its weight, and its encoder flickers."""
    rng, time = np.random.default_rng(3), np.arange(0.0, 20.0, 0.01)
    model = load_model(MODEL)
    q = np.stack([np.full_like(time, 0.4), np.sin(2.0 * time) + 0.4 * np.sin(5.3 * time)], 1)
    v, vd = (np.gradient(q, time, axis=0), np.gradient(np.gradient(q, time, axis=0), time, axis=0))
    effort = model.effort(Motion(q, v, vd)) + [0.7, 0.0] + 0.02 * rng.normal(size=q.shape)
    q[:, 0] += 1e-3 * rng.integers(0, 2, len(time))
    write_log(JointLog("log", model.joints, time, q, effort), tmp_path / "log.csv")
    held, kept = (
        json.loads(run("compare", MODEL, "log.csv", "--json", "-", *option).stdout)
        for option in ([], ["--no-auto-lock"])
    )
    assert set(held["joints"]) == {"elbow"} and set(kept["joints"]) == set(COULOMB)
    (note,) = (note for note in held["notes"] if "--no-auto-lock" in note)
    assert "shoulder at 0.4" in note
    assert held["error"]["nrms"] < 0.1 < kept["error"]["nrms"]


def test_a_wrong_sign_is_reported_first_and_corrected_on_request(tmp_path):
    words = "The effort of elbow has the wrong sign"
    log = effort_log("double_pendulum", 3, off=0.1, duration=8.0, share=0.01).log
    wrong, numbers, page = (tmp_path / name for name in ("wrong.csv", "n.json", "page.html"))
    write_log(replace(log, effort=log.effort * [1.0, -1.0]), wrong)
    said = told("compare", MODEL, wrong, "--json", numbers, "--report", page, "-q")
    assert said.index(words) < said.index("Joint by joint")
    assert "--gain elbow=-1" in said and "--correct-columns" in said
    found = json.loads(numbers.read_text())
    (column,) = found["columns"]
    assert (column["kind"], column["joints"]) == ("effort_sign", ["elbow"])
    assert found["error"]["nrms"] > 1.0
    assert words in page.read_text(encoding="utf-8")

    said = told("compare", MODEL, wrong, "--correct-columns", "--json", numbers, "-q")
    assert "results use the corrected columns" in said
    assert json.loads(numbers.read_text())["error"]["nrms"] < 0.3
    assert words in told("log", wrong, "--model", MODEL, "-q")
    assert words not in told("log", wrong, "-q")

    write_log(replace(log, effort=np.abs(log.effort)), wrong)
    said = told("compare", MODEL, wrong, "-q")
    assert "they are magnitudes" in said
    assert "as logged, mistakes included." in said and "--correct-columns" not in said
