"""Robots by the names of robot_descriptions, from a cache of the test, without a network."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from geodrake.cli.app import app
from geodrake.errors import ModelError
from geodrake.logs import JointLog, Motion, write_log
from geodrake.model import Given, load_model, save_model
from geodrake.robot.plant import load_plant
from geodrake.robot.shapes import robot_shapes

robots = pytest.importorskip("robot_descriptions")
repositories = pytest.importorskip("robot_descriptions._repositories")

PENDULUM = (Path(__file__).parents[2] / "models" / "double_pendulum.urdf").read_text()
MJCF = """<mujoco model="ur5e"><worldbody><body name="arm"><joint name="only" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.03"/></body></worldbody></mujoco>"""
FILES = {
    ("Universal_Robots_ROS2_Description", "urdf/ur.urdf.xacro"): """<robot name="ur"
        xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="ur_type" default="none"/>
        <xacro:arg name="name" default="none"/>
        <xacro:include filename="$(find ur_description)/urdf/parts.xacro"/>
        <xacro:part kind="$(arg ur_type)"/></robot>""",
    ("Universal_Robots_ROS2_Description", "urdf/parts.xacro"): """<robot name="parts"
        xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="part" params="kind">
        <link name="world"/><joint name="${kind}_joint" type="continuous"><parent link="world"/>
        <child link="hand"/><axis xyz="0 1 0"/></joint><link name="hand"><inertial>
        <origin xyz="0 0 -0.1"/><mass value="2"/><inertia ixx="0.01" iyy="0.01" izz="0.01"
        ixy="0" ixz="0" iyz="0"/></inertial></link></xacro:macro></robot>""",
    ("Universal_Robots_ROS2_Description", "package.xml"): "<package><name>ur_description</name>"
    "</package>",
    ("mujoco_menagerie", "universal_robots_ur5e/ur5e.xml"): MJCF,
    ("example-robot-data", "robots/panda_description/urdf/panda.urdf"): PENDULUM.replace(
        "<visual>",
        '<visual><geometry><mesh filename="package://panda_description/meshes/a.stl"/></geometry>'
        '</visual><visual><geometry><mesh filename="package://hand/b.stl"/></geometry></visual>'
        "<visual>",
        1,
    ),
    ("example-robot-data", "robots/panda_description/meshes/a.stl"): "solid a\nendsolid a\n",
    ("example-robot-data", "more/of_hands/package.xml"): "<package><name>hand</name></package>",
    ("example-robot-data", "more/of_hands/b.stl"): "solid b\nendsolid b\n",
}


def git(folder, *words):
    own = ["-c", "user.name=t", "-c", "user.email=t@t", "-c", "commit.gpgsign=false"]
    command = ["git", "-C", str(folder), *own, *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


@pytest.fixture
def fresh(monkeypatch, tmp_path):
    """Return a freshly imported robot_descriptions with an empty cache."""
    for name in ("ur5e", "ur5e_mj", "panda"):
        monkeypatch.delitem(sys.modules, f"robot_descriptions.{name}_description", raising=False)
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    for repository in repositories.REPOSITORIES.values():
        monkeypatch.setattr(repository, "url", str(tmp_path / "nowhere"))
    yield tmp_path
    for name in ("ur5e", "ur5e_mj", "panda"):
        sys.modules.pop(f"robot_descriptions.{name}_description", None)


@pytest.fixture
def cached(fresh, monkeypatch):
    """Return a cache with the files of three robots, at commits of its own."""
    for repository in dict.fromkeys(name for name, _ in FILES):
        known = repositories.REPOSITORIES[repository]
        folder = fresh / "cache" / known.cache_path
        for (of, name), text in FILES.items():
            if of == repository:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_text(text)
        git(folder.parent, "init", "-q", str(folder))
        git(folder, "add", ".")
        git(folder, "commit", "-q", "-m", "files")
        monkeypatch.setattr(known, "commit", git(folder, "rev-parse", "HEAD"))
    return fresh


def run(*arguments, code=0):
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == code, result.output
    return " ".join(result.output.split())


@pytest.mark.parametrize("name", ["UR5e", "ur5e_description"])
def test_the_xacro_of_a_name_is_expanded_for_that_robot(cached, name):
    pytest.importorskip("xacro")
    model = load_model(name)
    assert model.joints == ("ur5e_joint",)
    assert model.path == cached / "cache/ur_description/urdf/ur.urdf.xacro"
    assert any("ur5e_description of robot_descriptions" in note for note in model.notes)
    other = any("The MJCF of" in note and "ur5e_mj_description" in note for note in model.notes)
    assert other is (not name.endswith("description"))
    own = Given(xacro={"ur_type": "mine"})
    assert load_model(name, given=own).joints == ("mine_joint",)


@pytest.mark.parametrize("name", ["ur5e-mj", "ur5e_mj_description"])
def test_the_mjcf_of_a_name_is_that_of_the_description_asked_for(cached, name):
    model = load_model(name)
    assert model.joints == ("only",) and model.path.name == "ur5e.xml"
    assert load_plant(name).path == model.path


def test_packages_of_the_repository_are_found(cached):
    model = load_model("panda")
    repository = cached / "cache/example-robot-data"
    own = repository / "robots/panda_description"
    assert model.given.packages == {"panda_description": own, "hand": repository / "more/of_hands"}
    (found,) = robot_shapes(model.path, model.given).notes  # files without triangles
    assert "no triangles" in found and "--package" not in found
    mine = Given(packages={"hand": cached})
    assert load_model("panda", given=mine).given.packages["hand"] == cached


def test_a_file_that_is_there_wins_and_one_that_is_not_is_told_of_as_before(cached):
    Path("panda").write_text(MJCF)
    assert load_model("panda").joints == ("only",)
    for gone in ("gone.yaml", "arms/panda", str(cached / "ur5e")):
        with pytest.raises(ModelError, match=f"model file {gone} does not exist. Check the path.$"):
            load_model(gone)
    for gone in ("./ur5e", "ur5e/"):
        message = f"model file {cached / 'ur5e'} does not exist. Check the path."
        for load in (load_model, load_plant):
            with pytest.raises(ModelError, match=f"{message}$"):
                load(gone)
        assert message in run("check", gone, code=2)
    Path("ur5e").mkdir()
    with pytest.raises(ModelError, match="ur5e is a folder"):
        load_model("ur5e")


def test_an_unknown_name_has_the_three_nearest(cached):
    with pytest.raises(ModelError, match="model file ur5x does not exist") as caught:
        load_model("ur5x")
    words = str(caught.value).partition("nearest robot names are ")[2].rstrip(".").split(", ")
    assert len(words) == 3 and "ur5e" in words
    every = {each.removesuffix("_description") for each in robots.DESCRIPTIONS}
    assert every.issuperset(words)


def test_without_the_extra_its_name_is_said(fresh, monkeypatch):
    monkeypatch.setitem(sys.modules, "robot_descriptions", None)
    with pytest.raises(ModelError, match=r'pip install "geodrake\[robots\]"'):
        load_model("ur5e")
    with pytest.raises(ModelError, match=r"does not exist\. Check the path\.$"):
        load_model("ur5e.urdf")


def test_what_is_not_in_the_cache_is_downloaded_or_the_reason_is_said(fresh, capfd):
    with pytest.raises(ModelError, match="ur5e cannot be downloaded") as caught:
        load_model("ur5e")
    assert str(fresh / "nowhere") in str(caught.value)
    assert str(fresh / "cache/ur_description") in str(caught.value)
    shown = run("check", "ur5e", code=2)
    assert f"Downloading {fresh / 'nowhere'}" in shown and "cannot be downloaded" in shown


def test_commands_and_saved_models_know_it(cached):
    model, time = load_model("panda"), np.arange(0.0, 10.0, 0.01)
    angle = np.outer(time, [2.0, 3.1]) + np.array([0.0, 1.0])
    q, v, vd = np.sin(angle), np.cos(angle) * [2.0, 3.1], -np.sin(angle) * [4.0, 9.61]
    effort = model.effort(Motion(q, v, vd)) + np.random.default_rng(0).normal(0.0, 0.01, q.shape)
    write_log(JointLog("log", model.joints, time, q, effort), cached / "log.csv")
    shown = run("compare", "panda", "log.csv")
    assert "panda against log.csv" in shown
    run("export", "panda", "out", "--to", "mjcf")
    assert (cached / "out").is_dir()
    save_model(model, cached / "model.yaml")
    again = load_model(cached / "model.yaml")
    assert again.path == model.path and again.given.packages == model.given.packages
    refused = run("compare", "pandaa", "log.csv", code=2)
    assert "nearest" in refused and "panda" in refused


def test_what_is_downloaded_is_read(cached, monkeypatch):
    known = repositories.REPOSITORIES["mujoco_menagerie"]
    here = cached / "cache" / known.cache_path
    monkeypatch.setattr(known, "url", str(shutil.move(here, cached / "elsewhere")))
    git(cached / "elsewhere", "config", "uploadpack.allowAnySHA1InWant", "true")
    shown = run("check", "ur5e_mj")
    assert f"Downloading {cached / 'elsewhere'}" in shown and "Second opinion: MuJoCo" in shown
    assert here.is_dir() and "Downloading" not in run("check", "ur5e_mj")
