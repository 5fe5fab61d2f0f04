"""The command on what it cannot use: one clear message, exit code 2, and no file touched."""

import re
from pathlib import Path

import numpy as np
import pytest
from pendulum_logs import PENDULUM, body_effort
from typer.testing import CliRunner

from geodrake.cli.app import app
from geodrake.model.saved_model import load_model, save_model

HEADER = "time,shoulder.position,elbow.position,shoulder.effort,elbow.effort"


def rows(seconds=30.0, period=0.01):
    time = np.arange(0.0, seconds, period)
    angle = np.outer(time, [2.0, 3.1]) + np.outer(np.sin(0.7 * time), [1.0, 2.0])
    rate = np.array([2.0, 3.1]) + np.outer(0.7 * np.cos(0.7 * time), [1.0, 2.0])
    change = np.outer(-0.49 * np.sin(0.7 * time), [1.0, 2.0])
    q, v = 0.5 * np.sin(angle), 0.5 * rate * np.cos(angle)
    vd = 0.5 * (change * np.cos(angle) - rate**2 * np.sin(angle))
    return np.column_stack([time, q, body_effort(q, v, vd)])


def write(path, table, header=HEADER):
    lines = [header, *(",".join(map(str, row)) for row in table)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def log(tmp_path):
    return write(tmp_path / "log.csv", rows())


def refused(*arguments, code=2):
    """Run a command that must fail without a traceback; returns its message."""
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    assert result.stdout == ""
    # On a busy machine, what is being done is told every five seconds.
    lines = [line for line in result.stderr.splitlines() if not re.search(r" \(\d+ s\)$", line)]
    assert len(lines) == 1 or "Usage" in result.stderr
    return result.stderr


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize(
    ("header", "words"),
    [
        (HEADER.replace("effort", "colour"), "without effort"),
        (HEADER.replace("elbow", "elbw"), "(nearest: 'elbow')"),
        (HEADER.replace("time", "instant"), "no column 'time'"),
        (HEADER.replace("elbow.effort", "elbow.colour"), "without effort of elbow"),
        ("0,0.1,0.1,0.1,0.1", "has no header"),
    ],
)
def test_columns_must_be_those_of_the_robot(tmp_path, header, words):
    log = write(tmp_path / "log.csv", rows(), header)
    assert words in refused("compare", PENDULUM, log)


def test_what_is_not_there_or_not_a_robot(tmp_path, log):
    assert "nothing.urdf" in refused("compare", tmp_path / "nothing.urdf", log)
    assert "nothing.csv" in refused("compare", PENDULUM, tmp_path / "nothing.csv")
    other = write(tmp_path / "other.csv", rows())
    assert "not a robot description" in refused("compare", log, other)
    page = tmp_path / "page.urdf"
    page.write_text("<html><body/></html>")
    assert "page.urdf" in refused("compare", page, log)
    assert "is a folder" in refused("compare", tmp_path, log)
    assert "given twice" in refused("compare", PENDULUM, log, tmp_path / "." / log.name)
    refused("compare", PENDULUM)
    refused("compare")


def test_settings_must_make_sense(log):
    for bandwidth in ("0", "-1", "nan", "1000"):
        assert "Hz" in refused("compare", PENDULUM, log, "--bandwidth", bandwidth)
    refused("compare", PENDULUM, log, "--bandwidth", "wide")
    refused("compare", PENDULUM, log, "--blocks", "0")


def test_effects_and_places_must_exist(tmp_path, log):
    message = refused("add", "colomb_friction", PENDULUM, log)
    assert "Did you mean coulomb_friction" in message
    assert "'elbw'" in refused("add", "coulomb_friction", PENDULUM, log, "--where", "elbw")
    own = tmp_path / "own.py"
    message = refused("explain", PENDULUM, log, "--effects", own)
    assert f"The file of effects {own} does not exist. Check the path." in message
    assert "is a folder" in refused("explain", PENDULUM, log, "--effects", tmp_path)
    own.write_text("x = 1 / 0\n")
    assert "ZeroDivisionError" in refused("explain", PENDULUM, log, "--effects", own)
    own.write_text(RAISING)
    message = refused("add", "odd_friction", PENDULUM, log, "--effects", own)
    assert "line 12 of" in message
    assert "KeyError" in message
    twin = tmp_path / "twin.py"
    twin.write_text(RAISING)
    both = ("--effects", own, "--effects", twin)
    assert "another --effects file" in refused("explain", PENDULUM, log, *both)


RAISING = """
from dataclasses import dataclass
from geodrake.effects import JointEffect, Parameter


@dataclass(frozen=True)
class OddFriction(JointEffect):
    name = "odd_friction"
    parameters = (Parameter("strength", "N·m"),)

    def columns(self, motion):
        raise KeyError("what")
"""


def test_an_effect_that_does_not_exist_is_refused_before_anything_is_read(tmp_path, monkeypatch):
    def read(*args, **more):
        raise AssertionError("a model or a log was read")

    monkeypatch.setattr("geodrake.cli.session.read_model", read)
    (log := tmp_path / "log.csv").write_text("no,log\n")
    assert "nonsense" in refused("add", "nonsense", PENDULUM, log)


def test_targets_are_refused_before_the_work(tmp_path, log, monkeypatch):
    def never(*_arguments, **_settings):
        raise AssertionError("the model was loaded before the targets were checked")

    monkeypatch.setattr("geodrake.cli.session.read_model", never)
    folder = tmp_path / "folder.json"
    folder.mkdir()
    (tmp_path / "link.yaml").symlink_to(tmp_path / "robot.yaml")
    robot = tmp_path / "robot.yaml"
    robot.write_text("a model")
    before = contents(tmp_path)
    for target, words in [
        (("--json", tmp_path / "none" / "x.json"), "no folder"),
        (("--report", log / "x.html"), "no folder"),
        (("--json", folder), "is no file"),
        (("--save", tmp_path / "x.json"), "does not end in .yaml or .yml"),
        (("--report", tmp_path / "x.pdf"), "does not end in .html"),
        (("--save", robot), "is an input"),
        (("--save", tmp_path / "link.yaml"), "is an input"),
        (("--json", log), "does not end in .json"),
        (("--save", tmp_path / ("x" * 300 + ".yaml")), "cannot be written"),
        (("--json", Path("/proc/x.json")), "--json /proc/x.json"),
    ]:
        assert words in refused("compare", robot, log, *target)
    assert contents(tmp_path) == before


def test_a_saved_model_is_not_written_over_the_file_it_is_based_on(tmp_path, log):
    (tmp_path / "robot.dmd.yaml").write_text(
        f"directives:\n- add_model:\n    name: robot\n    file: file://{PENDULUM}\n"
    )
    base = tmp_path / "robot.dmd.yaml"
    saved = tmp_path / "saved.yaml"
    save_model(load_model(base), saved)
    before = contents(tmp_path)
    assert "is an input" in refused("compare", saved, log, "--save", base)
    assert contents(tmp_path) == before


def test_a_saved_model_says_where_its_base_was(tmp_path, log):
    base = tmp_path / "robot.urdf"
    base.write_text(PENDULUM.read_text())
    saved = tmp_path / "saved.yaml"
    save_model(load_model(base), saved)
    base.rename(tmp_path / "moved.urdf")
    message = refused("explain", saved, log)
    assert "robot.urdf" in message
    assert "base_model" in message


def test_zero_masses_and_odd_units_are_told_of_and_not_fatal(tmp_path):
    robot = tmp_path / "robot.urdf"
    robot.write_text(PENDULUM.read_text().replace('<mass value="0.6256"/>', '<mass value="0"/>'))
    table = rows()
    table[:, 3:] *= 1000.0
    log = write(tmp_path / "log.csv", table)
    result = CliRunner().invoke(app, ["compare", str(robot), str(log)])
    assert result.exit_code == 0, result.output
    assert "lower_link has a mass of 0 kg" in result.output
    assert "Efforts seem to be in other units" in result.output


def test_a_bug_is_told_in_one_line_and_traced_on_demand(log, monkeypatch):
    def broken(*_arguments, **_settings):
        raise RuntimeError("the sky\nfell")

    monkeypatch.setattr("geodrake.cli.session.read_model", broken)
    message = refused("compare", PENDULUM, log, code=1)
    assert message.startswith("Internal error: RuntimeError: the sky fell. ")
    for settings in ({"args": ["--debug"]}, {"env": {"GEODRAKE_DEBUG": "1"}}):
        arguments = ["compare", str(PENDULUM), str(log), *settings.get("args", [])]
        result = CliRunner().invoke(app, arguments, env=settings.get("env"))
        assert result.exit_code == 1
        assert "Traceback" in result.stderr
