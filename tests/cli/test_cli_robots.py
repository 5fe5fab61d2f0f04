"""Commands on robots with grippers and transmissions, and on files that need repairs."""

import json
import re
import sys
from dataclasses import replace

import numpy as np
import pandas
import pytest
from commands import contents, refused, run, told
from coupled_arm import WRIST, arm, log_of
from own_code import effect
from pendulum_logs import sines, with_gripper
from processes import ended, start
from scipy.integrate import solve_ivp

from geodrake.control import roll_out
from geodrake.effects import FittedEffect, Hysteresis, RotorInertia
from geodrake.logs import JointLog, Motion, read_log, write_log
from geodrake.model import load_model


@pytest.fixture
def robot(tmp_path):
    return with_gripper(tmp_path / "gripper.urdf")


def gripper_log(robot, path, *, finger=0.01, **further):
    """Write a log of the two joints of the arm with its gripper open by `finger`, m."""
    model = load_model(robot, lock={"left": finger})
    time, moved = sines(12.0, size=0.7)
    effort = model.effort(moved) + np.random.default_rng(0).normal(0.0, 0.01, moved.q.shape)
    write_log(JointLog(path.stem, model.joints, time, moved.q, effort), path)
    if further:
        pandas.read_csv(path).assign(**further).to_csv(path, index=False)
    return path


def test_a_gripper_without_measurements_is_held_with_a_note(robot, tmp_path):
    log = gripper_log(robot, tmp_path / "log.csv", finger=0.0)
    shown = told("compare", robot, log, "--json", tmp_path / "out.json")
    assert "Fixed, as no log has efforts of these joints" in shown and "left at 0" in shown
    assert "right follows left" in shown
    assert float(re.search(r"nrms ([\d.]+)", shown)[1]) < 0.02


def test_a_gripper_is_held_at_its_logged_position(robot, tmp_path):
    columns = {"left.position": 0.03, "right.position": 0.03}
    log = gripper_log(robot, tmp_path / "log.csv", finger=0.03, **columns)
    assert "left at 0.03" in told("compare", robot, log)


def test_a_saved_model_keeps_held_joints(robot, tmp_path):
    log = gripper_log(robot, tmp_path / "log.csv", finger=0.02)
    model = tmp_path / "model.yaml"
    told("add", "effort_offset", robot, log, "--lock", "left=0.02", "--save", model)
    assert load_model(model).held == {"left": 0.02}
    assert "left at 0.02" in told("compare", model, log)
    shown = told("rollout", model, log, "--before", robot, "--windows", 1)
    assert "before" in shown


def test_a_known_payload_in_the_hand_is_carried(robot, tmp_path):
    log = gripper_log(robot, tmp_path / "log.csv")
    shown = told("compare", robot, log, "--lock", "left=0.01", "--known-payload", "log:right:0.5")
    assert "known payload of 0.5 kg at right" in shown
    assert float(re.search(r"nrms ([\d.]+)", shown)[1]) > 0.1


def test_excite_moves_the_fingers_together(robot, tmp_path):
    motion = tmp_path / "motion.csv"
    fast = ("--seeds", 1, "--iterations", 3, "--samples", 40, "--duration", 4, "--harmonics", 2)
    told("excite", robot, *fast, "--save", motion, "--meshcat", tmp_path / "replay.html")
    log = read_log(motion)
    assert log.joints == ("shoulder", "elbow", "left")
    assert 0.0 <= log.position[:, 2].min() < log.position[:, 2].max() <= 0.04
    told("excite", robot, *fast, "--save", motion, "--lock", "left=0.01")
    assert read_log(motion).joints == ("shoulder", "elbow")


def test_xacro_files_with_code_need_trust(robot, tmp_path):
    pytest.importorskip("xacro")
    text = robot.read_text().replace(
        "<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', 1
    )
    path, saved = tmp_path / "arm.urdf.xacro", tmp_path / "saved.yaml"
    prop = '<xacro:property name="x" value="${(lambda: (1).__class__(1))()}"/>'
    prop += '<gazebo v="${x}"/></robot>'
    path.write_text(text.replace("</robot>", prop))
    log = gripper_log(robot, tmp_path / "log.csv")
    assert "--trust-xacro" in refused("compare", path, log)
    told("compare", path, log, "--save", saved, "--trust-xacro")
    assert "--trust-xacro" in refused("compare", saved, log)
    told("compare", saved, log, "--trust-xacro")


def simulated(robot, dry=0.0, width=1.0):
    """Simulate the pendulum with its gripper, and Dahl's friction there, for 3 s with SciPy."""
    model, time = load_model(robot), np.arange(0.0, 3.0, 0.01)
    limit, rates, damping = np.array([2.0, 1.0, 0.4]), np.array([1.9, 3.1, 2.3]), [0.3, 0.3, 8.0]

    def slope(t, state):
        q, v, still = state[None, :3], state[None, 3:6], np.zeros((4, 3))
        needed = model.motion(Motion(np.repeat(q, 4, 0), still, np.eye(4, 3))).load
        bias = model.motion(Motion(q, v, still[:1])).load[0] + [0.0, 0.0, dry * state[6]]
        effort = limit * np.sin(rates * t) - damping * v[0]
        bend = (v[0, 2] - abs(v[0, 2]) * state[6]) / width
        return [*v[0], *np.linalg.solve(needed[:3] - needed[3], effort - bias), bend]

    start = np.array([0.3, -0.2, 0.02, 0.0, 0.0, 0.0, 0.0])
    states = solve_ivp(slope, (0.0, 3.0), start, "LSODA", time, rtol=1e-7, atol=1e-9).y.T
    effort = limit * np.sin(np.outer(time, rates)) - damping * states[:, 3:6]
    return JointLog("log", model.joints, time, states[:, :3], effort, states[:, 3:6])


def test_a_rollout_moves_the_fingers_together(robot):
    model, log = load_model(robot), simulated(robot)
    rollout = roll_out(model, [log], most=3, horizon=0.3)
    assert rollout.broken == 0 and rollout.relative < 1e-2
    rotor = FittedEffect(RotorInertia("left"), np.array([0.1]))
    slower = roll_out(replace(model, effects=(rotor,)), [log], most=1, bandwidth=8.0)
    assert slower.broken == 0 and slower.relative > 10 * rollout.relative
    bristles = FittedEffect(Hysteresis("left", 1e-3), np.array([0.1]))
    bent = simulated(robot, 0.1, 1e-3)
    bare, whole = (
        roll_out(replace(model, effects=effects), [bent], most=3, horizon=0.3)
        for effects in ((), (bristles,))
    )
    assert whole.broken == 0 and whole.relative < 0.05 and bare.relative > 10 * whole.relative


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a folder of an arm with its transmission, and a log in which a motor has friction."""
    folder = tmp_path_factory.mktemp("arm")
    log = log_of(arm(folder), 0, lambda v: np.tanh(v / 1e-3) * [0.0, 0.8, 0.0], seconds=5.0)
    write_log(log, folder / "log.csv")
    return folder


def test_a_transmission_file_beside_the_model_is_used_by_default(files, tmp_path):
    robot, log, out = files / "arm.urdf", files / "log.csv", tmp_path / "out.json"
    shown = told("compare", robot, log, "--json", out)
    assert "m2, m3 for pitch, roll" in shown and "arm.transmission.yaml beside" in shown
    errors = json.loads(out.read_text())["joints"]
    assert list(errors) == ["m1", "m2", "m3"]
    assert errors["m1"]["nrms"] < 0.1 < errors["m2"]["nrms"]
    other = tmp_path / "turned.yaml"
    other.write_text(WRIST.replace("ratio: -8", "ratio: 8"))
    told("compare", robot, log, "--transmission", other, "--json", out)
    assert json.loads(out.read_text())["joints"]["m1"]["nrms"] > 0.5
    shown = told("compare", robot, log, "--transmission", "none", "--bandwidth", 10)
    assert "actuators" not in shown and "shoulder" in shown
    saved = tmp_path / "model.yaml"
    told("add", "coulomb_friction", robot, log, "--where", "m2", "--save", saved)
    told("compare", saved, log, "--json", out)
    assert json.loads(out.read_text())["error"]["nrms"] < 0.1


@pytest.mark.parametrize(
    ("wrong", "problem"),
    [
        ("gear: []", "it has the unknown field 'gear' (was gears meant?)"),
        ("gears: [{actuator: m, joint: shoulder, ratoi: 3}]", "the unknown field 'ratoi'"),
        ("gears: [{actuator: m, joint: shoulder, ratio: x}]", "ratio = x"),
        ("gears: [{actuator: m, joint: knee}]", "joint 'knee', which is not an independent"),
        ("gears: [{joint: shoulder}]", "gears[0] lacks its actuator"),
        ("gears: [{actuator: '', joint: shoulder}]", "gears[0] has no actuator"),
        ("coupled: [{joints: {roll: {a: [1]}}}]", "coupled[0].joints.roll.a = [1]"),
        ("coupled: [{joints: {roll: {5: 1}}}]", "coupled[0].joints.roll has 5 as a name"),
        ("gears: {actuator: m, joint: roll}", "expected a list but got a table of fields"),
        ("polynomials: [{actuator: m, joint: roll, map_of: 1}]", "the unknown field 'map_of'"),
        (
            "gears: [{actuator: m, joint: roll}, {actuator: n, joint: roll}]",
            "joint 'roll' in two of its parts",
        ),
        ("coupled: [{joints: {roll: {a: 1, b: 1}, pitch: {a: 2, b: 2}}}]", "its rank is 1"),
        ("coupled: [{joints: {roll: {a: 1}, roll: {b: 1}}}]", "it has 'roll' twice"),
        ("gears: [{actuator: pitch, joint: roll}]", "an actuator 'pitch', but the robot also has"),
        (
            "tables: [{actuator: m, joint: roll, actuator_positions: [0], joint_positions: [0]}]",
            "needs at least 3 increasing actuator positions",
        ),
        ("four_bars: [{actuator: m, joint: roll, ground: 1, crank: 3, coupler: 1, rocker: 0.5}]",
         "do not reach each other at q = 0"),
        ("gears: [", "while parsing"),
        ("", "is empty"),
    ],
)  # fmt: skip
def test_wrong_transmissions_are_one_line(wrong, problem, files, tmp_path):
    (tmp_path / "wrong.yaml").write_text(wrong)
    given = ("coulomb_friction", files / "arm.urdf", files / "log.csv", "--save", "saved.yaml")
    assert problem in refused("add", *given, "--transmission", "wrong.yaml")
    assert [path.name for path in tmp_path.iterdir()] == ["wrong.yaml"]


def test_transmission_files_are_never_overwritten(files):
    given = ("compare", files / "arm.urdf", files / "log.csv", "--transmission")
    before, beside = contents(files), files / "arm.transmission.yaml"
    assert beside.name in refused(*given, beside, "--json", beside)
    assert contents(files) == before
    assert "has no transmissions of motors" in refused(*given, "file")


URDF = """<robot name="two">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/>{mass}
    <inertia ixx="0.03" iyy="0.03" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0 0 0.1"/><mass value="1.2"/>
    <inertia ixx="0.012" iyy="0.012" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="60" velocity="4"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
    <origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="30" velocity="4"/></joint>
</robot>
"""
PRINTS = """
import atexit, ctypes, threading, time
print("printed")
os.write(1, b"written\\n")
ctypes.CDLL(None).printf(b"in C\\n")
atexit.register(lambda: sys.__stdout__.write("at the end\\n"))
atexit.register(os.system, "echo by a child at the end")
def loop():
    while True:
        os.write(1, b"in a thread\\n")
        time.sleep(0.001)
threading.Thread(target=loop, daemon=True).start()
"""


def model_of(folder, mass):
    path = folder / "two.urdf"
    path.write_text(URDF.format(mass=mass), encoding="utf-8")
    return path


def checked(path):
    """Return the result of `geodrake check`, and its numbers."""
    numbers = path.with_suffix(".json")
    done = run("check", path, "--samples", 2, "--json", numbers)
    return done, json.loads(numbers.read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("mass", "problem"),
    [
        ('<mass value="nan"/>', "upper has a mass or inertia that is not a number"),
        ('<mass value="abc"/>', "upper has a mass or inertia that is not a number"),
        ('<mass value="-2"/>', "upper has a mass of -2 kg"),
        ("", "upper has a mass of 0 kg"),
    ],
)
def test_a_repaired_mass_fails_the_check(tmp_path, mass, problem):
    done, numbers = checked(model_of(tmp_path, mass))
    assert done.exit_code == 1
    assert done.output.startswith(f"Warning: two.urdf was repaired. {problem}")
    assert "agree" not in done.output.rpartition("Verdict")[2]
    assert not numbers["agrees"] and numbers["repaired"]
    assert numbers["notes"][0].startswith(problem)


@pytest.mark.parametrize(
    ("form", "file"),
    [
        ("urdf", "two.urdf"),
        ("sdf", "two.sdf"),
        ("mjcf", "two.xml"),
        ("drake", "two.dmd.yaml"),
        ("isaac", "two.actuators.json"),
        ("python", "two_effort.py"),
        ("cpp", "two_effort.hpp"),
    ],
)
def test_exported_files_state_repairs(tmp_path, form, file):
    target = tmp_path / "out"
    done = run("export", model_of(tmp_path, '<mass value="nan"/>'), "--to", form, target, "-q")
    assert done.exit_code == 0
    assert done.output.startswith("Warning: two.urdf was repaired. upper has a mass")
    text = (target / file).read_text(encoding="utf-8")
    assert "geodrake repaired two.urdf: upper has a mass" in text


def test_repairs_of_links_with_any_name_keep_valid_xml(tmp_path):
    path = model_of(tmp_path, '<mass value="nan"/>')
    text = path.read_text("utf-8").replace('"upper"', '"up--per--&gt;-"')
    path.write_text(text, encoding="utf-8")
    assert run("export", path, "--to", "urdf", tmp_path / "out", "-q").exit_code == 0
    assert checked(tmp_path / "out" / "two.urdf")[0].exit_code == 0


def test_many_repairs_are_counted(tmp_path):
    links = "".join(
        f'<link name="l{k}"/><joint name="j{k}" type="continuous">'
        f'<parent link="{"fore" if k == 0 else f"l{k - 1}"}"/><child link="l{k}"/></joint>'
        for k in range(9)
    )
    path = model_of(tmp_path, '<mass value="2"/>')
    text = path.read_text("utf-8").replace("</robot>", f"{links}</robot>")
    path.write_text(text, encoding="utf-8")
    done, _ = checked(path)
    assert done.output.count("Warning") == 6
    assert "4 more of its parts were replaced or omitted" in done.output


def test_output_of_user_code_is_not_a_result(tmp_path):
    own = tmp_path / "own.py"
    own.write_text(effect(before=PRINTS), encoding="utf-8")
    model = model_of(tmp_path, '<mass value="2"/>')
    command = [sys.executable, "-m", "geodrake", "check", model, "--samples", "2", "--json", "-"]
    code, out, err = ended(start([*command, "--effects", own]))
    assert code == 0 and json.loads(out)["agrees"]
    told = {"printed", "written", "in C", "in a thread", "at the end", "by a child at the end"}
    assert told <= set(err.splitlines())


MJCF = """<mujoco model="m"><option density="{}"/><worldbody><body name="a">
<joint name="j" axis="0 1 0"/><geom type="capsule" size=".05 .2" pos=".1 0 0"/></body>
</worldbody></mujoco>"""


def test_ignored_parts_fail_the_check_and_are_reported_first(tmp_path):
    path = tmp_path / "m.xml"
    band = '<tendon><fixed name="p" stiffness="50" springlength=".1 .2"><joint joint="j" coef="1"/>'
    text = MJCF.format(0).replace("</mujoco>", f"{band}</fixed></tendon></mujoco>")
    path.write_text(text, encoding="utf-8")
    done, numbers = checked(path)
    assert done.exit_code == 1
    assert done.output.startswith("Warning: m.xml was repaired. ")
    assert "Tendon p with stiffness 50 is ignored." in done.output
    verdict = " ".join(done.output.rpartition("Verdict")[2].split())
    assert "has forces or parts that geodrake does not model" in verdict and "MuJoCo" in verdict
    assert not numbers["agrees"] and not numbers["repaired"]
    assert numbers["left_out"] == numbers["notes"][:1]
    assert numbers["second_opinion"]["by"].startswith("MuJoCo")
    assert numbers["second_opinion"]["relative"] > 0.01


@pytest.mark.parametrize(("name", "program"), [("m.xml", "MuJoCo"), ("two.urdf", "Pinocchio")])
def test_another_reader_of_the_file_agrees(tmp_path, monkeypatch, name, program):
    model_of(tmp_path, '<mass value="2"/>')
    (tmp_path / "m.xml").write_text(MJCF.format(0), encoding="utf-8")
    done, _ = checked(tmp_path / name)
    (opinion,) = re.findall(r"^Second opinion: (.*)", done.output, re.M)
    assert done.exit_code == 0
    assert opinion.startswith(program) and opinion.endswith("reads the file itself, agrees")
    assert "Warning" not in done.output
    monkeypatch.setitem(sys.modules, program.lower(), None)
    done, numbers = checked(tmp_path / "two.urdf")
    by = numbers["second_opinion"]["by"]
    assert ("not installed" in by) == (program == "Pinocchio") and done.exit_code == 0
