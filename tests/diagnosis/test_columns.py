"""Mistakes in the columns of logs are named and corrected, and none in right columns."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chain_logs import chain_log
from excitation_robots import arm as chain
from measurements import DATA, REFERENCE
from pendulum_logs import PENDULUM, body_effort
from pinocchio_logs import effort_log

from diagrams.benchmarks.column_errors import DURATION, WrongLog, make_log
from diagrams.benchmarks.simulated.engines import robot_file
from geodrake import load_model
from geodrake.cli.command import unchecked_words
from geodrake.control.export_proof.joints import exported_joints
from geodrake.diagnosis import check_columns, compare, corrected, with_motor_limits
from geodrake.diagnosis.columns import ColumnFinding
from geodrake.diagnosis.columns.kinds import words_of
from geodrake.effects import FittedEffect, JointElasticity
from geodrake.errors import ArgumentError
from geodrake.logs import JointLog, read_log
from geodrake.model import EffortSignal, save_model
from geodrake.model.signal_efforts import in_efforts
from geodrake.report import Units
from geodrake.report.explaining import gains_section, limits_section

MODELS = Path(__file__).parents[2] / "models"
JOINTS = ("shoulder", "elbow")


@pytest.fixture(scope="module")
def pendulum():
    return load_model(MODELS / "double_pendulum.urdf")


@pytest.fixture(scope="module")
def right():
    """Return a log of a double pendulum with friction, whose bodies are a tenth off."""
    log = effort_log("double_pendulum", 3, off=0.1, duration=12.0, share=0.01).log
    v = log.velocity
    rubbing = 0.1 * log.effort.std(0) * (np.tanh(v / 0.01) + 0.3 * v)
    return replace(log, effort=log.effort + rubbing)


def times(log, quantity, joint, factor):
    """Return a log with a column multiplied."""
    values = getattr(log, quantity).copy()
    values[:, joint] *= factor
    return replace(log, **{quantity: values})


def swap(log, *quantities):
    return replace(log, **{name: getattr(log, name)[:, ::-1] for name in quantities})


def both(log, joint, factor):
    return times(times(log, "position", joint, factor), "velocity", joint, factor)


MISTAKES = {
    "effort_sign": lambda log: times(log, "effort", 1, -1.0),
    "position_sign": lambda log: both(log, 1, -1.0),
    "swapped_efforts": lambda log: swap(log, "effort"),
    "swapped_joints": lambda log: swap(log, "position", "velocity", "effort"),
    "effort_unit": lambda log: times(log, "effort", 0, 1e3),
    "position_unit": lambda log: both(log, 1, 180.0 / np.pi),
    "velocity_factor": lambda log: replace(log, velocity=20.0 * log.velocity),
    "time": lambda log: replace(log, time=0.1 * log.time),
}


def test_nothing_is_found_in_right_columns(pendulum, right):
    assert check_columns(pendulum, [right]) == ()


@pytest.mark.parametrize("kind", MISTAKES)
def test_mistakes_are_named_and_corrected(pendulum, right, kind):
    wrong = MISTAKES[kind](right)
    (found,) = check_columns(pendulum, [wrong])
    assert found.kind == kind
    assert found.probability > 0.5
    assert found.gain > 0.0
    after = corrected(wrong, [found])
    for name in ("time", "position", "velocity", "effort"):
        scale = np.abs(getattr(right, name)).max(axis=0)
        off = {"time": 1e-3, "velocity_factor": 1e-3}.get(kind, 1e-9)
        np.testing.assert_allclose(
            getattr(after, name) / scale, getattr(right, name) / scale, atol=off
        )


def test_magnitudes_of_efforts_are_said_to_be_magnitudes(pendulum, right):
    (found,) = check_columns(pendulum, [replace(right, effort=np.abs(right.effort))])
    assert (found.kind, found.joints) == ("effort_magnitude", JOINTS)
    assert not found.is_correctable
    assert "never change sign" in str(found)


def test_dry_friction_alone_is_no_limit_of_a_motor(pendulum, right):
    """Nearly constant efforts resemble limited ones."""
    rng, v = np.random.default_rng(1), right.velocity
    own = 0.02 * rng.normal(size=v.shape) + 0.3 * np.tanh(v / 0.005)
    effort = np.column_stack([right.effort[:, 0], own[:, 1]])
    kinds = [found.kind for found in check_columns(pendulum, [replace(right, effort=effort)])]
    assert "effort_limit" not in kinds


@pytest.mark.parametrize("velocity", ["in degrees", "in radians", "none"])
def test_degrees_at_all_joints_are_one_mistake(pendulum, right, velocity):
    factor = 180.0 / np.pi
    rates = {"in degrees": factor * right.velocity, "in radians": right.velocity, "none": None}
    wrong = replace(right, position=factor * right.position, velocity=rates[velocity])
    (found,) = check_columns(pendulum, [wrong])
    alone = "_alone" * (velocity == "in radians")
    assert (found.kind, found.joints) == (f"position{alone}_unit", JOINTS)
    assert "of all joints" in str(found)
    after = corrected(wrong, [found])
    np.testing.assert_allclose(after.position, right.position, rtol=1e-12)
    if velocity != "none":
        np.testing.assert_allclose(after.velocity, right.velocity, rtol=1e-12)


def test_another_zero_is_found_within_the_arm():
    """At the last joint, another zero equals a rotated body."""
    model, log, (secret,) = make_log(
        WrongLog("another zero", "arm6", "pinocchio", "fast", 6, 9, DURATION)
    )
    (found,) = check_columns(model, [log])
    assert (found.kind, found.joints) == ("position_zero", (model.joints[secret.joints[0]],))
    assert found.values[0] == pytest.approx(secret.value, abs=0.05)


@pytest.mark.parametrize(
    "drawn",
    [
        # Leaning by up to 0.3 rad, of bodies a fifth off: zeros and gains of wrists would make up.
        WrongLog("tilted base", "arm6", "mujoco", "fast", 6, 9, DURATION),
        # Of bodies 60 % off, one number for all efforts makes up for the total mass.
        WrongLog("bodies that differ", "arm6", "pinocchio", "slow", 1, 61, DURATION),
    ],
    ids=lambda drawn: drawn.mistake,
)
def test_what_is_not_of_the_columns_is_no_mistake_in_them(drawn):
    model, log, _ = make_log(drawn)
    assert check_columns(model, [log]) == ()


def test_a_gain_is_told_where_its_fit_has_converged(gain=0.29):
    """Its value is that of the answer, and no other gains are named."""
    drawn = WrongLog("gain of a joint", "panda", "pinocchio", "point to point", 14, 9, DURATION)
    model, log, (secret,) = make_log(drawn)
    (j,) = secret.joints
    log = times(log, "effort", j, secret.value / gain)
    (found,) = check_columns(model, [log])
    assert (found.kind, found.joints) == ("effort_gain", (model.joints[j],))
    assert found.values[0] == pytest.approx(gain, rel=0.1)


def test_two_mistakes_are_found_one_after_the_other(pendulum, right):
    wrong = replace(times(right, "effort", 0, 1e3), velocity=-right.velocity)
    found = check_columns(pendulum, [wrong])
    assert {each.kind for each in found} == {"effort_unit", "velocity_factor"}
    after = corrected(wrong, found)
    np.testing.assert_allclose(after.effort, right.effort)
    np.testing.assert_allclose(after.velocity, right.velocity, rtol=0.01)


class TestCorrected:
    FOUND = ColumnFinding(
        "position_sign", ("elbow",), (-1.0,), 50.0, 1.0, (), 1.0, 0.1, "The …", "Correct it."
    )

    def test_what_was_taken_out_stays_so(self, right):
        found = replace(self.FOUND, kind="without_gravity", joints=("shoulder", "elbow"), values=())
        assert corrected(right, [found]) is right
        assert not found.is_correctable

    def test_unknown_joints_are_refused(self, right):
        with pytest.raises(ArgumentError, match="no joint 'wrist'"):
            corrected(right, [replace(self.FOUND, joints=("wrist",))])


@pytest.fixture(scope="module")
def arm():
    model = load_model(REFERENCE / "ur10e.urdf")
    return model, read_log(DATA / "ur10e_free_c.csv", joints=model.known_joints, partial=True)


@pytest.mark.measurements("data/ur10e_free_c.csv", "reference/ur10e.urdf")
class TestMeasured:
    def test_nothing_is_found_in_right_columns(self, arm):
        model, log = arm
        assert check_columns(model, [log]) == ()


@pytest.mark.parametrize(("joints", "kinds"), [(4, ["effort_sign"]), (31, [])])
def test_robots_of_many_joints_are_not_checked(joints, kinds):
    """Their mistakes are too many to compare; a note says so."""
    model = chain(1, joints="R" * joints)
    log = times(chain_log(model, 1, seconds=8.0, rate=50.0), "effort", 3, -1.0)
    assert [finding.kind for finding in check_columns(model, [log])] == kinds
    assert bool(unchecked_words(model, [log])) == (not kinds)


def test_one_log_a_joint_makes_no_mistake_likely():
    """In the usual protocol for friction, the other joints rest under dry friction."""
    rng, time = np.random.default_rng(0), np.arange(0.0, 25.0, 0.005)
    phase = 2.0 * np.pi * rng.uniform(0.1, 0.4, 3)[:, None] * time + rng.uniform(0.0, 6.0, (3, 1))
    rates = np.gradient(phase, time, axis=1)
    size = np.array([0.5, 0.3, 0.1])[:, None]
    logs = []
    for moving in (0, 1):
        q = np.tile([0.3, -0.6], (len(time), 1))
        v, vd = np.zeros_like(q), np.zeros_like(q)
        q[:, moving] += (size * np.sin(phase)).sum(axis=0)
        v[:, moving] = (size * rates * np.cos(phase)).sum(axis=0)
        vd[:, moving] = -(size * rates**2 * np.sin(phase)).sum(axis=0)
        effort = body_effort(q, v, vd) + rng.normal(0.0, 0.01, q.shape)
        effort[:, moving] += 0.4 * np.tanh(v[:, moving] / 1e-3) + 0.2 * v[:, moving]
        effort[:, 1 - moving] += rng.uniform(-0.3, 0.3)
        q += rng.normal(0.0, 1e-5, q.shape)
        logs.append(JointLog(f"joint {moving}", JOINTS, time, q, effort))
    assert check_columns(load_model(PENDULUM), logs) == ()


def test_columns_of_a_robot_with_soft_joints_are_checked():
    """Deflections need samples in time, which columns do not have."""
    rng, time = np.random.default_rng(0), np.arange(0.0, 20.0, 0.005)
    q = np.sin(np.outer(time, [1.9, 3.1]))
    v, vd = [1.9, 3.1] * np.cos(np.outer(time, [1.9, 3.1])), -np.square([1.9, 3.1]) * q
    effort = body_effort(q, v, vd) + rng.normal(0.0, 0.01, q.shape)
    model = load_model(PENDULUM)
    soft = FittedEffect(JointElasticity("elbow"), np.array([1e-4]))
    model = replace(model, effects=(*model.effects, soft))
    log = JointLog("log", JOINTS, time, q, -effort * [1.0, -1.0])
    (found,) = check_columns(model, [log])
    assert (found.kind, found.joints) == ("effort_sign", ("shoulder",))


def made(mistake):
    return make_log(WrongLog(mistake, "double_pendulum", "mujoco", "fast", 0, 3, 8.0))


@pytest.mark.parametrize("mistake", ["limit of a motor", "limit that falls with speed"])
def test_named_and_corrected(mistake, tmp_path):
    model, log, (secret,) = made(mistake)
    (found,) = check_columns(model, [log])
    joint = secret.joints[0]
    assert (found.kind, found.joints) == ("effort_limit", (model.joints[joint],))
    falls = mistake == "limit that falls with speed"
    assert len(found.values) == 1 + falls
    assert found.values[0] == pytest.approx(secret.value, rel=0.1)
    assert ("0 at a speed of" in str(found)) == falls
    assert "are commands: its motor saturates at" in str(found)
    after = corrected(log, [found])
    changed = np.flatnonzero((after.effort != log.effort).any(axis=0))
    assert changed.tolist() == [joint]
    v = log.velocity[:, joint] / (found.values[1] if falls else np.inf)
    most = found.values[0] * (1.0 - np.sign(log.effort[:, joint]) * v)
    assert (np.abs(after.effort[:, joint]) <= most + falls * 0.02 * secret.value + 1e-12).all()
    assert check_columns(model, [after]) == ()
    able = with_motor_limits(model, [log], [found])
    assert check_columns(able, [log]) == ()
    file = tmp_path / "robot.urdf"
    file.write_text(robot_file("double_pendulum").text, encoding="utf-8")
    path = tmp_path / "able.yaml"
    save_model(replace(able, path=file), path)
    (signal,) = load_model(path).effort_signals
    assert (signal.kind, signal.limit) == ("effort", found.values[0])
    assert signal.no_load_speed == (found.values[1] if falls else np.inf)
    assert in_efforts(log, [signal]).gain_deviations == pytest.approx(log.gain_deviations)
    known, before, mended = (
        compare(*each).errors.joints[joint].rms
        for each in ((load_model(path), [log]), (model, [log]), (model, [after]))
    )
    assert known == pytest.approx(mended, rel=0.02)
    assert known < 0.85 * before


def found_of(kind, joints, values):
    return ColumnFinding(kind, joints, values, 50.0, 1.0, (), 1.0, 0.1, "The …", "Log it.")


def test_limits_of_a_model_are_those_of_corrected_columns():
    model = load_model(MODELS / "arm6.urdf")
    n, (first, second, *_) = len(model.joints), model.joints
    log = JointLog("log", model.joints, np.arange(9.0), np.zeros((9, n)), np.ones((9, n)))
    limit = found_of("effort_limit", (first,), (3.0, 5.0))
    gain = found_of("effort_gain", (first,), (-2.0,))
    swap = found_of("swapped_efforts", (first, second), ())
    able = with_motor_limits(model, [log], [gain, limit, gain, swap])
    (signal,) = able.effort_signals
    assert signal == EffortSignal(second, "effort", 1.0, limit=6.0, no_load_speed=5.0)
    assert able.known_effort_limits[1] == 6.0
    assert [*exported_joints(able).values()][1].effort == 6.0
    currents = replace(log, effort_kinds={first: "current"})
    assert with_motor_limits(model, [currents], [limit]).effort_signals == ()
    assert corrected(currents, [limit]).effort.tolist() == log.effort.tolist()
    commands = replace(log, effort=np.nan * log.effort, command=log.position)
    assert with_motor_limits(model, [commands], [limit]).effort_signals == ()
    with pytest.raises(ArgumentError, match="logs must be"):
        with_motor_limits(model, ["log.csv"], [limit])
    drive = EffortSignal(first, "current", 0.5, deviation=0.05)
    of_drive = with_motor_limits(replace(model, effort_signals=(drive,)), [currents], [limit])
    assert of_drive.effort_signals == (replace(drive, limit=3.0, no_load_speed=5.0),)
    most = in_efforts(replace(currents, effort=90.0 * log.effort), of_drive.effort_signals)
    assert most.effort[:, 0] == pytest.approx(3.0)
    driven = replace(model, effort_signals=(drive,))
    assert with_motor_limits(driven, [log], [limit]).effort_signals == (drive,)
    servo = EffortSignal(first, "command", 90.0)
    served = replace(model, effort_signals=(servo,))
    assert with_motor_limits(served, [log], [limit]).effort_signals == (servo,)
    with pytest.raises(ArgumentError, match="no joint 'nose'"):
        with_motor_limits(model, [log], [found_of("effort_limit", ("nose",), (3.0,))])


def test_limits_stand_beside_gains_and_among_none():
    motor = EffortSignal("a", "effort", 1.0, limit=3.0, no_load_speed=5.0)
    drive = EffortSignal("b", "current", 0.5, limit=4.0)
    units = Units(("a", "b"), frozenset({"b"}))
    limits, gains = (make((motor, drive), units) for make in (limits_section, gains_section))
    assert [row[0].text for row in limits.tables[0].rows] == ["a"]
    assert limits.tables[0].rows[0][-1].text == "3.00 N·m, 0 at 5.00 rad/s"
    assert [row[0].text for row in gains.tables[0].rows] == ["b"]
    assert gains.tables[0].rows[0][-1].text == "4.00 N"
    assert not limits_section((drive,), units).says_something
    assert not gains_section((motor,), units).says_something


@pytest.mark.parametrize(
    ("kind", "values", "option"),
    [
        ("effort_unit", (1e-3,) * 2, "--units effort=Nmm."),
        ("position_alone_unit", (np.pi / 180,) * 2, "--units position=deg."),
        ("effort_gains", (2.5e-4, 2e-3), "--units effort=Nmm. Otherwise correct it with --gain"),
        ("effort_gains", (2.5, 7.0), "Correct it with --gain"),
    ],
)
def test_units_are_named_before_gains(kind, values, option):
    _, advice = words_of(kind, ["shoulder", "elbow"], values, all_joints=True)
    assert option in advice and ("--units" in option or "--units" not in advice)
