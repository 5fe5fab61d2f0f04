"""Model files that need more than themselves: one robot of several, packages, xacro."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geodrake import load_model, save_model
from geodrake.control.export_proof.model_text import model_file
from geodrake.effects import FittedEffect, ViscousFriction
from geodrake.errors import ModelError
from geodrake.logs import Motion
from geodrake.model import Given, save_export

MODELS = Path(__file__).parents[2] / "models"
PENDULUM = MODELS / "double_pendulum.urdf"


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def body(name, axis="0 1 0", z=0.0):
    return (
        f'<link name="{name}"><pose>0 0 {z} 0 0 0</pose><inertial><pose>0 0 0.2 0 0 0</pose>'
        "<mass>1.5</mass><inertia><ixx>0.02</ixx><iyy>0.02</iyy><izz>0.01</izz></inertia>"
        "</inertial></link>"
    )


def arm(name, x, weld=True):
    """A model of two links; its base is fixed to the world, or free."""
    fixed = "<joint name='fix' type='fixed'><parent>world</parent><child>base</child></joint>"
    joints = "".join(
        f"<joint name='{joint}' type='revolute'><parent>{parent}</parent><child>{child}</child>"
        "<axis><xyz>0 1 0</xyz></axis></joint>"
        for joint, parent, child in (("shoulder", "base", "upper"), ("elbow", "upper", "lower"))
    )
    links = body("base") + body("upper", z=0.2) + body("lower", z=0.7)
    own = fixed if weld else ""
    return f"<model name='{name}'><pose>{x} 0 0 0 0 0</pose>{links}{own}{joints}</model>"


def world(*models):
    return f"<sdf version='1.9'><world name='w'>{''.join(models)}</world></sdf>"


class TestSeveralRobots:
    @pytest.fixture(params=[True, False], ids=["fixed", "free"])
    def path(self, request, tmp_path):
        text = world(arm("left", 1.0, request.param), arm("right", -1.0, request.param))
        return write(tmp_path / "two.sdf", text)

    def test_all_of_them_are_the_model_unless_one_is_chosen(self, path):
        assert load_model(path).joints == (
            "left_shoulder", "left_elbow", "right_shoulder", "right_elbow",
        )  # fmt: skip
        model = load_model(path, given=Given(robot="right"))
        assert model.joints == ("shoulder", "elbow") and len(model.bodies) == 2
        notes = load_model(path).notes
        assert not notes or "left, right" in " ".join(notes)

    def test_the_chosen_one_moves_as_it_does_alone(self, path, tmp_path):
        alone = load_model(write(tmp_path / "one.sdf", world(arm("right", -1.0))))
        chosen = load_model(path, given=Given(robot="right"))
        motion = Motion(*np.random.default_rng(0).normal(size=(3, 5, 2)))
        np.testing.assert_allclose(chosen.effort(motion), alone.effort(motion), rtol=1e-12)

    def test_a_saved_model_remembers_its_robot(self, path, tmp_path):
        model = load_model(path, given=Given(robot="left"), lock={"elbow": 0.3})
        save_model(model, tmp_path / "model.yaml")
        again = load_model(tmp_path / "model.yaml")
        assert again.joints == ("shoulder",) and again.given.robot == "left"
        with pytest.raises(ModelError, match="cannot take robot 'right'"):
            load_model(tmp_path / "model.yaml", given=Given(robot="right"))


def test_robots_of_an_mjcf_are_named_by_their_first_bodies(tmp_path):
    def mjcf(name, x):
        inertial = '<inertial pos="0 0 .1" mass="1" diaginertia=".1 .1 .1"/>'
        return f'<body name="{name}" pos="{x} 0 0"><joint name="{name}_j"/>{inertial}</body>'

    text = f'<mujoco model="m"><worldbody>{mjcf("a", 0)}{mjcf("b", 1)}</worldbody></mujoco>'
    path = write(tmp_path / "m.xml", text)
    assert load_model(path, given=Given(robot="b")).joints == ("b_j",)
    with pytest.raises(ModelError, match="It has a, b"):
        load_model(path, given=Given(robot="m"))


XACRO = """<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="mass" default="2"/><xacro:include filename="$(find parts)/link.xacro"/>
<link name="base"/><xacro:part name="upper" mass="$(arg mass)"/>{}
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="2"/></joint></robot>"""
PART = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:macro name="part" params="name mass"><link name="${name}"><inertial>
<origin xyz="0 0 ${0.1 * 2}"/><mass value="${mass}"/>
<inertia ixx="0.2" iyy="0.2" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link></xacro:macro>
</robot>"""
MANIFEST = "<package><name>parts</name></package>"


class TestXacro:
    @pytest.fixture
    def robot(self, tmp_path):
        pytest.importorskip("xacro")
        write(tmp_path / "ws" / "parts" / "package.xml", MANIFEST)
        write(tmp_path / "ws" / "parts" / "link.xacro", PART)
        return write(tmp_path / "here" / "arm.urdf.xacro", XACRO.format(""))

    def test_it_is_expanded_with_its_arguments_and_packages(self, robot, tmp_path):
        given = Given(packages={"parts": tmp_path / "ws" / "parts"}, xacro={"mass": "3.5"})
        model = load_model(robot, given=given)
        np.testing.assert_allclose(model.phi[0, :4], [3.5, 0.0, 0.0, 0.7])
        save_model(model, tmp_path / "model.yaml")
        assert load_model(tmp_path / "model.yaml").phi[0, 0] == pytest.approx(3.5)

    def test_it_is_exported_as_what_it_expands_to(self, robot, tmp_path):
        given = Given(packages={"parts": tmp_path / "ws" / "parts"}, xacro={"mass": "3.5"})
        write(robot, XACRO.format("<!-- the arm -->"))
        model = load_model(robot, given=given)
        heavier = replace(model, phi=1.5 * model.phi)
        export = save_export(heavier, tmp_path / "heavier.urdf")
        assert any("the expansion of arm.urdf.xacro" in note for note in export.notes)
        assert b"<!-- the arm -->" in export.content and b"xacro:part" not in export.content
        again = load_model(tmp_path / "heavier.urdf")
        np.testing.assert_allclose(again.phi, heavier.phi, rtol=1e-12)

        rubbing = FittedEffect(ViscousFriction("shoulder"), np.array([0.7]))
        name, data, notes = model_file(replace(heavier, effects=(rubbing,)), "urdf", tmp_path)
        assert name == "arm.urdf" and b'damping="0.7"' in data
        assert any("the expansion of" in note for note in notes)

    def test_packages_are_found_where_ros_finds_them(self, robot, tmp_path, monkeypatch):
        (tmp_path / "install" / "share").mkdir(parents=True)
        (tmp_path / "ws" / "parts").rename(tmp_path / "install" / "share" / "parts")
        monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path / 'install'}")
        assert load_model(robot).phi[0, 0] == pytest.approx(2.0)

    def test_what_is_missing_is_said(self, robot, tmp_path, monkeypatch):
        with pytest.raises(ModelError, match=r"package 'parts', which was not found.*--package"):
            load_model(robot)
        write(robot, XACRO.format('<link name="$(arg side)"/>'))
        given = Given(packages={"parts": tmp_path / "ws" / "parts"})
        with pytest.raises(ModelError, match=r"side.*--xacro-arg side:=VALUE"):
            load_model(robot, given=given)
        monkeypatch.setitem(sys.modules, "xacro", None)
        with pytest.raises(ModelError, match=r"pip install \"geodrake\[robots\]\""):
            load_model(robot, given=given)
