"""Temperatures of joints: read from files, kept, and averaged to courses."""

import dataclasses

import numpy as np
import pytest

from geodrake.diagnosis import corrected
from geodrake.diagnosis.columns.finding import ColumnFinding
from geodrake.logs import JointLog, Reading, log_of_frame, read_log, write_log
from geodrake.logs.files.reading import ColumnMapping, MappedColumn
from geodrake.logs.preparation import prepare_logs
from geodrake.logs.temperatures import Temperatures

JOINTS = ("shoulder", "elbow")
TIME = np.arange(2000) / 100.0
Q = np.sin(TIME[:, None] * np.array([2.0, 3.0]))
WARMTH = np.stack([30.0 + TIME, 45.0 - 0.5 * TIME], 1)


def log_with(temperature):
    return JointLog("warm", JOINTS, TIME, Q, np.cos(Q), temperature=temperature)


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_a_log_keeps_them(tmp_path, suffix):
    path = tmp_path / f"log{suffix}"
    write_log(log_with(WARMTH), path)
    again = read_log(path)
    np.testing.assert_array_equal(again.temperature, WARMTH)
    assert not any("ignored" in note for note in again.notes)
    np.testing.assert_array_equal(again.select(["elbow"]).temperature, WARMTH[:, 1:])
    assert list(again.to_dataframe())[-1] == "elbow.temperature"


def test_one_joint_alone_may_have_one():
    only = WARMTH.copy()
    only[:, 0] = np.nan
    columns = log_with(only).columns()
    assert "shoulder.temperature" not in columns
    again = log_of_frame(columns, joints=JOINTS)
    np.testing.assert_array_equal(again.temperature, only)
    assert log_of_frame(log_with(None).columns()).temperature is None


def frame_with(form, warmth):
    """Columns of another logger, of a form of names."""
    frame = {"time": TIME}
    for name, values in (("q_J", Q), ("tau_J", np.cos(Q)), (form, warmth)):
        frame |= {name.replace("J", str(k)): values[:, k] for k in range(2)}
    return frame


def test_names_of_other_loggers():
    log = log_of_frame(frame_with("Temp_J (°C)", WARMTH), joints=JOINTS)
    np.testing.assert_array_equal(log.temperature, WARMTH)


@pytest.mark.parametrize("unit", ["[°F]", "[degF]"])
def test_degrees_of_fahrenheit_are_read(unit):
    other = 1.8 * WARMTH + 32.0
    log = log_of_frame(frame_with(f"temp_J {unit}", other), joints=JOINTS)
    np.testing.assert_allclose(log.temperature, WARMTH, rtol=1e-12)
    assert "temperature is in °F, by the column names: converted" in log.notes
    reading = Reading(units={"temperature": "F"})
    log = log_of_frame(frame_with("temp_J", other), joints=JOINTS, reading=reading)
    np.testing.assert_allclose(log.temperature, WARMTH, rtol=1e-12)


@pytest.mark.parametrize("numbered", [False, True])
def test_slow_ones_and_time_may_be_named_by_a_mapping_alone(tmp_path, numbered):
    """One a second, in a file of their own, beside motions at 100 Hz."""
    slow = {"moment": TIME[::100], "noise": 0.0 * TIME[::100]}
    slow |= {"drive 7": WARMTH[::100, 0], "drive 8": WARMTH[::100, 1]}
    quick = log_with(None).columns()
    names = ["moment", *(name for name in quick if name != "time"), *list(slow)[1:]]

    def column(name):
        return MappedColumn(1 + names.index(name) if numbered else name)

    np.savez(tmp_path / "motion.npz", moment=1e3 * quick.pop("time"), **quick)
    np.savez(tmp_path / "drives.npz", **{**slow, "moment": 1e3 * slow["moment"]})
    joints = {
        joint: {q: column(f"{joint}.{q}") for q in ("position", "effort")}
        | {"temperature": column(drive)}
        for joint, drive in zip(JOINTS, ("drive 7", "drive 8"), strict=True)
    }
    time = MappedColumn(1 if numbered else "moment", "ms")
    reading = Reading(mapping=ColumnMapping(joints, time))
    log = read_log(f"{tmp_path / 'motion.npz'}+{tmp_path / 'drives.npz'}", reading=reading)
    assert len(log) == len(TIME)
    known = log.time <= 19.0
    np.testing.assert_allclose(log.time[known], TIME[TIME <= 19.0], atol=1e-12)
    np.testing.assert_allclose(log.temperature[known], WARMTH[TIME <= 19.0], rtol=1e-12)


def test_limits_and_boards_are_no_temperatures_of_joints():
    columns = log_with(None).columns()
    columns |= {"temperature_limit_0": WARMTH[:, 0], "temperature_board": WARMTH[:, 1]}
    log = log_of_frame(columns, joints=JOINTS)
    assert log.temperature is None
    assert log.joints == JOINTS


def test_courses_are_means_over_seconds():
    readings = np.round(WARMTH)
    readings[300:500, 0] = np.nan
    readings[:, 1] = np.nan
    courses = Temperatures.of(JOINTS, TIME + 100.0, readings)
    assert list(courses.courses) == ["shoulder"]
    found = courses.at([2.0, 4.0, 17.3], ["elbow", "shoulder"])
    assert np.isnan(found[:, 0]).all()
    np.testing.assert_allclose(found[:, 1], [32.0, 34.0, 47.3], atol=0.1)  # whole degrees, and back
    assert Temperatures.of(JOINTS, TIME, np.full_like(WARMTH, np.nan)) is None


@pytest.mark.parametrize("code", [-1.0, 0.0, 127.0, 255.0, 5 * (255 - 32) / 9])
def test_readings_of_sensors_that_fail_are_none(code):
    readings = np.round(WARMTH)
    readings[:150, 0] = readings[300:303, 0] = code
    readings[:, 1] = code
    courses = Temperatures.of(JOINTS, TIME, readings)
    assert list(courses.courses) == ["shoulder"]
    found = courses.at(TIME, ["shoulder"])
    assert found.min() > 29.0 and found.max() < 1.0 + WARMTH[:, 0].max()
    cold = np.clip(np.round(WARMTH - 30.0), -3.0, 3.0)
    np.testing.assert_array_equal(
        Temperatures.of(JOINTS, TIME, cold).courses["shoulder"][0].size, np.unique(TIME // 1).size
    )


def test_a_prepared_log_says_which_sensors_fail():
    readings = WARMTH.copy()
    readings[:, 1] = 255.0
    notes = prepare_logs([log_with(readings)], bandwidth=5.0)[0].notes
    assert "temperature of elbow is not used: the sensor fails" in notes
    assert not any(
        "sensor" in note for note in prepare_logs([log_with(WARMTH)], bandwidth=5.0)[0].notes
    )


def test_columns_of_swapped_joints_take_theirs_along():
    swap = ColumnFinding("swapped_joints", JOINTS, (), 50.0, 0.99, (), 1.0, 0.1, "swapped", "")
    np.testing.assert_array_equal(corrected(log_with(WARMTH), [swap]).temperature, WARMTH[:, ::-1])


def test_a_prepared_log_knows_them_by_time_stamp():
    log = dataclasses.replace(log_with(WARMTH), time=TIME + 100.0)
    trajectory = prepare_logs([log], bandwidth=5.0)[0]
    found = trajectory.temperature(np.array([105.0, 110.0]))
    np.testing.assert_allclose(found, [[35.0, 42.5], [40.0, 40.0]], atol=0.05)
