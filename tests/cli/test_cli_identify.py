"""`geodrake identify`: finds what is there, writes it back, and refuses what cannot end well."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from pendulum_logs import PENDULUM as MODEL
from pendulum_logs import sines
from typer.testing import CliRunner

from geodrake.cli.app import app
from geodrake.cli.identify import named_effects
from geodrake.effects import CoulombFriction, FittedEffect, Payload, RotorInertia
from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification.identify import REGULARIZERS, regularizer_of
from geodrake.identification.logs.log_fits import LogFits, log_unknowns, regularizer_scale
from geodrake.identification.models import IdentificationSettings, identify_model
from geodrake.identification.models.identify import with_effects
from geodrake.inertia import from_mass_com_inertia, is_physical
from geodrake.logs.files import write_log
from geodrake.logs.motion import JointLog
from geodrake.model.saved_model import load_model, save_model
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
    return CliRunner().invoke(app, ["identify", *(str(a) for a in arguments)])


def refused(*arguments):
    result = identify(*arguments)
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    assert result.stdout == ""
    return result.stderr


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
    result = identify(MODEL, log, "--effects", FRICTIONS, *band, *files)
    assert result.exit_code == 0, result.output
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names.values())
    assert not re.search("[─━│\x1b]", result.output)
    for words in ("Joint by joint", "Mass in kg", "Verdict: The held-out error goes from nrms"):
        assert words in result.output

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
    again = CliRunner().invoke(
        app, ["compare", str(tmp_path / "m.yaml"), str(log), *band, "--json", "-"]
    )
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


def test_the_weight_is_the_largest_that_is_as_good(found):
    assert found.gamma in {tried.gamma for tried in found.sweep}
    best = min(tried.nrms for tried in found.sweep)
    chosen = next(tried.nrms for tried in found.sweep if tried.gamma == found.gamma)
    assert best <= chosen <= 1.1 * best
    assert [t.gamma for t in found.sweep] == sorted((t.gamma for t in found.sweep), reverse=True)


def test_held_out_errors_are_those_of_fits_without_the_fold(log):
    """Against residuals of the rows themselves, not through the triangular factors."""
    from geodrake.identification.logs.case import open_case

    model = with_effects(load_model(MODEL), named_effects(["viscous_friction"], truth()))
    case = open_case(model, [log], candidates=False)
    fits = LogFits(case.dataset, log_unknowns(case.dataset, model), np.array([1.0, 2.0]))
    held_out = fits.held_out([fits.solve("pullback", gamma=3.0, without=f) for f in fits.folds])
    for j, data in enumerate(case.dataset.data):
        for f in fits.folds:
            result = fits.solve("pullback", gamma=3.0, without=f)
            x = result.x
            local = data.local(fits.unknowns.columns)
            squares = [
                np.square(r.b[:, 0] - r.A[:, local[local >= 0]] @ x[local >= 0]).sum()
                for r in data.rows[f]
            ]
            assert held_out.sse[f, j] == pytest.approx(sum(squares), rel=1e-6)


def test_every_regularizer_knows_friction_to_within_its_size(log):
    from geodrake.identification.logs.case import open_case

    model = load_model(MODEL)
    known = [FittedEffect(CoulombFriction(joint), np.array([5.0])) for joint in model.joints]
    model = replace(model, effects=tuple(known))
    case = open_case(model, [log], candidates=False)
    fits = LogFits(case.dataset, log_unknowns(case.dataset, model), np.array([1.0, 2.0]))
    firm = 3.0 * regularizer_scale(fits.prior, "pullback")
    for name in REGULARIZERS:
        own_gamma = firm / regularizer_scale(fits.prior, name)
        values, weights = fits.extra_prior(name, own_gamma).T
        own = weights * regularizer_of(name).scalar_divergence(1.1 * values, values)
        np.testing.assert_allclose(firm / regularizer_scale(fits.prior, name) * own, 0.01)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("regularizer", ["pullback", "euclidean", "riemannian"])
def test_other_regularizers(log, regularizer):
    result = identify(
        MODEL,
        log,
        "--effects",
        FRICTIONS,
        "--regularizer",
        regularizer,
        "--gamma",
        "3",
        "--json",
        "-",
    )
    assert result.exit_code == 0, result.output
    numbers = json.loads(result.stdout)
    assert (numbers["regularizer"], numbers["gamma"], numbers["sweep"]) == (regularizer, 3.0, [])
    assert numbers["error"]["end_nrms"] < 0.3


def test_compare_tells_of_a_regularizer_without_a_solution(log, monkeypatch):
    solve = LogFits.solve

    def failing(self, regularizer, **options):
        if regularizer == "pullback":
            raise IdentificationError("The solver found nothing.")
        return solve(self, regularizer, **options)

    monkeypatch.setattr(LogFits, "solve", failing)
    result = identify(
        MODEL, log, "--effects", FRICTIONS, "--gamma", "10", "--compare", "--json", "-"
    )
    assert result.exit_code == 0, result.output
    numbers = json.loads(result.stdout)
    compared = [row["regularizer"] for row in numbers["comparison"]]
    assert compared == ["euclidean", "entropic", "riemannian"]
    why = "the pullback regularizer has no solution to compare: Without one fold: The solver found"
    assert sum(why in note for note in numbers["notes"]) == 1


def test_a_residual_bound_is_met(log):
    model = load_model(MODEL)
    effects = named_effects(FRICTIONS.split(","), model)
    settings = IdentificationSettings(residual_ratio=1.02)
    found = identify_model(model, [log], settings, effects=effects)
    loose = identify_model(
        model, [log], IdentificationSettings(gamma=1e-6), effects=effects
    )  # next to the least residual
    assert np.sqrt(found.result.residual / loose.result.residual) == pytest.approx(1.02, rel=1e-3)
    assert found.gamma > 1e-6


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
    result = identify(MODEL, log, "--gamma", "10")
    assert result.exit_code == 0, result.output
    assert f"--effects {FRICTIONS}" in result.output


def test_effects_by_name():
    model = load_model(MODEL)
    assert named_effects(["rotor_inertia@elbow"], model) == (RotorInertia("elbow"),)
    assert len(named_effects(["coulomb_friction"], model)) == 2
    assert len(named_effects(["coupled_friction", "coupled_friction@shoulder+elbow"], model)) == 1
    has = with_effects(model, [CoulombFriction("elbow")])
    assert named_effects(["coulomb_friction"], has) == (CoulombFriction("shoulder"),)
    with pytest.raises(ArgumentError, match="has coulomb_friction at elbow already"):
        with_effects(has, [CoulombFriction("elbow")])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--regularizer", "ridge"), 'regularizer must be one of "euclidean", "pullback"'),
        (("--gamma", "0"), "gamma must be a finite number above 0; it is 0"),
        (("--gamma", "nan"), "gamma must be a finite number above 0"),
        (("--gamma", "1", "--residual-bound", "1.1"), "Give one of them"),
        (("--residual-bound", "0.9"), "must be above 1"),
        (("--residual-bound", "nan"), "The residual bound must be a finite number"),
        (
            ("--total-mass", "-1"),
            "The total mass, in kg, must be a finite number above 0",
        ),
        (("--effects", "friction"), "Did you mean"),
        (("--effects", "payload"), "payload cannot be everywhere. Say on which body it is"),
        (("--effects", "payload@hand"), "no body 'hand'"),
        (("--effects", "coulomb_friction@wrist"), "no joint 'wrist'"),
        (("--effects", "stribeck_friction"), "geodrake add stribeck_friction MODEL LOG"),
        (("--effects", "none.py"), "none.py"),
        (("--export", "out.sdf"), "double_pendulum.urdf is a URDF"),
        (("--export", "out.txt"), "does not end in .urdf"),
        (("--export", str(MODEL)), "is an input of this command"),
        (("--ellipsoids", "e.gif"), "does not end in .png"),
        (("--meshcat", "nowhere/e.html"), "which is no folder"),
        (("--meshcat", "a.html", "--report", "a.html"), "already the target"),
    ],
)
def test_what_cannot_end_well_is_refused(log, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    message = refused(MODEL, log, "--save", "kept.yaml", *arguments)
    assert words in message
    assert list(tmp_path.iterdir()) == []


def test_an_unreachable_residual_is_refused(log, monkeypatch):
    def failing(*_arguments, **_settings):
        raise IdentificationError("The solver found nothing.")

    monkeypatch.setattr("geodrake.identification.logs.log_fits.identify", failing)
    message = refused(MODEL, log, "--residual-bound", "1.0001")
    assert "Raise the bound, or give gamma instead" in message


def test_too_small_a_weight_names_the_body(log, monkeypatch):
    def failing(*_arguments, **_settings):
        raise IdentificationError("The solver's parameters are not physical.", columns=[10])

    monkeypatch.setattr("geodrake.identification.logs.log_fits.identify", failing)
    message = refused(MODEL, log, "--gamma", "1e-9")
    assert "(lower_link)" in message
    assert "larger gamma" in message


def test_a_prior_that_is_no_body_is_named(log):
    model = load_model(MODEL)
    phi = model.phi.copy()
    phi[1, 4:] *= -1.0
    with pytest.raises(
        ArgumentError, match="parameters of lower_link are those of no body"
    ) as caught:
        identify_model(replace(model, phi=phi), [log])
    assert is_physical(caught.value.evidence["nearest"]).all()


def test_a_known_total_mass_is_met(log):
    model = load_model(MODEL)
    settings = IdentificationSettings(gamma=10.0, total_mass=1.6)
    found = identify_model(
        model, [log], settings, effects=named_effects(FRICTIONS.split(","), model)
    )
    assert found.model.phi[:, 0].sum() == pytest.approx(1.6, rel=1e-6)


def test_a_write_that_fails_leaves_nothing(log, tmp_path, monkeypatch):
    from geodrake.errors import ModelError

    def failing(*_arguments):
        raise ModelError("It cannot be changed.")

    monkeypatch.setattr("geodrake.model.export.EditedFile", failing)
    message = refused(
        MODEL, log, "--gamma", "1", "--save", tmp_path / "m.yaml", "--export", tmp_path / "o.urdf"
    )
    assert "It cannot be changed." in message
    assert list(tmp_path.iterdir()) == []


def test_the_page_says_that_the_model_was_refitted(found):
    page = render(page_of(found))
    assert "nothing was refitted" not in page
    assert "Every error of a refitted model is of held-out data" in page
    assert "What the model as it stands gets wrong" not in page
    assert ">compared<" not in page
    assert re.search(r">\s*identified\s*<", page)
    ends = f"{number(found.before.nrms)} to {number(found.after.nrms)}"
    verdict = f"The held-out error goes from nrms {ends}"
    assert re.search(rf"<h1[^>]*>\s*{re.escape(verdict)}", page)
    assert "before" in page
