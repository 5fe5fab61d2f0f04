"""Robots as they come, at the command line: a gripper that no log has, held joints, bad options."""

import re
from dataclasses import replace

import numpy as np
import pytest
from commands import refused, told
from pendulum_logs import PENDULUM
from scipy.integrate import solve_ivp

from geodrake.control import roll_out
from geodrake.effects import FittedEffect, Hysteresis, RotorInertia
from geodrake.logs import JointLog, Motion, read_log, write_log
from geodrake.model import load_model

FINGER = """<link name="{0}"><inertial><origin xyz="0 0 -0.02"/><mass value="0.2"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{0}" type="prismatic"><parent link="lower_link"/><child link="{0}"/>
<origin xyz="0 0 -0.3"/><axis xyz="{1} 0 0"/><limit lower="0" upper="0.04" effort="9"
velocity="0.2"/>{2}</joint>"""


@pytest.fixture
def robot(tmp_path):
    """The pendulum with a gripper, one finger of which follows the other."""
    own = FINGER.format("left", 1, "") + FINGER.format("right", -1, '<mimic joint="left"/>')
    path = tmp_path / "gripper.urdf"
    path.write_text(PENDULUM.read_text().replace("</robot>", own + "</robot>"))
    return path


def log_of(robot, path, *, finger=0.01, **further):
    """A log of the two joints of the arm, made with the gripper at that place."""
    model, time = load_model(robot, lock={"left": finger}), np.arange(0.0, 12.0, 0.01)
    rate, phase = np.array([2.0, 3.1]), np.array([0.0, 1.0])
    angle = np.outer(time, rate) + phase
    q, v, vd = np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)
    effort = model.effort(Motion(q, v, vd)) + np.random.default_rng(0).normal(0.0, 0.01, q.shape)
    write_log(JointLog(path.stem, model.joints, time, q, effort), path)
    if further:
        header, *lines = path.read_text().splitlines()
        lines = [f"{line},{','.join(map(str, further.values()))}" for line in lines]
        path.write_text("\n".join([",".join([header, *further]), *lines]) + "\n")
    return path


def test_a_log_without_the_gripper_holds_it_and_says_so(robot, tmp_path):
    log = log_of(robot, tmp_path / "log.csv", finger=0.0)
    shown = told("compare", robot, log, "--json", tmp_path / "out.json")
    assert "Fixed, as no log has their efforts" in shown and "left at 0" in shown
    assert "right follows left" in shown
    assert float(re.search(r"nrms of all joints ([\d.]+)", shown)[1]) < 0.02


def test_a_gripper_whose_position_was_logged_is_held_there(robot, tmp_path):
    columns = {"left.position": 0.03, "right.position": 0.03}
    log = log_of(robot, tmp_path / "log.csv", finger=0.03, **columns)
    assert "left at 0.03" in told("compare", robot, log)


def test_a_saved_model_goes_on_holding(robot, tmp_path):
    log = log_of(robot, tmp_path / "log.csv", finger=0.02)
    model = tmp_path / "model.yaml"
    told("add", "effort_offset", robot, log, "--lock", "left=0.02", "--save", model)
    assert load_model(model).held == {"left": 0.02}
    assert "left at 0.02" in told("compare", model, log)
    shown = told("rollout", model, log, "--before", robot, "--windows", 1)
    assert "before" in shown


def test_a_known_payload_in_the_hand_is_carried(robot, tmp_path):
    log = log_of(robot, tmp_path / "log.csv")
    shown = told("compare", robot, log, "--lock", "left=0.01", "--known-payload", "log:right:0.5")
    assert "known payload of 0.5 kg at right" in shown
    assert float(re.search(r"nrms of all joints ([\d.]+)", shown)[1]) > 0.1


def test_excite_moves_the_fingers_together(robot, tmp_path):
    motion = tmp_path / "motion.csv"
    fast = ("--seeds", 1, "--iterations", 3, "--samples", 40, "--duration", 4, "--harmonics", 2)
    told("excite", robot, *fast, "--save", motion, "--meshcat", tmp_path / "replay.html")
    log = read_log(motion)
    assert log.joints == ("shoulder", "elbow", "left")
    assert 0.0 <= log.position[:, 2].min() < log.position[:, 2].max() <= 0.04
    told("excite", robot, *fast, "--save", motion, "--lock", "left=0.01")
    assert read_log(motion).joints == ("shoulder", "elbow")


def test_a_xacro_file_that_asks_for_more_than_values_needs_to_be_trusted(robot, tmp_path):
    pytest.importorskip("xacro")
    text = robot.read_text().replace(
        "<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', 1
    )
    path, saved = tmp_path / "arm.urdf.xacro", tmp_path / "saved.yaml"
    prop = '<xacro:property name="x" value="${(lambda: (1).__class__(1))()}"/>'
    prop += '<gazebo v="${x}"/></robot>'
    path.write_text(text.replace("</robot>", prop))
    log = log_of(robot, tmp_path / "log.csv")
    assert "--trust-xacro" in refused("compare", path, log)
    told("compare", path, log, "--save", saved, "--trust-xacro")
    assert "--trust-xacro" in refused("compare", saved, log)
    told("compare", saved, log, "--trust-xacro")


def simulated(robot, dry=0.0, width=1.0):
    """Three seconds of the pendulum with its gripper, with Dahl's friction there, by SciPy."""
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
    states = solve_ivp(slope, (0.0, 3.0), start, t_eval=time, rtol=1e-7, atol=1e-9).y.T
    effort = limit * np.sin(np.outer(time, rates)) - damping * states[:, 3:6]
    return JointLog("log", model.joints, time, states[:, :3], effort, states[:, 3:6])


def test_a_rollout_moves_the_fingers_together(robot):
    model, log = load_model(robot), simulated(robot)
    rollout = roll_out(model, [log], most=3, horizon=0.3)
    assert rollout.broken == 0 and rollout.relative < 1e-2
    rotor = FittedEffect(RotorInertia("left"), np.array([0.1]))
    slower = roll_out(replace(model, effects=(rotor,)), [log], most=1, bandwidth=8.0)
    assert slower.broken == 0 and slower.relative > 10 * rollout.relative
    bristles, bent = (
        FittedEffect(Hysteresis("left", 1e-3), np.array([0.1])),
        simulated(robot, 0.1, 1e-3),
    )
    bare, whole = (
        roll_out(replace(model, effects=effects), [bent], most=3, horizon=0.3)
        for effects in ((), (bristles,))
    )
    assert whole.broken == 0 and whole.relative < 0.05 and bare.relative > 10 * whole.relative
