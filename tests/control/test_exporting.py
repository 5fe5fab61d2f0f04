"""Models written to files and read back, by other engines and geodrake, and the export check."""

import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest
import yaml
from chain_logs import inverse_dynamics
from effect_motions import instances
from mujoco_efforts import mujoco_efforts
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant

from geodrake import load_model
from geodrake.control.export_proof import export_to
from geodrake.control.export_proof.engines import MujocoEngine
from geodrake.control.export_proof.export import prove
from geodrake.control.export_proof.formats import FORMATS, SIGN_WIDTH, export_format
from geodrake.control.export_proof.held import held_by
from geodrake.control.export_proof.reference import (
    compared,
    random_motion,
    random_starts,
    roll_out_all,
)
from geodrake.effects import (
    AsymmetricFriction,
    CoulombFriction,
    EffortDelay,
    EffortOffset,
    FittedEffect,
    GravityTilt,
    JointSpring,
    LoadDependentFriction,
    Payload,
    RotorInertia,
    StribeckFriction,
    ViscousFriction,
)
from geodrake.errors import ModelError
from geodrake.inertia import from_mass_com_inertia
from geodrake.logs import Motion
from geodrake.model import EffortSignal, holding, save_model
from geodrake.model.logged_joints import reading_for
from geodrake.robot import joint_names
from geodrake.robot.plant import load_plant

MODELS = Path(__file__).parents[2] / "models"

URDF = """<?xml version="1.0"?>
<!-- my arm -->
<robot name="arm">
  <link name="base"/>
  <link name="one"><!-- weighed -->
    <inertial><origin xyz="0 0.1 0.2"/><mass value="2"/>
      <inertia ixx="0.05" iyy="0.05" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="meshes/one.stl"/></geometry></visual>
  </link>
  <link name="two">
    <inertial><origin xyz="0 0 0.2"/><mass value="1"/>
      <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="pin"/>
  <joint name="aa" type="fixed"><parent link="one"/><child link="pin"/></joint>
  <joint name="a" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="10" velocity="2"/>
    <dynamics damping="0.5"/></joint>
  <joint name="b" type="prismatic"><parent link="one"/><child link="two"/><origin xyz="0 0 0.4"/>
    <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="10" velocity="2"/></joint>
  <transmission name="t"><type>transmission_interface/SimpleTransmission</type>
    <joint name="b"/><actuator name="m">
    <drake:gear_ratio xmlns:drake="http://drake.mit.edu" value="10"/></actuator></transmission>
</robot>
"""

SDF = """<sdf version="1.9"><model name="arm"><!-- my arm -->
  <link name="one"><inertial><pose>0 0.1 0.2 0 0 0</pose><mass>2</mass>
    <inertia><ixx>0.05</ixx><iyy>0.05</iyy><izz>0.03</izz></inertia></inertial>
    <visual name="v"><geometry><mesh><uri>meshes/one.stl</uri></mesh></geometry></visual></link>
  <link name="two"><pose relative_to="b"/><inertial><pose>0 0 0.2 0 0 0</pose><mass>1</mass>
    <inertia><ixx>0.02</ixx><iyy>0.02</iyy><izz>0.01</izz></inertia></inertial></link>
  <joint name="a" type="revolute"><parent>world</parent><child>one</child><axis><xyz>0 1 0</xyz>
    <dynamics><damping>0.5</damping><!-- oil --></dynamics></axis></joint>
  <joint name="b" type="prismatic"><pose relative_to="one">0 0 0.4 0 0 0</pose><parent>one</parent>
    <child>two</child><axis><xyz>1 0 0</xyz></axis></joint>
</model></sdf>
"""

MJCF = """<mujoco model="arm"><!-- my arm -->
  <compiler {angle}/>
  <default><joint frictionloss="0.9"/>
    <default class="soft"><joint damping="0.5"/></default></default>
  <worldbody>
    <body name="one"><joint name="a" class="soft" axis="0 1 0"/>
      <inertial pos="0 0.1 0.2" mass="2" diaginertia="0.05 0.05 0.03"/>
      <body pos="0 0 0.4"><frame><joint type="slide" axis="1 0 0"/></frame>
        <inertial pos="0 0 0.2" mass="1" diaginertia="0.02 0.02 0.01"/></body>
    </body>
  </worldbody>
</mujoco>
"""

FILES = {
    "urdf": ("arm.urdf", URDF),
    "sdf": ("arm.sdf", SDF),
    "mjcf": ("arm.xml", MJCF.format(angle="")),
    "radian": ("arm.xml", MJCF.format(angle='angle="radian"')),
}


def loaded(folder, kind):
    name, text = FILES[kind]
    (folder / "own").mkdir()
    path = folder / "own" / name
    path.write_text(text)
    return load_model(path)


def fitted(model, *, springs):
    """Return the model with friction, rotors, a payload, and other springs than the file's."""
    a, b = model.joints
    body = model.bodies[-1]
    effects = [
        FittedEffect(ViscousFriction(a), np.array([0.7])),
        FittedEffect(ViscousFriction(b), np.array([1.1])),
        FittedEffect(CoulombFriction(a), np.array([0.4])),
        FittedEffect(RotorInertia(a), np.array([0.06])),
        FittedEffect(RotorInertia(b), np.array([0.3])),
        FittedEffect(
            Payload(body), from_mass_com_inertia(0.8, np.array([0.1, 0, 0.3]), 0.01 * np.eye(3))
        ),
    ]
    if springs:
        effects += [
            FittedEffect(JointSpring(a, center=0.2), np.array([3.0, 0.6])),
            FittedEffect(JointSpring(b), np.array([5.0, 0.0])),
            FittedEffect(EffortOffset(b), np.array([0.25])),
        ]
    return replace(model, effects=tuple(effects))


def motion(model, count=60, seed=0):
    q, v, vd = np.random.default_rng(seed).normal(size=(3, count, len(model.joints)))
    return Motion(model.positions(q), v, vd)


def exported(model, to, folder, motions=()):
    """Return the first file in a folder, what the files lack, and the notes in one line."""
    form = export_format(to)
    held, lost = held_by(model, form.holding(model), motions)
    folder.mkdir(exist_ok=True)
    made = form.write(model, held, folder)
    for name, content in made.files.items():
        (folder / name).write_bytes(content)
    return folder / next(iter(made.files)), lost, " ".join(made.notes)


def drake_effort(path, moved):
    """Return inverse dynamics by Drake alone, with free roots welded."""
    plant = MultibodyPlant(time_step=0.0)
    parser = Parser(plant)
    parser.package_map().PopulateFromFolder(str(path.parent))
    parser.AddModels(str(path))
    if path.suffix == ".urdf":
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    return inverse_dynamics(plant, moved.q, moved.v, moved.vd)


def dry(model, moved):
    """Return efforts of dry friction alone."""
    effort = np.zeros_like(moved.v)
    for each in model.effects:
        if isinstance(each.effect, CoulombFriction):
            at = model.joints.index(each.effect.joint)
            effort[:, at] += each.parameters[0] * np.sign(moved.v[:, at])
    return effort


@pytest.mark.parametrize(
    ("kind", "to"), [("urdf", "urdf"), ("urdf", "drake"), ("sdf", "sdf"), ("sdf", "drake")]
)
def test_drake_computes_the_same_from_the_files(kind, to, tmp_path):
    model = fitted(loaded(tmp_path, kind), springs=kind == "sdf")
    if (kind, to) == ("urdf", "drake"):
        tilt = FittedEffect(GravityTilt(0.1, 0.05), np.array([0.1, 0.05]))
        model = replace(model, effects=(*model.effects, tilt))
        in_their_format = exported(model, kind, tmp_path / "plain")[1]
        assert [lost.effect for lost in in_their_format] == ["gravity_tilt"]
    path, lost, _ = exported(model, to, tmp_path / "out")
    assert lost == ()
    moved = motion(model)
    ours = model.effort(moved)
    np.testing.assert_allclose(drake_effort(path, moved), ours - dry(model, moved), atol=1e-10)
    again = load_model(path)  # every effect counts once
    np.testing.assert_allclose(again.effort(moved), ours, atol=1e-9)
    assert "<!-- my arm -->" in path.read_text() or to != kind


def drakes_spring(text):
    """Return a spring of Drake at joint a, as URDF or SDF."""
    stated = {"joint": ("name", "a"), "nominal_angle": ("value", "1"), "stiffness": ("value", "9")}
    inside = "".join(text.format(f"drake:revolute_spring_{k}", *x) for k, x in stated.items())
    return f"<drake:revolute_spring>{inside}</drake:revolute_spring>"


GAZEBO = """<gazebo reference="a"><springReference value="1"/><springStiffness>9</springStiffness>
</gazebo>"""
OF_DRAKE = drakes_spring('<{0} {1}="{2}"/>')


@pytest.mark.parametrize(
    ("kind", "springs"),
    [
        ("urdf", GAZEBO),
        ("urdf", OF_DRAKE),
        ("urdf", GAZEBO + OF_DRAKE),
        ("sdf", drakes_spring("<{0}>{2}</{0}>")),
    ],
)
def test_springs_of_extensions_are_those_of_the_model(tmp_path, kind, springs):
    name, text = FILES[kind]
    end = "</robot>" if kind == "urdf" else "</model>"
    FILES["sprung"] = name, text.replace(end, springs + end)
    model = fitted(loaded(tmp_path, "sprung"), springs=True)
    effects = [f for f in model.effects if getattr(f.effect, "joint", "") != "b"]
    model = replace(model, effects=tuple(effects))
    path, lost, _ = exported(model, kind, tmp_path / "out")
    assert lost == ()
    moved = motion(model)
    np.testing.assert_allclose(load_model(path).effort(moved), model.effort(moved), atol=1e-9)


def test_mujoco_computes_the_same_from_the_file(tmp_path):
    for kind in ("mjcf", "radian"):
        (tmp_path / kind).mkdir()
        model = fitted(loaded(tmp_path / kind, kind), springs=True)
        tilt = FittedEffect(GravityTilt(0.06, -0.03), np.array([0.06, -0.03]))
        model = replace(model, effects=(*model.effects, tilt))
        path, lost, _ = exported(model, "mjcf", tmp_path / kind / "out")
        assert lost == ()
        compiled = mujoco.MjModel.from_xml_path(str(path))
        assert compiled.dof_frictionloss == pytest.approx([0.4, 0.0])
        assert compiled.dof_damping.ravel()[:2] == pytest.approx([0.7, 1.1])
        assert compiled.dof_armature == pytest.approx([0.06, 0.3])
        moved = motion(model)
        found = mujoco_efforts(compiled, range(2), moved.q, moved.v, moved.vd)
        ours = model.effort(moved)
        np.testing.assert_allclose(found, ours - dry(model, moved), atol=1e-9)
        np.testing.assert_allclose(load_model(path).effort(moved), ours, atol=1e-9)


def test_a_robot_goes_through_all_formats_and_back(tmp_path):
    """Each export is read for the next one; the last has what every format can hold."""
    model = fitted(loaded(tmp_path, "urdf"), springs=False)
    moved = motion(model)
    ours = model.effort(moved)
    for to in ("sdf", "mjcf", "urdf", "mjcf", "sdf"):
        path, lost, _ = exported(model, to, tmp_path / f"{to}_of_{model.path.suffix[1:]}")
        assert lost == ()
        model = load_model(path)
        assert model.joints == ("a", "b")
        np.testing.assert_allclose(model.effort(moved), ours, atol=1e-9)


def test_joints_that_follow_others_follow_them_in_all_formats(tmp_path):
    mimic = '<mimic joint="b" multiplier="-0.5" offset="0.1"/>'
    third = """<link name="three"><inertial><origin xyz="0.1 0 0.2"/><mass value="0.7"/>
      <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="c" type="revolute"><parent link="one"/><child link="three"/><axis xyz="1 0 0"/>
      <limit lower="-3" upper="3" effort="10" velocity="2"/><dynamics damping="0.4"/>"""
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.replace("</robot>", f"{third}{mimic}</joint></robot>"), encoding="utf-8")
    first = model = load_model(path)
    moved = motion(first)
    for to in ("sdf", "mjcf", "urdf"):
        path, *_ = exported(model, to, tmp_path / to)
        model = load_model(path)
        assert [f.coefficients for f in model.followers.values()] == [(0.1, -0.5)]
        np.testing.assert_allclose(model.effort(moved), first.effort(moved), atol=1e-9)
        theirs = first.effort(moved)
        if to == "mjcf":
            theirs = followed_in_mujoco(path, model, moved)
        np.testing.assert_allclose(theirs, model.effort(moved), rtol=1e-6, atol=1e-8)
        plant = MultibodyPlant(time_step=0.001)
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
        if to != "mjcf":
            Parser(plant).AddModels(str(path))
            assert plant.num_constraints() == 1


@pytest.mark.parametrize("to", ["urdf", "sdf", "mjcf", "drake", "isaac", "python", "cpp", "ros2"])
def test_joints_that_follow_by_a_ratio_that_changes_are_refused(to, tmp_path):
    inertia = '<inertial pos="0 0 .1" mass="1" diaginertia=".1 .1 .1"/>'
    body = f'<body name="one"><joint name="a"/>{inertia}<body name="two"><joint name="b"/>{inertia}'
    tie = '<equality><joint joint1="b" joint2="a" polycoef="0 1 .3 0 0"/></equality>'
    (tmp_path / "bent.xml").write_text(
        f"<mujoco><worldbody>{body}</body></body></worldbody>{tie}</mujoco>"
    )
    model = load_model(tmp_path / "bent.xml")
    assert model.joints == ("a",)
    with pytest.raises(ModelError, match="cannot express that b follows another joint by a ratio"):
        export_to(to, model, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_point_masses_get_a_volume_for_mujoco(tmp_path):
    inertia = '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'
    bob = f'<inertial><origin xyz="0 0 -1"/><mass value="2"/>{inertia}</inertial>'
    hinge = '<joint name="a" type="continuous"><parent link="base"/><child link="bob"/>'
    (tmp_path / "bob.urdf").write_text(
        f'<robot name="r"><link name="base"/><link name="bob">{bob}</link>'
        f'{hinge}<axis xyz="0 1 0"/></joint></robot>'
    )
    proven = export_to("mjcf", load_model(tmp_path / "bob.urdf"), tmp_path / "out")
    (body,) = load_model(tmp_path / "out" / "bob.xml").phi
    np.testing.assert_allclose(body[:4], [2.0, 0.0, 0.0, -2.0], atol=1e-9)
    assert any("exports use 2 kg" in note for note in proven.notes)


ODD = """<mujoco model="r"><option gravity="1 2 -3"/><worldbody>
<body name="a"><joint name="a" axis="0 1 0" springdamper=".5 .8"/><geom size=".1" pos=".3 0 0"/>
<body name="b" pos=".5 0 0"><joint name="b"/><geom size=".1" pos="0 .2 0"/></body></body>
</worldbody><actuator>
<pid joint="a" kp="1" input="pos vel" velrange="-1 1"/><motor joint="b" ctrlrange="-3 3"/>
</actuator></mujoco>"""


@pytest.mark.parametrize("to", ["mjcf", "sdf", "urdf"])
def test_gravity_and_springs_of_a_time_constant_are_those_of_the_model(to, tmp_path):
    text = ODD
    if not hasattr(mujoco.MjModel, "actuator_ctrladr"):  # several signals are of MuJoCo 4
        text = "".join(line for line in ODD.splitlines() if "<pid" not in line)
    (tmp_path / "odd.xml").write_text(text)
    model = load_model(tmp_path / "odd.xml")
    assert model.effort_limits[1] == 3.0
    damping = [f for f in model.effects if f.effect.name == "viscous_friction"]
    changed = replace(model, effects=tuple(damping))
    proven = export_to(to, changed, tmp_path / "out")
    assert all(each.is_rounding for each in proven.proof.differences)
    told = any("set it to 1 2 -3 m/s² in the simulator" in note for note in proven.notes)
    assert told is (to != "mjcf")


def followed_in_mujoco(path, model, moved):
    """Return efforts (N, n) at the leaders, along whose motion the equalities do no work."""
    theirs, J = mujoco.MjModel.from_xml_path(str(path)), model.coordinates.constant
    assert theirs.neq == 1
    whole = model.plant_positions(moved.q), moved.v @ J.T, moved.vd @ J.T
    return mujoco_efforts(theirs, joint_names(model.plant), *whole) @ J


def test_several_files_become_one(tmp_path):
    model = load_model(MODELS / "cheetah.dmd.yaml")
    path, *_ = exported(model, "mjcf", tmp_path / "mjcf")
    compiled = mujoco.MjModel.from_xml_path(str(path))
    assert compiled.nv == len(model.joints)
    again, moved = load_model(path), motion(model)
    order = [again.joints.index(joint) for joint in model.joints]
    back = np.argsort(order)
    other = Motion(moved.q[:, back], moved.v[:, back], moved.vd[:, back])
    np.testing.assert_allclose(again.effort(other)[:, order], model.effort(moved), atol=1e-9)


def test_pinocchio_reads_the_inertias_damping_and_friction(tmp_path):
    model = fitted(loaded(tmp_path, "urdf"), springs=False)
    path, *_ = exported(model, "urdf", tmp_path / "out")
    read = pinocchio.buildModelFromUrdf(str(path))
    assert read.damping == pytest.approx([0.7, 1.1])
    for name in ("damping", "friction", "lowerDryFrictionLimit", "upperDryFrictionLimit"):
        if hasattr(read, name):
            getattr(read, name)[:] = 0.0
    data, moved = read.createData(), motion(model)
    found = [
        pinocchio.rnea(read, data, *each) for each in zip(moved.q, moved.v, moved.vd, strict=True)
    ]
    bodies = replace(model, effects=tuple(f for f in model.effects if f.effect.name == "payload"))
    np.testing.assert_allclose(found, bodies.effort(moved), atol=1e-10)


@pytest.mark.parametrize("kind", FILES)
def test_nothing_else_in_the_file_changes(kind, tmp_path):
    model = loaded(tmp_path, kind)
    to = "mjcf" if kind == "radian" else kind
    path, *_ = exported(model, to, tmp_path / "own" / ".." / "own2")  # as it is, on the same level
    there = path.read_text()
    assert ("../own/meshes/one.stl" in there) == (kind in ("urdf", "sdf"))
    assert re.sub(r"\.\./own/", "", there) == model.path.read_text()


@pytest.mark.parametrize(
    ("kind", "values"), [(LoadDependentFriction, [0.1]), (AsymmetricFriction, [0.3, 0.5, 0.1, 0.2])]
)
def test_what_a_format_lacks_is_fitted_into_what_it_holds(kind, values, tmp_path):
    model = loaded(tmp_path, "urdf")
    extra = FittedEffect(kind("a"), np.array(values))
    whole = replace(model, effects=(*model.effects, extra))
    moved = motion(whole, 400)
    held, (lost,) = held_by(whole, FORMATS["urdf"].holding(whole), [moved])
    assert (lost.effect, lost.where) == (extra.effect.name, ("a",))
    assert lost.into == ("viscous_friction", "coulomb_friction")

    def error(other):
        return np.sum((other.effort(moved) - whole.effort(moved)) ** 2)

    assert error(held) < 0.4 * error(model)
    # No other damping and dry friction of the joint is nearer.
    for k, each in enumerate(held.effects):
        for factor in (0.95, 1.05):
            effects = [*held.effects]
            effects[k] = FittedEffect(each.effect, factor * each.parameters)
            assert error(replace(held, effects=tuple(effects))) > error(held)


def test_isaac_has_a_value_for_everything_that_it_would_read_elsewhere(tmp_path):
    model = fitted(loaded(tmp_path, "urdf"), springs=False)
    more = [
        FittedEffect(EffortDelay(0.012), np.zeros(0)),
        FittedEffect(StribeckFriction("a", 0.3), np.array([0.2])),
    ]
    servo = EffortSignal("b", "command", 30.0, damping=2.0, delay=0.02, limit=8.0, deviation=1.0)
    model = replace(model, effects=(*model.effects, *more), effort_signals=(servo,))
    exported(model, "isaac", tmp_path / "out", [motion(model)])
    joints = json.loads((tmp_path / "out" / "arm.actuators.json").read_text())["joints"]
    assert joints["b"] == {
        "effort_limit": 8.0,
        "velocity_limit": 2.0,
        "stiffness": 30.0,
        "damping": 2.0,
        "armature": pytest.approx(0.3),
        "friction": 0.0,
        "dynamic_friction": 0.0,
        "viscous_friction": pytest.approx(1.1),
        "delay": 0.02,
        "effort_delay": 0.012,
    }
    a = joints["a"]
    assert (a["effort_limit"], a["stiffness"], a["effort_delay"]) == (10.0, 0.0, 0.012)
    assert a["friction"] == pytest.approx(a["dynamic_friction"] + 0.2)


def test_joints_of_included_files_are_refused(tmp_path):
    (tmp_path / "own").mkdir()
    inner = MJCF.format(angle="")
    body = inner[inner.index("<body name") : inner.index("  </worldbody>")]
    (tmp_path / "own" / "inner.xml").write_text(f"<mujoco>{body}</mujoco>")
    path = tmp_path / "own" / "arm.xml"
    path.write_text(inner.replace(body, '<include file="inner.xml"/>'))
    model = load_model(path)
    with pytest.raises(ModelError, match=r"includes .*inner"):
        exported(fitted(model, springs=False), "mjcf", tmp_path / "out")


def test_a_joint_that_moves_no_inertia_is_named():
    model = load_model(MODELS / "double_pendulum.urdf")
    phi = model.phi.copy()
    phi[-1] = 0.0
    starts = random_starts(model, random_motion(model))
    with pytest.raises(RuntimeError, match="the bodies moved by elbow have no inertia"):
        roll_out_all(replace(model, phi=phi), starts, 1e-3)


# Motors, servos and delays, as MuJoCo reads and simulates them

INERTIAL = """<inertial><origin xyz="0 0 0.2"/><mass value="1"/>
  <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>"""
HINGES = f"""<robot name="arm"><link name="base"/>
  <link name="one">{INERTIAL}</link><link name="two">{INERTIAL}</link>
  <joint name="a" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="10" velocity="2"/></joint>
  <joint name="b" type="revolute"><parent link="one"/><child link="two"/><axis xyz="0 1 0"/>
    <origin xyz="0 0 0.4"/><limit lower="-3" upper="3" effort="50" velocity="2"/></joint>
</robot>"""
BARE = """<mujoco model="arm"><!-- my arm -->
  {before}
  <worldbody>
    <body name="one"><joint name="a" axis="0 1 0"/>
      <inertial pos="0 0 0.2" mass="1" diaginertia="0.02 0.02 0.01"/>
      <body pos="0 0 0.4"><joint axis="0 1 0"/>
        <inertial pos="0 0 0.2" mass="1" diaginertia="0.02 0.02 0.01"/></body>
    </body>
  </worldbody>
  {after}<!-- the end -->
</mujoco>
"""
DELAY = 0.0137


def hinged(folder, before="", after="", *, text=None):
    (folder / "own").mkdir(exist_ok=True)
    path = folder / "own" / ("arm.xml" if text is None else "arm.urdf")
    path.write_text(BARE.format(before=before, after=after) if text is None else text)
    return load_model(path)


def servoed(model, delay=DELAY, effects=()):
    """Return the model with a servo at its second joint."""
    signal = EffortSignal(
        model.joints[1], "command", 30.0, damping=2.0, delay=delay, limit=20.0, deviation=1.0
    )
    return replace(model, effort_signals=(signal,), effects=(*model.effects, *effects))


def delayed(seconds, joint=None):
    return FittedEffect(EffortDelay(seconds, joint), np.zeros(0))


def names(compiled):
    return [compiled.actuator(k).name for k in range(compiled.nu)]


def test_a_robot_written_anew_has_a_motor_or_a_servo_at_every_joint(tmp_path):
    model = servoed(hinged(tmp_path, text=HINGES))
    path, _, notes = exported(model, "mjcf", tmp_path / "out")
    compiled = mujoco.MjModel.from_xml_path(str(path))
    assert names(compiled) == ["a", "b"]
    assert compiled.actuator_trnid[:, 0].tolist() == [0, 1]
    assert compiled.actuator_gainprm[:, 0].tolist() == [1.0, 30.0]
    np.testing.assert_array_equal(compiled.actuator_biasprm[:, :3], [[0, 0, 0], [0, -30, -2]])
    np.testing.assert_array_equal(compiled.actuator_forcerange, [[-10, 10], [-20, 20]])
    np.testing.assert_array_equal(compiled.actuator_ctrlrange[0], [-10, 10])
    assert compiled.actuator_forcelimited.tolist() == [1, 1]
    assert compiled.actuator_ctrllimited.tolist() == [1, 0]
    assert compiled.actuator_delay.tolist() == [0.0, DELAY]
    assert compiled.actuator_history[1].tolist() == [15, 1]
    assert "(kv / kp) dc/dt" in notes
    again = load_model(path)
    assert again.joints == model.joints
    np.testing.assert_array_equal(again.effort_limits, [10.0, 20.0])
    assert exported(again, "mjcf", tmp_path / "again")[0].read_bytes() == path.read_bytes()


def test_limits_that_logs_told_are_in_new_files_and_noted_beside_the_users(tmp_path):
    model = hinged(tmp_path, text=HINGES)
    assert "effort limits" not in exported(model, "urdf", tmp_path / "plain")[2]
    model = replace(model, effort_signals=(EffortSignal("b", "effort", 1.0, limit=7.0),))
    path, _, notes = exported(model, "urdf", tmp_path / "own_format")
    np.testing.assert_array_equal(load_model(path).effort_limits, [10.0, 50.0])
    assert "effort limits in arm.urdf are unchanged; the model knows lower ones: b 7 N·m" in notes
    for form in ("sdf", "mjcf"):
        path, _, notes = exported(model, form, tmp_path / form)
        np.testing.assert_array_equal(load_model(path).effort_limits, [10.0, 7.0])
        assert "effort limits" not in notes
    notes = " ".join(export_to("sdf", servoed(model), tmp_path / "servos").notes)
    assert "sdf has no servo gains, such as those of b" in notes


def test_a_file_of_the_users_gets_actuators_for_servos_and_delays_alone(tmp_path):
    model = hinged(tmp_path)
    assert exported(model, "mjcf", tmp_path / "plain")[0].read_text() == BARE.format(
        before="", after=""
    )
    path, *_ = exported(servoed(model), "mjcf", tmp_path / "out")
    text, own = path.read_text(), BARE.format(before="", after="")
    head = own[: own.index("</mujoco>")].rstrip()
    named = head.replace('<joint axis="0 1 0"/>', '<joint axis="0 1 0" name="body_1_joint_0"/>')
    assert text.startswith(f"{named}\n  <actuator>\n    <motor")
    assert text.endswith("  </actuator>\n</mujoco>\n")
    compiled = mujoco.MjModel.from_xml_path(str(path))
    assert names(compiled) == ["a", "body_1_joint_0"]
    late = replace(model, effects=(delayed(-0.02, "a"),))
    compiled = mujoco.MjModel.from_xml_path(str(exported(late, "mjcf", tmp_path / "late")[0]))
    assert compiled.actuator_delay.tolist() == [0.02, 0.0]


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("", '<actuator><motor name="mine" joint="body_1_joint_0" gear="3"/></actuator>'),
        ("", '<actuator><general name="mine" jointinparent="body_1_joint_0"/></actuator>'),
        (
            '<tendon><fixed name="t"><joint joint="body_1_joint_0" coef="2"/></fixed></tendon>',
            '<actuator><position name="mine" tendon="t" kp="7"/></actuator>',
        ),
    ],
)
def test_actuators_of_the_users_stay(before, after, tmp_path):
    model = hinged(tmp_path, before, after)
    path = model.path
    path.write_text(path.read_text().replace("<joint axis", '<joint name="body_1_joint_0" axis'))
    model = servoed(load_model(path))
    out, _, notes = exported(model, "mjcf", tmp_path / "out")
    assert out.read_text() == path.read_text()
    assert 'body_1_joint_0: kp="30.0" kv="2.0" delay="0.0137" nsample="15"' in notes
    more = replace(model, effects=(delayed(-0.01, "a"),))
    out, _, notes = exported(more, "mjcf", tmp_path / "more")
    compiled = mujoco.MjModel.from_xml_path(str(out))
    assert names(compiled) == ["mine", "a"]  # control signals of the first keep their place
    assert compiled.actuator_delay.tolist() == [0.0, 0.01]
    assert "are unchanged" in notes


def test_defaults_of_actuators_would_change_what_is_added(tmp_path):
    before = '<default><position timeconst="0.1"/></default>'
    model = servoed(hinged(tmp_path, before))
    path, _, notes = exported(model, "mjcf", tmp_path / "out")
    assert path.read_text() == BARE.format(before=before, after="")
    assert "defaults of actuators" in notes
    classes = '<default><default class="mine"><motor gear="3"/></default></default>'
    path, *_ = exported(servoed(hinged(tmp_path, classes)), "mjcf", tmp_path / "classes")
    assert mujoco.MjModel.from_xml_path(str(path)).nu == 2


def test_delays_shorter_than_a_step_are_said(tmp_path):
    model = hinged(tmp_path, '<option timestep="0.004"/>')
    *_, notes = exported(servoed(model, delay=0.003), "mjcf", tmp_path / "out")
    assert "step of 0.004 s is longer than the delay of body_1_joint_0" in notes
    *_, notes = exported(servoed(model, delay=0.004), "mjcf", tmp_path / "long")
    assert "is longer than" not in notes
    fine = hinged(tmp_path, '<option timestep="0.0005"/>')
    path, _, notes = exported(servoed(fine, delay=0.003), "mjcf", tmp_path / "fine")
    assert mujoco.MjModel.from_xml_path(str(path)).actuator_history[1][0] == 7
    assert "time steps of 0.0005 s and more" in notes
    odd = servoed(hinged(tmp_path, '<option timestep="-1"/>'), delay=0.0015)
    assert "step of 0.002 s is longer" in exported(odd, "mjcf", tmp_path / "odd")[2]  # MuJoCo's own
    with pytest.raises(ModelError, match="line 2: bad format in attribute 'timestep'"):
        hinged(tmp_path, '<option timestep="fast"/>')


def test_efforts_that_are_measured_late_are_so_by_a_sensor(tmp_path):
    model = replace(hinged(tmp_path), effects=(delayed(0.0065, "a"),))
    path, _, notes = exported(model, "mjcf", tmp_path / "out")
    compiled = mujoco.MjModel.from_xml_path(str(path))
    assert compiled.nu == 0 and compiled.sensor(0).name == "a_effort"
    assert "a_effort" in notes or "<joint>_effort" in notes
    model = replace(hinged(tmp_path, text=HINGES), effects=(delayed(0.0065, "a"),))
    path, *_ = exported(model, "mjcf", tmp_path / "anew")
    compiled = mujoco.MjModel.from_xml_path(str(path))
    compiled.opt.timestep = 1e-3
    data = mujoco.MjData(compiled)
    for k in range(30):
        data.ctrl[0] = 0.1 * k
        mujoco.mj_step(compiled, data)
    assert data.sensor("a_effort").data[0] == pytest.approx(0.1 * (29 - 6.5))


def test_the_proof_tells_efforts_and_commands_to_actuators(tmp_path):
    for k, model in enumerate((hinged(tmp_path, text=HINGES), hinged(tmp_path))):
        acting = servoed(model, effects=(delayed(-0.0223, "a"),))
        proven = export_to("mjcf", acting, tmp_path / f"out{k}")
        assert proven.lacks == ()
        effort, position = proven.proof.differences
        assert effort.is_rounding and position.is_rounding and position.typical > 0.01


@pytest.mark.parametrize(
    ("old", "new"), [('kp="30.0"', 'kp="30.3"'), ('delay="0.02"', 'delay="0.025"')]
)
def test_the_proof_sees_wrong_actuators(old, new, tmp_path):
    model = servoed(hinged(tmp_path, text=HINGES), effects=(delayed(-0.02, "a"),))
    path, *_ = exported(model, "mjcf", tmp_path / "out")
    motion = random_motion(model)
    arguments = [MujocoEngine], compared([motion]), random_starts(model, motion)
    assert prove(model, path, *arguments).differences[1].is_rounding
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    assert not prove(model, path, *arguments).differences[1].is_rounding


def test_a_joint_that_had_no_motor_in_logs_gets_none(tmp_path):
    """The saved model says so for further logs, and no file gives the joint a motor."""
    model = replace(hinged(tmp_path, text=HINGES), motorless=("a",), effects=(delayed(-0.02),))
    save_model(model, tmp_path / "model.yaml")
    model = load_model(tmp_path / "model.yaml")
    assert model.motorless == ("a",) == tuple(reading_for(model).motorless)
    assert holding(model, {"a": 0.1}).motorless == ()
    compiled = mujoco.MjModel.from_xml_path(str(exported(model, "mjcf", tmp_path / "mjcf")[0]))
    assert names(compiled) == ["b"] and compiled.jnt_actfrclimited.tolist() == [0, 1]
    plant = load_plant(exported(model, "sdf", tmp_path / "sdf")[0]).plant
    actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
    assert [each.joint().name() for each in actuators] == ["b"]
    exported(model, "isaac", tmp_path / "isaac")
    joints = json.loads((tmp_path / "isaac" / "arm.actuators.json").read_text())["joints"]
    assert [(joints[j]["effort_limit"], joints[j]["delay"]) for j in "ab"] == [(0, 0), (50, 0.02)]
    assert "a had no motor in logs" in exported(model, "urdf", tmp_path / "urdf")[2]
    proven = export_to("mjcf", replace(model, effects=()), tmp_path / "proven")
    assert all(each.is_rounding for each in proven.proof.differences)
    text = (tmp_path / "model.yaml").read_text().replace("motorless: [a]", "motorless: [c]")
    (tmp_path / "model.yaml").write_text(text)
    with pytest.raises(ModelError, match="motorless has 'c', which the robot does not have"):
        load_model(tmp_path / "model.yaml")


def test_a_joint_that_dry_friction_holds_does_not_creep(tmp_path):
    """With MuJoCo's defaults, joints creep under a load that friction holds."""
    friction = [FittedEffect(CoulombFriction(joint), np.array([4.0])) for joint in "ab"]
    model = replace(hinged(tmp_path, text=HINGES), effects=tuple(friction))
    engine = mujoco.MjModel.from_xml_path(str(exported(model, "mjcf", tmp_path / "out")[0]))
    data = mujoco.MjData(engine)
    data.qpos[:] = 0.5, -0.2  # gravity pulls with 3 and 0.6 N·m
    while data.time < 5.0:
        mujoco.mj_step(engine, data)
    np.testing.assert_allclose(data.qpos, [0.5, -0.2], atol=2e-3)


CHAINS = """<mujoco><worldbody><body name="one"><joint name="shoulder" axis="0 1 0"/>
  <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
  <body name="two"><joint name="elbow" axis="0 1 0"/>
    <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body></worldbody></mujoco>"""
MODEL = Path(__file__).parents[2] / "models" / "double_pendulum.urdf"

CHAIN = """<robot name="chain"><link name="base"/>{links}</robot>"""
LINK = """<link name="{0}"><inertial><origin xyz="0 0.02 0.2"/><mass value="2"/>
  <inertia ixx="0.05" iyy="0.05" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{1}" type="revolute"><parent link="{2}"/><child link="{0}"/><axis xyz="{3}"/>
  <origin xyz="0 0 0.4"/><limit lower="-2" upper="2" effort="90" velocity="1.5"/></joint>"""


@pytest.fixture
def chain(tmp_path):
    """Return a robot with the joints and the hand that the instances of effects name."""
    names = ("arm", "shoulder", "base", "0 1 0"), ("forearm", "elbow", "arm", "1 0 0")
    links = "".join(LINK.format(*n) for n in (*names, ("hand", "wrist", "forearm", "0 0 1")))
    path = tmp_path / "chain.urdf"
    path.write_text(CHAIN.format(links=links))
    return load_model(path)


def with_value(effect):
    values = np.full(len(effect.parameters), 0.1)
    if effect.name == "payload":
        values = from_mass_com_inertia(0.5, np.array([0.1, 0, 0]), 0.01 * np.eye(3))
    return FittedEffect(effect, values)


def test_every_effect_is_held_or_named(chain):
    held = {"viscous_friction", "coulomb_friction", "rotor_inertia", "payload"}
    late, tilted = {"effort_delay"}, {"gravity_tilt"}
    more = {"urdf": set(), "sdf": set(), "isaac": late, "mjcf": late | tilted, "drake": tilted}
    assert FORMATS.keys() - more.keys() == {"python", "cpp", "ros2"}  # which have all of them
    motion = random_motion(chain)[:300]
    for effect in instances():
        model = replace(chain, effects=(with_value(effect),))
        for name, others in more.items():
            _, found = held_by(model, FORMATS[name].holding(model), [motion])
            assert {lost.effect for lost in found} == {effect.name} - held - others


def test_all_effects_at_once(chain, tmp_path):
    model = replace(chain, effects=tuple(map(with_value, instances())))
    found = export_to("mjcf", model, tmp_path / "out")
    assert len(found.lacks) > 15
    assert len(found.proof.differences) == 2
    assert all(difference.is_rounding for difference in found.proof.differences)


def test_what_mujoco_warns_of_is_no_file(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "two.xml"
    file.write_text(CHAINS, encoding="utf-8")
    engine = MujocoEngine(file, load_model(MODEL))
    engine.roll_out(np.zeros(2), np.zeros(2), np.full((3, 2), 1e30), 1e-3)
    (said,) = engine.messages
    assert "The simulation is unstable" in said
    assert [path.name for path in tmp_path.iterdir()] == ["two.xml"]
    assert capfd.readouterr().err == ""


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
    """Check the syntax with empty packages of ROS."""
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
