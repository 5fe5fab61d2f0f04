"""Robots of several files, of packages and of xacro, and one of several robots in a file."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.parsing import PackageMap

from geodrake import load_model, save_model
from geodrake.control.export_proof.model_text import model_file
from geodrake.effects import FittedEffect, ViscousFriction
from geodrake.errors import ModelError
from geodrake.logs import Motion
from geodrake.model import check_dynamics, save_export
from geodrake.robot.files import Given
from geodrake.robot.files.includes import add_packages, named_packages
from geodrake.robot.shapes import robot_shapes

PENDULUM = Path(__file__).parents[2] / "models" / "double_pendulum.urdf"
LINK = """<link name="{}"><inertial><mass>{}</mass></inertial></link>"""
JOINT = """<joint name="{}" type="{}"><parent>world</parent><child>{}</child>
<axis><xyz>{}</xyz></axis></joint>"""


def sdf(content):
    return f'<sdf version="1.9"><model name="robot">\n{content}\n</model></sdf>\n'


def body(name="a", mass=1.0, axis="0 0 1", kind="revolute"):
    return LINK.format(name, mass) + "\n" + JOINT.format(f"{name}_joint", kind, name, axis)


def including(uri):
    return sdf(body() + f"\n<include><name>more</name><uri>{uri}</uri></include>")


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def package(folder, name):
    write(folder / "package.xml", f"<package><name>{name}</name></package>")
    return folder


@pytest.mark.parametrize("by", ["path", "folder", "file", "package", "model"])
def test_sdf_includes(by, tmp_path):
    package(tmp_path, "p")
    file = write(tmp_path / "more" / "model.sdf", sdf(body("b")))
    uri = {
        "path": "more/model.sdf",
        "folder": "more",
        "file": file.as_uri(),
        "package": "package://p/more/model.sdf",
        "model": "model://p/more/model.sdf",
    }[by]
    model = load_model(write(tmp_path / "robot.sdf", including(uri)))
    assert set(model.joints) == {"a_joint", "b_joint"}


FINGER = """<sdf version="1.9"><model name="finger">
<frame name="mount" attached_to="a"><pose>0 0 -.02 0 .3 0</pose></frame>
<link name="a"><inertial><pose>0 0 .03 0 .2 0</pose><mass>.1</mass>
<inertia><ixx>1e-4</ixx><iyy>2e-4</iyy><izz>1.5e-4</izz></inertia></inertial></link>
<link name="b"><pose relative_to="a">0 0 .06 .2 0 0</pose><inertial><mass>.05</mass></inertial>
</link><joint name="bend" type="revolute"><parent>a</parent><child>b</child>
<axis><xyz expressed_in="__model__">1 0 0</xyz><dynamics><spring_stiffness>.2</spring_stiffness>
</dynamics></axis></joint>MORE</model></sdf>"""
NESTED = """<link name="c"><inertial><mass>.2</mass></inertial></link>
<joint name="slide" type="prismatic"><pose relative_to="__model__"/><parent>__model__</parent>
<child>c</child><axis><xyz expressed_in="mount">0 1 1</xyz></axis></joint>
<include merge="true"><name>tip</name><uri>package://p/tip.sdf</uri><pose>.1 0 0 0 .3 0</pose>
</include><joint name="tilt" type="revolute"><parent>c</parent><child>d</child>
<axis><xyz>0 1 0</xyz></axis></joint>"""
OLD = """<sdf version="1.4"><model name="old"><link name="a"><pose>0 0 .1 .5 0 0</pose></link>
<link name="b"><pose>0 0 .3 .5 .4 0</pose><inertial><pose>.1 0 0 0 0 0</pose></inertial></link>
<joint name="bend" type="revolute"><parent>a</parent><child>b</child><axis><xyz>1 0 0</xyz>
<dynamics><friction>0.30</friction></dynamics></axis></joint></model></sdf>"""


@pytest.mark.parametrize("merge", [False, True])
@pytest.mark.parametrize("kind", ["placed", "nested", "old"])
def test_included_sdf_models_are_what_drake_makes_of_them(tmp_path, kind, merge):
    package(tmp_path, "p")
    names = {"a": "d", "b": "e", "mount": "mount_2", "bend": "bend_2"}
    tip = FINGER.replace("MORE", "")
    for name, other in names.items():
        tip = tip.replace(f'"{name}"', f'"{other}"').replace(f">{name}<", f">{other}<")
    write(tmp_path / "tip.sdf", tip)
    finger = OLD if kind == "old" else FINGER.replace("MORE", NESTED if kind == "nested" else "")
    write(tmp_path / "finger.sdf", finger)
    placed = "<placement_frame>mount</placement_frame>" if kind == "placed" else ""
    scope = "" if merge else "more::"
    include = including("package://p/finger.sdf").replace(
        "</uri>",
        f"""</uri>{placed}
<pose relative_to="a0">0 0 .1 0 0 .2</pose>""",
    )
    text = include.replace('"a"', '"a0"').replace(">a<", ">a0<")
    text = text.replace(
        "</model>",
        f"""<joint name="k" type="revolute"><parent>a0</parent>
<child>{scope}a</child><axis><xyz>1 0 0</xyz></axis></joint></model>""",
    )
    robot = write(tmp_path / "robot.sdf", text.replace("<include>", f'<include merge="{merge}">'))
    check = check_dynamics(model := load_model(robot))
    assert check.by.startswith("Drake") and check.second is not None and check.second.holds
    assert not model.left_out
    dry = [f.parameters.tolist() for f in model.effects if f.effect.name == "coulomb_friction"]
    assert dry == ([[0.3]] if kind == "old" else [])
    springs = [f.effect.where for f in model.effects if f.effect.name == "joint_spring"]
    assert len(springs) == {"placed": 1, "nested": 2, "old": 0}[kind]


@pytest.mark.parametrize("place", ["worlds/models/more", "more", "gazebo/more"])
def test_models_of_gazebo_are_found_beside_the_world_and_on_its_path(tmp_path, monkeypatch, place):
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", f"{tmp_path / 'gazebo'}")
    named = "<model><sdf version='1.9'>b.sdf</sdf></model>"
    write(write(tmp_path / place / "model.config", named).with_name("b.sdf"), sdf(body("b")))
    model = load_model(write(tmp_path / "worlds" / "robot.sdf", including("model://more")))
    assert set(model.joints) == {"a_joint", "b_joint"}
    assert (second := check_dynamics(model).second) is not None and second.holds


def test_worlds_without_their_sun_are_checked_and_shown(tmp_path):
    folder = tmp_path / "my worlds"
    write(folder / "more" / "model.sdf", sdf(body("b")))
    visual = "<visual name='v'><geometry><sphere><radius>1</radius></sphere></geometry></visual>"
    spring = "<dynamics><spring_stiffness>2</spring_stiffness></dynamics></axis>"
    loop = """<joint name="{}" type="revolute"><parent>{}</parent><child>{}</child><axis>
<xyz>0 0 1</xyz></axis></joint>"""
    robot = body("a").replace("</link>", f"{visual}</link>").replace("</axis>", spring)
    robot += LINK.format("c", 1.0) + loop.format("one", "a", "c") + loop.format("two", "world", "c")
    world = f"""<sdf version="1.9"><world name="w"><include><uri>model://sun</uri></include>
<include><uri>https://fuel.org/Ground Plane</uri></include><model name="robot">{robot}
<include><name>more</name><uri>more</uri></include></model></world></sdf>"""
    path = write(folder / "robot.sdf", world)
    check = check_dynamics(load_model(path))
    assert check.by.startswith("Drake") and check.second is not None and check.second.holds
    found = robot_shapes(path, Given())
    assert (list(found.links), found.notes) == (["robot::a"], ())


def test_joints_of_an_sdf_are_stated_where_their_nested_children_are(tmp_path):
    dynamics = "<dynamics><friction>.4</friction><spring_stiffness>3</spring_stiffness></dynamics>"
    joint = """<joint name="{}" type="revolute"><parent>{}</parent><child>{}</child>
<axis><xyz>1 0 0</xyz>{}</axis></joint>"""
    wrist = f"""<model name="wrist">{LINK.format("w", 1.0)}<model name="tip">
{LINK.format("t", 1.0)}{LINK.format("u", 1.0)}{joint.format("lead", "t", "u", "")}</model>
<frame name="inner" attached_to="tip::t"/>
{joint.format("follow", "w", "inner", f'<mimic joint="tip::lead"/>{dynamics}')}</model>"""
    outer = joint.format("base", "a", "wrist", dynamics)
    model = load_model(write(tmp_path / "robot.sdf", sdf(body("a") + wrist + outer)))
    assert set(model.joints) == {"a_joint", "base", "lead"}
    assert [*model.followers] == ["robot::wrist::tip::follow"]
    for name in ("coulomb_friction", "joint_spring"):
        places = [f.effect.where for f in model.effects if f.effect.name == name]
        assert sorted(places) == [("base",), ("lead",)]


def test_mjcf_includes(tmp_path):
    inner = """<mujocoinclude><worldbody><body name="b"><joint name="j"/>
    <inertial pos="0 0 1" mass="2" diaginertia="1 1 1"/></body></worldbody></mujocoinclude>"""
    write(tmp_path / "parts" / "b.xml", inner)
    outer = '<mujoco model="m"><include file="{}.xml"/></mujoco>'
    for name in ("parts/b", "b"):  # from the folder of the model, and from the file's own
        write(tmp_path / "parts" / "a.xml", outer.format(name))
        model = load_model(write(tmp_path / "robot.xml", outer.format("parts/a")))
        assert (model.joints, model.phi[0, 0]) == (("j",), 2.0)


def test_paths_of_directives_are_from_the_folder_of_their_own_file(tmp_path):
    write(tmp_path / "arms" / "arm.urdf", PENDULUM.read_text(encoding="utf-8"))
    inner = "directives:\n- add_model: {name: arm, file: arm.urdf}\n"
    write(tmp_path / "arms" / "arm.dmd.yaml", inner)
    top = "directives:\n- add_directives: {{file: {}}}\n"
    write(tmp_path / "arms" / "all.dmd.yaml", top.format("arm.dmd.yaml"))
    path = write(tmp_path / "top.dmd.yaml", top.format("arms/all.dmd.yaml"))
    assert load_model(path).joints == ("shoulder", "elbow")
    assert robot_shapes(path, Given()).links
    with pytest.raises(ModelError, match=r"legs/arm\.dmd\.yaml does not exist"):
        load_model(write(path, top.format("legs/arm.dmd.yaml")))


def test_messages_of_drake_have_the_line_of_the_file_it_is_in(tmp_path):
    broken = PENDULUM.read_text(encoding="utf-8").replace('type="revolute"', 'type="rubber"', 1)
    urdf = write(tmp_path / "arm.urdf", broken)
    with pytest.raises(ModelError, match=r"arm\.urdf, line 27: Joint 'shoulder' has unrecog"):
        load_model(urdf)
    top = "directives:\n- add_model: {name: arm, file: arm.urdf}\n"
    with pytest.raises(ModelError, match=r"arm\.urdf, line 27: Joint 'shoulder' has unrecog"):
        load_model(write(tmp_path / "top.dmd.yaml", top))
    write(tmp_path / "b.sdf", sdf("\n" + body("b", axis="0 0 many")))
    with pytest.raises(ModelError, match=r"b\.sdf, line 5: <xyz> has '0 0 many'"):
        load_model(write(tmp_path / "robot.sdf", including("b.sdf")))


def test_only_packages_that_are_named_are_looked_for(tmp_path, monkeypatch):
    near = package(tmp_path / "near", "near")
    package(tmp_path, "near")  # which is farther
    far = package(tmp_path / "path" / "deep" / "far", "far")
    package(far / "within", "within")
    package(tmp_path / "path" / ".hidden", "hidden")
    write(package(tmp_path / "path" / "marked" / "inner", "inner").parent / "COLCON_IGNORE", "")
    (tmp_path / "path" / "loop").symlink_to(tmp_path / "path")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{tmp_path / 'path'}:")
    names = named_packages("package://near/a.stl model://far/b package://far/c 'package://x y/z'")
    assert names == {"near", "far", "x y"}
    packages = PackageMap()
    add_packages(packages, near / "robot.urdf", {*names, "within", "hidden", "inner", "drake"})
    assert packages.GetPath("near") == str(near)
    assert packages.GetPath("far") == str(far)
    assert not any(packages.Contains(name) for name in ("x y", "within", "hidden", "inner"))


MODELS = Path(__file__).parents[2] / "models"


def swinging(name, axis="0 1 0", z=0.0):
    return (
        f'<link name="{name}"><pose>0 0 {z} 0 0 0</pose><inertial><pose>0 0 0.2 0 0 0</pose>'
        "<mass>1.5</mass><inertia><ixx>0.02</ixx><iyy>0.02</iyy><izz>0.01</izz></inertia>"
        "</inertial></link>"
    )


def arm(name, x, weld=True):
    """Return a model of two links, whose base is fixed to the world or free."""
    fixed = "<joint name='fix' type='fixed'><parent>world</parent><child>base</child></joint>"
    joints = "".join(
        f"<joint name='{joint}' type='revolute'><parent>{parent}</parent><child>{child}</child>"
        "<axis><xyz>0 1 0</xyz></axis></joint>"
        for joint, parent, child in (("shoulder", "base", "upper"), ("elbow", "upper", "lower"))
    )
    links = swinging("base") + swinging("upper", z=0.2) + swinging("lower", z=0.7)
    own = fixed if weld else ""
    return f"<model name='{name}'><pose>{x} 0 0 0 0 0</pose>{links}{own}{joints}</model>"


def world(*models):
    return f"<sdf version='1.9'><world name='w'>{''.join(models)}</world></sdf>"


class TestSeveralRobots:
    @pytest.fixture(params=[True, False], ids=["fixed", "free"])
    def path(self, request, tmp_path):
        text = world(arm("left", 1.0, request.param), arm("right", -1.0, request.param))
        return write(tmp_path / "two.sdf", text)

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

    def test_a_folder_above_is_a_package_by_its_name(self, robot, tmp_path):
        (tmp_path / "ws" / "parts" / "package.xml").unlink()
        inside = tmp_path / "ws" / "parts" / "urdf" / "arm.urdf.xacro"
        inside.parent.mkdir()
        assert load_model(robot.rename(inside)).phi[0, 0] == pytest.approx(2.0)

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
