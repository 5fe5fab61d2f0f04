"""`geodrake identify` and `identifiable`: results, files, and errors of solvers."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from commands import refused, run, told
from pendulum_logs import PENDULUM as MODEL
from pendulum_logs import sine_log, sines

from geodrake.cli.identify import named_effects
from geodrake.effects import CoulombFriction, FittedEffect, Payload, RotorInertia
from geodrake.errors import ArgumentError, IdentificationError, ModelError
from geodrake.excitation import (
    identifiable_parameters,
    log_identifiability,
    make_target,
    measurement_factor,
)
from geodrake.identification import IdentificationSettings, identify_model
from geodrake.identification.logs.log_fits import LogFits
from geodrake.identification.models.identify import with_effects
from geodrake.inertia import from_mass_com_inertia, is_physical
from geodrake.logs import JointLog, write_log
from geodrake.model import load_model, save_model
from geodrake.report import page_of, render
from geodrake.report.exciting import identifiable_sentences
from geodrake.report.numbers import number
from geodrake.robot.base_parameters import structural_base_parameters

FRICTIONS = "viscous_friction,coulomb_friction"
HEAVIER = 1.5


def truth():
    """Return the pendulum with a heavier forearm than its model file has."""
    model = load_model(MODEL)
    phi = model.phi.copy()
    phi[-1] *= HEAVIER
    return replace(model, phi=phi)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "log.csv"
    write_log(sine_log(truth()), path)
    return path


@pytest.fixture(scope="module")
def found(log):
    model = load_model(MODEL)
    return identify_model(model, [log], effects=frictions(model))


def frictions(model):
    return named_effects(FRICTIONS.split(","), model)


def identify(*arguments):
    """Return the numbers of the command on the pendulum."""
    result = run("identify", MODEL, *arguments, "--json", "-")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_everything_is_written(log, tmp_path):
    names = {
        "--save": "m.yaml",
        "--export": "out.urdf",
        "--json": "n.json",
        "--report": "r.html",
        "--ellipsoids": "e.png",
        "--meshcat": "e.html",
    }
    files = [word for option, name in names.items() for word in (option, tmp_path / name)]
    band = ("--bandwidth", "5")  # otherwise it is chosen anew for the fitted model
    output = told("identify", MODEL, log, "--effects", FRICTIONS, *band, *files)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names.values())
    assert not re.search("[─━│\x1b]", output)
    for words in ("Joint by joint", "Mass in kg", "Verdict: Identified, nrms "):
        assert words in output

    saved, exported = load_model(tmp_path / "m.yaml"), load_model(tmp_path / "out.urdf")
    np.testing.assert_allclose(exported.phi, saved.phi, rtol=1e-9, atol=1e-15)
    numbers = json.loads((tmp_path / "n.json").read_text())
    assert numbers["certificate"]["holds"] and numbers["certificate"]["solver"] == "clarabel"
    assert numbers["error"]["end_nrms"] < 0.2 * numbers["error"]["start_nrms"]
    page = (tmp_path / "r.html").read_text().replace("<wbr>", "")
    table = page.partition("<h2>Bodies</h2>")[2]
    assert all(body in table for body in saved.bodies) and "kg" in table
    body = numbers["bodies"][saved.bodies[-1]]
    assert body["mass"] == pytest.approx(saved.phi[-1, 0])
    assert body["mass_before"] == pytest.approx(truth().phi[-1, 0] / HEAVIER)
    assert {e["effect"] for e in numbers["effects"]} == set(FRICTIONS.split(","))
    again = run("compare", tmp_path / "m.yaml", log, *band, "--json", "-")
    compared = json.loads(again.stdout)["error"]["nrms"]
    assert compared == pytest.approx(numbers["error"]["end_nrms"], rel=0.1)


def test_the_fit_is_the_truth_within_its_deviations(found):
    """Efforts identify the base parameters of a pendulum, not every parameter."""
    _, moved = sines()
    exact, fitted = truth(), found.model
    rigid = replace(fitted, effects=())
    assert np.sqrt(np.mean((rigid.effort(moved) - exact.effort(moved)) ** 2)) < 0.02
    expected = {"viscous_friction": [0.1, 0.1], "coulomb_friction": [0.3, 0.2]}
    for effect in fitted.effects:
        at = fitted.joints.index(effect.effect.where[0])
        error = effect.parameters[0] - expected[effect.effect.name][at]
        assert abs(error) < 4 * effect.deviations[0] + 0.01
    assert is_physical(fitted.phi).all()
    assert found.after.nrms < 3 * found.after.floor_nrms
    assert fitted.information.shape == (24, 24)
    assert np.linalg.eigvalsh(fitted.information).min() > 0
    assert fitted.fitted_to
    best = min(tried.nrms for tried in found.sweep)  # the weight is the largest that is as good
    chosen = next(tried.nrms for tried in found.sweep if tried.gamma == found.gamma)
    assert best <= chosen <= 1.1 * best
    assert [t.gamma for t in found.sweep] == sorted((t.gamma for t in found.sweep), reverse=True)


def test_a_given_weight_is_used(log):
    numbers = identify(log, "--effects", FRICTIONS, "--regularizer", "riemannian", "--gamma", 3)
    assert (numbers["regularizer"], numbers["gamma"]) == ("riemannian", 3.0)
    assert numbers["sweep"] == [] and numbers["error"]["end_nrms"] < 0.3


def test_compare_names_a_regularizer_without_a_solution(log, monkeypatch):
    solve = LogFits.solve

    def failing(self, regularizer, **options):
        if regularizer == "pullback":
            raise IdentificationError("The solver found nothing.")
        return solve(self, regularizer, **options)

    monkeypatch.setattr(LogFits, "solve", failing)
    numbers = identify(log, "--effects", FRICTIONS, "--gamma", "10", "--compare")
    compared = [row["regularizer"] for row in numbers["comparison"]]
    assert compared == ["euclidean", "entropic", "riemannian"]
    why = "the pullback regularizer has no solution to compare: Without one fold: The solver found"
    assert sum(why in note for note in numbers["notes"]) == 1


def test_a_residual_bound_and_a_total_mass_are_met(log):
    model = load_model(MODEL)

    def fitted(**settings):
        return identify_model(
            model, [log], IdentificationSettings(**settings), effects=frictions(model)
        )

    found, loose = fitted(residual_ratio=1.02), fitted(gamma=1e-6)  # next to the least residual
    assert np.sqrt(found.result.residual / loose.result.residual) == pytest.approx(1.02, rel=1e-3)
    assert found.gamma > 1e-6
    phi = fitted(gamma=10.0, total_mass=1.6).model.phi
    assert phi[:, 0].sum() == pytest.approx(1.6, rel=1e-6)


def test_a_payload_is_a_body_of_its_own(tmp_path):
    load = from_mass_com_inertia(0.8, [0.0, 0.0, 0.1], 0.004 * np.eye(3))
    bare, hand = load_model(MODEL), load_model(MODEL).bodies[-1]
    time, moved = sines()
    carrying = replace(bare, effects=(FittedEffect(Payload(hand), load),))
    effort = carrying.effort(moved) + 0.02 * np.random.default_rng(1).normal(size=moved.v.shape)
    log = JointLog("log", bare.joints, time, moved.q, effort)
    settings = IdentificationSettings(gamma=30.0)
    found = identify_model(carrying, [log], settings)
    assert [body.name for body in found.bodies][-1] == f"payload on {hand}"
    (fitted,) = found.model.effects
    assert fitted.parameters[0] == pytest.approx(0.8, rel=0.1)
    save_model(found.model, tmp_path / "m.yaml")
    assert load_model(tmp_path / "m.yaml").information.shape == (30, 30)
    effects = named_effects([f"payload@{hand}"], bare)
    new = identify_model(bare, [log], settings, effects=effects)
    assert new.before.nrms > 3 * new.after.nrms


def test_missing_effects_of_a_bare_model_are_suggested(log):
    assert f"--effects {FRICTIONS}" in told("identify", MODEL, log, "--gamma", "10")


def test_effects_by_name():
    model = load_model(MODEL)
    assert named_effects(["rotor_inertia@elbow"], model) == (RotorInertia("elbow"),)
    assert len(named_effects(["coulomb_friction"], model)) == 2
    assert len(named_effects(["coupled_friction", "coupled_friction@shoulder+elbow"], model)) == 1
    has = with_effects(model, [CoulombFriction("elbow")])
    assert named_effects(["coulomb_friction"], has) == (CoulombFriction("shoulder"),)
    with pytest.raises(ArgumentError, match="already has coulomb_friction at elbow"):
        with_effects(has, [CoulombFriction("elbow")])


def test_errors_of_solvers_say_what_helps(log, monkeypatch):
    nothing = IdentificationError("The solver found nothing.")
    flat = IdentificationError("The solver's parameters are not physical.", columns=[10])
    for error, option, words in (
        (nothing, "--residual-bound 1.0001", ["Raise the bound, or use gamma instead"]),
        (flat, "--gamma 1e-9", ["(lower_link)", "larger gamma"]),
    ):

        def failing(*_arguments, error=error, **_settings):
            raise error

        monkeypatch.setattr("geodrake.identification.logs.log_fits.identify", failing)
        message = refused("identify", MODEL, log, *option.split())
        assert all(each in message for each in words)


def test_a_write_that_fails_leaves_nothing(log, tmp_path, monkeypatch):
    def failing(*_arguments):
        raise ModelError("It cannot be changed.")

    monkeypatch.setattr("geodrake.model.export.EditedFile", failing)
    files = ("--save", "m.yaml", "--export", "o.urdf")
    assert "It cannot be changed." in refused("identify", MODEL, log, "--gamma", "1", *files)
    assert list(tmp_path.iterdir()) == []


def test_the_page_says_that_the_model_was_refitted(found):
    page = render(page_of(found))
    assert "Nothing was refitted" not in page
    assert "Errors of refitted models are on held-out data" in page
    assert "What the model as it stands gets wrong" not in page
    ends = f"{number(found.before.nrms)} → {number(found.after.nrms)}"
    verdict = f"Identified, nrms {ends} on held-out data"
    assert re.search(rf"<h1[^>]*>\s*{re.escape(verdict)}", page)
    assert "before" in page


NOISE = 0.02
LOG = sine_log(load_model(MODEL), seed=0)


def found_in(logs, **settings):
    model = load_model(MODEL)
    return log_identifiability(model, logs, effects=frictions(model), **settings)


def test_counts_are_written(tmp_path):
    write_log(LOG, tmp_path / "log.csv")
    files = ("--json", tmp_path / "n.json", "--report", tmp_path / "r.html")
    output = told("identifiable", MODEL, tmp_path / "log.csv", "--effects", FRICTIONS, *files)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.csv", "n.json", "r.html"]
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


def test_counts_are_those_of_the_motion():
    """Compare with the exact, unfiltered motion under as much noise.

    The model with its friction explains the log, whatever the filter.
    """
    found = found_in([LOG])
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


def test_parameters_of_a_joint_at_rest_are_not_identifiable():
    lame_log = sine_log(load_model(MODEL), size=(0.4, 0.01), seed=0)
    lame, lively = (found_in([each], noise=NOISE) for each in (lame_log, LOG))
    assert lame.count < lively.count
    missing = {(e.effect, e.where) for e in lame.effects if not e.is_identifiable}
    assert ("viscous_friction", ("elbow",)) in missing
    assert "viscous_friction of elbow" in " ".join(identifiable_sentences(lame))
    assert "All parameters of effects are identifiable" in " ".join(identifiable_sentences(lively))
