"""Knowledge beside a log: payloads that the robot carried, and data sheets of its motors."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
import servo_logs
from commands import run
from pinocchio_logs import MODELS, perturbed, random_motion, robot
from servo_logs import PERIOD, TRUTH

from geodrake import load_model
from geodrake.control import roll_out
from geodrake.diagnosis import compare
from geodrake.errors import ArgumentError
from geodrake.identification.logs.case import prepare_case
from geodrake.identification.logs.servo_motion import PARAMETERS
from geodrake.identification.logs.signal_calibration import (
    calibrate_efforts,
    calibrated,
    with_servo_motions,
)
from geodrake.logs import JointLog, KnownPayload, Reading, read_log, write_log
from geodrake.logs.motors import known_motors, motor_named, motor_of_robot
from geodrake.model.carried_payloads import joints_with_known_gain

ARM, PENDULUM = "arm6", "double_pendulum"
PLACE = (0.05, -0.02, 0.1)
WEIGHT = KnownPayload("flange", 3.0, PLACE)
LIGHT = KnownPayload("lower_link", 0.5, (0.1, 0.0, -0.2))


@cache
def model_file(name=ARM):
    return load_model(MODELS / f"{name}.urdf")


def recorded(plant, label, rng, *, gains=0.0, weight=None, share=0.03):
    """Return a log of a robot with or without a weight, with noise in a share of its efforts."""
    plant, file = pin.Model(plant), plant
    if weight is not None:
        frame = file.frames[file.getFrameId(weight.body)]
        body = pin.Inertia(weight.mass, np.array(weight.mass_center), np.zeros((3, 3)))
        plant.inertias[frame.parentJoint] += frame.placement.act(body)
    data, time = plant.createData(), np.arange(0.0, 24.0, 0.008)
    q, v, a = random_motion(file, rng)(time)
    load = np.array([pin.rnea(plant, data, *sample) for sample in zip(q, v, a, strict=True)])
    effort = load * (1.0 + np.asarray(gains))
    noise = share * effort.std(0) * rng.normal(size=effort.shape)
    q = q + 1e-5 * np.sign(share) * rng.normal(size=q.shape)
    v = v + 2e-4 * np.sign(share) * rng.normal(size=q.shape)
    payloads = () if weight is None else (weight,)
    return JointLog(label, tuple(file.names[1:]), time, q, effort + noise, v, payloads=payloads)


def two_logs(seed, gains=0.0, *, off=0.2, weight=WEIGHT, name=ARM):
    """Return a log without and one with the weight; bodies differ from those of the file."""
    rng = np.random.default_rng(seed)
    plant = perturbed(robot(name), rng, off)
    empty = recorded(plant, "empty", rng, gains=gains)
    return [empty, recorded(plant, "held", rng, gains=gains, weight=weight)]


def bare(log):
    return replace(log, payloads=())


def clean(weight, name=ARM):
    """Return a log without noise of the robot in the model file."""
    return recorded(robot(name), "held", np.random.default_rng(11), weight=weight, share=0.0)


class TestGainTold:
    def test_payloads_of_all_logs_do_not_identify_gains(self):
        held = [two_logs(seed, [0.0, 0.08], weight=LIGHT, name=PENDULUM)[1] for seed in (9, 10)]
        case = prepare_case(model_file(PENDULUM), held, candidates=True)
        assert not any(effect.name == "effort_scale" for effect in case.dataset.effects)
        assert any("known payloads do not identify effort gains" in note for note in case.notes)

    def test_gains_are_known_at_joints_that_bear_the_payload(self):
        model, weight = model_file(), KnownPayload("forearm", 1.0)
        assert joints_with_known_gain(model, [(), (weight,)]) == model.joints[:3]
        assert joints_with_known_gain(model, [(weight,), (weight, WEIGHT)]) == model.joints
        assert joints_with_known_gain(model, [(weight,), (weight,)]) == ()


class TestLoad:
    @pytest.mark.parametrize("body", ["flange", "tool0"])
    def test_taken_off(self, body):
        """An exact model leaves nothing; `tool0` is welded on, in a frame of its own."""
        log = clean(replace(WEIGHT, body=body))
        assert compare(model_file(), [bare(log)]).errors.nrms > 0.3
        assert compare(model_file(), [log]).errors.nrms < 1e-4

    def test_moves_with_the_robot_in_a_rollout(self):
        log, model = clean(LIGHT, PENDULUM), model_file(PENDULUM)
        without = roll_out(model, [bare(log)], horizon=0.2, most=3)
        held = roll_out(model, [log], horizon=0.2, most=3)
        assert held.relative < 0.02 * without.relative

    def test_both_fitted_and_held_out(self):
        """The one of four logs that has the weight is cut in two."""
        empty, held = two_logs(16, off=0.0, weight=LIGHT, name=PENDULUM)
        logs = [empty, *(two_logs(seed, name=PENDULUM, weight=LIGHT)[0] for seed in (17, 18))]
        case = prepare_case(model_file(PENDULUM), [*logs, held], candidates=False, bandwidth=2.0)
        assert [each.payloads for each in case.trajectories] == [(), (), (), (LIGHT,)]
        assert len(case.folds) == 8
        case = prepare_case(model_file(PENDULUM), [*logs, bare(held)], candidates=False)
        assert len(case.folds) == 4


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"mass": 0.0}, "a mass of 0 kg"),
        ({"mass": float("nan")}, "a mass of nan kg"),
        ({"mass_center": (0.0, 1.0)}, r"mass_center must be \(3,\)"),
        ({"mass_center": (0.0, 1.0, np.inf)}, "coordinates x, y, z"),
    ],
)
def test_impossible_weights(values, words):
    with pytest.raises(ArgumentError, match=words):
        replace(WEIGHT, **values)


def test_the_command_finds_a_gain_by_a_known_payload(tmp_path):
    logs = two_logs(17, [0.0, 0.08], weight=LIGHT, name=PENDULUM)
    paths = [tmp_path / f"{log.name}.csv" for log in logs]
    for log, path in zip(logs, paths, strict=True):
        write_log(log, path)
    payload = f"{paths[1]}:lower_link:0.5:0.1,0,-0.2"  # a log may be named by its path
    said = run(
        "explain", model_file(PENDULUM).path, *paths, "--known-payload", payload, "--details"
    )
    assert said.exit_code == 0, said.output
    (value,) = re.findall(r"(?m)^effort_scale +elbow +(\S+) ±", said.stdout)
    assert float(value) == pytest.approx(0.08, abs=0.01)
    assert "Missing: effort scale (elbow)" in said.stdout
    assert "known payload of 0.5 kg at lower_link" in " ".join(said.output.split())


def test_a_payload_tells_unknown_gains_of_currents():
    """Bodies are 20 % off; without the payload, gains are uncertain by about 12 %."""
    truth = np.array([12.0, 7.5, 3.0, 5.0, 1.5, 0.8])
    kinds = dict.fromkeys(model_file().joints, "current")
    logs = [replace(log, effort=log.effort / truth, effort_kinds=kinds) for log in two_logs(1)]
    found = calibrated(model_file(), logs, ["current"] * 6)
    gains = np.array([signal.gain for signal in found])
    spread = np.array([signal.uncertainty for signal in found])
    assert (spread < 0.01).all()
    assert (np.abs(np.log(gains / truth)) < 2.0 * spread).all()
    without = calibrated(model_file(), logs[:1], ["current"] * 6)
    assert min(signal.uncertainty for signal in without) > 0.05


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


def mine(folder, **values):
    """Return a motor of a file with the value and deviation of each quantity."""
    path = folder / "mine.yaml"
    told = ", ".join(f"{name}: [{at}, {off}, at home]" for name, (at, off) in values.items())
    path.write_text(f"mine: {{{told}}}")
    return motor_named("mine", known_motors(path))


def test_a_data_sheet_adds_to_a_log(tmp_path):
    """A slow swing by a few degrees hardly depends on stiffness or armature."""
    (tmp_path / "pendulum.urdf").write_text(servo_logs.PENDULUM)
    pendulum, time = load_model(tmp_path / "pendulum.urdf"), np.arange(0.0, 16.0, PERIOD)
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
    fit, at = with_servo_motions(model, [log])[1]["hinge"], PARAMETERS.index("armature")
    assert fit.parameters[at] == pytest.approx(TRUTH[4], rel=0.3)
    assert fit.deviations[at] < 0.2 * TRUTH[4]
