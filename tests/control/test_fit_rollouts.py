"""Fits of soft joints and play by rollouts; logs are of two masses, by scipy and by MuJoCo."""

import dataclasses
import json

import numpy as np
import pytest
from flexible_arm import arm_log, soft_arm
from two_masses import FRICTION, GAP, ROTOR, STIFFNESS, having, loose, springy, swung
from typer.testing import CliRunner

from geodrake import load_model, save_model
from geodrake.cli.app import app
from geodrake.control.rollout import fit_rollouts
from geodrake.control.rollout.fit_rollouts import better_model, held_out
from geodrake.control.rollout.linearized_motion import LinearizedMotion
from geodrake.control.rollout.motion_search import blinds
from geodrake.control.rollout.passages import chosen_passages
from geodrake.control.rollout.rollout_values import rollout_values
from geodrake.control.rollout.simulation import simulations
from geodrake.errors import LogError, ModelError
from geodrake.identification.logs.case import open_case
from geodrake.logs.files import write_log


def never_worse(found):
    """Whether held-out windows of the model that comes back depart no more than before."""
    before, after = found.held_out
    return not found.taken or after.relative <= before.relative


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(6))
def test_a_gap_that_is_too_wide_is_found(pendulum, seed):
    """Its sides are not those of the log, so that it is known less well."""
    found = fit_rollouts(loose(pendulum, 1.3), [swung(seed, stiffness=2e3, gap=GAP)])
    (value,) = found.values
    assert abs(value.after / GAP - 1.0) < 0.25
    assert abs(value.after - GAP) < 3.0 * value.deviation
    assert never_worse(found)
    if found.taken:
        assert found.model.effects[-1].effect.half_width == value.after


def linearized_motion(model, log, most=2):
    """Windows of a log, and how they are simulated near their motion."""
    case = open_case(model, [log], candidates=False)
    passages = chosen_passages(case, 0.4, most)
    simulation = simulations(case, passages)(log.name)
    for passage in passages:
        near, soft = LinearizedMotion.of(simulation, passage), simulation.law.soft
        yield passage, simulation, near, soft.couplings(simulation.law.mu)


def test_near_the_motion_is_as_in_the_diagram():
    model = soft_arm(0.8)
    for passage, simulation, near, couplings in linearized_motion(model, arm_log(2000.0)):
        exact = simulation.positions(passage) - passage.segment.position
        found, _ = near.departure(model.effects, couplings)
        assert np.sqrt(np.mean((found - exact) ** 2)) < 0.12 * np.sqrt(np.mean(exact**2))


def test_play_near_the_motion_is_as_in_the_diagram(pendulum):
    """Both begin with links where the motion before leaves them in their dead bands."""
    for passage, simulation, near, couplings in linearized_motion(loose(pendulum, 1.0), swung(0)):
        exact = simulation.positions(passage) - passage.segment.position
        found, _ = near.departure(loose(pendulum, 1.0).effects, couplings)
        assert np.sqrt(np.mean(exact**2)) > 0.2 * GAP
        assert np.sqrt(np.mean((found - exact) ** 2)) < 0.03 * np.sqrt(np.mean(exact**2))


def test_what_cannot_be_fitted_is_said(pendulum):
    with pytest.raises(ModelError, match="no soft joint and no play"):
        fit_rollouts(having(pendulum, ROTOR, FRICTION), [swung(0)])
    with pytest.raises(LogError, match="windows to fit and"):
        fit_rollouts(springy(pendulum, 0.8), [swung(0)], most=3)


@pytest.fixture(scope="module")
def files(pendulum, tmp_path_factory):
    folder = tmp_path_factory.mktemp("command")
    save_model(springy(pendulum, 0.8), folder / "soft.yaml")
    save_model(having(pendulum, ROTOR, FRICTION), folder / "stiff.yaml")
    write_log(swung(0, seconds=10.0), folder / "log.csv")
    return folder


class TestCommand:
    def run(self, *words):
        return CliRunner().invoke(app, [str(word) for word in words])

    def test_fits_and_saves(self, files):
        done = self.run(
            "rollout", files / "soft.yaml", files / "log.csv", "--fit", "--quiet",
            "--save", files / "better.yaml", "--json", files / "fit.json",
            "--report", files / "fit.html", "--series", files / "fit.csv",
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
        assert "What was fitted" in (files / "fit.html").read_text()

    @pytest.mark.parametrize(
        ("words", "says"),
        [
            ("stiff.yaml log.csv --fit", "no soft joint and no play"),
            ("soft.yaml log.csv --save new.yaml", "Without --fit"),
            ("soft.yaml log.csv --fit --commands", "commands of a servo"),
            ("soft.yaml log.csv --fit --before stiff.yaml", "do not go together"),
            ("soft.yaml log.csv --fit --windows 2", "windows to fit and"),
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


def test_windows_count_alike_in_any_order():
    """Also those of logs at different rates, which have different numbers of samples."""
    rng = np.random.default_rng(0)
    departures = [rng.standard_normal((count, 1)) for count in (400, 25, 100)]
    slopes = [np.ones((len(each), 1, 1)) for each in departures]
    scales = {way: blinds(slopes[::way], departures[::way])[0].scale for way in (1, -1)}
    np.testing.assert_allclose(scales[1], scales[-1])


def test_what_is_known_of_other_parameters_stays(pendulum):
    """As for a compliance that is given: nothing of it varies with the others any more."""
    model = springy(pendulum, 0.8)
    rng = np.random.default_rng(0)
    root = rng.standard_normal((13, 13))
    model = dataclasses.replace(model, information=root @ root.T + np.eye(13))
    values = rollout_values(model)
    better = better_model(model, values, np.array([2e-3, 0.1]), np.array([1e-4, 0.02]))
    np.testing.assert_array_equal(better.information[:12, :12], model.information[:12, :12])
    np.testing.assert_array_equal(better.information[12, :12], 0.0)
    assert better.information[12, 12] == pytest.approx(1e8)
    assert np.linalg.eigvalsh(better.information).min() > 0.0
    assert better.effects[-1].effect.damping == 0.1
