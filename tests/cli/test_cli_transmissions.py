"""Transmissions at the command line: a file beside the model, the model's own, and wrong ones."""

import json

import numpy as np
import pytest
from coupled_arm import WRIST, arm, log_of
from typer.testing import CliRunner

from geodrake.cli.app import app
from geodrake.logs import write_log


def run(*arguments, code=0):
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    if code:
        assert len(result.stderr.strip().splitlines()) == 1 and not result.stdout
    return " ".join((result.stderr if code else result.output).split())


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The arm with its wrist beside it, and a log of its motors, one of which rubs."""
    folder = tmp_path_factory.mktemp("arm")
    model = arm(folder)
    log = log_of(model, 0, lambda v: np.tanh(v / 1e-3) * [0.0, 0.8, 0.0], seconds=8.0)
    write_log(log, folder / "log.csv")
    return folder


def test_a_file_beside_the_model_is_taken_and_said(files, tmp_path):
    robot, log, out = files / "arm.urdf", files / "log.csv", tmp_path / "out.json"
    shown = run("compare", robot, log, "--json", out)
    assert "m2, m3 for pitch, roll" in shown and "arm.transmission.yaml beside" in shown
    errors = json.loads(out.read_text())["joints"]
    assert list(errors) == ["m1", "m2", "m3"]
    assert errors["m1"]["nrms"] < 0.1 < errors["m2"]["nrms"]
    saved = tmp_path / "model.yaml"
    run("add", "coulomb_friction", robot, log, "--where", "m2", "--save", saved)
    run("compare", saved, log, "--json", out)
    assert json.loads(out.read_text())["error"]["nrms"] < 0.1


@pytest.mark.thorough
def test_none_and_another_file_instead(files, tmp_path):
    robot, log = files / "arm.urdf", files / "log.csv"
    (tmp_path / "turned.yaml").write_text(WRIST.replace("ratio: -8", "ratio: 8"))
    assert "actuators" in run("compare", robot, log)
    shown = run("compare", robot, log, "--transmission", "none", "--bandwidth", 10)
    assert "actuators" not in shown and "shoulder" in shown
    out = tmp_path / "out.json"
    run("compare", robot, log, "--transmission", tmp_path / "turned.yaml", "--json", out)
    assert json.loads(out.read_text())["joints"]["m1"]["nrms"] > 0.5


@pytest.mark.parametrize(
    ("wrong", "problem"),
    [
        ("gear: []", "it has the unknown field 'gear' (was gears meant?)"),
        ("gears: [{actuator: m, joint: shoulder, ratoi: 3}]", "the unknown field 'ratoi'"),
        ("gears: [{actuator: m, joint: shoulder, ratio: x}]", "ratio = x"),
        ("gears: [{actuator: m, joint: knee}]", "the joint 'knee', which the robot does not"),
        ("gears: [{joint: shoulder}]", "gears[0] lacks its actuator"),
        ("gears: [{actuator: '', joint: shoulder}]", "gears[0] does not name its actuator"),
        ("coupled: [{joints: {roll: {a: [1]}}}]", "coupled[0].joints.roll.a = [1]"),
        ("coupled: [{joints: {roll: {5: 1}}}]", "coupled[0].joints.roll has 5 for a name"),
        ("gears: {actuator: m, joint: roll}", "expected a list but got a table of fields"),
        ("polynomials: [{actuator: m, joint: roll, map_of: 1}]", "the unknown field 'map_of'"),
        (
            "gears: [{actuator: m, joint: roll}, {actuator: n, joint: roll}]",
            "the joint 'roll' in two of its parts",
        ),
        ("coupled: [{joints: {roll: {a: 1, b: 1}, pitch: {a: 2, b: 2}}}]", "its rank is 1"),
        ("coupled: [{joints: {roll: {a: 1}, roll: {b: 1}}}]", "it has 'roll' twice"),
        ("gears: [{actuator: pitch, joint: roll}]", "an actuator 'pitch', and the robot a joint"),
        (
            "tables: [{actuator: m, joint: roll, actuator_positions: [0], joint_positions: [0]}]",
            "needs 3 actuator positions",
        ),
        ("four_bars: [{actuator: m, joint: roll, ground: 1, crank: 3, coupler: 1, rocker: 0.5}]",
         "do not reach each other where q = 0"),
        ("gears: [", "while parsing"),
        ("", "is empty"),
    ],
)  # fmt: skip
def test_wrong_transmissions_are_one_line(wrong, problem, files, tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text(wrong)
    saved = tmp_path / "saved.yaml"
    shown = run(
        "add", "coulomb_friction", files / "arm.urdf", files / "log.csv", "--transmission", path,
        "--save", saved, code=2,
    )  # fmt: skip
    assert problem in shown and not saved.exists()


def test_a_transmission_file_is_never_replaced(files):
    beside = files / "arm.transmission.yaml"
    shown = run(
        "compare", files / "arm.urdf", files / "log.csv", "--transmission", beside, "--json",
        beside, code=2,
    )  # fmt: skip
    assert beside.name in shown and beside.read_text() == WRIST


def test_a_model_file_without_motors_has_no_transmission_of_its_own(files):
    shown = run("compare", files / "arm.urdf", files / "log.csv", "--transmission", "file", code=2)
    assert "states no transmissions of motors" in shown
