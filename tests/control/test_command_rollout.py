"""Rollouts under commands: the servo closes the loop around the simulated robot; by MuJoCo."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from geodrake.control import roll_out
from geodrake.control.rollout import commanded_motions
from geodrake.control.rollout.passages import chosen_passages
from geodrake.control.rollout.simulation import simulations
from geodrake.control.rollout.stepping import stepping
from geodrake.effects import (
    CoulombFriction,
    EffortDelay,
    EffortScale,
    FittedEffect,
    Hysteresis,
    LoadDependentFriction,
    RotorInertia,
    ViscousFriction,
)
from geodrake.errors import ArgumentError, LogError
from geodrake.identification.logs.case import open_case
from geodrake.logs import JointLog
from geodrake.model import EffortSignal, load_model
from geodrake.report import About, page_of, render
from geodrake.report.json_output import record
from geodrake.report.motion_errors import motion_values
from geodrake.report.views import numbers_of
from geodrake.robot import gears
from geodrake.robot.transmission.statements import Drive

INERTIAL = """<inertial><origin xyz="0 0 0.2"/><mass value="1.5"/>
  <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>"""
URDF = """<robot name="arm"><link name="base"/>
  <link name="one">INERTIAL</link><link name="two">INERTIAL</link>
  <joint name="a" type="continuous"><parent link="base"/><child link="one"/><axis xyz="0 1 0"/>
    {}</joint>
  <joint name="b" type="continuous"><parent link="one"/><child link="two"/><axis xyz="0 1 0"/>
    <origin xyz="0 0 0.4"/>{}</joint>
</robot>""".replace("INERTIAL", INERTIAL)
KP, KD, LIMIT, VISCOUS, ARMATURE = (
    np.array(values)
    for values in ([90.0, 40.0], [5.0, 2.0], [14.0, np.inf], [0.6, 0.3], [0.05, 0.03])
)
DAMPING = [f'<dynamics damping="{value}"/>' for value in VISCOUS]
DELAY, STEP, EVERY = 0.03, 5e-4, 10


def simulated(seconds=8.0, seed=1):
    """A log of commands, true efforts beside it, by MuJoCo; servos are computed here by hand."""
    compiled = mujoco.MjModel.from_xml_string(URDF.format(*DAMPING))
    compiled.opt.timestep = STEP
    compiled.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    compiled.dof_armature[:] = ARMATURE
    data, rng = mujoco.MjData(compiled), np.random.default_rng(seed)
    rates, phases = rng.uniform(1.0, 6.0, (2, 3)), rng.uniform(0.0, 2 * np.pi, (2, 3))

    def command(t):
        angle = rates * t + phases
        return 0.35 * np.sin(angle).sum(1), 0.35 * (rates * np.cos(angle)).sum(1)

    data.qpos[:] = command(0.0)[0]
    rows = []
    for k in range(round(seconds / STEP)):
        c, rate = command(max(k * STEP - DELAY, 0.0))
        rate = rate if k * STEP > DELAY else 0.0 * rate
        effort = np.clip(KP * (c - data.qpos) + KD * (rate - data.qvel), -LIMIT, LIMIT)
        if k % EVERY == 0:
            rows.append([data.time, *data.qpos, *data.qvel, *effort, *command(k * STEP)[0]])
        data.qfrc_applied[:] = effort
        mujoco.mj_step(compiled, data)
    time, *columns = np.split(np.array(rows), [1, 3, 5, 7], axis=1)
    position, velocity, effort, told = columns
    return JointLog(
        "arm", ("a", "b"), time[:, 0], position, effort, velocity=velocity, command=told
    )


def knowing(model, turns=1.0):
    """The model with its servos and effects, at motors that turn so many times as fast."""
    effects, signals = [], []
    sizes = np.array([KP, KD, VISCOUS, ARMATURE]) / turns**2
    rows = zip(model.joints, LIMIT / np.abs(turns), *sizes, strict=True)
    for joint, limit, kp, kd, viscous, armature in rows:
        effects.append(FittedEffect(ViscousFriction(joint), np.array([viscous])))
        effects.append(FittedEffect(RotorInertia(joint), np.array([armature])))
        servo = EffortSignal(joint, "command", kp, damping=kd, delay=DELAY, limit=limit)
        signals.append(servo)
    return replace(model, effects=tuple(effects), effort_signals=tuple(signals))


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """A log, and the model that knows its servos and effects."""
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(URDF.format("", ""))
    return simulated(), knowing(load_model(path))


def without_efforts(log, *joints):
    effort = log.effort.copy()
    for joint in joints:
        effort[:, log.joints.index(joint)] = np.nan
    return replace(log, effort=effort)


def test_the_true_servos_move_the_model_as_the_robot(arm):
    log, model = arm
    silent = without_efforts(log, "a", "b")
    rollout = roll_out(model, [silent], most=2, commands=True)
    assert rollout.broken == 0 and len(rollout.windows) == 2
    assert rollout.relative < 0.002
    for joint in rollout.joints:
        assert joint.rms == pytest.approx(joint.relative * joint.moved)
        assert joint.moved > 0.05


def test_servos_at_motors_behind_gears(arm):
    """Motors that turn N times as fast need stiffness and damping over N²."""
    log, model = arm
    N = np.array([5.0, -3.0])
    drive = Drive(("m1", "m2"), ("a", "b"), gears(N))
    geared = knowing(load_model(model.path, transmission=[drive]), N)
    turned = JointLog(
        "arm",
        ("m1", "m2"),
        log.time,
        N * log.position,
        np.full_like(log.effort, np.nan),
        velocity=N * log.velocity,
        command=N * log.command,
    )
    assert roll_out(geared, [turned], most=2, horizon=0.2, commands=True).relative < 0.01


def test_joints_without_a_servo_get_their_efforts(arm):
    log, model = arm
    mixed = replace(model, effort_signals=model.effort_signals[:1])
    brief = {"most": 1, "horizon": 0.3}
    assert roll_out(mixed, [without_efforts(log, "a")], **brief, commands=True).relative < 0.02
    # The efforts of the other joint matter: without what they carry, it falls.
    light = replace(log, effort=log.effort * [1.0, 0.5])
    half = roll_out(mixed, [without_efforts(light, "a")], **brief, commands=True)
    assert half.joints[1].relative > 0.1


def test_the_loop_is_closed(arm):
    """A push that the model lacks drives an open loop away, and a servo holds against it."""
    log, model = arm
    heavier = replace(model, phi=1.3 * model.phi)
    closed = roll_out(heavier, [log], most=2, horizon=1.0, commands=True)
    opened = roll_out(heavier, [log], most=2, horizon=1.0)
    assert closed.relative < 0.5 * opened.relative


def test_reports_say_what_the_model_was_under(arm):
    log, model = arm
    delay = FittedEffect(EffortDelay(0.002, "b"), np.zeros(0))
    late = replace(model, effects=(*model.effects, delay))
    found = roll_out(late, [log], most=1, horizon=0.2, commands=True)
    assert any("effort_delay of b is ignored" in note for note in found.notes)
    assert numbers_of(found)["under"] == "commands"
    about = About("arm", ("log",))
    assert "arm under the commands of log" in render(page_of(found, about))
    opened = roll_out(model, [log], most=1, horizon=0.2)
    assert numbers_of(opened)["under"] == "efforts"
    assert "arm under the efforts of log" in render(page_of(opened, about))


def test_models_on_the_way_have_their_motions(arm):
    """Servos are known, and what the joints have beside them is added bit by bit."""
    model, log = arm[1], simulated(seconds=2.5)
    logs, viscous = [without_efforts(log, "a", "b")], replace(model, effects=model.effects[::2])
    bare = replace(model, effects=(), effort_signals=())  # servos are those of the last model
    motions = commanded_motions(bare, model, logs, between=[viscous])
    shares = [motion.relative for motion in motions]
    assert shares[0] > shares[1] > 10 * shares[2]
    told = record("Motions", **motion_values(motions)["motion"])
    assert [told[key]["relative"] for key in ("before", "after")] == [shares[0], shares[2]]
    assert [step["relative"] for step in told["steps"]] == [shares[1]]


def test_logs_without_commands_are_refused(arm):
    log, model = arm
    with pytest.raises(LogError, match="commands of a servo"):
        roll_out(replace(model, effort_signals=()), [log], commands=True)
    with pytest.raises(LogError, match="commands of a servo"):
        roll_out(model, [replace(log, command=None)], commands=True)
    with pytest.raises(ArgumentError, match="horizon"):
        roll_out(model, [log], horizon=0.0, commands=True)


def test_steps_move_a_rigid_robot_as_drake_does(arm):
    """With load-dependent friction, bristles, a wrong gain, integrals, a limit and a dead band."""
    log, model = arm
    kinds = (
        (LoadDependentFriction("a"), 0.2),
        (CoulombFriction("b"), 0.4),
        (Hysteresis("a", 0.02), 0.5),
        (EffortScale("b"), 0.1),
    )
    more = tuple(FittedEffect(effect, np.array([value])) for effect, value in kinds)
    servos = tuple(replace(s, integral=60.0, dead_band=0.01) for s in model.effort_signals)
    robot = replace(model, effects=(*model.effects, *more), effort_signals=servos)
    case = open_case(robot, [log], candidates=False)
    passages = chosen_passages(case, 0.5, 2)
    found = stepping(case, passages, commands=True).positions()
    drake = simulations(case, passages, commands=True)(log.name)
    for passage, steps in zip(passages, found, strict=True):
        exact = drake.positions(passage)
        assert np.ptp(exact, axis=0).min() > 0.05
        assert np.abs(steps - exact).max() < 2e-3


def test_a_robot_that_flies_apart_has_no_positions(arm):
    """From where it is too fast on."""
    log, model = arm
    case = open_case(model, [log], candidates=False)
    whole = stepping(case, chosen_passages(case, 0.5, 4), commands=True)
    slow = replace(whole, fastest=5e-7 * whole.fastest).positions()
    gone = np.array([np.isnan(positions).all(axis=1) for positions in slow])
    assert 0.1 < gone.mean() < 0.9 and (np.diff(gone.astype(int)) >= 0).all()
    assert np.isfinite(whole.positions()).all()
