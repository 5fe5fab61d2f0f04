"""The ros2_control package of a model, compiled without ROS against stubs of its interfaces."""

import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import yaml

from geodrake import load_model
from geodrake.control.export_proof import export_to
from geodrake.control.export_proof.ros2 import SIGN_WIDTH
from geodrake.effects import CoulombFriction, FittedEffect, Payload, ViscousFriction
from geodrake.errors import ModelError
from geodrake.inertia import from_mass_com_inertia
from geodrake.logs import Motion

STUBS = Path(__file__).parent / "ros2_stubs"
PAYLOAD = from_mass_com_inertia(2.5, np.array([0.0, 0.0, 0.1]), 0.01 * np.eye(3))
PACKAGE = "demo_feedforward"


@pytest.fixture(scope="module")
def model():
    robot = load_model(files("geodrake") / "demo" / "demo.urdf")
    effects = (
        FittedEffect(Payload("flange"), PAYLOAD),
        FittedEffect(CoulombFriction("elbow_pitch"), np.array([4.0])),
        FittedEffect(ViscousFriction("base_yaw"), np.array([3.0])),
    )
    return replace(robot, effects=effects)


@pytest.fixture(scope="module")
def folder(model, tmp_path_factory):
    folder = tmp_path_factory.mktemp("ros2") / PACKAGE
    export_to("ros2", model, folder)
    return folder


@pytest.fixture(scope="module")
def program(folder, tmp_path_factory):
    compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("there is no C++ compiler")
    built = tmp_path_factory.mktemp("built") / "main"
    options = ["-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wno-unused-parameter"]
    sources = [folder / "src" / "feedforward.cpp", STUBS / "main.cpp"]
    command = [compiler, *options, f"-I{STUBS}", f"-I{folder / 'include'}", *sources, "-o", built]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return built


def run(program, rows, scale=1.0, desired=False):
    given = f"{scale!r} {int(desired)}\n" + "\n".join(" ".join(map(repr, r)) for r in rows.tolist())
    done = subprocess.run([program], input=given, capture_output=True, text=True, check=True)
    first, *lines = done.stdout.splitlines()
    return first.split(), lines


def samples(model, count=20):
    rng = np.random.default_rng(0)
    return (rng.uniform(-1.0, 1.0, (count, len(model.joints))) for _ in range(3))


@pytest.mark.parametrize("desired", [False, True])
def test_commands_are_references_and_the_model_without_acceleration(model, program, desired):
    q, v, told = samples(model)
    names, lines = run(program, np.hstack([q, v, told]), scale=0.5, desired=desired)
    found = np.array([line.split() for line in lines], float)
    motion = Motion(model.positions(q), v, np.zeros_like(v))
    needed = model.effort(motion, sign_width=SIGN_WIDTH)
    ramp = np.minimum(1.0, 0.25 * np.arange(1, len(q) + 1))  # s, of one second
    limits = model.effort_limits
    expected = np.clip(told + 0.5 * ramp[:, None] * needed, -limits, limits)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    assert names[: len(model.joints)] == [f"{joint}/effort" for joint in model.joints]
    assert f"controller/{model.joints[2]}/velocity" in names


def test_unknown_readings_end_in_an_error_and_limits_hold(model, program):
    q, v, told = samples(model, 2)
    told[0] = 1e4
    q[1, 3] = np.nan
    _, lines = run(program, np.hstack([q, v, told]))
    np.testing.assert_allclose(np.array(lines[0].split(), float), model.effort_limits)
    assert lines[1] == "error"


def test_files_are_what_colcon_and_pluginlib_read(model, folder):
    package = ET.parse(folder / "package.xml").getroot()
    assert package.findtext("name") == PACKAGE
    assert package.findtext("export/build_type") == "ament_cmake"
    depends = {each.text for each in package.iter("depend")}
    cmake = (folder / "CMakeLists.txt").read_text()
    assert depends <= set(re.findall(r"find_package\((\w+) REQUIRED\)", cmake))
    for path in re.findall(r"(src/[\w.]+|plugin\.xml)", cmake):
        assert (folder / path).is_file()
    (plugin,) = ET.parse(folder / "plugin.xml").getroot().iter("class")
    assert plugin.get("type") == f"{PACKAGE}::Feedforward"
    settings = yaml.safe_load((folder / "config" / "feedforward.yaml").read_text())
    assert settings["controller_manager"]["ros__parameters"][PACKAGE]["type"] == plugin.get("name")
    own = settings[PACKAGE]["ros__parameters"]
    assert own["joints"] == list(model.joints)
    np.testing.assert_allclose(own["effort_limits"], model.effort_limits)
    declared = set(
        re.findall(
            r'auto_declare<[^(]+>\("(\w+)"', (folder / "src" / "feedforward.cpp").read_text()
        )
    )
    assert declared == set(own)
    kept = {path.relative_to(folder).as_posix() for path in folder.rglob("*.*")}
    assert {"README.md", f"include/{PACKAGE}/demo_effort.hpp"} <= kept


def test_cmake_takes_the_lists(folder, tmp_path):
    """The syntax, with packages of ROS that do nothing."""
    cmake = shutil.which("cmake")
    if cmake is None:
        pytest.skip("there is no CMake")
    names = re.findall(r"find_package\((\w+) REQUIRED\)", (folder / "CMakeLists.txt").read_text())
    for name in names:
        text = f"add_library({name}::{name} INTERFACE IMPORTED)\n"
        if name == "ament_cmake":
            text = "function(ament_package)\nendfunction()\n"
        if name == "pluginlib":
            text += "function(pluginlib_export_plugin_description_file)\nendfunction()\n"
        (tmp_path / f"Find{name}.cmake").write_text(text)
    command = [cmake, "-S", folder, "-B", tmp_path / "build", f"-DCMAKE_MODULE_PATH={tmp_path}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_robots_with_other_joints_are_refused(tmp_path):
    body = '<body><joint name="j" type="ball"/><geom size="0.1"/></body>'
    text = f"<mujoco><worldbody>{body}</worldbody></mujoco>"
    (tmp_path / "ball.xml").write_text(text)
    with pytest.raises(ModelError, match="one degree of freedom"):
        export_to("ros2", load_model(tmp_path / "ball.xml"), tmp_path / "out")
    assert not (tmp_path / "out").exists()
