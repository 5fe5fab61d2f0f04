"""Motors by their data sheets: the table, files of users, and what they say of gains."""

from dataclasses import replace

import numpy as np
import pytest
from servo_logs import PENDULUM, PERIOD, TRUTH, servo_log

from geodrake import load_model
from geodrake.errors import ArgumentError
from geodrake.identification.logs.servo_motion import PARAMETERS
from geodrake.identification.logs.signal_calibration import calibrate_efforts, with_servo_motions
from geodrake.logs import Reading, read_log
from geodrake.logs.motors import known_motors, motor_named, motor_of_robot


def test_every_motor_has_positive_values_with_sources():
    for name, motor in known_motors().items():
        told = [getattr(motor, what) for what in motor.__struct_fields__[2:]]
        assert name == motor.name and any(told)
        assert all(value > 0.0 and source for value, _, source in filter(None, told))


def test_a_motor_is_found_by_its_name_and_by_that_of_a_robot():
    servo = motor_named("STS-3215")
    assert servo is motor_of_robot("so101_new_calib") and motor_of_robot("ur10e") is None
    assert servo.gain("command") == servo.stiffness[:2] and servo.gain("voltage") is None
    with pytest.raises(ArgumentError, match="Motor 'sts3216' is unknown") as caught:
        motor_named("sts3216")
    assert "sts3215" in caught.value.advice


def test_a_file_adds_motors(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("mine: {stiffness: [60.0, 6.0, measured at home]}")
    assert motor_named("Mine", known_motors(path)).gain("command") == (60.0, 6.0)
    for text, words in (
        ("mine: {stiffness: [-60.0, 6.0, x]}", "stiffness of mine is -60"),
        ("mine: {stiffness: 60}", "mine.stiffness"),
        ("mine: {stifness: [60.0, 6.0, x]}", "stifness"),
        ("mine: [", "not valid YAML"),
    ):
        path.write_text(text)
        with pytest.raises(ArgumentError, match=words):
            known_motors(path)


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    path = tmp_path_factory.mktemp("pendulum") / "pendulum.urdf"
    path.write_text(PENDULUM)
    return load_model(path)


def mine(folder, **values):
    """A motor by a file of one's own: quantity -> value and deviation."""
    path = folder / "mine.yaml"
    told = ", ".join(f"{name}: [{at}, {off}, at home]" for name, (at, off) in values.items())
    path.write_text(f"mine: {{{told}}}")
    return motor_named("mine", known_motors(path))


def armature(fits):
    at = PARAMETERS.index("armature")
    return fits["hinge"].parameters[at], fits["hinge"].deviations[at]


def test_a_data_sheet_tells_what_a_log_does_not(pendulum, tmp_path):
    """A slow swing by a few degrees hardly tells stiffness or armature."""
    time = np.arange(0.0, 16.0, PERIOD)
    q = 0.02 * np.sin(0.7 * time)
    told = q + 0.01 * np.tanh(3.0 * np.cos(0.7 * time))
    rows = np.column_stack([time, np.round(q, 3), told])
    path, names = tmp_path / "slow.csv", "time,hinge.position,hinge.command"
    np.savetxt(path, rows, delimiter=",", header=names, comments="")
    motor = mine(tmp_path, stiffness=(TRUTH[0], 6.0), armature=(TRUTH[4], 0.1 * TRUTH[4]))
    signals = []
    for motors in ({}, {"": motor}):
        log = read_log(path, joints=pendulum.joints, reading=Reading(motors=motors))
        model, _, notes = calibrate_efforts(pendulum, [log])
        signals += model.effort_signals
    unknown, told = signals
    assert told.uncertainty < 0.12 < unknown.uncertainty
    assert abs(told.gain - TRUTH[0]) < 2.0 * told.deviation
    assert "times the published value of mine" in notes[-1]
    found, deviation = armature(with_servo_motions(model, [log])[1])
    assert found == pytest.approx(TRUTH[4], rel=0.3) and deviation < 0.2 * TRUTH[4]


def test_a_log_that_tells_overrules_a_wrong_data_sheet(pendulum, tmp_path):
    motor = mine(tmp_path, stiffness=(120.0, 60.0), armature=(2.0 * TRUTH[4], TRUTH[4]))
    log = replace(servo_log(), motors={"hinge": motor})
    model = calibrate_efforts(pendulum, [log])[0]
    assert model.effort_signals[0].gain == pytest.approx(TRUTH[0], rel=0.02)
    model, fits = with_servo_motions(model, [log])
    assert armature(fits)[0] == pytest.approx(TRUTH[4], rel=0.15)
    assert any(fitted.effect.name == "rotor_inertia" for fitted in model.effects)
