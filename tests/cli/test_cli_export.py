"""`geodrake export`: files that simulators agree with, what they lack, and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from pendulum_logs import PENDULUM as MODEL
from pendulum_logs import sines
from typer.testing import CliRunner

from geodrake.cli.app import app
from geodrake.control.export_proof import export as proof
from geodrake.control.export_proof.formats import FORMATS
from geodrake.control.export_proof.held import Exported, ExportFormat
from geodrake.effects import (
    CoulombFriction,
    EffortDelay,
    FittedEffect,
    LoadDependentFriction,
    RotorInertia,
    StribeckFriction,
    ViscousFriction,
)
from geodrake.logs.files import write_log
from geodrake.logs.motion import JointLog
from geodrake.model.saved_model import load_model, save_model

PERIOD, DELAY = 0.01, 0.02


def truth():
    model = load_model(MODEL)
    a, b = model.joints
    effects = (
        FittedEffect(ViscousFriction(a), np.array([0.1])),
        FittedEffect(CoulombFriction(a), np.array([0.3])),
        FittedEffect(CoulombFriction(b), np.array([0.2])),
        FittedEffect(RotorInertia(b), np.array([0.01])),
        FittedEffect(StribeckFriction(a, 0.3), np.array([0.2])),
        FittedEffect(LoadDependentFriction(b), np.array([0.15])),
        FittedEffect(EffortDelay(DELAY), np.zeros(0)),
    )
    return replace(model, effects=effects)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A saved model with its robot's file, and a log of it."""
    here = tmp_path_factory.mktemp("export")
    model, rng = truth(), np.random.default_rng(3)
    time, moved = sines(16.0, period=PERIOD)
    effort = EffortDelay(DELAY).delayed(model.effort(moved), PERIOD)
    effort += 0.01 * rng.normal(size=effort.shape)
    write_log(JointLog("log", model.joints, time, moved.q, effort), here / "log.csv")
    save_model(model, here / "model.yaml")
    return here


def export(*arguments):
    return CliRunner().invoke(app, ["export", *(str(a) for a in arguments)])


def refused(*arguments):
    result = export(*arguments, "-q")
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    assert result.stdout == ""
    lines = result.stderr.splitlines()
    assert len([line for line in lines if not line.startswith("Warning: ")]) == 1
    return result.stderr


@pytest.fixture(scope="module")
def in_urdf(folder):
    out, numbers = folder / "new" / "urdf", folder / "urdf.json"
    result = export(
        folder / "model.yaml", folder / "log.csv", "--to", "urdf", out, "--json", numbers
    )
    assert result.exit_code == 0, result.output
    return result.stdout, json.loads(numbers.read_text())


def test_simulators_agree_on_what_the_files_hold(in_urdf):
    _, numbers = in_urdf
    found = [(each["engine"].split()[0], each["what"]) for each in numbers["differences"]]
    assert found == [("Drake", "effort"), ("Drake", "position"), ("Pinocchio", "effort")]
    for each in numbers["differences"]:
        assert each["largest"] < 1e-6
        assert each["typical"] > 0.01
    assert numbers["ignored"] == ["coulomb_friction"]


def test_each_effect_that_is_lacking_has_its_price(in_urdf):
    printed, numbers = in_urdf
    lacks = {each["effect"]: each for each in numbers["lacks"]}
    assert set(lacks) == {"stribeck_friction", "load_dependent_friction", "effort_delay"}
    assert lacks["effort_delay"]["into"] == []
    assert lacks["load_dependent_friction"]["where"] == ["elbow"]
    into = lacks["load_dependent_friction"]["into"]
    assert set(into) <= {"viscous_friction", "coulomb_friction"} and into
    costs = [each["nrms"] for each in numbers["lacks"]]
    assert costs == sorted(costs, reverse=True)
    error = numbers["error"]
    assert error["nrms"] < 0.01 < min(lacks["effort_delay"]["nrms"], error["held_nrms"])
    assert error["nrms"] < lacks["load_dependent_friction"]["nrms"] < error["held_nrms"]
    assert error["simulated_nrms"] > error["held_nrms"]
    for name in lacks:
        assert name in printed
    assert "Drake does not act on coulomb_friction" in printed


def test_the_price_is_that_of_the_file_compared_with_the_log(folder, in_urdf):
    _, numbers = in_urdf
    path = folder / "new" / "urdf" / MODEL.name
    result = CliRunner().invoke(app, ["compare", str(path), str(folder / "log.csv"), "--json", "-"])
    again = json.loads(result.stdout)["error"]["nrms"]
    assert again == pytest.approx(numbers["error"]["held_nrms"], rel=0.05)


@pytest.mark.parametrize(
    ("to", "files"),
    [
        ("drake", ["double_pendulum.dmd.yaml", "double_pendulum.urdf", "package.xml"]),
        ("isaac", ["double_pendulum.actuators.json", "double_pendulum.urdf"]),
        ("mjcf", ["double_pendulum.xml"]),
    ],
)
def test_other_formats_without_a_log(to, files, folder, tmp_path):
    out = tmp_path / to
    result = export(folder / "model.yaml", "--to", to, out, "--json", "-")
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in out.iterdir()) == files
    numbers = json.loads(result.stdout)
    assert max(each["largest"] for each in numbers["differences"]) < 1e-6
    assert numbers["error"] == {}
    lacks = {each["effect"] for each in numbers["lacks"]}
    assert ("effort_delay" in lacks) == (to == "drake")
    assert ("without geometry" in " ".join(numbers["notes"])) == (to == "mjcf")


def test_a_file_that_says_something_else_is_noticed(folder, tmp_path, monkeypatch):
    kept = proof.without
    monkeypatch.setattr(proof, "without", lambda model, kinds: kept(load_model(MODEL), kinds))
    result = export(folder / "model.yaml", "--to", "urdf", tmp_path / "out")
    assert result.exit_code == 0
    assert "differs from geodrake by more than rounding" in " ".join(result.stdout.split())


def test_a_format_is_one_more_entry(folder, tmp_path, monkeypatch):
    """One that holds everything, and that no simulator reads."""

    def write(model, held, out):
        assert held.lost == ()
        assert held.model.effects
        return Exported({"effects.txt": " ".join(f.effect.name for f in model.effects).encode()})

    everything = ExportFormat("words", lambda model: lambda effect: True, write)
    monkeypatch.setitem(FORMATS, "words", everything)
    result = export(folder / "model.yaml", folder / "log.csv", "--to", "words", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "load_dependent_friction" in (tmp_path / "out" / "effects.txt").read_text()
    assert "The files hold the model, nrms" in " ".join(result.stdout.split())


def test_a_floating_robot_goes_into_its_own_format_alone(tmp_path):
    leg = MODEL.with_name("cheetah_leg.urdf")
    result = export(leg, "--floating", "--to", "urdf", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "not tried in simulators" in result.stdout
    assert "floats" in refused(leg, "--floating", "--to", "sdf", tmp_path / "other")


def test_simulators_that_are_not_there_are_named(tmp_path, monkeypatch):
    monkeypatch.setattr(proof, "engine", lambda name: None)
    result = export(MODEL, "--to", "urdf", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert 'pip install "geodrake[export]"' in result.stdout
    assert (tmp_path / "out" / MODEL.name).is_file()


def test_a_file_that_is_there_stays(tmp_path):
    there = tmp_path / MODEL.name
    there.write_text("mine")
    assert "--force" in refused(MODEL, "--to", "urdf", tmp_path)
    assert there.read_text() == "mine"
    assert export(MODEL, "--to", "urdf", tmp_path, "--force").exit_code == 0
    assert there.read_bytes() == MODEL.read_bytes()


def test_bad_input_is_a_line_and_nothing_is_written(folder, tmp_path):
    out = tmp_path / "out"
    own = tmp_path / MODEL.name
    own.write_bytes(MODEL.read_bytes())
    assert "urdf, sdf, mjcf" in refused(MODEL, "--to", "usd", out)
    assert "is an input" in refused(own, "--to", "urdf", tmp_path, "--force")
    assert "no folder" in refused(MODEL, "--to", "urdf", own)
    assert "log" in refused(MODEL, tmp_path / "none.csv", "--to", "urdf", out)
    assert "none" in refused(tmp_path / "none.urdf", "--to", "urdf", out)
    ball = tmp_path / "ball.sdf"
    ball.write_text(
        '<sdf version="1.9"><model name="m"><link name="l"/><joint name="j" type="ball">'
        "<parent>world</parent><child>l</child></joint></model></sdf>"
    )
    assert "joint j is of the type" in refused(ball, "--to", "urdf", out)
    target = tmp_path / "no" / "x.json"
    assert "no folder" in refused(MODEL, "--to", "urdf", out, "--json", target)
    assert not out.exists()
    assert export(MODEL, out).exit_code == 2  # --to is missing


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    assert "file" in refused(MODEL, "--to", "urdf", tmp_path / "file" / "out")


def test_a_robot_with_a_joint_that_follows(tmp_path):
    link = """<link name="{0}"><inertial><mass value="1"/><origin xyz="0.1 0 0"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
    joint = """<joint name="{0}" type="revolute"><parent link="base"/><child link="{1}"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/>
    <dynamics damping="0.2"/>{2}</joint>"""
    parts = (link.format("one"), link.format("two"), joint.format("a", "one", ""))
    follows = joint.format("b", "two", '<mimic joint="a"/>')
    path = tmp_path / "gripper.urdf"
    path.write_text(f'<robot name="g"><link name="base"/>{"".join(parts)}{follows}</robot>')
    for to, count in (("urdf", 2), ("mjcf", 1), ("sdf", 1)):
        result = export(path, "--to", to, tmp_path / to, "--json", "-")
        assert result.exit_code == 0, result.output
        found = json.loads(result.stdout)["differences"]
        assert len(found) == count and all(each["largest"] < 1e-9 for each in found)


def test_the_folder_is_last_or_an_option(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runner, start = CliRunner(), ["export", str(folder / "model.yaml"), "--quiet", "--to", "cpp"]
    log = str(folder / "log.csv")
    for words in (["one"], ["--to-dir", "two"], [log, "three"], [log, "--to-dir", "four"]):
        found = runner.invoke(app, [*start, *words])
        assert found.exit_code == 0, found.stderr
        assert list((tmp_path / words[-1]).iterdir())
    found = runner.invoke(app, start)
    assert found.exit_code == 2 and "--to-dir" in found.stderr
    assert {each.name for each in tmp_path.iterdir()} == {"one", "two", "three", "four"}
