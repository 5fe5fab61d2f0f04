"""Transmissions at the command line: a file beside the model, the model's own, and wrong ones."""

import json

import numpy as np
import pytest
from commands import contents, refused, told
from coupled_arm import WRIST, arm, log_of

from geodrake.logs import write_log


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The arm with its wrist beside it, and a log of its motors, one of which rubs."""
    folder = tmp_path_factory.mktemp("arm")
    model = arm(folder)
    log = log_of(model, 0, lambda v: np.tanh(v / 1e-3) * [0.0, 0.8, 0.0], seconds=8.0)
    write_log(log, folder / "log.csv")
    return folder


def test_a_file_beside_the_model_is_taken_and_said_unless_another_or_none_is_given(files, tmp_path):
    robot, log, out = files / "arm.urdf", files / "log.csv", tmp_path / "out.json"
    shown = told("compare", robot, log, "--json", out)
    assert "m2, m3 for pitch, roll" in shown and "arm.transmission.yaml beside" in shown
    errors = json.loads(out.read_text())["joints"]
    assert list(errors) == ["m1", "m2", "m3"]
    assert errors["m1"]["nrms"] < 0.1 < errors["m2"]["nrms"]
    other = tmp_path / "turned.yaml"
    other.write_text(WRIST.replace("ratio: -8", "ratio: 8"))
    told("compare", robot, log, "--transmission", other, "--json", out)
    assert json.loads(out.read_text())["joints"]["m1"]["nrms"] > 0.5
    shown = told("compare", robot, log, "--transmission", "none", "--bandwidth", 10)
    assert "actuators" not in shown and "shoulder" in shown
    saved = tmp_path / "model.yaml"
    told("add", "coulomb_friction", robot, log, "--where", "m2", "--save", saved)
    told("compare", saved, log, "--json", out)
    assert json.loads(out.read_text())["error"]["nrms"] < 0.1


@pytest.mark.parametrize(
    ("wrong", "problem"),
    [
        ("gear: []", "it has the unknown field 'gear' (was gears meant?)"),
        ("gears: [{actuator: m, joint: shoulder, ratoi: 3}]", "the unknown field 'ratoi'"),
        ("gears: [{actuator: m, joint: shoulder, ratio: x}]", "ratio = x"),
        ("gears: [{actuator: m, joint: knee}]", "joint 'knee', which is not an independent"),
        ("gears: [{joint: shoulder}]", "gears[0] lacks its actuator"),
        ("gears: [{actuator: '', joint: shoulder}]", "gears[0] has no actuator"),
        ("coupled: [{joints: {roll: {a: [1]}}}]", "coupled[0].joints.roll.a = [1]"),
        ("coupled: [{joints: {roll: {5: 1}}}]", "coupled[0].joints.roll has 5 as a name"),
        ("gears: {actuator: m, joint: roll}", "expected a list but got a table of fields"),
        ("polynomials: [{actuator: m, joint: roll, map_of: 1}]", "the unknown field 'map_of'"),
        (
            "gears: [{actuator: m, joint: roll}, {actuator: n, joint: roll}]",
            "joint 'roll' in two of its parts",
        ),
        ("coupled: [{joints: {roll: {a: 1, b: 1}, pitch: {a: 2, b: 2}}}]", "its rank is 1"),
        ("coupled: [{joints: {roll: {a: 1}, roll: {b: 1}}}]", "it has 'roll' twice"),
        ("gears: [{actuator: pitch, joint: roll}]", "an actuator 'pitch', but the robot also has"),
        (
            "tables: [{actuator: m, joint: roll, actuator_positions: [0], joint_positions: [0]}]",
            "needs at least 3 increasing actuator positions",
        ),
        ("four_bars: [{actuator: m, joint: roll, ground: 1, crank: 3, coupler: 1, rocker: 0.5}]",
         "do not reach each other at q = 0"),
        ("gears: [", "while parsing"),
        ("", "is empty"),
    ],
)  # fmt: skip
def test_wrong_transmissions_are_one_line(wrong, problem, files, tmp_path):
    (tmp_path / "wrong.yaml").write_text(wrong)
    given = ("coulomb_friction", files / "arm.urdf", files / "log.csv", "--save", "saved.yaml")
    assert problem in refused("add", *given, "--transmission", "wrong.yaml")
    assert [path.name for path in tmp_path.iterdir()] == ["wrong.yaml"]


def test_a_transmission_file_is_never_replaced_and_a_model_without_motors_has_none(files):
    given = ("compare", files / "arm.urdf", files / "log.csv", "--transmission")
    before, beside = contents(files), files / "arm.transmission.yaml"
    assert beside.name in refused(*given, beside, "--json", beside)
    assert contents(files) == before
    assert "has no transmissions of motors" in refused(*given, "file")
