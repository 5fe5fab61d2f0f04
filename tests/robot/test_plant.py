"""Robots in Drake's plants: read, repaired, lumped, and beside others."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from scenes import PENDULUM, plant_of, scene

from geodrake import load_model
from geodrake.effects import CoulombFriction, ViscousFriction
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import from_mass_com_inertia, inertial_parameters, is_physical
from geodrake.inertia.bodies import lumped_bodies
from geodrake.model import check_dynamics, save_export
from geodrake.model.robot_model import from_loaded_plant
from geodrake.robot import RobotInstance
from geodrake.robot.plant import effort_limits, joint_names, load_plant

GOOD = "ixx='0.1' iyy='0.1' izz='0.1' ixy='0' ixz='0' iyz='0'"


def urdf(inertial="", *, joint="", extra=""):
    """Return a base and one revolute joint about y, with an inertial element of the link `l1`."""
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
    """Return damping, rotor inertia and dry friction that a file states at a joint."""
    own = [length for length in loaded.terms.lengths if length.shares == {joint: 1.0}]
    return np.sum([(x.damping[0], x.armature, x.friction) for x in own], axis=0)


@pytest.fixture
def load(tmp_path, capfd):
    """Load a text under a file name, and check that nothing was printed."""

    def load_text(text, name="robot.urdf", **options):
        path = tmp_path / name
        path.write_text(text)
        try:
            return load_plant(path, **options)
        finally:
            assert capfd.readouterr() == ("", "")

    return load_text


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
    """Gravity on the base counts for efforts."""

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
