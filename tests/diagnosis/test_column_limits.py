"""Efforts that were asked for of motors that give less: simulated, named, and kept to the limit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from diagrams.benchmarks.column_errors import WrongLog, make_log
from diagrams.benchmarks.hidden.robots import robot_file
from geodrake import load_model
from geodrake.control.export_proof.joints import exported_joints
from geodrake.diagnosis import check_columns, compare, corrected, with_motor_limits
from geodrake.diagnosis.columns import ColumnFinding
from geodrake.diagnosis.columns.kinds import words_of
from geodrake.diagnosis.columns.limits import likely_limits
from geodrake.errors import ArgumentError
from geodrake.logs import JointLog
from geodrake.model import EffortSignal, save_model
from geodrake.model.effort_signal import MotorLimit
from geodrake.model.signal_efforts import in_efforts
from geodrake.report import Units
from geodrake.report.explaining import gains_section, limits_section

MODELS = Path(__file__).parents[2] / "models"


def made(mistake):
    return make_log(WrongLog(mistake, "double_pendulum", "mujoco", "fast", 0, 3, 8.0))


class TestLimit:
    def test_is_that_of_a_motor_on_a_voltage(self):
        """Of which no more than 24 V acts, as the law of direct-current motors has it."""
        rng = np.random.default_rng(0)
        kt, ke, resistance, ratio, most = 0.05, 0.04, 0.8, 30.0, 24.0
        v, voltage = rng.uniform(-15.0, 15.0, 200), rng.uniform(-60.0, 60.0, 200)
        asked, given = (
            ratio * kt * (np.clip(voltage, -own, own) - ratio * ke * v) / resistance
            for own in (np.inf, most)
        )
        limit = MotorLimit(ratio * kt * most / resistance, most / (ratio * ke))
        np.testing.assert_allclose(limit.given(asked, v), given, atol=1e-9)
        share, square = limit.beyond(asked, v)
        assert share == np.mean(np.abs(voltage) > most)
        assert square * share == pytest.approx(np.mean((asked - given) ** 2))

    def test_none_is_likely_where_efforts_are_what_is_needed(self):
        """But one at the top of the efforts, which cuts noise off."""
        rng, time = np.random.default_rng(1), np.linspace(0.0, 20.0, 2000)
        needed, v = 2.0 * np.sin(time), np.cos(0.7 * time)
        right = likely_limits(needed + 0.02 * rng.normal(size=2000), needed, v)
        assert all(limit.effort > 1.98 for limit in right)
        given = np.clip(needed, -1.5, 1.5)
        flat, *_ = likely_limits(needed, given + 0.02 * rng.normal(size=2000), v)
        assert flat.effort == pytest.approx(1.5, rel=0.02)


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


@pytest.mark.parametrize("lacks", ["velocity", "half of it", "what is in it", "positions"])
def test_columns_with_nothing_in_them_cost_no_efforts(lacks):
    time = np.linspace(0.0, 2.0, 201)
    position, velocity = np.sin(time)[:, None], np.cos(time)[:, None]
    empty = np.arange(201)[:, None] % 10 == 5
    columns = {
        "velocity": {},
        "half of it": {"velocity": np.where(time[:, None] < 1.0, velocity, np.nan)},
        "what is in it": {"velocity": 0.0 * velocity},
        "positions": {"position": np.where(empty, np.nan, position)},
    }
    log = JointLog("log", ("hinge",), time, position, 3.0 * np.ones((201, 1)))
    log = replace(log, **columns[lacks])
    given = corrected(log, [found_of("effort_limit", ("hinge",), (2.0, 4.0))]).effort[:, 0]
    motor = EffortSignal("hinge", "effort", 1.0, limit=2.0, no_load_speed=4.0)
    assert in_efforts(log, [motor]).effort[:, 0].tolist() == given.tolist()
    there = ~empty[:, 0] if lacks == "positions" else np.full(201, True)
    expected = 2.0 - 0.5 * np.cos(time)
    np.testing.assert_allclose(given[there][1:-1], expected[there][1:-1], atol=1e-4)


@pytest.mark.parametrize(
    ("kind", "values", "option"),
    [
        ("effort_unit", (1e-3,) * 2, "--units effort=Nmm."),
        ("position_alone_unit", (np.pi / 180,) * 2, "--units position=deg."),
        ("effort_gains", (2.5e-4, 2e-3), "--units effort=Nmm. Otherwise correct it by --gain"),
        ("effort_gains", (2.5, 7.0), "Correct it by --gain"),
    ],
)
def test_units_are_named_before_gains(kind, values, option):
    _, advice = words_of(kind, ["shoulder", "elbow"], values, all_joints=True)
    assert option in advice and ("--units" in option or "--units" not in advice)
