"""`geodrake export`: files that simulators agree with, missing effects, and refusals."""

import json
from contextlib import chdir
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import refused, run, told
from pendulum_logs import PENDULUM as MODEL
from pendulum_logs import sines, with_gripper

from geodrake.control.export_proof import export as proof
from geodrake.effects import (
    CoulombFriction,
    EffortDelay,
    FittedEffect,
    LoadDependentFriction,
    RotorInertia,
    StribeckFriction,
    ViscousFriction,
)
from geodrake.logs import JointLog, write_log
from geodrake.model import load_model, save_model

PERIOD, DELAY = 0.01, 0.02


def truth():
    model = load_model(MODEL)
    a, b = model.joints
    values = {
        ViscousFriction(a): 0.1,
        CoulombFriction(a): 0.3,
        CoulombFriction(b): 0.2,
        RotorInertia(b): 0.01,
        StribeckFriction(a, 0.3): 0.2,
        LoadDependentFriction(b): 0.15,
    }
    effects = [FittedEffect(effect, np.array([value])) for effect, value in values.items()]
    delay = FittedEffect(EffortDelay(DELAY), np.zeros(0))
    return replace(model, effects=(*effects, delay))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder of a saved model and a log of it."""
    here = tmp_path_factory.mktemp("export")
    model, rng = truth(), np.random.default_rng(3)
    time, moved = sines(16.0, period=PERIOD)
    effort = EffortDelay(DELAY).delayed(model.effort(moved), PERIOD)
    effort += 0.01 * rng.normal(size=effort.shape)
    write_log(JointLog("log", model.joints, time, moved.q, effort), here / "log.csv")
    save_model(model, here / "model.yaml")
    return here


def export(*arguments):
    """Return the output and the numbers of the command."""
    output = told("export", *arguments, "--json", "numbers.json")
    return output, json.loads(Path("numbers.json").read_text())


@pytest.fixture(scope="module")
def in_urdf(folder):
    with chdir(folder):
        return export("model.yaml", "log.csv", "--to", "urdf", "new/urdf")


def test_simulators_agree_on_what_the_files_hold(in_urdf):
    _, numbers = in_urdf
    found = [(each["engine"].split()[0], each["what"]) for each in numbers["differences"]]
    assert found == [("Drake", "effort"), ("Drake", "position"), ("Pinocchio", "effort")]
    for each in numbers["differences"]:
        assert each["largest"] < 1e-6
        assert each["typical"] > 0.01
    assert numbers["ignored"] == ["coulomb_friction"]


def test_each_missing_effect_has_its_cost(in_urdf):
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
    assert all(name in printed for name in lacks)
    assert "Ignored: coulomb_friction by Drake" in printed


def test_the_cost_is_the_error_of_the_file_on_the_log(folder, in_urdf):
    _, numbers = in_urdf
    path = folder / "new" / "urdf" / MODEL.name
    result = run("compare", path, folder / "log.csv", "--json", "-")
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
    _, numbers = export(folder / "model.yaml", "--to", to, "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == files
    assert max(each["largest"] for each in numbers["differences"]) < 1e-6
    assert numbers["error"] == {}
    lacks = {each["effect"] for each in numbers["lacks"]}
    assert ("effort_delay" in lacks) == (to == "drake")
    assert ("without geometry" in " ".join(numbers["notes"])) == (to == "mjcf")


def test_a_different_file_is_noticed(folder, monkeypatch):
    kept = proof.without
    monkeypatch.setattr(proof, "without", lambda model, kinds: kept(load_model(MODEL), kinds))
    output, _ = export(folder / "model.yaml", "--to", "urdf", "out")
    assert "differs by more than rounding" in output


def test_a_floating_robot_goes_into_its_own_format():
    leg = MODEL.with_name("cheetah_leg.urdf")
    output, _ = export(leg, "--floating", "--to", "urdf", "out")
    assert "not tested in simulators" in output


def test_missing_simulators_are_named(monkeypatch):
    monkeypatch.setattr(proof, "find_spec", lambda name: None)
    output, _ = export(MODEL, "--to", "urdf", "out")
    assert 'pip install "geodrake[export]"' in output
    assert Path("out", MODEL.name).is_file()


def test_existing_files_stay(tmp_path):
    there = tmp_path / MODEL.name
    there.write_text("mine")
    assert "--force" in refused("export", MODEL, "--to", "urdf", tmp_path)
    assert there.read_text() == "mine"
    export(MODEL, "--to", "urdf", tmp_path, "--force")
    assert there.read_bytes() == MODEL.read_bytes()


def test_a_robot_with_a_joint_that_follows(tmp_path):
    path = with_gripper(tmp_path / "gripper.urdf")
    for to, count in (("urdf", 2), ("mjcf", 1), ("sdf", 1)):
        _, numbers = export(path, "--to", to, tmp_path / to)
        found = numbers["differences"]
        assert len(found) == count and all(each["largest"] < 1e-9 for each in found)


def test_the_folder_is_last_or_an_option(folder, tmp_path):
    given, log = ("export", folder / "model.yaml", "--quiet", "--to", "cpp"), folder / "log.csv"
    for words in (["one"], ["--to-dir", "two"], [log, "three"], [log, "--to-dir", "four"]):
        told(*given, *words)
        assert list((tmp_path / words[-1]).iterdir())
    assert {each.name for each in tmp_path.iterdir()} == {"one", "two", "three", "four"}
