"""Motors by their data sheets: the table, files of users, and what they say of gains."""

from dataclasses import replace

import numpy as np
import pytest
from servo_logs import PENDULUM, TRUTH, servo_log

from geodrake import load_model
from geodrake.errors import ArgumentError
from geodrake.identification.logs.servo_fit import PARAMETERS
from geodrake.identification.logs.servo_model import with_servo_motions
from geodrake.identification.logs.signal_calibration import calibrate_efforts
from geodrake.logs.files import Reading, read_log
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
    with pytest.raises(ArgumentError, match="no motor 'sts3216'") as caught:
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


@pytest.fixture
def slow(tmp_path):
    """A log in which hardly anything tells the stiffness: a slow swing by a few degrees."""
    log = servo_log()
    path = tmp_path / "slow.csv"
    time = log.time - log.time[0]
    q = 0.02 * np.sin(0.7 * time)
    told = q + 0.01 * np.tanh(3.0 * np.cos(0.7 * time))
    rows = np.column_stack([time, np.round(q, 3), told])
    np.savetxt(path, rows, delimiter=",", header="time,hinge.position,hinge.command", comments="")
    return path


def test_a_data_sheet_tells_the_stiffness_that_a_log_does_not(pendulum, slow, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(f"mine: {{stiffness: [{TRUTH[0]}, 6.0, measured at home]}}")
    mine = motor_named("mine", known_motors(path))
    signals = []
    for motors in ({}, {"": mine}):
        log = read_log(slow, joints=pendulum.joints, reading=Reading(motors=motors))
        model, _, notes = calibrate_efforts(pendulum, [log])
        signals += model.effort_signals
    unknown, told = signals
    assert told.uncertainty < 0.12 < unknown.uncertainty
    assert abs(told.gain - TRUTH[0]) < 2.0 * told.deviation
    assert "of what is published of mine" in notes[-1]


def test_a_log_that_tells_the_stiffness_overrules_a_wrong_data_sheet(pendulum, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("mine: {stiffness: [120.0, 60.0, a catalogue]}")
    log = replace(servo_log(), motors={"hinge": motor_named("mine", known_motors(path))})
    (signal,) = calibrate_efforts(pendulum, [log])[0].effort_signals
    assert signal.gain == pytest.approx(TRUTH[0], rel=0.02)


@pytest.mark.parametrize("published", [1.0, 2.0])
def test_a_motion_that_tells_the_armature_overrules_a_wrong_data_sheet(
    pendulum, tmp_path, published
):
    path = tmp_path / "mine.yaml"
    armature = published * TRUTH[4]
    path.write_text(f"mine: {{armature: [{armature}, {0.5 * armature}, a catalogue]}}")
    log = replace(servo_log(), motors={"hinge": motor_named("mine", known_motors(path))})
    model, fits = with_servo_motions(calibrate_efforts(pendulum, [log])[0], [log])
    found = fits["hinge"].parameters[PARAMETERS.index("armature")]
    assert found == pytest.approx(TRUTH[4], rel=0.15)
    assert any(fitted.effect.name == "rotor_inertia" for fitted in model.effects)


def test_a_data_sheet_tells_the_armature_that_a_log_does_not(pendulum, slow, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(f"mine: {{armature: [{TRUTH[4]}, {0.1 * TRUTH[4]}, a catalogue]}}")
    motors = {"": motor_named("mine", known_motors(path))}
    log = read_log(slow, joints=pendulum.joints, reading=Reading(motors=motors))
    fits = with_servo_motions(calibrate_efforts(pendulum, [log])[0], [log])[1]
    at = PARAMETERS.index("armature")
    assert fits["hinge"].parameters[at] == pytest.approx(TRUTH[4], rel=0.3)
    assert fits["hinge"].deviations[at] < 0.2 * TRUTH[4]
