"""`geodrake identifiable`: counts that are right, words that follow from them, bad input."""

import json

import numpy as np
import pytest
from commands import told
from pendulum_logs import PENDULUM as MODEL
from pendulum_logs import sines

from geodrake.cli.identify import named_effects
from geodrake.excitation import (
    identifiable_parameters,
    log_identifiability,
    make_target,
    measurement_factor,
)
from geodrake.logs import JointLog, write_log
from geodrake.model import load_model
from geodrake.report.exciting import identifiability_verdict
from geodrake.robot.base_parameters import structural_base_parameters

FRICTIONS = ("viscous_friction", "coulomb_friction")
NOISE = 0.02


def pendulum_log(path, *, elbow=0.4, seconds=20.0, seed=0, friction=(0.3, 0.2)):
    """A log in which the elbow moves by a share, of a pendulum with friction."""
    rng, model = np.random.default_rng(seed + 100), load_model(MODEL)
    time, moved = sines(seconds, seed, np.array([0.4, elbow]))
    effort = model.effort(moved) + np.sign(moved.v) * friction + 0.1 * moved.v
    effort += NOISE * rng.normal(size=effort.shape)
    write_log(JointLog("log", model.joints, time, moved.q, effort), path)
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return pendulum_log(tmp_path_factory.mktemp("logs") / "log.csv")


def found_in(logs, **settings):
    model = load_model(MODEL)
    effects = named_effects(FRICTIONS, model)
    return log_identifiability(model, logs, effects=effects, **settings)


def test_everything_is_written(log, tmp_path):
    files = ("--json", tmp_path / "n.json", "--report", tmp_path / "r.html")
    output = told("identifiable", MODEL, log, "--effects", ",".join(FRICTIONS), *files)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["n.json", "r.html"]
    numbers = json.loads((tmp_path / "n.json").read_text())
    assert numbers["command"] == "identifiable"
    assert f"{numbers['told']} of {numbers['possible']} directions are identifiable" in output
    assert numbers["told"] == sum(d["told"] for d in numbers["directions"])
    assert numbers["told"] <= numbers["possible"] == len(numbers["combinations"])
    told_by = sum(b["told"] for b in numbers["bodies"].values())
    told_by += sum(e["told"] for e in numbers["effects"])
    assert told_by == pytest.approx(numbers["told"])
    page = (tmp_path / "r.html").read_text().replace("<wbr>", "")
    assert "chart-directions" in page and "coulomb_friction" in page


def test_counts_are_those_of_the_motion(log):
    """The same number of directions as from the exact, unfiltered motion and as much noise.

    The model with its friction explains the log, whatever the filter.
    """
    found = found_in([log])
    model = found.model
    rank = structural_base_parameters(model.plant).rank
    assert found.possible == rank + 4
    assert sum(b.possible for b in (*found.bodies, *found.effects)) == pytest.approx(rank + 4)
    np.testing.assert_allclose(found.noise, found.floor, rtol=0.6)
    assert found.count_at_floor >= found.count - 1
    time, motion = sines(seed=0)
    share = np.sqrt(len(time) / found.samples)  # as much information from more samples
    target = make_target(model, noise=found.noise * share, sign_width=1e-2)
    exact = identifiable_parameters(target, measurement_factor(target, motion))
    assert abs(exact.kept - found.count) <= 1
    np.testing.assert_allclose(
        np.sqrt(found.identifiable.variances[:4]), np.sqrt(exact.variances[:4]), rtol=0.3
    )


def test_a_joint_that_hardly_moves_is_not_told(tmp_path, log):
    lame = found_in([pendulum_log(tmp_path / "lame.csv", elbow=0.01)], noise=NOISE)
    lively = found_in([log], noise=NOISE)
    assert lame.count < lively.count
    missing = {(e.effect, e.where) for e in lame.effects if not e.is_identifiable}
    assert ("viscous_friction", ("elbow",)) in missing
    assert "viscous_friction of elbow" in identifiability_verdict(lame)
    assert "All parameters of effects are identifiable" in identifiability_verdict(lively)
