"""The commands of the tutorial, one after the other, on an arm whose truth is known."""

import re
import shlex
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from geodrake import load_model
from geodrake.cli.app import app
from geodrake.effects import CoulombFriction, FittedEffect, Payload, ViscousFriction
from geodrake.inertia import from_mass_com_inertia
from geodrake.logs.files import write_log
from geodrake.logs.motion import JointLog, Motion

PAGE = Path(__file__).parents[2] / "docs" / "tutorial.md"
COMMANDS = [
    line
    for block in re.findall(r"^```\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    for line in block.splitlines()
    if line.startswith("geodrake ")
]
WEIGHT = from_mass_com_inertia(2.0, np.array([0.0, 0.0, 0.05]), 1e-5 * np.eye(3))


def log_of(model, name, seed, payload=None):
    """A log of sines at all joints, with noise."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, 20.0, 0.01)
    rates, phases = rng.uniform(0.5, 3.0, (3, 6)), rng.uniform(0.0, 6.0, (3, 6))
    sizes = (
        0.25
        * np.minimum(*map(np.abs, model.position_limits)).clip(0.5, 1.5)
        * rng.uniform(0.4, 1.0, (3, 6))
    )
    angle = time[:, None, None] * rates + phases
    q, v = (sizes * np.sin(angle)).sum(1), (sizes * rates * np.cos(angle)).sum(1)
    vd = -(sizes * rates**2 * np.sin(angle)).sum(1)
    loaded = model
    if payload is not None:
        carried = FittedEffect(Payload("flange"), payload)
        loaded = replace(model, effects=(*model.effects, carried))
    effort = loaded.effort(Motion(q, v, vd))
    effort += 0.01 * effort.std(axis=0) * rng.standard_normal(effort.shape)
    return JointLog(name, model.joints, time, q, effort, v)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder with the files that the tutorial speaks of."""
    folder = tmp_path_factory.mktemp("tutorial")
    urdf = files("geodrake") / "demo" / "demo.urdf"
    (folder / "robot.urdf").write_text(urdf.read_text(encoding="utf-8"))
    model = load_model(folder / "robot.urdf")
    joints = model.joints[1:3]
    rubs = [FittedEffect(CoulombFriction(j), np.array([3.0])) for j in joints]
    rubs += [FittedEffect(ViscousFriction(j), np.array([4.0])) for j in joints]
    truth = replace(model, effects=(*model.effects, *rubs))
    for k, (name, payload) in enumerate((("free_1", None), ("free_2", None), ("weight", WEIGHT))):
        write_log(log_of(truth, name, k, payload), folder / f"{name}.csv")
    return folder


def test_commands_do_what_the_tutorial_says(folder, monkeypatch):
    monkeypatch.chdir(folder)
    told = {}
    for command in COMMANDS:
        words = shlex.split(command)[1:]
        fast = ["--seeds", "1", "--iterations", "5"] if words[0] == "excite" else []
        result = CliRunner().invoke(app, [*words, *fast, "--quiet"])
        assert result.exit_code == 0, (command, result.output)
        told.setdefault(words[0], []).append(result.output)
    first, weighed, changed = told["explain"]
    assert "coulomb_friction" in first and "viscous_friction" in first
    assert "payload" not in weighed.split("Verdict")[0]
    assert "payload" in changed and "flange" in changed
    for name in ("robot.yaml", "report.html", "motion.csv", "exported"):
        assert (folder / name).exists()
