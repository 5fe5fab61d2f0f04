"""Rollouts under logged efforts and under commands, against SciPy, MuJoCo and Pinocchio."""

import dataclasses
import json
import sys
from dataclasses import replace
from importlib.resources import as_file, files

import numpy as np
import pytest
from pinocchio_logs import MODELS, effort_log
from scipy.integrate import solve_ivp
from two_masses import INERTIA, WEIGHT
from typer.testing import CliRunner

from diagrams.benchmarks.simulated.servos import STEP, Servos, simulated
from diagrams.harness import sines
from geodrake import effects, load_model, save_model
from geodrake.cli.app import app
from geodrake.control import EffectForce, roll_out
from geodrake.control.rollout import commanded_motions
from geodrake.control.rollout.passages import Conditions, chosen_passages
from geodrake.control.rollout.simulation import simulations
from geodrake.control.rollout.stepping import Stepping
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
from geodrake.effects.robot_motion import log_number
from geodrake.errors import ArgumentError, LogError
from geodrake.identification.logs.case import prepare_case
from geodrake.logs import JointLog, read_log, write_log
from geodrake.model import EffortSignal
from geodrake.report import About, page_of, render
from geodrake.report.explaining import motion_values
from geodrake.report.json_output import record
from geodrake.report.views import numbers_of
from geodrake.robot import gears
from geodrake.robot.transmission.schema import Drive

pytest.importorskip("pinocchio")


ARM, PENDULUM = MODELS / "arm6.urdf", MODELS / "double_pendulum.urdf"


@pytest.fixture(scope="module")
def plain():
    """Return a log of an arm without hidden effects."""
    return effort_log("arm6", 2, share=0.0, duration=6.0).log


@pytest.fixture(scope="module")
def frictional():
    """Return a log of a pendulum with friction, and the model that has it."""
    sizes, model = {"shoulder": 0.3, "elbow": 0.15}, load_model(PENDULUM)

    def friction(seen):
        return np.array([*sizes.values()]) * (np.tanh(seen.v / 5e-3) + seen.v)

    effects = [
        FittedEffect(kind(joint), np.array([size]))
        for joint, size in sizes.items()
        for kind in (CoulombFriction, ViscousFriction)
    ]
    log = effort_log("double_pendulum", 2, friction, share=0.01, duration=8.0).log
    return log, replace(model, effects=tuple(effects))


def test_the_true_model_stays_with_the_motion(plain):
    """Pinocchio's efforts move Drake's robot along the motion."""
    rollout = roll_out(load_model(ARM), [plain], most=6)
    assert rollout.relative < 2e-3
    assert rollout.broken == 0
    assert len(rollout.windows) == 6


def test_command(frictional, tmp_path, monkeypatch):
    log, having_it = frictional
    write_log(log, tmp_path / "log.csv")
    save_model(having_it, tmp_path / "arm.yaml")
    monkeypatch.chdir(tmp_path)
    arguments = ["rollout", "arm.yaml", "log.csv", "--before", str(PENDULUM), "--windows", "2"]
    written = ["--horizon", "0.2", "--json", "r.json", "--report", "r.html"]
    result = CliRunner().invoke(app, [*arguments, *written])
    assert result.exit_code == 0, result.output
    numbers = json.loads((tmp_path / "r.json").read_text())
    assert numbers["relative"] < numbers["before"]["relative"]
    assert "chart-rollout" in (tmp_path / "r.html").read_text()
    ignored = ["--save", "x.yaml"], ["--blocks", "4"]  # only a fit saves
    for wrong in (["--horizon", "-1"], ["--windows", "0"], *ignored):
        bad = CliRunner().invoke(app, [*arguments[:3], *wrong])
        assert bad.exit_code == 2
        assert "Traceback" not in bad.output
    told = CliRunner().invoke(app, ["rollout", "--help"], env={"COLUMNS": "200"}).output
    assert "--before" in told
    assert {"--fit", "--save"} <= set(told.split())
    assert "--blocks" not in told.split()


def test_what_cannot_be_simulated(plain):
    with pytest.raises(ArgumentError, match=r"horizon must be .*0\.001 to 1000"):
        roll_out(load_model(ARM), [plain], horizon=0.0)
    with pytest.raises(LogError, match="s of motion without a gap"):
        roll_out(load_model(ARM), [plain], horizon=60.0)


def test_a_robot_that_is_thrown_about_goes_as_its_diagram(monkeypatch):
    """Without its payload and friction, the demo's wrist turns some hundred times too far."""
    with as_file(files("geodrake") / "demo") as demo:
        model, log = load_model(demo / "demo.urdf"), read_log(demo / "demo.csv")
    found = roll_out(model, [log], horizon=0.1)
    rolling = sys.modules[roll_out.__module__]
    monkeypatch.setattr(rolling, "can_step", lambda model: False)
    theirs = roll_out(model, [log], horizon=0.1)
    assert 20.0 < theirs.relative != found.relative
    for window, other in zip(found.windows, theirs.windows, strict=True):
        size = np.abs(other.departure).max()
        np.testing.assert_allclose(window.simulated, other.simulated, rtol=0.0, atol=0.02 * size)


FIRST_STAMP, RATE = 100.0, 250.0
LOSS = (effects.ViscousFriction("hinge"), [0.1])


def drive(t):
    """Return the effort of the motor, N·m."""
    return 3.0 * np.sin(2.1 * t) + 1.5 * np.sin(5.3 * t + 1.0)


def swung(name, needed, rate=lambda t, v, z: 0.0, *, start=(0.1, 0.0, 0.0), seconds=8.0):
    """Return a log of I q̈ + m g l sin q + needed(t, q, v, z) = drive(t), with ż = rate(t, v, z).

    The motion starts with (q, v, z), and the log's first time stamp is FIRST_STAMP.
    """

    def slope(t, x):
        q, v, z = x
        effort = drive(t) - WEIGHT * np.sin(q) - needed(t, q, v, z)
        return [v, effort / INERTIA, rate(t, v, z)]

    time = np.arange(0.0, seconds, 1.0 / RATE)
    x = solve_ivp(slope, (0.0, seconds), start, "RK45", time, rtol=1e-8, max_step=5e-3).y
    return JointLog(
        name, ("hinge",), FIRST_STAMP + time, x[0, :, None], drive(time)[:, None], x[1, :, None]
    )


def departure(model, *logs, having=(), most=2):
    """Return the departure of the pendulum with these effects and its friction."""
    fitted = (effects.FittedEffect(effect, np.array(values)) for effect, values in (LOSS, *having))
    robot = dataclasses.replace(model, effects=tuple(fitted))
    return roll_out(robot, logs, most=most, bandwidth=8.0).relative


def test_friction_of_a_hinge_is_that_of_the_temperatures_in_the_log(pendulum):
    def temperature(t):
        return 30.0 + 15.0 * np.sin(0.2 * t)

    def needed(t, q, v, z):
        change = -0.03 * np.tanh(v / 0.02) - 0.02 * v
        return 0.5 * np.tanh(v / 0.02) + 0.1 * v + (temperature(t) - 30.0) * change

    warm = (effects.ThermalFriction("hinge", 30.0), [-0.03, -0.02])
    having = (effects.CoulombFriction("hinge"), [0.5]), warm
    log = swung("heating", needed, seconds=14.0)
    readings = np.round(temperature(log.time - FIRST_STAMP), 1)[:, None]
    read = dataclasses.replace(log, temperature=readings)
    known, warm = (departure(pendulum, each, having=having, most=3) for each in (read, log))
    assert known < 1e-2
    assert warm > 20 * known  # without readings it stays at 30 °C


def test_contact_acts_in_its_log_and_at_its_time(pendulum):
    """The rod's end is pushed along x, in the second of two logs alone."""
    push, start, end = 12.0, 1.5, 6.5

    def pushed(t, q, v, z):
        within = np.tanh((t - start) / 0.02) - np.tanh((t - end) / 0.02)
        # The end is at x = −0.6 sin q, z = −0.6 cos q.
        return 0.1 * v - 0.5 * within * push * 0.6 * np.cos(q)

    logs = swung("first", lambda t, q, v, z: 0.1 * v), swung("second", pushed)

    def departs(log, later=0.0):
        span = start + later, end + later
        contact = effects.Contact("rod", *span, 0.02, log_number(log), 0.0, 0.0, -0.6)
        return departure(pendulum, *logs, having=[(contact, [push, *np.zeros(5)])], most=4)

    right = departs("second")
    assert right < 1e-3
    assert min(departs("first"), departs("second", 3.0)) > 100 * right


@dataclasses.dataclass(frozen=True)
class Unbent(effects.Hysteresis):
    """Bristles that start undeflected in every simulation."""

    def states_along(self, motion):
        return np.zeros((len(motion.v), 1))


def test_bristles_start_as_bent_as_the_motion_left_them(pendulum):
    angle, size = 0.4, 2.0
    log = swung(
        "bristles",
        lambda t, q, v, z: 0.1 * v + size * z,
        lambda t, v, z: (v - abs(v) * z) / angle,
        start=(0.1, 1.0, 1.0),  # a joint that moves as its log begins is taken to have slipped
    )
    bent, unbent = (
        departure(pendulum, log, having=[(kind("hinge", angle), [size])])
        for kind in (effects.Hysteresis, Unbent)
    )
    assert bent < 1e-3
    assert unbent > 100 * bent


def test_states_of_bristles_are_those_of_the_system(pendulum):
    bristles = effects.Hysteresis("hinge", 0.4)
    system = EffectForce(pendulum.plant, [(bristles, [2.0])])
    context = system.CreateDefaultContext()
    system.GetInputPort("state").FixValue(context, np.zeros(2))
    port = system.GetOutputPort("generalized_force")
    assert port.Eval(context) == 0.0
    system.set_hidden_states(context, {bristles: [-0.7]})
    np.testing.assert_allclose(port.Eval(context), 0.7 * 2.0)
    other = effects.Hysteresis("hinge", 0.1)
    for states in ({bristles: [0.1, 0.2]}, {bristles: 0.1}, {other: [0.1]}, {LOSS[0]: []}):
        with pytest.raises(ArgumentError, match=r"hidden state here|the state of hysteresis"):
            system.set_hidden_states(context, states)


LINK_INERTIA = """<inertial><origin xyz="0 0 0.2"/><mass value="1.5"/>
  <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>"""
URDF = """<robot name="arm"><link name="base"/>
  <link name="one">INERTIAL</link><link name="two">INERTIAL</link>
  <joint name="a" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 1 0"/>
    LIMIT</joint>
  <joint name="b" type="revolute"><parent link="one"/><child link="two"/><axis xyz="0 1 0"/>
    <origin xyz="0 0 0.4"/>LIMIT</joint>
</robot>""".replace("INERTIAL", LINK_INERTIA)
URDF = URDF.replace("LIMIT", '<limit lower="-9" upper="9" effort="999" velocity="99"/>')
KP, KD, LIMIT, VISCOUS, ARMATURE = (
    np.array(values) for values in ([90.0, 40.0], [5.0, 2.0], [14.0, 1e6], [0.6, 0.3], [0.05, 0.03])
)
DELAY, EVERY = 0.03, 5  # s, and steps from row to row


def told_log(seconds=8.0, seed=1):
    """Return a log of commands with true efforts, by Pinocchio."""
    rng = np.random.default_rng(seed)
    waves = rng.uniform(1.0, 6.0, (2, 3)).T, rng.uniform(0.0, 2 * np.pi, (2, 3)).T
    time = np.arange(0.0, seconds, STEP)
    command = sines(time, np.full((3, 2), 0.35), *waves)[0]
    none = np.zeros(2)
    servos = Servos(KP, KD, True, DELAY, VISCOUS, none, ARMATURE, LIMIT, none, none)
    made = simulated("pinocchio", URDF, servos, command)
    time, command, position, velocity, effort = (x[::EVERY] for x in (time, command, *made))
    return JointLog("arm", ("a", "b"), time, position, effort, velocity, command=command)


def knowing(model, turns=1.0):
    """Return the model with its servos and effects, for motors that turn faster by a ratio."""
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
    """Return a log, and the model that knows its servos and effects."""
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(URDF)
    return told_log(), knowing(load_model(path))


def without_efforts(log, *joints):
    effort = log.effort.copy()
    for joint in joints:
        effort[:, log.joints.index(joint)] = np.nan
    return replace(log, effort=effort)


def test_servos_at_motors_behind_gears(arm):
    """Motors that turn N times as fast need stiffness and damping divided by N²."""
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
    """Servos are known; effects at the joints are added one by one."""
    model, log = arm[1], told_log(seconds=2.5)
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


def test_steps_move_a_rigid_robot_as_drake_does(arm):
    """It has load-dependent friction, bristles, a wrong gain, integrals, a limit and backlash."""
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
    case = prepare_case(robot, [log], candidates=False)
    passages = chosen_passages(case, 0.5, 2)
    found = Stepping(Conditions(case, True), passages).positions()
    drake = simulations(Conditions(case, True), passages)(log.name)
    for passage, steps in zip(passages, found, strict=True):
        exact = drake.positions(passage)
        assert np.ptp(exact, axis=0).min() > 0.05
        assert np.abs(steps - exact).max() < 2e-3
