"""`geodrake identify`: finds what is there, writes it back, and refuses what cannot end well."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from commands import refused, run, told
from pendulum_logs import PENDULUM as MODEL
from pendulum_logs import sines

from geodrake.cli.identify import named_effects
from geodrake.effects import CoulombFriction, FittedEffect, Payload, RotorInertia
from geodrake.errors import ArgumentError, IdentificationError, ModelError
from geodrake.identification import IdentificationSettings, identify_model
from geodrake.identification.logs.log_fits import LogFits
from geodrake.identification.models.identify import with_effects
from geodrake.inertia import from_mass_com_inertia, is_physical
from geodrake.logs import JointLog, write_log
from geodrake.model import load_model, save_model
from geodrake.report import page_of, render
from geodrake.report.numbers import number

FRICTIONS = "viscous_friction,coulomb_friction"
HEAVIER = 1.5


def truth():
    """The pendulum with a heavier forearm than its model file says."""
    model = load_model(MODEL)
    phi = model.phi.copy()
    phi[-1] *= HEAVIER
    return replace(model, phi=phi)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    time, moved = sines()
    effort = truth().effort(moved) + np.sign(moved.v) * [0.3, 0.2] + 0.1 * moved.v
    effort += 0.02 * np.random.default_rng(1).normal(size=effort.shape)
    path = tmp_path_factory.mktemp("logs") / "log.csv"
    write_log(JointLog("log", truth().joints, time, moved.q, effort), path)
    return path


@pytest.fixture(scope="module")
def found(log):
    model = load_model(MODEL)
    effects = named_effects(FRICTIONS.split(","), model)
    return identify_model(model, [log], effects=effects)


def identify(*arguments):
    """Numbers of the command on the pendulum, which it writes to standard output."""
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
    band = ("--bandwidth", "5")  # else it is chosen for the model, and that is another one after
    output = told("identify", MODEL, log, "--effects", FRICTIONS, *band, *files)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names.values())
    assert not re.search("[─━│\x1b]", output)
    for words in ("Joint by joint", "Mass in kg", "Verdict: nrms on held-out data"):
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
    """What moves an effort, not every parameter: of a pendulum, base parameters are seen."""
    _, moved = sines()
    exact, fitted = truth(), found.model
    rigid = replace(fitted, effects=())
    assert np.sqrt(np.mean((rigid.effort(moved) - exact.effort(moved)) ** 2)) < 0.02
    for effect in fitted.effects:
        expected = {"viscous_friction": [0.1, 0.1], "coulomb_friction": [0.3, 0.2]}
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


def test_a_weight_that_is_given_is_taken(log):
    numbers = identify(log, "--effects", FRICTIONS, "--regularizer", "riemannian", "--gamma", 3)
    assert (numbers["regularizer"], numbers["gamma"]) == ("riemannian", 3.0)
    assert numbers["sweep"] == [] and numbers["error"]["end_nrms"] < 0.3


def test_compare_tells_of_a_regularizer_without_a_solution(log, monkeypatch):
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
    effects = named_effects(FRICTIONS.split(","), model)
    settings = IdentificationSettings(residual_ratio=1.02)
    found = identify_model(model, [log], settings, effects=effects)
    loose = identify_model(
        model, [log], IdentificationSettings(gamma=1e-6), effects=effects
    )  # next to the least residual
    assert np.sqrt(found.result.residual / loose.result.residual) == pytest.approx(1.02, rel=1e-3)
    assert found.gamma > 1e-6
    weighed = IdentificationSettings(gamma=10.0, total_mass=1.6)
    phi = identify_model(model, [log], weighed, effects=effects).model.phi
    assert phi[:, 0].sum() == pytest.approx(1.6, rel=1e-6)


def test_a_payload_is_a_body_of_its_own(tmp_path):
    load = from_mass_com_inertia(0.8, [0.0, 0.0, 0.1], 0.004 * np.eye(3))
    bare = load_model(MODEL)
    time, moved = sines()
    carrying = replace(bare, effects=(FittedEffect(Payload(bare.bodies[-1]), load),))
    effort = carrying.effort(moved) + 0.02 * np.random.default_rng(1).normal(size=moved.v.shape)
    log = JointLog("log", bare.joints, time, moved.q, effort)
    settings = IdentificationSettings(gamma=30.0)
    found = identify_model(carrying, [log], settings)
    assert [body.name for body in found.bodies][-1] == f"payload on {bare.bodies[-1]}"
    (fitted,) = found.model.effects
    assert fitted.parameters[0] == pytest.approx(0.8, rel=0.1)
    save_model(found.model, tmp_path / "m.yaml")
    assert load_model(tmp_path / "m.yaml").information.shape == (30, 30)
    new = identify_model(
        bare, [log], settings, effects=named_effects([f"payload@{bare.bodies[-1]}"], bare)
    )
    assert new.before.nrms > 3 * new.after.nrms


def test_a_bare_model_is_told_what_it_lacks(log):
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


@pytest.mark.parametrize(
    ("error", "option", "words"),
    [
        (
            IdentificationError("The solver found nothing."),
            "--residual-bound 1.0001",
            ["Raise the bound, or use gamma instead"],
        ),
        (
            IdentificationError("The solver's parameters are not physical.", columns=[10]),
            "--gamma 1e-9",
            ["(lower_link)", "larger gamma"],
        ),
    ],
)
def test_what_a_solver_cannot_do_is_told_with_what_helps(log, monkeypatch, error, option, words):
    def failing(*_arguments, **_settings):
        raise error

    monkeypatch.setattr("geodrake.identification.logs.log_fits.identify", failing)
    message = refused("identify", MODEL, log, *option.split())
    assert all(each in message for each in words)


def test_a_write_that_fails_leaves_nothing(log, tmp_path, monkeypatch):
    def failing(*_arguments):
        raise ModelError("It cannot be changed.")

    monkeypatch.setattr("geodrake.model.export.EditedFile", failing)
    message = refused(
        "identify", MODEL, log, "--gamma", "1", "--save", "m.yaml", "--export", "o.urdf"
    )
    assert "It cannot be changed." in message
    assert list(tmp_path.iterdir()) == []


def test_the_page_says_that_the_model_was_refitted(found):
    page = render(page_of(found))
    assert "Nothing was refitted" not in page
    assert "Errors of refitted models are on held-out data" in page
    assert "What the model as it stands gets wrong" not in page
    assert ">compared<" not in page
    assert re.search(r">\s*identified\s*<", page)
    ends = f"{number(found.before.nrms)} → {number(found.after.nrms)}"
    verdict = f"nrms on held-out data {ends}"
    assert re.search(rf"<h1[^>]*>\s*{re.escape(verdict)}", page)
    assert "before" in page
