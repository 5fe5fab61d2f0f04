"""A calibration weight held in one of two logs tells gains of efforts.

Logs are Pinocchio's inverse dynamics, with the weight as a body of its own model at a frame of its
own; a gain multiplies all of a joint's measured effort.
"""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import pinocchio as pin
from pinocchio_logs import MODELS, perturbed, random_motion, robot
from typer.testing import CliRunner

from geodrake import load_model
from geodrake.cli.app import app
from geodrake.control import roll_out
from geodrake.diagnosis import compare
from geodrake.effects import EffortDelay, FittedEffect
from geodrake.errors import ArgumentError
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.signal_calibration import calibrated
from geodrake.logs import JointLog, KnownPayload, write_log
from geodrake.model.carried_payloads import joints_with_known_gain

ARM, PENDULUM = "arm6", "double_pendulum"
PLACE = (0.05, -0.02, 0.1)
WEIGHT = KnownPayload("flange", 3.0, PLACE)
LIGHT = KnownPayload("lower_link", 0.5, (0.1, 0.0, -0.2))


@cache
def model_file(name=ARM):
    return load_model(MODELS / f"{name}.urdf")


def recorded(plant, label, rng, *, gains=0.0, weight=None, share=0.03):
    """A log of a robot that holds a weight or none, with noise in a share of its efforts."""
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
    """A log without and one with the weight, of a robot whose bodies differ from its file."""
    rng = np.random.default_rng(seed)
    plant = perturbed(robot(name), rng, off)
    empty = recorded(plant, "empty", rng, gains=gains)
    return [empty, recorded(plant, "held", rng, gains=gains, weight=weight)]


def bare(log):
    return replace(log, payloads=())


def clean(weight, name=ARM):
    """A log without noise of the robot in the model file."""
    return recorded(robot(name), "held", np.random.default_rng(11), weight=weight, share=0.0)


class TestGainTold:
    def test_not_by_what_all_logs_have(self):
        held = [two_logs(seed, [0.0, 0.08], weight=LIGHT, name=PENDULUM)[1] for seed in (9, 10)]
        case = open_case(model_file(PENDULUM), held, candidates=True)
        assert not any(effect.name == "effort_scale" for effect in case.dataset.effects)
        assert any("known payloads do not identify effort gains" in note for note in case.notes)

    def test_only_at_joints_that_bear_it(self):
        model, weight = model_file(), KnownPayload("forearm", 1.0)
        assert joints_with_known_gain(model, [(), (weight,)]) == model.joints[:3]
        assert joints_with_known_gain(model, [(weight,), (weight, WEIGHT)]) == model.joints
        assert joints_with_known_gain(model, [(weight,), (weight,)]) == ()


class TestLoad:
    """What the weight needs is known exactly."""

    @pytest.mark.parametrize("body", ["flange", "tool0"])
    def test_taken_off(self, body):
        """Of an exact model nothing is left; `tool0` is welded on, in a frame of its own."""
        log = clean(replace(WEIGHT, body=body))
        assert compare(model_file(), [bare(log)]).errors.nrms > 0.3
        assert compare(model_file(), [log]).errors.nrms < 1e-4

    def test_of_efforts_that_are_late(self):
        late, log = 0.0137, clean(LIGHT, PENDULUM)
        effort = [np.interp(log.time - late, log.time, column) for column in log.effort.T]
        log = replace(log, effort=np.stack(effort, 1))
        delay = FittedEffect(EffortDelay(late), np.empty(0))
        model = model_file(PENDULUM)
        delayed = replace(model, effects=(*model.effects, delay))
        assert compare(model, [log]).errors.nrms > 0.01
        assert compare(delayed, [log]).errors.nrms < 1e-3

    def test_moves_with_the_robot_in_a_rollout(self):
        log, model = clean(LIGHT, PENDULUM), model_file(PENDULUM)
        without = roll_out(model, [bare(log)], horizon=0.2, most=3)
        held = roll_out(model, [log], horizon=0.2, most=3)
        assert held.relative < 0.02 * without.relative

    def test_both_fitted_and_held_out(self):
        """Of four logs only one has the weight: it is cut in two."""
        empty, held = two_logs(16, off=0.0, weight=LIGHT, name=PENDULUM)
        logs = [empty, *(two_logs(seed, name=PENDULUM, weight=LIGHT)[0] for seed in (17, 18))]
        case = open_case(model_file(PENDULUM), [*logs, held], candidates=False, bandwidth=2.0)
        assert [each.payloads for each in case.trajectories] == [(), (), (), (LIGHT,)]
        assert len(case.folds) == 8
        case = open_case(model_file(PENDULUM), [*logs, bare(held)], candidates=False)
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


class TestCommand:
    @pytest.fixture(scope="class")
    @staticmethod
    def files(tmp_path_factory):
        folder = tmp_path_factory.mktemp("logs")
        logs = two_logs(17, [0.0, 0.08], weight=LIGHT, name=PENDULUM)
        paths = [folder / f"{log.name}.csv" for log in logs]
        for log, path in zip(logs, paths, strict=True):
            write_log(log, path)
        return paths

    def run(self, files, payload, command):
        words = [command, MODELS / f"{PENDULUM}.urdf", *files, "--known-payload", payload]
        words.append("--details")
        return CliRunner().invoke(app, [str(word) for word in words])

    def test_the_log_may_have_a_path(self, files):
        result = self.run(files, f"{files[1]}:lower_link:0.5:0.1,0,-0.2", "compare")
        assert result.exit_code == 0, result.output
        assert "known payload of 0.5 kg at lower_link" in " ".join(result.output.split())

    def test_tells_the_gain(self, files):
        result = self.run(files, "held:lower_link:0.5:0.1,0,-0.2", "explain")
        assert result.exit_code == 0, result.output
        (step,) = [line for line in result.stdout.splitlines() if re.match(r"\d+ +\w", line)]
        assert re.match(r"1 +effort_scale +elbow ", step)
        (gain,) = re.findall(r"gain_error (\S+) ±", result.output)
        assert float(gain) == pytest.approx(0.08, abs=0.01)
        assert "known payload of 0.5 kg at lower_link" in " ".join(result.output.split())

    @pytest.mark.parametrize(
        ("given", "words"),
        [
            ("other:lower_link:0.5", "begins with none of the logs"),
            ("held:hand:0.5", "no moving body 'hand'"),
            ("held:lower_link:-1", "a mass of -1 kg"),
            ("held:lower_link", "cannot be parsed"),
            ("held:lower_link:heavy", "cannot be parsed"),
            ("held:lower_link:0.5:1,2", "cannot be parsed"),
        ],
    )
    def test_refuses(self, files, given, words):
        result = self.run(files, given, "compare")
        assert result.exit_code == 2, result.output
        assert words in result.stderr
        assert len(result.stderr.strip().splitlines()) == 1


def test_a_payload_tells_unknown_gains_of_currents():
    """Bodies are 20 % off, so that without it gains are known to about 12 %."""
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
