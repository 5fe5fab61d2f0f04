"""Joints without motors, and joints at rest."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from acrobot_logs import HEADER, simulated, text

from geodrake import load_model
from geodrake.diagnosis import add, compare, explain
from geodrake.effects import CoulombFriction, ViscousFriction
from geodrake.errors import ArgumentError, LogError
from geodrake.identification import IdentificationSettings, identify_model
from geodrake.logs import JointLog, Reading, read_log, write_log
from geodrake.logs.files import read_mapping
from geodrake.model.logged_joints import reading_for


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
    assert any("shoulder has no motor in the model" in note for note in found.notes)
    assert found.model.motorless == ("shoulder",)


def test_an_exact_model_misses_nothing(files):
    model, logs = files()
    found = explain(model, logs)
    assert found.steps == ()
    assert found.end.nrms < 0.02


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
    with pytest.raises(LogError, match="has positions but no efforts of shoulder") as caught:
        explain(driven, [path])
    assert "--passive shoulder" in caught.value.advice
    log = read_log(path, reading=Reading(kinds={"shoulder": "passive"}))
    zeros = replace(log, effort_kinds={})
    found = compare(driven, [zeros])
    assert "the effort of shoulder is 0 in 100 % of the rows" in found.first[0]
    assert "--passive shoulder" in found.first[0]
    assert [each.joint for each in found.errors.joints] == ["elbow"]
    still = replace(zeros, effort=np.zeros_like(zeros.effort))
    with pytest.raises(LogError, match="is constant") as caught:
        compare(driven, [still])
    assert "--passive shoulder" in caught.value.advice


def test_motors_that_logs_do_not_agree_on(files):
    model, paths = files()
    first, second = (read_log(path, reading=reading_for(model)) for path in paths)
    driven = replace(second, effort_kinds={}, effort=np.sin(second.position))
    none = [replace(log, effort_kinds=dict.fromkeys(log.joints, "passive")) for log in (first,)]
    with pytest.raises(LogError, match="has a motor in only one of"):
        compare(model, [first, driven])
    with pytest.raises(LogError, match=r"No joint of log .* has a motor"):
        compare(model, none)


@pytest.mark.parametrize("regularizer", ["entropic", "pullback"])
def test_identify_fits_bodies_beside_a_joint_without_a_motor(files, regularizer):
    model, logs = files(shoulder=0.08, friction=0.3, mass=1.2)
    settings = IdentificationSettings(regularizer=regularizer, gamma=1.0)
    effects = [ViscousFriction("shoulder"), CoulombFriction("elbow")]
    found = identify_model(model, logs, settings, effects=effects)
    phi = found.model.phi
    assert phi[:, 0] == pytest.approx([1.2, 1.2], rel=0.05)
    known = {f.effect.name: f.parameters[0] for f in found.model.effects}
    assert known["viscous_friction"] == pytest.approx(0.08, rel=0.05)
    assert known["coulomb_friction"] == pytest.approx(0.3, rel=0.1)
    assert found.model.motorless == ("shoulder",)
    assert found.after.nrms < 0.1 * found.before.nrms


def test_positions_beyond_the_limits_of_a_file_are_noted(files, tmp_path):
    _, logs = files()
    joint = '<joint name="elbow"'
    (tmp_path / "narrow.xml").write_text(text().replace(joint, f'{joint} range="-20 20"'))
    narrow = load_model(tmp_path / "narrow.xml")  # ±0.35 rad
    (said,) = [n for n in compare(narrow, logs[:1]).notes if "exceed the model's limits" in n]
    assert "elbow in" in said
    assert "of log 'log1'" in said


pinocchio = pytest.importorskip("pinocchio")

ARM = Path(__file__).parents[2] / "models" / "arm7.urdf"
MOVING = (1, 3)
COULOMB, VISCOUS = np.array([1.8, 1.1]), np.array([0.7, 0.5])
STEP, NOISE = 1e-4, 0.05


def braked_log(seed, *, seconds=40.0):
    """Return a log in which two joints swing; efforts of others are off by up to 1 N·m."""
    rng = np.random.default_rng(seed)
    robot = pinocchio.buildModelFromUrdf(str(ARM))
    data, time = robot.createData(), np.arange(0.0, seconds, 0.01)
    q, v, vd = np.zeros((3, len(time), robot.nv))
    q += rng.uniform(-0.7, 0.7, robot.nv)
    for j in MOVING:
        for rate in 2.0 * np.pi * rng.uniform(0.1, 0.5, 4):
            size, angle = rng.uniform(0.1, 0.35), rate * time + rng.uniform(0.0, 6.3)
            q[:, j] += size * np.sin(angle)
            v[:, j] += size * rate * np.cos(angle)
            vd[:, j] -= size * rate**2 * np.sin(angle)
    effort = np.array([pinocchio.rnea(robot, data, *row) for row in zip(q, v, vd, strict=True)])
    effort += np.where(np.isin(np.arange(robot.nv), MOVING), 0.0, rng.uniform(-1.0, 1.0, robot.nv))
    effort[:, MOVING] += COULOMB * np.sign(v[:, MOVING]) + VISCOUS * v[:, MOVING]
    return JointLog(
        f"braked {seed}",
        tuple(robot.names)[1:],
        time,
        np.round(q / STEP) * STEP,
        effort + NOISE * rng.normal(size=effort.shape),
        velocity=v + 0.02 * rng.normal(size=v.shape),
    )


MODEL = load_model(ARM)


def test_friction_of_the_joints_that_move_is_all_that_is_found():
    found = explain(MODEL, [braked_log(0, seconds=24.0)])
    assert found.model.joints == ("joint_2", "joint_4")
    assert {step.effect for step in found.steps} == {"coulomb_friction", "viscous_friction"}
    values = {f.effect.name: [] for f in found.model.effects}
    for fitted in found.model.effects:
        values[fitted.effect.name].append(fitted.parameters[0])
    np.testing.assert_allclose(values["coulomb_friction"], COULOMB, rtol=0.05)
    np.testing.assert_allclose(values["viscous_friction"], VISCOUS, rtol=0.1)
    assert found.verdict == "explained"
    (note,) = (note for note in found.notes if "--no-auto-lock" in note)
    assert all(f"joint_{k} at" in note for k in (1, 3, 5, 6, 7))


def test_identification_holds_the_same_joints():
    settings = IdentificationSettings(gamma=100.0)
    found = identify_model(MODEL, [braked_log(1)], settings)
    assert found.model.joints == found.prior.joints == ("joint_2", "joint_4")
    weighed = IdentificationSettings(gamma=100.0, total_mass=float(MODEL.phi[:, 0].sum()))
    assert identify_model(MODEL, [braked_log(1)], weighed).model.joints == MODEL.joints


@pytest.mark.parametrize(
    ("effect", "place", "words"),
    [
        ("payload", "link_7", "link_7 is part of link_4, as nothing moves between them"),
        ("coulomb_friction", "joint_5", "joint_5 is fixed by .* hardly moves"),
    ],
)
def test_nothing_is_added_where_nothing_moves(effect, place, words):
    with pytest.raises(ArgumentError, match=words):
        add(effect, MODEL, [braked_log(3, seconds=20.0)], where=[place])
