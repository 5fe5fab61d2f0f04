"""Joints that follow others, and motors that files state, against Pinocchio and MuJoCo."""

import mujoco
import numpy as np
import pytest
from coupled_arm import text as arm_text
from known_robots import assert_close
from mujoco_efforts import mujoco_efforts

from geodrake import load_model, save_model
from geodrake.errors import ModelError
from geodrake.excitation.regressor_gradient import (
    inverse_dynamics_regressor_gradient,
    reverse_recursion,
)
from geodrake.logs import JointLog, Motion
from geodrake.model import Given, holding
from geodrake.model.logged_joints import log_of_model
from geodrake.robot import KinematicTree, inverse_dynamics, inverse_dynamics_regressor, joint_names
from geodrake.robot.effort_slopes import effort_slopes

TRANSMISSION = """<transmission name="wrist"><type>transmission_interface/{kind}</type>
<actuator name="b"><role>actuator2</role><mechanicalReduction>{n2}</mechanicalReduction></actuator>
<actuator name="a"><role>actuator1</role><mechanicalReduction>40</mechanicalReduction></actuator>
<joint name="roll"><role>joint2</role><offset>0.5</offset></joint>
<joint name="pitch"><role>joint1</role><mechanicalReduction>2</mechanicalReduction></joint>
</transmission>"""
SIMPLE = """<transmission name="s"><type>transmission_interface/SimpleTransmission</type>
<joint name="shoulder"/><actuator name="s1"><mechanicalReduction>8</mechanicalReduction></actuator>
</transmission>"""
NEWER = """<ros2_control name="arm" type="system"><transmission name="s">
<plugin>transmission_interface/SimpleTransmission</plugin><actuator name="s1" role="actuator1"/>
<joint name="shoulder" role="joint1"><mechanical_reduction>8</mechanical_reduction>
<offset>0.2</offset></joint></transmission></ros2_control>"""


def loaded(tmp_path, text, name="robot.urdf", **options):
    path = tmp_path / name
    path.write_text(text)
    return load_model(path, **options)


def driven(tmp_path, extra, **options):
    return loaded(tmp_path, arm_text().replace("</robot>", extra + "</robot>"), **options)


@pytest.mark.parametrize("kind", ["DifferentialTransmission", "FourBarLinkageTransmission"])
def test_pairs_of_ros_control(kind, tmp_path):
    """As its actuatorToJointPosition has it, written out."""
    extra = SIMPLE + TRANSMISSION.format(kind=kind, n2=-50)
    model = driven(tmp_path, extra, transmission="file")
    assert model.joints == ("s1", "a", "b")
    q = np.random.default_rng(0).normal(size=(4, 3))
    s, a, b = q.T
    if kind == "DifferentialTransmission":
        pitch, roll = (a / 40 + b / -50) / (2 * 2.0), (a / 40 - b / -50) / (2 * 1.0) + 0.5
    else:
        pitch, roll = a / (2.0 * 40), (b / -50 - a / (2.0 * 40)) / 1.0 + 0.5
    assert_close(model.plant_positions(q), np.column_stack([s / 8, pitch, roll]))


def test_without_being_asked_logs_are_of_joints_and_a_note_says_so(tmp_path):
    model = driven(tmp_path, SIMPLE)
    assert model.joints == ("shoulder", "pitch", "roll")
    assert any("has transmissions of shoulder" in note for note in model.notes)
    direct = SIMPLE.replace("<mechanicalReduction>8</mechanicalReduction>", "")
    assert not any("motors" in note for note in driven(tmp_path, direct).notes)


@pytest.mark.parametrize(
    ("extra", "problem"),
    [
        (SIMPLE.replace("8", "0"), "has a reduction of 0"),
        (f"{SIMPLE[:-15]}<mechanicalReduction>0</mechanicalReduction>{SIMPLE[-15:]}", "of 0"),
        (SIMPLE.replace("8", "eight"), "has 'eight', which is not a number"),
        (SIMPLE.replace('"shoulder"', '"knee"'), "'knee', which is not an independent joint"),
        (SIMPLE.replace('<joint name="shoulder"/>', ""), "0 joints and 1 actuators instead of 1"),
        ("", "has no transmissions of motors"),
    ],
)
def test_transmissions_that_cannot_be_taken(extra, problem, tmp_path):
    driven(tmp_path, extra)  # where nobody asks for them, they do not matter
    with pytest.raises(ModelError, match=problem):
        driven(tmp_path, extra, transmission="file")


MJCF = """<mujoco model="m"><worldbody>
<body name="a"><joint name="j" type="hinge" axis="0 1 0"/>
<inertial pos="0.1 0 0.2" mass="2" diaginertia="0.1 0.2 0.15"/>
<body name="b" pos="0 0.1 0.5"><joint name="k" type="hinge" axis="0 1 0"/>
<inertial pos="0 0.1 0.2" mass="1.5" diaginertia="0.1 0.1 0.12"/></body></body>
<body name="c" pos="0 1 0"><joint name="s" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></worldbody>{}</mujoco>"""
TENDONS = """<tendon>
<fixed name="t1"><joint joint="j" coef="1"/><joint joint="k" coef="0.5"/></fixed>
<fixed name="t2"><joint joint="j" coef="1"/><joint joint="k" coef="-0.7"/></fixed></tendon>
<actuator><motor name="m1" tendon="t1" gear="2"/><motor name="m2" tendon="t2"/>
<motor name="m3" joint="s" gear="7"/></actuator>"""
BENT = '<equality><joint joint1="k" joint2="j" polycoef="0.1 1 0.4 -0.3 0.2"/></equality>'


def test_tendons_of_mujoco_are_coupled_motors(tmp_path):
    model = loaded(tmp_path, MJCF.format(TENDONS), "m.xml", transmission="file")
    assert set(model.joints) == {"m1", "m2", "m3"}
    theirs = mujoco.MjModel.from_xml_string(MJCF.format(TENDONS))
    data, rng = mujoco.MjData(theirs), np.random.default_rng(0)
    names = [theirs.actuator(k).name for k in range(3)]
    q, v, vd = rng.normal(size=(3, 4, 3))
    load, at = model.motion(Motion(q, v, vd)).load, [model.joints.index(n) for n in names]
    J = model.coordinates.constant
    for k in range(4):
        joints = dict(zip(joint_names(model.plant), model.plant_positions(q)[k], strict=True))
        rates = dict(zip(joint_names(model.plant), (v @ J.T)[k], strict=True))
        for joint, value in joints.items():
            data.joint(joint).qpos[:], data.joint(joint).qvel[:] = value, rates[joint]
        data.ctrl[:] = load[k, at]
        mujoco.mj_forward(theirs, data)
        np.testing.assert_allclose(data.actuator_length, q[k, at], atol=1e-12)
        expected = dict(zip(joint_names(model.plant), (vd @ J.T)[k], strict=True))
        for joint, value in expected.items():
            np.testing.assert_allclose(data.joint(joint).qacc, value, rtol=1e-8, atol=1e-8)


def test_joints_that_follow_polynomials_are_those_of_mujoco(tmp_path):
    """Forces of the constraint do no work along J(q), which changes with q."""
    model = loaded(tmp_path, MJCF.format(BENT), "m.xml")
    assert model.joints == ("j", "s")
    theirs = mujoco.MjModel.from_xml_string(MJCF.format(BENT))
    motion = np.random.default_rng(0).uniform(-0.8, 0.8, (3, 5, 2))
    x, w, a = motion[..., 0]
    y = 0.1 + x + 0.4 * x**2 - 0.3 * x**3 + 0.2 * x**4
    slope, bend = 1 + 0.8 * x - 0.9 * x**2 + 0.8 * x**3, 0.8 - 1.8 * x + 2.4 * x**2
    follower = np.stack([y, slope * w, slope * a + bend * w**2])[..., None]
    j, s, k = mujoco_efforts(theirs, "jsk", *np.concatenate([motion, follower], axis=-1)).T
    assert_close(model.motion(Motion(*motion)).load, np.stack([j + slope * k, s], axis=1))


def test_what_follows_a_follower_of_a_polynomial_follows_its_leader(tmp_path):
    """s = 0.05 − 0.7 k and k = p(j): both are of j, and the efforts of both are at it."""
    more = '<joint joint1="s" joint2="k" polycoef="0.05 -0.7 0 0 0"/></equality>'
    text = MJCF.format(BENT.replace("</equality>", more))
    model, theirs = loaded(tmp_path, text, "m.xml"), mujoco.MjModel.from_xml_string(text)
    assert model.joints == ("j",) and not model.left_out
    motion = np.random.default_rng(0).uniform(-0.8, 0.8, (3, 5, 1))
    x, w, a = motion[..., 0]
    y = 0.1 + x + 0.4 * x**2 - 0.3 * x**3 + 0.2 * x**4
    slope, bend = 1 + 0.8 * x - 0.9 * x**2 + 0.8 * x**3, 0.8 - 1.8 * x + 2.4 * x**2
    k = np.stack([y, slope * w, slope * a + bend * w**2])
    s = np.stack([0.05 - 0.7 * k[0], *(-0.7 * k[1:])])
    rows = np.stack([motion[..., 0], s, k], axis=-1)
    tau_j, tau_s, tau_k = mujoco_efforts(theirs, "jsk", *rows).T
    expected = tau_j + slope * (tau_k - 0.7 * tau_s)
    assert_close(model.motion(Motion(*motion)).load[:, 0], expected)


def test_motors_of_leaders_of_polynomials_move_followers_too(tmp_path):
    """With j = θ / 50 + 0.2, the effort is (τ_j + p′(j) τ_k) / 50, those of MuJoCo at joints."""
    gear = "gears: [{actuator: motor, joint: j, ratio: 50, offset: 0.2}]"
    (tmp_path / "m.transmission.yaml").write_text(gear)
    model, text = loaded(tmp_path, MJCF.format(BENT), "m.xml"), MJCF.format(BENT)
    assert model.joints == ("motor", "s")
    motion = np.random.default_rng(0).uniform(-0.8, 0.8, (3, 5, 2))
    x, w, a = motion[..., 0]
    y = 0.1 + x + 0.4 * x**2 - 0.3 * x**3 + 0.2 * x**4
    slope, bend = 1 + 0.8 * x - 0.9 * x**2 + 0.8 * x**3, 0.8 - 1.8 * x + 2.4 * x**2
    follower = np.stack([y, slope * w, slope * a + bend * w**2])[..., None]
    rows = np.concatenate([motion, follower], axis=-1)
    j, s, k = mujoco_efforts(mujoco.MjModel.from_xml_string(text), "jsk", *rows).T
    q, v, vd = motion * [50.0, 1.0]
    own = Motion(q - [10.0, 0.0], v, vd)
    assert_close(model.motion(own).load, np.stack([(j + slope * k) / 50, s], axis=1))
    assert_close(model.coordinates.nearest(model.plant_positions(own.q)), own.q)
    save_model(model, tmp_path / "saved.yaml")
    assert_close(load_model(tmp_path / "saved.yaml").effort(own), model.effort(own))
    held = load_model(tmp_path / "m.xml", lock={"motor": 0.0})
    assert_close(held.phi, holding(model, {"motor": 0.0}).phi)
    with pytest.raises(ModelError, match="'k' cannot be fixed, as it follows"):
        load_model(tmp_path / "m.xml", transmission="none", lock={"k": 0.1})


def test_logged_efforts_of_followers_of_polynomials_count_at_their_leaders(tmp_path):
    model, time = loaded(tmp_path, MJCF.format(BENT), "m.xml"), np.arange(0.0, 1.0, 0.01)
    values = 0.1 * np.random.default_rng(0).normal(size=(3, len(time))).cumsum(axis=1).T
    x = values[:, 0]
    values[:, 2] = 0.1 + x + 0.4 * x**2 - 0.3 * x**3 + 0.2 * x**4
    efforts = np.random.default_rng(1).normal(size=values.shape)
    log = log_of_model(JointLog("log", ("j", "s", "k"), time, values, efforts), model)
    slope = 1 + 0.8 * x - 0.9 * x**2 + 0.8 * x**3
    np.testing.assert_allclose(log.effort[:, 0], efforts[:, 0] + slope * efforts[:, 2])
    assert [note for note in log.notes if " k " in note] == [
        "the effort of k is added to that of j, which it follows"
    ]
    assert model.default_position("j") == 0.0


def test_motors_of_two_arms_have_the_arm_before_their_names(tmp_path):
    (tmp_path / "arm.urdf").write_text(arm_text().replace("</robot>", SIMPLE + "</robot>"))
    add = "- add_model: {{name: {}, file: 'file://{}/arm.urdf'}}\n".format
    both = f"directives:\n{add('left', tmp_path)}{add('right', tmp_path)}"
    model = loaded(tmp_path, both, "two.dmd.yaml", transmission="file")
    assert model.joints[::3] == ("left_s1", "right_s1")
    save_model(model, tmp_path / "saved.yaml")
    assert load_model(tmp_path / "saved.yaml").joints == model.joints
    one = driven(tmp_path, SIMPLE, transmission="file")
    motion = np.random.default_rng(0).uniform(-0.8, 0.8, (3, 5, 6))
    for k in range(2):
        own = slice(3 * k, 3 * k + 3)
        efforts = model.effort(Motion(*motion))[:, own]
        assert_close(efforts, one.effort(Motion(*motion[..., own])))
    left = load_model(tmp_path / "two.dmd.yaml", transmission="file", given=Given("left"))
    assert left.joints == one.joints


def test_the_newer_form_of_ros_control(tmp_path):
    model = driven(tmp_path, NEWER, transmission="file")
    assert_close(model.plant_positions(np.array([[4.0, 0.1, 0.2]])), [[0.7, 0.1, 0.2]])


INERTIA = 'ixx="0.02" iyy="0.03" izz="0.025" ixy="0.001" ixz="0.002" iyz="-0.001"'


def link(name, mass, com):
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
        f"<inertia {INERTIA}/></inertial></link>"
    )


def joint(name, parent, child, axis, extra="", kind="revolute"):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.1 0.2 -0.3" rpy="0.3 0.1 -0.2"/><axis xyz="{axis}"/>'
        f'<limit lower="-2" upper="2" effort="5" velocity="3"/>{extra}</joint>'
    )


def follow(leader, multiplier, offset=0.0):
    return f'<mimic joint="{leader}" multiplier="{multiplier}" offset="{offset}"/>'


def gripper(follows=True):
    """Return two arms, with a geared rotor beside one and a chain behind the other."""
    own = follow if follows else (lambda *_: "")
    damping = '<dynamics damping="0.3" friction="0.2"/>'
    return (
        '<robot name="gripper"><link name="base"/>'
        + link("a", 2.0, "0.1 0 0.2") + link("b", 1.0, "0 0.1 -0.2") + link("rotor", 0.5, "0 0 0")
        + link("c", 0.4, "0 0.02 0.1") + link("d", 0.7, "0.1 0 0.1")
        + link("finger", 0.3, "0 0 0.1")
        + joint("ja", "base", "a", "0 0 1", damping)
        + joint("jb", "a", "b", "0 1 0")
        + joint("spin", "base", "rotor", "1 0 0", damping + own("ja", 9.0))
        + joint("jc", "b", "c", "0 1 0", own("jb", -0.7, 0.4))
        + joint("jd", "c", "d", "1 0 0", own("jc", 0.5, 0.1))
        + joint("slide", "d", "finger", "0 0.6 0.8", own("jb", 0.2, 0.05), kind="prismatic")
        + "</robot>"
    )  # fmt: skip


def motion_of(count=8, width=2, seed=0):
    return Motion(*np.random.default_rng(seed).uniform(-1.2, 1.2, (3, count, width)))


def test_efforts_are_those_of_pinocchios_mimic_joints(tmp_path):
    pinocchio = pytest.importorskip("pinocchio")
    text = gripper()
    text = text.replace(follow("jc", 0.5, 0.1), follow("jb", -0.35, 0.3))  # no chains there
    model, whole = loaded(tmp_path, gripper()), pinocchio.buildModelFromXML(text, True)
    assert whole.nv == 2 and model.joints == ("ja", "jb")
    order = [whole.joints[whole.getJointId(name)].idx_v for name in model.joints]
    motion, data = motion_of(), whole.createData()
    rows = np.stack([motion.q, motion.v, motion.vd], axis=1)[:, :, np.argsort(order)]
    expected = np.array([pinocchio.rnea(whole, data, *row)[order] for row in rows])
    assert_close(model.motion(motion).load, expected)


def test_efforts_regressors_and_gradients_are_those_through_the_jacobian(tmp_path):
    model, apart = (
        loaded(tmp_path, gripper()),
        loaded(tmp_path, gripper(follows=False), "apart.urdf"),
    )
    motion, tree = motion_of(), KinematicTree.from_plant(apart.plant)
    phi, J = model.phi, model.coordinates.constant
    samples = model.plant_positions(motion.q), motion.v @ J.T, motion.vd @ J.T
    own = motion.q, motion.v, motion.vd
    Y = inverse_dynamics_regressor(model.tree, *own)
    expected = np.swapaxes(J[None], 1, 2) @ inverse_dynamics_regressor(tree, *samples)
    assert_close(Y, expected)
    assert_close(inverse_dynamics(model.tree, *own, phi), Y @ phi.ravel())
    ours, theirs = effort_slopes(model.tree, *own, phi), effort_slopes(tree, *samples, phi)
    for name in ("position", "velocity", "acceleration"):
        assert_close(getattr(ours, name), J.T @ getattr(theirs, name) @ J)
    weights = np.random.default_rng(1).normal(size=Y.shape)
    slopes = inverse_dynamics_regressor_gradient(model.tree, *own, weights)
    q, v, vd = samples
    others = reverse_recursion(tree, (q, v, v, vd), J[None] @ weights)
    for name in ("q", "v", "vd"):
        assert_close(getattr(slopes, name), getattr(others, name) @ J)


def test_damping_friction_and_limits_are_those_of_all_that_move_together(tmp_path):
    model = loaded(tmp_path, gripper())
    values = {(f.effect.name, f.effect.where): f.parameters[0] for f in model.effects}
    assert values == {
        ("viscous_friction", ("ja",)): pytest.approx(0.3 * (1 + 81)),
        ("coulomb_friction", ("ja",)): pytest.approx(0.2 * (1 + 9)),
    }
    np.testing.assert_allclose(model.velocity_limits, [3 / 9, 3.0])
    lower, upper = model.position_limits
    np.testing.assert_allclose(lower, [-2 / 9, -2.0])
    np.testing.assert_allclose(upper, [2 / 9, 2.0])
    assert model.sliding_joints == () and model.joint_pairs == (("ja", "jb"),)
    assert any("jd follows jb" in note for note in model.notes)


@pytest.mark.parametrize(
    "mimics",
    [
        {"spin": follow("jx", 1.0)},
        {"spin": follow("jb", "nan")},
        {"jc": follow("jd", 1.0), "jd": follow("jc", 1.0)},
    ],
)
def test_what_cannot_follow_moves_by_itself_and_a_note_says_so(mimics, tmp_path):
    text = gripper(follows=False)
    for name, mimic in mimics.items():
        opened = f'<joint name="{name}" type="revolute">'
        text = text.replace(opened, opened + mimic)
    model = loaded(tmp_path, text)
    assert len(model.joints) == 6
    assert any("<mimic> is ignored" in said and name in said for said in model.left_out)


def test_efforts_of_followers_are_added_to_their_leaders(tmp_path):
    model, time = loaded(tmp_path, gripper()), np.arange(0.0, 1.0, 0.01)
    names = ("ja", "jb", "spin", "slide")
    values = np.random.default_rng(0).normal(size=(4, len(time))).cumsum(axis=1).T
    log = log_of_model(JointLog("log", names, time, values, values), model)
    assert log.joints == ("ja", "jb")
    np.testing.assert_allclose(log.effort[:, 0], values[:, 0] + 9.0 * values[:, 2])
    np.testing.assert_allclose(log.effort[:, 1], values[:, 1] + 0.2 * values[:, 3])
    assert any("spin is added" in note for note in log.notes)
