"""What model files state of motors: ros_control's formulas, MuJoCo's tendons and polynomials."""

import mujoco
import numpy as np
import pytest
from coupled_arm import text
from known_robots import assert_close
from mujoco_efforts import mujoco_efforts

from geodrake import load_model, save_model
from geodrake.errors import ModelError
from geodrake.logs import Motion
from geodrake.model import holding

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


def loaded(tmp_path, extra, name="robot.urdf", whole=None, **options):
    path = tmp_path / name
    path.write_text(whole or text().replace("</robot>", extra + "</robot>"))
    return load_model(path, **options)


@pytest.mark.parametrize("kind", ["DifferentialTransmission", "FourBarLinkageTransmission"])
def test_pairs_of_ros_control(kind, tmp_path):
    """As its actuatorToJointPosition has it, written out."""
    extra = SIMPLE + TRANSMISSION.format(kind=kind, n2=-50)
    model = loaded(tmp_path, extra, transmission="file")
    assert model.joints == ("s1", "a", "b")
    q = np.random.default_rng(0).normal(size=(4, 3))
    s, a, b = q.T
    if kind == "DifferentialTransmission":
        pitch, roll = (a / 40 + b / -50) / (2 * 2.0), (a / 40 - b / -50) / (2 * 1.0) + 0.5
    else:
        pitch, roll = a / (2.0 * 40), (b / -50 - a / (2.0 * 40)) / 1.0 + 0.5
    assert_close(model.plant_positions(q), np.column_stack([s / 8, pitch, roll]))


def test_without_being_asked_logs_are_of_joints_and_a_note_says_so(tmp_path):
    model = loaded(tmp_path, SIMPLE)
    assert model.joints == ("shoulder", "pitch", "roll")
    assert any("states how motors move shoulder" in note for note in model.notes)
    direct = SIMPLE.replace("<mechanicalReduction>8</mechanicalReduction>", "")
    assert not any("motors" in note for note in loaded(tmp_path, direct).notes)


@pytest.mark.parametrize(
    ("extra", "problem"),
    [
        (SIMPLE.replace("8", "0"), "has a reduction of 0"),
        (SIMPLE.replace("8", "eight"), "has 'eight', which is no number"),
        (SIMPLE.replace('"shoulder"', '"knee"'), "'knee', which the robot does not have"),
        (SIMPLE.replace('<joint name="shoulder"/>', ""), "0 joints and 1 actuators instead of 1"),
        ("", "states no transmissions of motors"),
    ],
)
def test_transmissions_that_cannot_be_taken(extra, problem, tmp_path):
    loaded(tmp_path, extra)  # where nobody asks for them, they do not matter
    with pytest.raises(ModelError, match=problem):
        loaded(tmp_path, extra, transmission="file")


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
    model = loaded(tmp_path, "", "m.xml", MJCF.format(TENDONS), transmission="file")
    assert set(model.joints) == {"m1", "m2", "m3"}
    theirs = mujoco.MjModel.from_xml_string(MJCF.format(TENDONS))
    data, rng = mujoco.MjData(theirs), np.random.default_rng(0)
    names = [theirs.actuator(k).name for k in range(3)]
    q, v, vd = rng.normal(size=(3, 4, 3))
    load, at = model.motion(Motion(q, v, vd)).load, [model.joints.index(n) for n in names]
    for k in range(4):
        joints = dict(zip(model.tree_joints, model.plant_positions(q)[k], strict=True))
        rates = dict(zip(model.tree_joints, model.plant_velocities(q, v)[k], strict=True))
        for joint, value in joints.items():
            data.joint(joint).qpos[:], data.joint(joint).qvel[:] = value, rates[joint]
        data.ctrl[:] = load[k, at]
        mujoco.mj_forward(theirs, data)
        np.testing.assert_allclose(data.actuator_length, q[k, at], atol=1e-12)
        expected = dict(zip(model.tree_joints, model.plant_velocities(q, vd)[k], strict=True))
        for joint, value in expected.items():
            np.testing.assert_allclose(data.joint(joint).qacc, value, rtol=1e-8, atol=1e-8)


def test_joints_that_follow_polynomials_are_those_of_mujoco(tmp_path):
    """Forces of the constraint do no work along J(q), which changes with q."""
    model = loaded(tmp_path, "", "m.xml", MJCF.format(BENT))
    assert model.joints == ("j", "s")
    theirs = mujoco.MjModel.from_xml_string(MJCF.format(BENT))
    motion = np.random.default_rng(0).uniform(-0.8, 0.8, (3, 5, 2))
    x, w, a = motion[..., 0]
    y = 0.1 + x + 0.4 * x**2 - 0.3 * x**3 + 0.2 * x**4
    slope, bend = 1 + 0.8 * x - 0.9 * x**2 + 0.8 * x**3, 0.8 - 1.8 * x + 2.4 * x**2
    follower = np.stack([y, slope * w, slope * a + bend * w**2])[..., None]
    j, s, k = mujoco_efforts(theirs, "jsk", *np.concatenate([motion, follower], axis=-1)).T
    assert_close(model.motion(Motion(*motion)).load, np.stack([j + slope * k, s], axis=1))


def test_a_leader_of_a_polynomial_holds_its_follower(tmp_path):
    model = loaded(tmp_path, "", "m.xml", MJCF.format(BENT))
    held = load_model(tmp_path / "m.xml", lock={"j": 0.1})
    assert held.joints == ("s",)
    place = 0.1 + 0.1 + 0.4 * 0.01 - 0.3 * 1e-3 + 0.2e-4
    assert held.held == pytest.approx({"j": 0.1, "k": place})
    assert_close(held.phi, holding(model, {"j": 0.1}).phi)
    save_model(model, tmp_path / "saved.yaml")
    assert load_model(tmp_path / "saved.yaml").joints == ("j", "s")


def test_the_newer_form_of_ros_control(tmp_path):
    model = loaded(tmp_path, NEWER, transmission="file")
    assert_close(model.plant_positions(np.array([[4.0, 0.1, 0.2]])), [[0.7, 0.1, 0.2]])
