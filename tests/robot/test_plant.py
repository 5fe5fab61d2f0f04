"""Robots in Drake's plants: read, repaired, lumped, and beside others."""

from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteSpring
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from scenes import PENDULUM, plant_of, scene

from geodrake import load_model
from geodrake.effects import CoulombFriction, ViscousFriction
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import (
    from_mass_com_inertia,
    inertial_parameters,
    is_physical,
    to_mass_com_inertia,
)
from geodrake.inertia.bodies import lumped_bodies
from geodrake.logs.motion import Motion
from geodrake.model import check_dynamics, save_export
from geodrake.model.robot_model import from_loaded_plant
from geodrake.robot import RobotInstance
from geodrake.robot.plant import effort_limits, joint_names, load_plant, set_inertial_parameters
from geodrake.robot.robot_instance import add_generalized_force
from geodrake.robot.stated import Spring

MODELS = Path(__file__).parents[2] / "models"
GOOD = "ixx='0.1' iyy='0.1' izz='0.1' ixy='0' ixz='0' iyz='0'"


def urdf(inertial="", *, joint="", extra=""):
    """Base, one revolute joint about y, one link `l1` with the given inertial element."""
    return f"""<robot name="r"><link name="base"/><link name="l1">{inertial}</link>
    <joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="2" effort="10" velocity="3"/>{joint}</joint>{extra}</robot>"""


def inertial(mass=1.0, inertia=GOOD, xyz="0 0 0.1"):
    return (
        f"""<inertial><origin xyz="{xyz}"/><mass value="{mass}"/><inertia {inertia}/></inertial>"""
    )


def tensor(xx, yy, zz, xy=0.0):
    return f"ixx='{xx}' iyy='{yy}' izz='{zz}' ixy='{xy}' ixz='0' iyz='0'"


def stated(loaded, joint):
    """Damping, rotor inertia and dry friction that a file states at a joint."""
    own = [length for length in loaded.terms.lengths if length.shares == {joint: 1.0}]
    return np.sum([(x.damping[0], x.armature, x.friction) for x in own], axis=0)


@pytest.fixture
def load(tmp_path, capfd):
    """Loads a text under a file name and checks that nothing was printed."""

    def load_text(text, name="robot.urdf", **options):
        path = tmp_path / name
        path.write_text(text)
        try:
            return load_plant(path, **options)
        finally:
            assert capfd.readouterr() == ("", "")

    return load_text


@pytest.mark.parametrize("name", ["double_pendulum", "arm6", "arm7"])
def test_own_models_are_physical_and_limited(name, capfd):
    loaded = load_plant(MODELS / f"{name}.urdf")
    plant = loaded.plant
    assert loaded.repairs == () and loaded.notes == ()
    assert capfd.readouterr() == ("", "")
    assert is_physical(inertial_parameters(plant), tolerance=1e-4).all()
    assert (effort_limits(plant) > 0).all()
    assert np.isfinite([*plant.GetPositionUpperLimits(), *plant.GetVelocityUpperLimits()]).all()


def test_urdf_ignores_geometry_mimic_and_transmissions(load):
    mesh = """<visual><geometry><mesh filename="package://none/a.dae"/></geometry></visual>
    <collision><geometry><mesh filename="missing.stl"/></geometry></collision>"""
    extra = """<transmission name="t"><joint name="absent"/><type>SimpleTransmission</type>
    </transmission>"""
    loaded = load(urdf(mesh + inertial(), joint="<mimic joint='absent'/>", extra=extra))
    assert loaded.plant.num_velocities() == 1
    assert any("mimic" in said and "j1" in said for said in loaded.left_out)


def test_urdf_reads_limits_damping_and_friction(load):
    loaded = load(urdf(inertial(), joint="<dynamics damping='0.5' friction='0.3'/>"))
    model = from_loaded_plant(loaded, floating=False)
    assert model.effort_limits == pytest.approx([10.0])
    assert model.velocity_limits == pytest.approx([3.0])
    assert np.ravel(model.position_limits) == pytest.approx([-1.0, 2.0])
    assert loaded.plant.GetJointByName("j1").default_damping() == 0.0
    stated = {f.effect: f.parameters.tolist() for f in model.effects}
    assert stated == {ViscousFriction("j1"): [0.5], CoulombFriction("j1"): [0.3]}
    assert any("viscous_friction" in note and "j1 0.5" in note for note in model.notes)
    assert any("coulomb_friction" in note for note in model.notes)
    endless = urdf(inertial()).replace('lower="-1" upper="2"', 'lower="-inf" upper="inf"')
    endless = from_loaded_plant(load(endless), floating=False)
    assert np.ravel(endless.position_limits).tolist() == [-np.inf, np.inf]


@pytest.mark.parametrize("effort", [10, 0])
def test_rotor_inertia_is_read_out_and_removed(load, effort):
    extra = """<transmission><type>SimpleTransmission</type><joint name="j1"/><actuator name="a">
    <x:rotor_inertia value="0.001"/><x:gear_ratio value="10"/></actuator></transmission>"""
    text = urdf(inertial(), extra=extra).replace("<robot", "<robot xmlns:x='http://drake.mit.edu'")
    text = text.replace('effort="10"', f'effort="{effort}"')
    loaded = load(text)
    assert stated(loaded, "r::j1") == pytest.approx([0.0, 0.1, 0.0])
    mass = loaded.plant.CalcMassMatrix(loaded.plant.CreateDefaultContext())
    assert mass[0, 0] == pytest.approx(0.1 + 0.1**2)


@pytest.mark.parametrize("floating", [False, True])
def test_floating_joints_of_a_urdf_have_their_links_where_they_say(load, floating):
    above = """<link name="world"/><link name="plate"/><joint name="p" type="fixed">
    <parent link="world"/><child link="plate"/><origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/>
    </joint><joint name="f" type="floating"><parent link="plate"/><child link="base"/>
    <origin xyz="2 0 0.5" rpy="0.4 0 0"/></joint>"""
    text = urdf(inertial(), extra=above).replace(
        '<link name="base"/>', f'<link name="base">{inertial()}</link>'
    )
    loaded = load(text, floating=floating)
    plant = loaded.plant
    X_WB = plant.EvalBodyPoseInWorld(plant.CreateDefaultContext(), plant.GetBodyByName("base"))
    np.testing.assert_allclose(X_WB.translation(), [1.0, 2.0, 0.5], atol=1e-12)
    turn = RollPitchYaw(X_WB.rotation()).vector()
    np.testing.assert_allclose(turn, [0.4, 0.0, np.pi / 2], atol=1e-12)
    check = check_dynamics(from_loaded_plant(loaded, floating=floating))
    assert "Pinocchio" in check.by and check.second is not None and check.holds


def test_each_velocity_of_a_planar_joint_has_its_damping(load):
    text = urdf(inertial()).replace(
        '<joint name="j1" type="revolute">', '<drake:joint type="planar" name="j1">'
    )
    text = text.replace("<robot", '<robot xmlns:drake="http://drake.mit.edu"')
    text = text.replace("</joint>", '<dynamics damping="1 2 3"/></drake:joint>')
    model = from_loaded_plant(load(text), floating=False)
    found = [(f.effect.where, *f.parameters) for f in model.effects]
    assert found == [(("j1_vx",), 1.0), (("j1_vy",), 2.0), (("j1_wz",), 3.0)]


SDF = """<sdf version="1.7"><model name="m"><link name="l1"><inertial>
<pose>0 0 0.1 0 0 1.5707963267948966</pose><mass>{mass}</mass>
<inertia><ixx>{ixx}</ixx><iyy>0.2</iyy><izz>0.2</izz></inertia></inertial>
<visual name="v"><geometry><mesh><uri>package://none/a.stl</uri></mesh></geometry></visual>
<collision name="c"><geometry><mesh><uri>model://none/a.stl</uri></mesh></geometry></collision></link>
<joint name="j1" type="revolute"><parent>world</parent><child>l1</child><axis><xyz>0 1 0</xyz>
<limit><effort>7</effort></limit><dynamics><damping>0.2</damping><friction>0.3</friction>
<spring_stiffness>3</spring_stiffness></dynamics></axis></joint></model></sdf>"""


def test_sdf(load):
    loaded = load(SDF.format(mass=1.0, ixx=0.1), "m.sdf")
    assert loaded.repairs == ()
    assert stated(loaded, "m::j1") == pytest.approx([0.2, 0.0, 0.3])
    assert effort_limits(loaded.plant) == pytest.approx([7.0])
    springs = [x.spring for x in loaded.terms.lengths if any(x.spring.coefficients)]
    assert springs == [Spring.linear(3.0)]
    assert loaded.plant.num_force_elements() == 1


def test_sdf_inertia_is_repaired_in_the_frame_of_the_link(load):
    loaded = load(SDF.format(mass=2.0, ixx=0.5), "m.world")
    (repair,) = loaded.repairs
    # The pose turns by a right angle about z: ixx of the file is Iyy of the link.
    com, inertia = np.array([0.0, 0.0, 0.1]), np.diag([0.2, 0.5, 0.2])
    np.testing.assert_allclose(repair.before, from_mass_com_inertia(2.0, com, inertia), atol=1e-12)
    np.testing.assert_allclose(inertial_parameters(loaded.plant)[0], repair.after, rtol=1e-9)


def test_an_sdf_states_damping_and_friction_of_a_universal_joint_at_each_axis(load):
    text = SDF.format(mass=1.0, ixx=0.1).replace('type="revolute"', 'type="universal"')
    own = "<dynamics><damping>3</damping><friction>4</friction></dynamics>"
    text = text.replace("0 1 0", "1 0 0").replace(
        "</axis>", f"</axis><axis2><xyz>0 1 0</xyz>{own}</axis2>"
    )
    model = from_loaded_plant(load(text, "m.sdf"), floating=False)
    places = [f.effect.where for f in model.effects if f.effect.name == "coulomb_friction"]
    assert places == [("j1_wx",), ("j1_wy",)]
    second = [f for f in model.effects if f.effect.where == ("j1_wy",)]
    assert [f.parameters.tolist() for f in second] == [[3.0], [4.0]]
    (said,) = model.left_out
    assert (
        "<spring_stiffness>" in said
        and np.isfinite(model.effort(Motion(*np.ones((3, 1, 2))))).all()
    )


def test_links_of_an_sdf_weigh_nothing_where_a_welded_one_has_their_inertia(load):
    text = SDF.format(mass=1.0, ixx=0.1).replace("<ixx>0.1</ixx>", "<ixx>0.4</ixx>")  # a thin link
    tool = """<link name="tool"><inertial><mass>0.5</mass><inertia><ixx>0.1</ixx><iyy>0.1</iyy>
    <izz>0.1</izz></inertia></inertial></link><joint name="weld" type="fixed"><parent>l1</parent>
    <child>tool</child></joint></model>"""
    loaded = load(text.replace("</model>", tool), "m.sdf")
    assert loaded.repairs == ()
    assert inertial_parameters(loaded.plant)[0, [0, 5]] == pytest.approx([1.5, 0.4 + 0.1 + 0.01])


MJCF = """<mujoco model="m"><compiler meshdir="absent"/><asset><mesh name="x" file="x.stl"/>
<mesh file="y.obj"/></asset>
<default><joint damping="0.3" armature="0.2"/><default class="stiff"><joint frictionloss="2"/>
</default></default><worldbody>
<body name="a" pos="0 0 1"><joint name="h" type="hinge" axis="0 1 0" class="stiff"/>
  <geom type="mesh" mesh="x"/><inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>
  <body name="b"><joint name="s" type="slide" axis="0 0 1" frictionloss="0.5"/>
    <joint name="s2" type="slide" axis="1 0 0"/>
    <geom type="mesh" mesh="y"/>
    <body><joint name="q" type="ball"/><geom type="sphere" size="0.1" mass="1"/></body>
  </body></body>
<body name="f" pos="1 2 3"><freejoint/><geom type="box" size=".1 .1 .1" mass="3"/></body>
</worldbody><actuator><motor name="m" joint="h" gear="100" ctrlrange="-1 1"/></actuator></mujoco>"""


DUMMIES = """<robot name="cart"><link name="map"/><link name="dx"/><link name="dy"/>
<link name="base"><inertial><origin xyz=".05 0 .2"/><mass value="20"/>
<inertia ixx=".3" iyy=".4" izz=".5" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="x" type="prismatic"><parent link="map"/><child link="dx"/>{limit}</joint>
<joint name="y" type="prismatic"><parent link="dx"/><child link="dy"/><axis xyz="0 1 0"/>
{limit}</joint>
<joint name="yaw" type="continuous"><parent link="dy"/><child link="base"/>{origin}
<axis xyz="0 0 1"/></joint></robot>"""
LIMIT = '<limit lower="-5" upper="5" effort="99" velocity="5"/>'


def test_frames_between_joints_of_a_mobile_base_weigh_nothing(load):
    loaded = load(DUMMIES.format(limit=LIMIT, origin=""), "m.urdf")
    assert not loaded.changes and any("weigh nothing: dx, dy" in note for note in loaded.notes)
    model = load_model(loaded.path)
    check = check_dynamics(model, samples=5)
    assert check.holds and check.second is not None and check.second.relative < 1e-11
    copy = loaded.path.with_name("copy.urdf")
    save_export(model, copy)
    assert copy.read_bytes() == loaded.path.read_bytes()
    apart = DUMMIES.format(limit=LIMIT, origin='<origin xyz="0.1 0 0"/>')
    assert [repair.body for repair in load(apart, "m.urdf").repairs] == ["dx", "dy"]
    seen = DUMMIES.replace('"dx"/>', '"dx"><visual/></link>', 1).format(limit=LIMIT, origin="")
    assert [repair.body for repair in load(seen, "m.urdf").repairs] == ["dx"]


def test_mjcf(load):
    loaded = load(MJCF, "m.xml")
    plant = loaded.plant
    assert joint_names(plant) == ("h", "s", "s2", "q_wx", "q_wy", "q_wz")
    for name, friction in {"h": 2.0, "s": 0.5, "s2": 0.0, "q": 0.0}.items():
        assert stated(loaded, f"m::{name}") == pytest.approx([0.3, 0.2, friction])
    assert effort_limits(plant)[0] == pytest.approx(100.0)
    assert any("meshes" in note and "b" in note for note in loaded.changes)
    # The body without mass gets a thousandth of the robot's; that between two joints has none.
    assert [repair.body for repair in loaded.repairs] == ["b"]
    assert inertial_parameters(plant)[:, 0].sum() == pytest.approx(3.0 * 1.001)
    X_WF = plant.EvalBodyPoseInWorld(plant.CreateDefaultContext(), plant.GetBodyByName("f"))
    np.testing.assert_allclose(X_WF.translation(), [1, 2, 3])


def test_mjcf_floating(load):
    names = joint_names(load(MJCF, "m.xml", floating=True).plant)
    assert names[-6:] == ("f_x", "f_y", "f_z", "f_yaw", "f_pitch", "f_roll") and len(names) == 12


def test_directives_with_two_instances(load, tmp_path):
    (tmp_path / "arm.urdf").write_text(urdf(inertial(2.0, tensor(1, 1, 5))))
    text = """directives:
- add_model: {name: left, file: arm.urdf}
- add_model: {name: right, file: "FILE"}
- add_weld: {parent: world, child: "left::base"}
""".replace("FILE", (tmp_path / "arm.urdf").as_uri())
    loaded = load(text, "two.dmd.yaml")
    assert joint_names(loaded.plant) == ("left_j1", "right_j1")
    assert [repair.body for repair in loaded.repairs] == ["left::l1", "right::l1"]
    assert is_physical(inertial_parameters(loaded.plant), tolerance=1e-6).all()


def test_world_link_stays_the_world(load):
    loaded = load(urdf(inertial()).replace('"base"', '"world"'), floating=True)
    assert loaded.plant.num_velocities() == 1
    assert any("cannot float" in note for note in loaded.notes)


def test_a_joint_that_points_to_the_base_is_read_outwards(load):
    text = """<sdf version="1.7"><model name="m"><link name="tip"/><link name="root"/>
    <link name="pad"/>
    <joint name="a" type="revolute"><parent>tip</parent><child>root</child><axis><xyz>0 0 1</xyz>
    </axis></joint><joint name="b" type="revolute"><parent>world</parent><child>root</child><axis>
    <xyz>0 0 1</xyz></axis></joint><joint name="w" type="fixed"><parent>pad</parent>
    <child>tip</child></joint></model></sdf>"""
    bodies = lumped_bodies(load(text, "m.sdf").plant)
    assert {b.name: {m.name for m in b.members} for b in bodies} == {
        "root": {"root"},
        "tip": {"tip", "pad"},
    }


@pytest.mark.parametrize(
    ("mass", "inertia", "words"),
    [
        (1.0, tensor(1, 1, 5), "exceeds the sum"),
        (1.0, tensor(1, 1, 1, 2), "negative"),
        (1.0, tensor("nan", 1, 1), "not a number"),
        (-1.0, GOOD, "mass of -1 kg"),
        ("abc", GOOD, "not a number"),
        (0.0, tensor(0, 0, 0), "mass of 0 kg"),
    ],
)
def test_impossible_inertia_is_repaired_and_named(load, mass, inertia, words):
    loaded = load(urdf(inertial(mass, inertia)))
    (repair,) = loaded.repairs
    assert repair.body == "l1"
    assert words in repair.problem and str(repair).startswith("l1 has")
    assert repair.before.shape == repair.after.shape == (10,)
    phi = inertial_parameters(loaded.plant)[0]
    np.testing.assert_allclose(phi, repair.after, rtol=1e-9, atol=1e-15)
    assert is_physical(phi, tolerance=1e-6)
    if mass == 1.0 and words != "not a number":
        np.testing.assert_allclose(phi[:4], [1, 0, 0, 0.1], atol=1e-12)


@pytest.mark.parametrize(
    ("inertia", "words"),
    [(tensor(0, 0, 0), "no rotational inertia"), (tensor(1, 1, 2), "no thickness")],
)
def test_a_body_without_volume_stays_and_fits_start_beside_it(load, inertia, words):
    loaded = load(urdf(inertial(1.0, inertia, "0.1 0 0")))
    (thin,) = loaded.thin
    assert not loaded.repairs and words in thin.problem
    assert any(words in note and "exports use 1 kg" in note for note in loaded.notes)
    np.testing.assert_array_equal(inertial_parameters(loaded.plant)[0], thin.before)
    assert is_physical(thin.after, tolerance=1e-6) and not is_physical(thin.before)


def test_a_point_mass_on_its_axis_is_no_body_that_moves(load):
    loaded = load(urdf(inertial(1.0, tensor(0, 0, 0), "0 0 0")))
    assert not loaded.thin and "no rotational inertia" in loaded.repairs[0].problem


def test_repair_changes_only_what_is_too_small(load):
    (repair,) = load(urdf(inertial(1.0, tensor(1, 1, 5)))).repairs
    _, _, before = to_mass_com_inertia(repair.before)
    _, _, after = to_mass_com_inertia(repair.after)
    # Second moments about the axes: 2.5, 2.5 and -1.5 before; the last alone is raised, to 1e-4.
    np.testing.assert_allclose(before, np.diag([1, 1, 5]), atol=1e-12)
    np.testing.assert_allclose(after, np.diag([2.5001, 2.5001, 5]), atol=1e-12)


def test_impossible_member_of_a_possible_body_is_no_problem(load):
    def fixed(name, inertial_text):
        return f"""<link name="{name}">{inertial_text}</link><joint name="to_{name}" type="fixed">
        <parent link="l1"/><child link="{name}"/><origin xyz="0 0 0.2" rpy="0.5 0 0"/></joint>"""

    point_mass = fixed("point", inertial(0.5, tensor(0, 0, 0), "0 0 0"))
    dummy = fixed("dummy", inertial(0.0, GOOD))
    loaded = load(urdf(inertial(), extra=point_mass + dummy + fixed("tool0", "")))
    assert loaded.repairs == ()
    assert any("dummy" in note for note in loaded.changes)
    (body,) = lumped_bodies(loaded.plant)
    assert [member.name for member in body.members] == ["l1", "point", "dummy", "tool0"]
    expected = from_mass_com_inertia(1.0, [0, 0, 0.1], 0.1 * np.eye(3)) + from_mass_com_inertia(
        0.5, [0, 0, 0.2], np.zeros((3, 3))
    )
    np.testing.assert_allclose(inertial_parameters(loaded.plant)[0], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("r.urdf", "<html><body/></html>", "root element is <html>"),
        ("r.urdf", "", "is empty"),
        ("r.yaml", "a: b\n", "Drake cannot read"),
        ("r.yaml", "directives: []\n", "do not add a model"),
        ("r.yaml", "directives:\n- add_model: {name: a, file: absent.urdf}\n", "absent.urdf"),
        ("r.urdf", "<robot name='r'/>", "no links"),
        ("r.urdf", urdf().replace('child link="l1"', 'child link="l2"'), "l2"),
        ("r.sdf", "<sdf version='1.7'/>", "Drake cannot read"),
        ("r.sdf", "<sdf><model name='r'><link name='l'/></model></sdf>", "1: <sdf> has no version"),
    ],
)
def test_not_a_robot(load, name, text, words):
    with pytest.raises(ModelError, match=words) as error:
        load(text, name)
    assert name in str(error.value) and error.value.advice
    assert "\n" not in str(error.value) or "XML" in str(error.value)


def test_written_parameters_are_read_back():
    plant = load_plant(MODELS / "arm6.urdf").plant
    context = plant.CreateDefaultContext()
    phi = np.random.default_rng(2).normal(size=(6, 10)) + 3.0
    set_inertial_parameters(plant, context, phi)
    np.testing.assert_allclose(inertial_parameters(plant, context), phi, rtol=1e-9)
    with pytest.raises(ArgumentError, match=r"phi must be \(6, 10\)"):
        set_inertial_parameters(plant, context, phi[:-1])
    with pytest.raises(ArgumentError, match="finite"):
        set_inertial_parameters(plant, context, phi * np.nan)


def test_several_roots_are_each_welded(load):
    loaded = load(urdf(inertial(), extra=f'<link name="ball">{inertial()}</link>'))
    assert loaded.plant.num_velocities() == 1
    assert any("ball" in note for note in loaded.notes)


JOINTS = ("shoulder", "elbow")


@pytest.mark.parametrize(
    ("joints", "actuated"), [(JOINTS, ()), (JOINTS[::-1], JOINTS), (JOINTS, JOINTS[::-1])]
)
def test_ports_have_the_joints_in_the_order_asked_for(joints, actuated):
    """State, acceleration and efforts against the plant's own, joint by joint."""
    builder = DiagramBuilder()
    plant = scene(builder, time_step=0.0, actuated=actuated)
    arm = plant.GetModelInstanceByName("arm")
    ports = RobotInstance(plant, "arm").ports(builder, joints)
    efforts = np.array([1.5, -0.7])
    source = builder.AddSystem(ConstantVectorSource(efforts))
    builder.Connect(source.get_output_port(), ports.effort)
    root = builder.Build().CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    of_joints = [plant.GetJointByName(joint, arm) for joint in joints]
    for k, joint in enumerate(of_joints):
        joint.set_angle(context, 0.3 + k)
        joint.set_angular_rate(context, -1.0 - k)
    at = [joint.velocity_start() for joint in of_joints]

    def value(port):
        return port.Eval(port.get_system().GetMyContextFromRoot(root))

    np.testing.assert_allclose(value(ports.state), [0.3, 1.3, -1.0, -2.0])
    applied = np.zeros(plant.num_velocities())
    applied[at] = efforts
    M = plant.CalcMassMatrix(context)
    rest = plant.CalcGravityGeneralizedForces(context) - plant.CalcBiasTerm(context)
    expected = np.linalg.solve(M, applied + rest)
    np.testing.assert_allclose(value(ports.acceleration), expected[at], rtol=1e-9)
    whole = plant.get_generalized_acceleration_output_port()
    np.testing.assert_allclose(value(whole), expected, rtol=1e-9, atol=1e-9)


def test_a_state_is_set_and_nothing_else_moves():
    plant = plant_of()
    context = plant.CreateDefaultContext()
    before = plant.GetPositionsAndVelocities(context)
    robot = RobotInstance(plant, "arm")
    robot.set_state(context, JOINTS[::-1], [0.1, 0.2, 0.3, 0.4])
    changed = np.flatnonzero(plant.GetPositionsAndVelocities(context) != before)
    q = robot.positions(JOINTS)
    v = plant.num_positions() + robot.velocities
    assert set(changed) == {*q, *v}
    np.testing.assert_allclose(plant.GetPositions(context)[q], [0.2, 0.1])


def test_forces_on_a_plant_add_up_however_many_come():
    builder = DiagramBuilder()
    plant = scene(builder)
    rng = np.random.default_rng(0)
    forces = rng.normal(size=(3, plant.num_velocities()))
    for force in forces:
        source = builder.AddSystem(ConstantVectorSource(force))
        add_generalized_force(builder, plant, source.get_output_port())
    root = builder.Build().CreateDefaultContext()
    port = plant.get_applied_generalized_force_input_port()
    found = port.Eval(plant.GetMyContextFromRoot(root))
    np.testing.assert_allclose(found, forces.sum(0), atol=1e-14)


def test_forces_that_are_an_input_of_the_diagram_stay_so():
    builder = DiagramBuilder()
    plant = scene(builder)
    builder.ExportInput(plant.get_applied_generalized_force_input_port(), "force")
    with pytest.raises(ArgumentError, match="before ExportInput"):
        RobotInstance(plant, "arm").ports(builder, JOINTS)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hand", "no model instance 'hand'. It has table, other, crate, arm"),
        ("table", "Model instance 'table' has no moving joint"),
    ],
)
def test_what_is_no_robot_is_refused(name, message):
    with pytest.raises(ArgumentError, match=message):
        RobotInstance(plant_of(), name)


@pytest.mark.parametrize(("name", "found"), [("arm", True), ("other", False), (None, True)])
def test_springs_at_joints_of_the_robot_are_its_own(name, found):
    plant = plant_of(finalize=False)
    arm = plant.GetModelInstanceByName("arm")
    plant.AddForceElement(RevoluteSpring(plant.GetJointByName("elbow", arm), 0.1, 3.0))
    plant.Finalize()
    joint = "elbow" if name else "arm_elbow"
    assert RobotInstance(plant, name).springs == ([(joint, 3.0, 0.1)] if found else [])


@pytest.mark.parametrize(
    ("name", "joints", "actuated", "message"),
    [
        ("arm", ("shoulder", "wrist"), (), "moves shoulder, elbow, but the controller"),
        (None, JOINTS, (), "RobotInstance"),
        ("crate", ("crate",), (), "but the controller crate"),
        ("arm", JOINTS, ("elbow",), "none at shoulder"),
    ],
)
def test_robots_that_do_not_fit_are_refused(name, joints, actuated, message):
    builder = DiagramBuilder()
    plant = scene(builder, actuated=actuated)
    with pytest.raises(ArgumentError, match=message):
        RobotInstance(plant, name).ports(builder, joints)


def test_a_floating_body_is_no_robot_with_joints_of_one_degree():
    robot = RobotInstance(plant_of(), "crate")
    with pytest.raises(ArgumentError, match="has 6 degrees of freedom"):
        robot.positions()


class TestBase:
    """Gravity on the base is what matters to efforts."""

    model = load_model(PENDULUM)

    def check(self, plant, **options):
        RobotInstance(plant, "arm").check_base(self.model.tree, self.model.joints, **options)

    def test_it_may_stand_anywhere_and_be_turned(self):
        turned = RigidTransform(RotationMatrix.MakeZRotation(0.7), [0.2, 0.1, 1.0])
        self.check(plant_of(X_TB=turned))
        with pytest.raises(ArgumentError, match="another orientation"):
            self.check(plant_of(X_TB=turned), turned=True)
        self.check(plant_of(X_TB=RigidTransform([1.0, 0.0, 0.0])), turned=True)

    @pytest.mark.parametrize("angle", [0.01, np.pi])
    def test_it_must_not_lean(self, angle):
        leaning = RigidTransform(RotationMatrix.MakeXRotation(angle), [0.0, 0.0, 1.0])
        with pytest.raises(ArgumentError, match=r"another inclination .* directives"):
            self.check(plant_of(X_TB=leaning))

    def test_gravity_must_be_the_same(self):
        plant = plant_of(finalize=False)
        plant.set_gravity_enabled(plant.GetModelInstanceByName("arm"), False)
        plant.Finalize()
        with pytest.raises(ArgumentError, match=r"\[-?0.0, -?0.0, -?0.0\] m/s² in the plant"):
            self.check(plant)

    def test_it_must_not_move(self):
        plant = MultibodyPlant(0.0)
        (below,) = Parser(plant).AddModels(str(PENDULUM))
        (above,) = Parser(plant, "above").AddModels(str(PENDULUM))
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link", below))
        tip = plant.get_body(plant.GetBodyIndices(below)[-1])
        plant.WeldFrames(tip.body_frame(), plant.GetFrameByName("base_link", above))
        plant.Finalize()
        name = plant.GetModelInstanceName(above)
        with pytest.raises(ArgumentError, match=r"base of .* moves"):
            RobotInstance(plant, name).check_base(self.model.tree, self.model.joints)
