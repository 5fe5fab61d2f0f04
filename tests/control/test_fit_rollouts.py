"""Fits by rollouts of elastic joints, backlash and servos, to logs by SciPy and MuJoCo."""

import dataclasses
import json
from dataclasses import replace

import numpy as np
import pytest
from flexible_arm import arm_log, soft_arm
from servo_logs import LATE, PENDULUM, TRUTH, servo_log
from two_masses import FRICTION, GAP, ROTOR, STIFFNESS, followed, having, loose, springy, swung
from typer.testing import CliRunner

from geodrake import effects, load_model, save_model
from geodrake.cli.app import app
from geodrake.control import fit_rollouts, roll_out
from geodrake.control.rollout import FittedValue, RolloutFit
from geodrake.control.rollout.fit_rollouts import fitted_model, held_out
from geodrake.control.rollout.linearized_motion import LinearizedMotion
from geodrake.control.rollout.motion_search import rollout_values
from geodrake.control.rollout.passages import Conditions, chosen_passages
from geodrake.control.rollout.simulation import simulations
from geodrake.effects import CoulombFriction, RotorInertia, ViscousFriction
from geodrake.errors import ArgumentError, LogError, ModelError
from geodrake.identification.logs.case import prepare_case
from geodrake.logs import write_log
from geodrake.model import EffortSignal
from geodrake.report import About, page_of, render
from geodrake.report.rollouts import rollout_fit_words
from geodrake.report.views import numbers_of


def departures(case):
    """Return departures in the diagram and near the motion, window by window."""
    passages = chosen_passages(case, 0.4, 2)
    made = simulations(Conditions(case, False), passages)(case.options.logs[0].name)
    for passage in passages:
        found, _ = LinearizedMotion.of(made, passage).departure(made.robot)
        yield made.positions(passage) - passage.segment.position, found


def rms(departure):
    return np.sqrt(np.mean(departure**2))


def test_near_the_motion_is_as_in_the_diagram(pendulum):
    """With backlash, both begin with links where the preceding motion leaves them."""
    for model, log, share, least in (
        (soft_arm(0.8), arm_log(2000.0, seconds=5.0), 0.12, 1e-4),
        (loose(pendulum, 1.0), swung(0), 0.03, 0.2 * GAP),
    ):
        for exact, found in departures(prepare_case(model, [log], candidates=False)):
            assert rms(exact) > least
            assert rms(found - exact) < share * rms(exact)


def test_what_cannot_be_fitted_is_said(pendulum):
    with pytest.raises(ModelError, match="no elastic joint and no backlash"):
        fit_rollouts(having(pendulum, ROTOR, FRICTION), [swung(0)])
    with pytest.raises(LogError, match="windows for fitting and"):
        fit_rollouts(springy(pendulum, 0.8), [swung(0)], most=3)


@pytest.fixture(scope="module")
def files(pendulum, tmp_path_factory):
    folder = tmp_path_factory.mktemp("command")
    save_model(springy(pendulum, 0.8), folder / "soft.yaml")
    save_model(having(pendulum, ROTOR, FRICTION), folder / "stiff.yaml")
    write_log(swung(0, seconds=4.5), folder / "log.csv")
    return folder


class TestCommand:
    def run(self, *words):
        return CliRunner().invoke(app, [str(word) for word in words])

    def test_fits_and_saves(self, files):
        done = self.run(
            "rollout", files / "soft.yaml", files / "log.csv", "--fit", "--quiet",
            "--save", files / "better.yaml", "--json", files / "fit.json",
            "--report", files / "fit.html", "--series", files / "fit.csv", "--horizon", "0.3",
        )  # fmt: skip
        assert done.exit_code == 0, done.output
        assert "held out" in done.output
        found = json.loads((files / "fit.json").read_text())
        assert found["taken"]
        value = found["values"][0]
        assert (value["effect"], value["joint"]) == ("joint_elasticity", "hinge")
        assert STIFFNESS * value["after"] == pytest.approx(1.0, abs=0.02)
        held = found["held_out"]
        assert held["after"]["relative"] < held["before"]["relative"]
        saved = load_model(files / "better.yaml").effects[-1]
        assert saved.parameters == pytest.approx(value["after"])
        assert saved.deviations == pytest.approx(value["deviation"])
        damping = next(v["after"] for v in found["values"] if v["name"] == "damping")
        assert saved.effect.damping == pytest.approx(damping)
        assert "Fitted values" in (files / "fit.html").read_text()

    @pytest.mark.parametrize(
        ("words", "says"),
        [
            ("stiff.yaml log.csv --fit", "no elastic joint and no backlash"),
            ("soft.yaml log.csv --save new.yaml", "--save new.yaml needs --fit"),
            ("soft.yaml log.csv --fit --commands", "commands of a servo"),
            ("soft.yaml log.csv --fit --before stiff.yaml", "exclude each other"),
            ("soft.yaml log.csv --fit --windows 2", "windows for fitting and"),
        ],
    )
    def test_refuses_in_a_line(self, files, monkeypatch, words, says):
        monkeypatch.chdir(files)
        done = self.run("rollout", *words.split(), "--quiet")
        assert done.exit_code == 2
        assert says in done.output
        assert not (files / "new.yaml").exists()


def test_blocks_and_logs_are_held_out_whole():
    assert held_out(["a"] * 8).tolist() == [False, False, True, True] * 2
    assert held_out(["a", "a", "b", "c", "c"]).tolist() == [False, False, True, False, False]


def test_what_is_known_of_other_parameters_stays(pendulum):
    """A fixed compliance does not correlate with the others any more."""
    model = springy(pendulum, 0.8)
    rng = np.random.default_rng(0)
    root = rng.standard_normal((13, 13))
    model = dataclasses.replace(model, information=root @ root.T + np.eye(13))
    values = rollout_values(model)
    better = fitted_model(model, values, np.array([2e-3, 0.1]), np.array([1e-4, 0.02]))
    np.testing.assert_array_equal(better.information[:12, :12], model.information[:12, :12])
    np.testing.assert_array_equal(better.information[12, :12], 0.0)
    assert better.information[12, 12] == pytest.approx(1e8)
    assert np.linalg.eigvalsh(better.information).min() > 0.0
    assert better.effects[-1].effect.damping == 0.1


# Under commands


PD = EffortSignal("hinge", "command", 100.0, damping=6.0, delay=0.013)


def servoed(model, share, *servos):
    """Return a pendulum with servos and a spring of a share of the true compliance."""
    return dataclasses.replace(springy(model, share), effort_signals=servos)


def test_a_spring_under_commands_is_found(pendulum):
    servo = dataclasses.replace(PD, integral=200.0, limit=6.5)
    log = followed(0, servo, noise=1e-4, seconds=3.5)
    assert not np.isfinite(log.effort).any()
    found = fit_rollouts(servoed(pendulum, 2.0, servo), [log], most=4, commands=True)
    before, after = found.held_out
    assert before.commands and after.commands
    assert after.relative < before.relative
    value, *_ = found.values
    assert abs(STIFFNESS * value.after - 1.0) < max(0.02, 3.5 * STIFFNESS * value.deviation)


UNSURE = dataclasses.replace(PD, deviation=10.0, damping_deviation=0.6)


def test_a_servo_and_its_motor_are_found_with_a_spring(pendulum):
    """Fit all inexact parameters, and the delay, some of either sign."""
    wrong = dataclasses.replace(UNSURE, gain=80.0, damping=4.8)
    model = servoed(pendulum, 1.5, wrong)
    *motor, spring = model.effects
    motor += having(pendulum, ROTOR, FRICTION, (effects.EffortOffset("hinge"), 1e-3)).effects[-1:]
    unsure = [replace(each, deviations=0.1 * each.parameters) for each in motor]
    model = replace(model, effects=(*unsure, spring))
    fit = fit_rollouts(model, [followed(0, PD, noise=1e-4, seconds=5.0)], most=4, commands=True)
    assert fit.taken and fit.held_out[1].relative < 0.1 * fit.held_out[0].relative
    found = {(value.effect, value.name): value.after for value in fit.values}
    expected = {
        ("joint_elasticity", "compliance"): pytest.approx(1.0 / STIFFNESS, rel=0.1),
        ("joint_elasticity", "damping"): pytest.approx(0.05, rel=0.3),
        ("servo", "gain"): pytest.approx(PD.gain, rel=0.01),
        ("servo", "damping"): pytest.approx(PD.damping, rel=0.02),
        ("servo", "delay"): pytest.approx(PD.delay, rel=0.03),
        ("rotor_inertia", "inertia"): pytest.approx(ROTOR, rel=0.02),
        ("viscous_friction", "viscous"): pytest.approx(FRICTION, rel=0.1),
    }
    assert found == expected
    (servo,) = fit.model.effort_signals
    assert servo.deviation == pytest.approx(UNSURE.deviation / 80.0 * servo.gain)
    assert fit.model.effects[2] is unsure[2]


def test_what_cannot_follow_commands_is_said(pendulum):
    log = followed(0, PD, seconds=1.5)
    with pytest.raises(LogError, match="commands of a servo"):
        fit_rollouts(servoed(pendulum, 0.5, PD), [swung(0)], commands=True)
    with pytest.raises(ArgumentError, match="commands"):
        fit_rollouts(servoed(pendulum, 0.5, PD), [log], commands="all")


def test_results_say_what_they_are_under(pendulum):
    model, log = servoed(pendulum, 0.5, PD), followed(0, PD, seconds=1.5)
    rollout = roll_out(model, [log], horizon=0.1, most=2, bandwidth=12.0, commands=True)
    late = FittedValue("servo", "hinge", "delay", 5.1e-3, 13e-3, 1e-5)
    for values, words in (
        ((), ("arm under the commands of log", "under the logged commands")),
        ((late,), ("elastic joints, backlash, servos and motors", "delay, ms", "5.10", "13.000")),
    ):
        found = RolloutFit(model, values, rollout, rollout, (False, True), 0.2)
        page = render(page_of(found, About("arm", ("log",))))
        assert all(word in page for word in words) and "logged efforts" not in page
    assert "(p = 0.20, 1 windows); add logs or" in rollout_fit_words(found)
    unsure = servoed(pendulum, 0.5, dataclasses.replace(PD, deviation=1.0))
    unfitted = dataclasses.replace(found, model=unsure, values=())
    assert "servo gains of hinge are uncertain" in unfitted.notes[-1]
    told = numbers_of(found)
    for part in ("fitted", "held_out"):
        assert {stage["under"] for stage in told[part].values()} == {"commands"}


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("pendulum") / "pendulum.urdf"
    path.write_text(PENDULUM)
    return load_model(path)


@pytest.fixture(scope="module")
def log():
    return servo_log()


@pytest.fixture(scope="module")
def fit(model, log):
    """Fit one log, cut in two."""
    half, columns = len(log) // 2, ("time", "position", "effort", "command")
    parts = {"a": slice(half), "b": slice(half, None)}
    logs = [
        replace(log, name=name, **{c: getattr(log, c)[part] for c in columns})
        for name, part in parts.items()
    ]
    return fit_rollouts(model, logs, commands=True)


def test_a_servo_and_its_joint_are_those_of_mujoco(fit):
    (servo,) = fit.model.effort_signals
    kp, _, damping, coulomb, armature, _ = TRUTH
    found = {type(each.effect): float(each.parameters[0]) for each in fit.model.effects}
    assert servo.gain == pytest.approx(kp, rel=0.01)
    assert servo.delay - servo.damping / servo.gain == pytest.approx(LATE, abs=0.002)
    assert found[ViscousFriction] + servo.damping == pytest.approx(damping, rel=0.05)
    assert found[CoulombFriction] == pytest.approx(coulomb, rel=0.05)
    assert found[RotorInertia] == pytest.approx(armature, rel=0.25)


def test_windows_that_the_fit_did_not_see_depart_less(fit):
    before, after = fit.held_out
    assert fit.taken and fit.chance < 0.02
    assert after.relative < 0.05 * before.relative
    values = {(value.effect, value.name): value for value in fit.values}
    assert values["servo", "gain"].after == pytest.approx(TRUTH[0], rel=0.02)
    assert values["coulomb_friction", "coulomb"].before == 0.0


def test_a_joint_that_no_command_moves_is_refused(model, log):
    rng = np.random.default_rng(0)
    few = {name: getattr(log, name)[:2000] for name in ("time", "position", "effort", "command")}
    other = replace(log, **few | {"command": 0.3 * rng.normal(size=(2000, 1))})
    with pytest.raises(LogError, match="command"):
        fit_rollouts(model, [other], commands=True)
