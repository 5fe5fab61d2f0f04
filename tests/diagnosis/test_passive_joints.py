"""Joints without a motor: an acrobot of MuJoCo, whose shoulder nobody drives or measures."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from geodrake import load_model
from geodrake.diagnosis import compare, explain
from geodrake.errors import LogError
from geodrake.identification import identify_model
from geodrake.identification.logs.case import open_case
from geodrake.logs.files import Reading, read_log, read_mapping, write_log
from geodrake.model.logged_joints import reading_for

ACROBOT = """<mujoco><option timestep="0.0005"/><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0" damping="{shoulder}"/>
    <inertial pos="0 0 -0.25" mass="1.2" diaginertia="0.02 0.02 0.002"/>
    <body name="lower" pos="0 0 -0.5">
      <joint name="elbow" axis="0 1 0" frictionloss="{friction}"/>
      <inertial pos="0 0 -0.2" mass="{mass}" diaginertia="0.01 0.01 0.001"/></body></body>
  </worldbody><actuator><motor joint="elbow"/></actuator></mujoco>"""
HEADER = "time,shoulder.position,elbow.position,elbow.effort"


def text(shoulder=0.0, friction=0.0, mass=0.8):
    return ACROBOT.format(shoulder=shoulder, friction=friction, mass=mass)


def simulated(xml, seed, seconds=16.0):
    """(N, 4) time, positions and the elbow's effort with noise, as a servo swings the elbow."""
    model, rng = mujoco.MjModel.from_xml_string(xml), np.random.default_rng(seed)
    data, rows = mujoco.MjData(model), []
    phase, rate, size = (rng.uniform(*ends, 4) for ends in ((0, 6.3), (0.2, 1.1), (0.3, 0.7)))
    data.qpos[:] = rng.normal(0.0, 0.3, 2)
    for k in range(int(seconds / model.opt.timestep)):
        time = k * model.opt.timestep
        wanted = size @ np.sin(2 * np.pi * rate * time + phase)
        data.ctrl[0] = 12.0 * (wanted - data.qpos[1]) - 0.8 * data.qvel[1]
        if k % 8 == 0:
            rows.append([time, *data.qpos, data.ctrl[0]])
        mujoco.mj_step(model, data)
    table = np.array(rows)
    return table + rng.normal(0.0, 1.0, table.shape) * [0.0, 2e-5, 2e-5, 0.02]


@pytest.fixture
def files(tmp_path):
    """What writes a model file and two logs of another robot."""

    def write(**truth):
        (tmp_path / "acrobot.xml").write_text(text())
        logs = [tmp_path / f"log{seed}.csv" for seed in (1, 2)]
        for seed, path in enumerate(logs):
            table = simulated(text(**truth), seed)
            np.savetxt(path, table, delimiter=",", header=HEADER, comments="")
        return load_model(tmp_path / "acrobot.xml"), logs

    return write


def test_friction_and_mass_of_both_links_are_found_without_the_effort_of_one(files):
    model, logs = files(shoulder=0.08, friction=0.3, mass=1.2)
    found = explain(model, logs)
    steps = {step.effect: step for step in found.steps}
    assert steps["coulomb_friction"].where == ("elbow",)
    assert "shoulder" in steps["viscous_friction"].where
    viscous = steps["viscous_friction"].parameters["shoulder"]["viscous"]
    assert viscous == pytest.approx(0.08, rel=0.05)
    phi = found.model.phi
    assert phi[1, 0] == pytest.approx(1.2, rel=0.05)
    assert phi[0, 0] == pytest.approx(1.2, rel=0.1)
    assert not {"backlash", "effort_offset", "rotor_inertia", "torque_ripple"} & steps.keys()
    assert any("shoulder has no motor by the model" in note for note in found.notes)
    assert found.model.motorless == ("shoulder",)


def test_an_exact_model_misses_nothing(files):
    model, logs = files()
    found = explain(model, logs)
    assert found.steps == ()
    error = compare(model, logs).errors
    assert error.nrms < 0.02


def test_the_likelihood_does_not_depend_on_the_scale_of_what_nobody_measured(files):
    """The shoulder alone tells ratios: with its equations only, bodies of any scale are as good."""
    model, logs = files()
    case = open_case(model, logs, candidates=False)
    dataset, j = case.dataset, model.joints.index("shoulder")
    columns = np.arange(model.phi.size)
    phi = model.phi.ravel()
    data, local = dataset.data[j], dataset.data[j].local(columns)
    own = [np.einsum("ij,j->i", R[:, local], phi) for R in data.factors]
    for scale in (0.5, 1.0, 3.0):
        squares = scale**2 * sum(map(float, map(np.dot, own, own)))
        power = np.zeros(len(model.joints))
        power[j] = squares
        pull = dataset.passive_pull(columns, scale * phi, power)
        # Shrinking by noise and growing by the inertia cancel: d/ds of (‖Yφ‖² s² / 2 − p log s).
        assert pull @ (scale * phi) == pytest.approx(squares, rel=1e-9)
    assert dataset.inertias(columns, phi)[j] == pytest.approx(1.0)


@pytest.mark.parametrize("said", ["option", "mapping", "zeros"])
def test_a_log_says_in_several_ways_that_a_joint_has_no_motor(files, tmp_path, said):
    _, (path, _) = files()
    reading = Reading(kinds={"shoulder": "passive"})
    if said == "mapping":
        (tmp_path / "m.yaml").write_text(
            "time: time\njoints:\n  shoulder: {position: shoulder.position, effort: passive}\n"
            "  elbow: {position: elbow.position, effort: elbow.effort}\n"
        )
        reading = Reading(mapping=read_mapping(tmp_path / "m.yaml"))
    elif said == "zeros":
        table = np.loadtxt(path, delimiter=",", skiprows=1)
        table = np.column_stack([table, np.zeros(len(table))])
        path = tmp_path / "zeros.csv"
        np.savetxt(path, table, delimiter=",", header=f"{HEADER},shoulder.effort", comments="")
        reading = Reading(motorless=frozenset(["shoulder"]))
    log = read_log(path, reading=reading)
    assert log.passive == ("shoulder",)
    assert not log.effort[:, log.joints.index("shoulder")].any()
    assert log.gain_deviations[log.joints.index("shoulder")] == 0.0
    write_log(log, tmp_path / "again.csv")
    assert read_log(tmp_path / "again.csv").passive == ("shoulder",)


def test_what_has_a_motor_by_the_model_is_asked_for(files, tmp_path):
    model, (path, _) = files()
    assert reading_for(model).motorless == {"shoulder"}
    driven = text().replace(
        '<motor joint="elbow"/>', '<motor joint="elbow"/><motor joint="shoulder"/>'
    )
    (tmp_path / "driven.xml").write_text(driven)
    driven = load_model(tmp_path / "driven.xml")
    with pytest.raises(LogError, match="without effort of shoulder") as caught:
        explain(driven, [path])
    assert "--passive shoulder" in caught.value.advice
    log = read_log(path, reading=Reading(kinds={"shoulder": "passive"}))
    zeros = replace(log, effort_kinds={})
    with pytest.raises(LogError, match="never changes") as caught:
        compare(driven, [zeros])
    assert "--passive shoulder" in caught.value.advice


def test_motors_that_logs_do_not_agree_on(files):
    model, paths = files()
    first, second = (read_log(path, reading=reading_for(model)) for path in paths)
    driven = replace(second, effort_kinds={}, effort=np.sin(second.position))
    none = [replace(log, effort_kinds=dict.fromkeys(log.joints, "passive")) for log in (first,)]
    with pytest.raises(LogError, match="not in both"):
        compare(model, [first, driven])
    with pytest.raises(LogError, match=r"No joint of log .* has a motor"):
        compare(model, none)


def test_identify_says_that_it_fits_measured_efforts_alone(files):
    model, logs = files()
    with pytest.raises(LogError, match="shoulder has no motor"):
        identify_model(model, logs)
