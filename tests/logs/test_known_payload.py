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
from geodrake.control.rollout import roll_out
from geodrake.diagnosis import compare
from geodrake.effects import EffortDelay, FittedEffect
from geodrake.errors import ArgumentError
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.signal_calibration import calibrated
from geodrake.logs.files import write_log
from geodrake.logs.known_payload import KnownPayload
from geodrake.logs.motion import JointLog
from geodrake.model.carried_payloads import joints_with_known_gain

PLACE = (0.05, -0.02, 0.1)
WEIGHT = KnownPayload("flange", 3.0, PLACE)


@cache
def model_file(name="arm6"):
    return load_model(MODELS / f"{name}.urdf")


def recorded(plant, label, rng, *, gains=0.0, weight=None, friction=None, share=0.03, **motion):
    """A log of a robot that holds a weight: (mass, place, frame) or none."""
    plant, file = pin.Model(plant), plant
    if weight is not None:
        mass, place, name = weight
        frame = file.frames[file.getFrameId(name)]
        body = pin.Inertia(mass, np.array(place), np.zeros((3, 3)))
        plant.inertias[frame.parentJoint] += frame.placement.act(body)
    data, time = plant.createData(), np.arange(0.0, 24.0, 0.004)
    q, v, a = random_motion(file, rng, **motion)(time)
    load = np.array([pin.rnea(plant, data, *sample) for sample in zip(q, v, a, strict=True)])
    effort = load + friction(load, v) if friction else load
    effort = effort * (1.0 + np.asarray(gains))
    noise = share * effort.std(0) * rng.normal(size=effort.shape)
    q = q + 1e-5 * np.sign(share) * rng.normal(size=q.shape)
    v = v + 2e-4 * np.sign(share) * rng.normal(size=q.shape)
    return JointLog(label, tuple(file.names[1:]), time, q, effort + noise, v)


def two_logs(seed, gains=0.0, *, off=0.2, stated=WEIGHT, weight=None, name="arm6", friction=None):
    """A log without and one with the weight, of a robot whose bodies differ from its file."""
    rng = np.random.default_rng(seed)
    plant = perturbed(robot(name), rng, off)
    weight = weight or (3.0, PLACE, "flange")
    empty = recorded(plant, "empty", rng, gains=gains, friction=friction)
    held = recorded(plant, "held", rng, gains=gains, friction=friction, weight=weight)
    return [empty, replace(held, payloads=(stated,))]


def gain_of(joint, size=0.08, count=6):
    return size * np.eye(count)[joint]


class TestGainTold:
    def test_not_by_what_all_logs_have(self):
        held = [two_logs(seed, gain_of(1))[1] for seed in (9, 10)]
        case = open_case(model_file(), held, candidates=True)
        assert not any(effect.name == "effort_scale" for effect in case.dataset.effects)
        assert any("known payloads identify no gain" in note for note in case.notes)

    def test_only_at_joints_that_bear_it(self):
        model, weight = model_file(), KnownPayload("forearm", 1.0)
        assert joints_with_known_gain(model, [(), (weight,)]) == model.joints[:3]
        assert joints_with_known_gain(model, [(weight,), (weight, WEIGHT)]) == model.joints
        assert joints_with_known_gain(model, [(weight,), (weight,)]) == ()


class TestLoad:
    """What the weight needs is known exactly."""

    def test_taken_off(self):
        """Of an exact model, nothing is left in either log."""
        empty, held = two_logs(10, off=0.0)
        rng = np.random.default_rng(11)
        clean = recorded(robot("arm6"), "held", rng, weight=(3.0, PLACE, "flange"), share=0.0)
        assert compare(model_file(), [clean]).errors.nrms > 0.3
        assert compare(model_file(), [replace(clean, payloads=(WEIGHT,))]).errors.nrms < 1e-4
        errors = compare(model_file(), [empty, held]).errors
        assert errors.nrms < 1.15 * errors.floor_nrms

    def test_in_the_frame_of_a_link_that_is_welded_on(self):
        rng, weight = np.random.default_rng(12), KnownPayload("tool0", 2.0, PLACE)
        log = recorded(robot("arm6"), "held", rng, weight=(2.0, PLACE, "tool0"), share=0.0)
        at = robot("arm6").frames[robot("arm6").getFrameId("tool0")].placement
        assert np.linalg.norm(at.translation) > 0.01
        assert compare(model_file(), [replace(log, payloads=(weight,))]).errors.nrms < 1e-4

    def test_of_efforts_that_are_late(self):
        rng, late = np.random.default_rng(13), 0.0137
        log = recorded(robot("arm6"), "held", rng, weight=(3.0, PLACE, "flange"), share=0.0)
        effort = [np.interp(log.time - late, log.time, column) for column in log.effort.T]
        log = replace(log, effort=np.stack(effort, 1), payloads=(WEIGHT,))
        delay = FittedEffect(EffortDelay(late), np.empty(0))
        model = replace(model_file(), effects=(*model_file().effects, delay))
        assert compare(model_file(), [log]).errors.nrms > 0.01
        assert compare(model, [log]).errors.nrms < 1e-3

    def test_stays_at_another_bandwidth(self):
        other = open_case(model_file(), two_logs(14), candidates=False, bandwidth=2.0)
        assert [trajectory.payloads for trajectory in other.trajectories] == [(), (WEIGHT,)]

    def test_moves_with_the_robot_in_a_rollout(self):
        rng = np.random.default_rng(15)
        log = recorded(robot("arm6"), "held", rng, weight=(3.0, PLACE, "flange"), share=0.0)
        bare = roll_out(model_file(), [log], horizon=0.2, most=3)
        held = roll_out(model_file(), [replace(log, payloads=(WEIGHT,))], horizon=0.2, most=3)
        assert held.relative < 0.02 * bare.relative

    def test_both_fitted_and_held_out(self):
        """Of four logs only one has the weight: it is cut in two."""
        empty, held = two_logs(16)
        logs = [empty, *(two_logs(seed)[0] for seed in (17, 18))]
        assert len(open_case(model_file(), [*logs, held], candidates=False).folds) == 8
        bare = replace(held, payloads=())
        assert len(open_case(model_file(), [*logs, bare], candidates=False).folds) == 4


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"mass": 0.0}, "a mass of 0 kg"),
        ({"mass": float("nan")}, "a mass of nan kg"),
        ({"mass_center": (0.0, 1.0)}, "three numbers x, y, z"),
        ({"mass_center": (0.0, 1.0, np.inf)}, "three numbers x, y, z"),
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
        weight, name = (0.5, (0.1, 0.0, -0.2), "lower_link"), "double_pendulum"
        stated = KnownPayload("lower_link", 0.5, (0.1, 0.0, -0.2))
        logs = two_logs(17, gain_of(1, 0.08, 2), stated=stated, weight=weight, name=name)
        paths = [folder / f"{log.name}.csv" for log in logs]
        for log, path in zip(logs, paths, strict=True):
            write_log(log, path)
        return paths

    def run(self, files, *given, command="explain"):
        options = [word for payload in given for word in ("--known-payload", payload)]
        words = [command, MODELS / "double_pendulum.urdf", *files, *options]
        return CliRunner().invoke(app, [str(word) for word in words])

    @pytest.mark.parametrize("log", ["held.csv", None])
    def test_the_log_has_a_name_or_a_path(self, files, log):
        given = f"{log or files[1]}:lower_link:0.5:0.1,0,-0.2"
        result = self.run(files, given, command="compare")
        assert result.exit_code == 0, result.output
        assert "0.5 kg known at lower_link" in " ".join(result.output.split())

    def test_tells_the_gain(self, files):
        result = self.run(files, "held:lower_link:0.5:0.1,0,-0.2")
        assert result.exit_code == 0, result.output
        (step,) = [line for line in result.stdout.splitlines() if re.match(r"\d+ +\w", line)]
        assert re.match(r"1 +effort_scale +elbow ", step)
        (gain,) = re.findall(r"gain_error (\S+) ±", result.output)
        assert float(gain) == pytest.approx(0.08, abs=0.01)
        assert "0.5 kg known at lower_link" in " ".join(result.output.split())

    @pytest.mark.parametrize(
        ("given", "words"),
        [
            ("other:lower_link:0.5", "there is no such log"),
            ("held:hand:0.5", "no body 'hand'"),
            ("held:lower_link:-1", "a mass of -1 kg"),
            ("held:lower_link", "cannot be read"),
            ("held:lower_link:heavy", "cannot be read"),
            ("held:lower_link:0.5:1,2", "cannot be read"),
            ("held:lower_link:0.5:1,2,x", "cannot be read"),
            ("held::0.5", "cannot be read"),
            ("held", "there is no such log"),
        ],
    )
    def test_refuses(self, files, given, words):
        result = self.run(files, given)
        assert result.exit_code == 2, result.output
        assert words in result.stderr
        assert len(result.stderr.strip().splitlines()) == 1


class TestUnknownGains:
    """Currents in the place of efforts: a known payload is what their scale is measured by."""

    GAINS = np.array([12.0, 7.5, 3.0, 5.0, 1.5, 0.8])

    def currents(self, log):
        kinds = dict.fromkeys(log.joints, "current")
        return replace(log, effort=log.effort / self.GAINS, effort_kinds=kinds)

    def test_a_payload_tells_them(self):
        """Bodies are 20 % off, so that without it gains are known to about 12 %."""
        logs = [self.currents(log) for log in two_logs(1)]
        found = calibrated(model_file(), logs, ["current"] * 6)
        gains = np.array([signal.gain for signal in found])
        spread = np.array([signal.uncertainty for signal in found])
        assert (spread < 0.01).all()
        assert (np.abs(np.log(gains / self.GAINS)) < 2.0 * spread).all()
        without = calibrated(model_file(), logs[:1], ["current"] * 6)
        assert min(signal.uncertainty for signal in without) > 0.05
