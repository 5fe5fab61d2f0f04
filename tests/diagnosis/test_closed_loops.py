"""Closed loops from logs to names: MuJoCo moves a four-bar, and geodrake names what is missing."""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from closed_loops import four_bar, leg

from geodrake import load_model, save_model
from geodrake.control import roll_out
from geodrake.diagnosis import compare, explain
from geodrake.errors import LogError
from geodrake.logs import JointLog, read_log
from geodrake.model import model_of_logs
from geodrake.model.logged_joints import log_of_model, reading_for
from geodrake.robot import joint_names

STEP, RATE = 5e-4, 200.0
WAVES = 2 * np.pi * np.array([0.21, 0.33, 0.5, 0.81, 1.1, 1.6])
SIZES = np.array([0.5, 0.3, 0.2, 0.12, 0.1, 0.05])


@cache
def moved(text, seed, motors=("crank",), gains=(60.0,), size=1.0, seconds=8.0):
    """Return MuJoCo's model with stiff constraints, and rows of time, efforts and positions."""
    m, rng = mujoco.MjModel.from_xml_string(text), np.random.default_rng(seed)
    m.opt.timestep, m.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    m.eq_solref[:], m.eq_solimp[:] = [1e-3, 1], [0.9999, 0.9999, 0.001, 0.5, 2]
    data, rows = mujoco.MjData(m), []
    phases, gains = rng.uniform(0, 2 * np.pi, (len(motors), len(WAVES))), np.array(gains)
    at = [m.joint(name).dofadr[0] for name in motors]
    for k in range(int(seconds / STEP)):
        turns = WAVES * k * STEP + phases
        wanted = size * (np.sin(turns) - np.sin(phases)) @ SIZES - data.qpos[at]
        data.ctrl[:] = gains * (wanted + 0.05 * (size * np.cos(turns) @ (SIZES * WAVES)))
        data.ctrl[:] -= 0.05 * gains * data.qvel[at]
        if k % round(1.0 / RATE / STEP) == 0:
            rows.append([k * STEP, *data.ctrl, *data.qpos])
        mujoco.mj_step(m, data)
    return m, np.array(rows)


def simulated(text, seconds=8.0, seed=0, noise=0.002, joints=("crank",)):
    """Return time, positions (N, n) of joints and noisy efforts (N,) at the crank."""
    m, rows = moved(text, seed)
    time, effort, *places = rows[: int(seconds * RATE)].T
    effort = effort + noise * np.random.default_rng(seed).normal(size=len(effort))
    return time, np.stack([places[m.joint(name).qposadr[0]] for name in joints], 1), effort


def log_of(text, name="log", **options):
    time, places, effort = simulated(text, **options)
    return JointLog(name, ("crank",), time, places, effort[:, None])


def model_of(folder, text=None):
    path = folder / "robot.xml"
    path.write_text(text or four_bar())
    return load_model(path)


def test_a_four_bar_that_is_its_file_is_adequate(tmp_path):
    found = explain(model_of(tmp_path), [log_of(four_bar())])
    assert found.verdict == "adequate"


def test_a_heavier_rocker_is_named(tmp_path):
    found = explain(model_of(tmp_path), [log_of(four_bar(mass=1.6), seed=2)])
    (step, *_) = found.steps
    assert step.where == ("rocker",) and step.effect in ("payload", "wrong_inertia")
    assert found.end.nrms < 0.1 * found.start.nrms


def test_hidden_friction_of_a_joint_without_a_motor_is_named(tmp_path):
    hidden = 'damping=".1" armature=".01" frictionloss=".15"'
    log = log_of(four_bar(rocker=hidden), seed=1)
    found = explain(model_of(tmp_path), [log])
    (step, *_) = found.steps
    assert (step.effect, step.where) == ("coulomb_friction", ("rocker",))
    assert step.parameters["rocker"]["coulomb"] == pytest.approx(0.15, abs=0.02)


def test_a_rollout_goes_with_mujocos_simulation(tmp_path):
    log = log_of(four_bar(), noise=0.0)
    found = roll_out(model_of(tmp_path), [log], horizon=0.2, most=4)
    assert found.relative < 0.01 and not found.broken


def two_joints(places, efforts):
    time = np.arange(len(places)) / RATE
    return JointLog("log", ("crank", "rocker"), time, places, efforts)


def test_efforts_of_a_second_motor_go_to_the_free_joint(tmp_path):
    model = model_of(tmp_path, four_bar(motors="crank rocker"))
    assert any("more motors than degrees of freedom" in note for note in model.notes)
    time, places, _ = simulated(four_bar(), seconds=2.0, joints=("crank", "rocker"))
    efforts = np.random.default_rng(0).normal(size=places.shape)
    log = log_of_model(two_joints(places, efforts), model)
    G = np.gradient(places[:, 1], places[:, 0])
    inner = np.abs(np.gradient(places[:, 0])) > 2e-3
    expected = efforts[:, 0] + G * efforts[:, 1]
    np.testing.assert_allclose(log.effort[inner, 0], expected[inner], atol=0.02)
    assert any("rocker is added to that of crank" in note for note in log.notes)
    with pytest.raises(
        LogError, match="no effort of rocker, which has a motor in addition to crank"
    ):
        log_of_model(JointLog("log", ("crank",), time, places[:, :1], efforts[:, :1]), model)


def odd(log, model):
    return [note for note in log_of_model(log, model).notes if "differs from its position" in note]


def test_a_log_that_contradicts_the_loop_is_told(tmp_path):
    model = model_of(tmp_path)
    time, places, effort = simulated(four_bar(), joints=("crank", "rocker"))
    places = places + 1e-3 * np.random.default_rng(0).normal(size=places.shape)
    efforts = np.column_stack([effort, 0.0 * effort])
    assert not odd(two_joints(places, efforts), model)
    places[:, 1] += 0.05
    (said,) = odd(two_joints(places, efforts), model)
    assert (
        "rocker differs from its position in the closed loop of <connect> of coupler and rocker"
        in said
    )
    assert "by 0.05" in said
    head = "time,crank.position,crank.effort,rocker.position"
    table = np.column_stack([time, places[:, 0], effort, places[:, 1]])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=head, comments="")
    found = compare(model, [tmp_path / "log.csv"])
    assert any(
        "rocker differs from its position in the closed loop" in note for note in found.notes
    )


def test_a_log_of_another_joint_of_the_loop_is_refused(tmp_path):
    time, places, effort = simulated(four_bar(), seconds=2.0, joints=("rocker",))
    log = JointLog("log", ("rocker",), time, places, effort[:, None])
    fitted = replace(model_of(tmp_path), fitted_to=("other",))
    with pytest.raises(LogError, match="has rocker of a closed loop, but not crank"):
        model_of_logs(fitted, [log])
    with pytest.raises(
        LogError, match="no effort of crank, which has a motor in addition to rocker"
    ):
        log_of_model(log, model_of_logs(model_of(tmp_path), [log]))


def test_joints_lead_that_logs_have(tmp_path):
    model = model_of(tmp_path, four_bar(motors=""))
    time, places, effort = simulated(four_bar(), seconds=4.0, joints=("crank", "rocker"))
    log = JointLog("log", ("rocker",), time, places[:, 1:], effort[:, None])
    led = model_of_logs(model, [log])
    assert model.joints == ("crank",) and led.joints == ("rocker",)
    assert any("rocker is independent, as in the logs" in note for note in led.notes)
    save_model(led, tmp_path / "led.yaml")
    assert load_model(tmp_path / "led.yaml").joints == ("rocker",)
    q = np.linspace(-0.2, 0.4, 5)[:, None]  # below, the rocker turns back
    still = np.zeros_like(q)
    theta = model.coordinates.tree_samples(q, still + 1.0, still)[0]
    rocker, at = joint_names(model.plant).index("rocker"), joint_names(led.plant).index("crank")
    again = led.coordinates.joint_positions(theta[:, [rocker]])
    np.testing.assert_allclose(again[:, at], q[:, 0], atol=1e-9)


def test_a_log_beyond_the_loop_says_where(tmp_path):
    model = model_of(tmp_path, four_bar().replace('pos="0.3 0 -0.1"', 'pos="0.42 0 0"'))
    places = np.outer(np.sin(np.arange(400) / RATE), [2.0, 1.0])
    with pytest.raises(LogError, match=r"closed loop .* does not close at crank = "):
        log_of_model(two_joints(places, np.ones((400, 2))), model)


def test_springs_of_a_leg_are_joints_without_a_motor(tmp_path):
    motors, springs, text = ("hip", "knee", "crank"), ("shin", "heel"), leg()
    m, rows = moved(text, 0, motors, (800.0, 400.0, 80.0), 0.4)
    efforts = rows[:, 1:4] + 0.02 * np.random.default_rng(0).normal(size=(len(rows), 3))
    places = [4 + m.joint(name).qposadr[0] for name in (*motors, *springs)]
    rows = np.column_stack([rows[:, 0], efforts, rows[:, places]])
    head = ["time", *(f"{j}.effort" for j in motors)]
    head += [f"{j}.position" for j in (*motors, *springs)]
    np.savetxt(tmp_path / "leg.csv", rows, delimiter=",", header=",".join(head), comments="")
    model = model_of(tmp_path, text)
    log = read_log(
        tmp_path / "leg.csv", joints=model.known_joints, partial=True, reading=reading_for(model)
    )
    model = model_of_logs(model, [log])
    assert set(model.joints) == {"hip", "knee", "shin", "heel", "crank"}
    assert set(log.passive) == set(springs)
    errors = {joint.joint: joint for joint in compare(model, [log]).errors.joints}
    for motor in motors:
        assert errors[motor].rms < 1.5 * errors[motor].floor
