"""Motors, servos and delays in MJCF and for Isaac Lab: as MuJoCo reads and simulates them."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from geodrake.control.export_proof import export_to
from geodrake.control.export_proof.export import prove
from geodrake.control.export_proof.formats import export_format
from geodrake.control.export_proof.held import held_by
from geodrake.control.export_proof.reference import compared, random_motion, random_starts
from geodrake.effects import CoulombFriction, EffortDelay, FittedEffect
from geodrake.errors import ModelError
from geodrake.model import EffortSignal, holding, save_model
from geodrake.model.logged_joints import reading_for
from geodrake.model.saved_model import load_model
from geodrake.robot.plant import load_plant

INERTIAL = """<inertial><origin xyz="0 0 0.2"/><mass value="1"/>
  <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>"""
URDF = f"""<robot name="arm"><link name="base"/>
  <link name="one">{INERTIAL}</link><link name="two">{INERTIAL}</link>
  <joint name="a" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="10" velocity="2"/></joint>
  <joint name="b" type="revolute"><parent link="one"/><child link="two"/><axis xyz="0 1 0"/>
    <origin xyz="0 0 0.4"/><limit lower="-3" upper="3" effort="50" velocity="2"/></joint>
</robot>"""
MJCF = """<mujoco model="arm"><!-- my arm -->
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


def loaded(folder, before="", after="", *, text=None):
    (folder / "own").mkdir(exist_ok=True)
    path = folder / "own" / ("arm.xml" if text is None else "arm.urdf")
    path.write_text(MJCF.format(before=before, after=after) if text is None else text)
    return load_model(path)


def servoed(model, delay=DELAY, effects=()):
    """The model with a servo at its second joint."""
    signal = EffortSignal(
        model.joints[1], "command", 30.0, damping=2.0, delay=delay, limit=20.0, deviation=1.0
    )
    return replace(model, effort_signals=(signal,), effects=(*model.effects, *effects))


def delayed(seconds, joint=None):
    return FittedEffect(EffortDelay(seconds, joint), np.zeros(0))


def exported(model, folder, to="mjcf"):
    """The first file of an export, and its notes in one line."""
    form = export_format(to)
    made = form.write(model, held_by(model, form.holding(model), ()), folder)
    folder.mkdir()
    for name, content in made.files.items():
        (folder / name).write_bytes(content)
    return folder / next(iter(made.files)), " ".join(made.notes)


def names(compiled):
    return [compiled.actuator(k).name for k in range(compiled.nu)]


def test_a_robot_written_anew_has_a_motor_or_a_servo_at_every_joint(tmp_path):
    model = servoed(loaded(tmp_path, text=URDF))
    path, notes = exported(model, tmp_path / "out")
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
    assert exported(again, tmp_path / "again")[0].read_bytes() == path.read_bytes()


def test_limits_that_logs_told_are_in_new_files_and_noted_beside_the_users(tmp_path):
    model = loaded(tmp_path, text=URDF)
    assert "limits of effort" not in exported(model, tmp_path / "plain", "urdf")[1]
    model = replace(model, effort_signals=(EffortSignal("b", "effort", 1.0, limit=7.0),))
    path, notes = exported(model, tmp_path / "own_format", "urdf")
    np.testing.assert_array_equal(load_model(path).effort_limits, [10.0, 50.0])
    assert (
        "limits of effort in arm.urdf stay as they are; the model knows of less: b 7 N·m" in notes
    )
    for form in ("sdf", "mjcf"):
        path, notes = exported(model, tmp_path / form, form)
        np.testing.assert_array_equal(load_model(path).effort_limits, [10.0, 7.0])
        assert "limits of effort" not in notes
    notes = " ".join(export_to("sdf", servoed(model), tmp_path / "servos").notes)
    assert "sdf does not have the gains of servos, such as those of b" in notes


def test_a_file_of_the_users_gets_actuators_for_servos_and_delays_alone(tmp_path):
    model = loaded(tmp_path)
    assert exported(model, tmp_path / "plain")[0].read_text() == MJCF.format(before="", after="")
    path, _ = exported(servoed(model), tmp_path / "out")
    text, own = path.read_text(), MJCF.format(before="", after="")
    head = own[: own.index("</mujoco>")].rstrip()
    named = head.replace('<joint axis="0 1 0"/>', '<joint axis="0 1 0" name="body_1_joint_0"/>')
    assert text.startswith(f"{named}\n  <actuator>\n    <motor")
    assert text.endswith("  </actuator>\n</mujoco>\n")
    compiled = mujoco.MjModel.from_xml_path(str(path))
    assert names(compiled) == ["a", "body_1_joint_0"]
    late = replace(model, effects=(delayed(-0.02, "a"),))
    compiled = mujoco.MjModel.from_xml_path(str(exported(late, tmp_path / "late")[0]))
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
    model = loaded(tmp_path, before, after)
    path = model.path
    path.write_text(path.read_text().replace("<joint axis", '<joint name="body_1_joint_0" axis'))
    model = servoed(load_model(path))
    out, notes = exported(model, tmp_path / "out")
    assert out.read_text() == path.read_text()
    assert 'body_1_joint_0: kp="30.0" kv="2.0" delay="0.0137" nsample="15"' in notes
    more = replace(model, effects=(delayed(-0.01, "a"),))
    out, notes = exported(more, tmp_path / "more")
    compiled = mujoco.MjModel.from_xml_path(str(out))
    assert names(compiled) == ["mine", "a"]  # control signals of the first keep their place
    assert compiled.actuator_delay.tolist() == [0.0, 0.01]
    assert "stay as they are" in notes


def test_defaults_of_actuators_would_change_what_is_added(tmp_path):
    before = '<default><position timeconst="0.1"/></default>'
    model = servoed(loaded(tmp_path, before))
    path, notes = exported(model, tmp_path / "out")
    assert path.read_text() == MJCF.format(before=before, after="")
    assert "defaults of actuators" in notes
    classes = '<default><default class="mine"><motor gear="3"/></default></default>'
    path, _ = exported(servoed(loaded(tmp_path, classes)), tmp_path / "classes")
    assert mujoco.MjModel.from_xml_path(str(path)).nu == 2


def test_delays_shorter_than_a_step_are_said(tmp_path):
    model = loaded(tmp_path, '<option timestep="0.004"/>')
    _, notes = exported(servoed(model, delay=0.003), tmp_path / "out")
    assert "step of 0.004 s is longer than the delay of body_1_joint_0" in notes
    _, notes = exported(servoed(model, delay=0.004), tmp_path / "long")
    assert "is longer than" not in notes
    fine = loaded(tmp_path, '<option timestep="0.0005"/>')
    path, notes = exported(servoed(fine, delay=0.003), tmp_path / "fine")
    assert mujoco.MjModel.from_xml_path(str(path)).actuator_history[1][0] == 7
    assert "steps of the simulation of 0.0005 s and more" in notes
    odd = servoed(loaded(tmp_path, '<option timestep="-1"/>'), delay=0.0015)
    assert "step of 0.002 s is longer" in exported(odd, tmp_path / "odd")[1]  # MuJoCo's own
    with pytest.raises(ModelError, match="line 2: bad format in attribute 'timestep'"):
        loaded(tmp_path, '<option timestep="fast"/>')


def test_efforts_that_are_measured_late_are_so_by_a_sensor(tmp_path):
    model = replace(loaded(tmp_path), effects=(delayed(0.0065, "a"),))
    path, notes = exported(model, tmp_path / "out")
    compiled = mujoco.MjModel.from_xml_path(str(path))
    assert compiled.nu == 0 and compiled.sensor(0).name == "a_effort"
    assert "a_effort" in notes or "<joint>_effort" in notes
    model = replace(loaded(tmp_path, text=URDF), effects=(delayed(0.0065, "a"),))
    path, _ = exported(model, tmp_path / "anew")
    compiled = mujoco.MjModel.from_xml_path(str(path))
    compiled.opt.timestep = 1e-3
    data = mujoco.MjData(compiled)
    for k in range(30):
        data.ctrl[0] = 0.1 * k
        mujoco.mj_step(compiled, data)
    assert data.sensor("a_effort").data[0] == pytest.approx(0.1 * (29 - 6.5))


def test_the_proof_tells_efforts_and_commands_to_actuators(tmp_path):
    for k, model in enumerate((loaded(tmp_path, text=URDF), loaded(tmp_path))):
        acting = servoed(model, effects=(delayed(-0.0223, "a"),))
        proven = export_to("mjcf", acting, tmp_path / f"out{k}")
        assert proven.lacks == ()
        effort, position = proven.proof.differences
        assert effort.is_rounding and position.is_rounding and position.typical > 0.01


@pytest.mark.parametrize(
    ("old", "new"), [('kp="30.0"', 'kp="30.3"'), ('delay="0.02"', 'delay="0.025"')]
)
def test_the_proof_sees_wrong_actuators(old, new, tmp_path):
    model = servoed(loaded(tmp_path, text=URDF), effects=(delayed(-0.02, "a"),))
    path, _ = exported(model, tmp_path / "out")
    motion = random_motion(model)
    arguments = ["mujoco"], compared([motion]), random_starts(model, motion)
    assert prove(model, path, *arguments).differences[1].is_rounding
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    assert not prove(model, path, *arguments).differences[1].is_rounding


def test_a_joint_that_had_no_motor_in_logs_gets_none(tmp_path):
    """The saved model says so, next logs are read so, and no file gives the joint a motor."""
    model = replace(loaded(tmp_path, text=URDF), motorless=("a",), effects=(delayed(-0.02),))
    save_model(model, tmp_path / "model.yaml")
    model = load_model(tmp_path / "model.yaml")
    assert model.motorless == ("a",) == tuple(reading_for(model).motorless)
    assert holding(model, {"a": 0.1}).motorless == ()
    compiled = mujoco.MjModel.from_xml_path(str(exported(model, tmp_path / "mjcf")[0]))
    assert names(compiled) == ["b"] and compiled.jnt_actfrclimited.tolist() == [0, 1]
    plant = load_plant(exported(model, tmp_path / "sdf", "sdf")[0]).plant
    actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
    assert [each.joint().name() for each in actuators] == ["b"]
    exported(model, tmp_path / "isaac", "isaac")
    joints = json.loads((tmp_path / "isaac" / "arm.actuators.json").read_text())["joints"]
    assert [(joints[j]["effort_limit"], joints[j]["delay"]) for j in "ab"] == [(0, 0), (50, 0.02)]
    assert "a had no motor in logs" in exported(model, tmp_path / "urdf", "urdf")[1]
    proven = export_to("mjcf", replace(model, effects=()), tmp_path / "proven")
    assert all(each.is_rounding for each in proven.proof.differences)
    text = (tmp_path / "model.yaml").read_text().replace("motorless: [a]", "motorless: [c]")
    (tmp_path / "model.yaml").write_text(text)
    with pytest.raises(ModelError, match="says that 'c' has no motor, which the robot does not"):
        load_model(tmp_path / "model.yaml")


def test_a_joint_that_dry_friction_holds_does_not_creep(tmp_path):
    """By MuJoCo's defaults joints creep under a load that friction holds."""
    friction = [FittedEffect(CoulombFriction(joint), np.array([4.0])) for joint in "ab"]
    model = replace(loaded(tmp_path, text=URDF), effects=tuple(friction))
    engine = mujoco.MjModel.from_xml_path(str(exported(model, tmp_path / "out")[0]))
    data = mujoco.MjData(engine)
    data.qpos[:] = 0.5, -0.2  # gravity pulls with 3 and 0.6 N·m
    while data.time < 5.0:
        mujoco.mj_step(engine, data)
    np.testing.assert_allclose(data.qpos, [0.5, -0.2], atol=2e-3)
