"""What stays of an explanation: findings that go take along what cannot be without them."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import pinocchio as pin
from pinocchio_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.diagnosis import Diagnosis
from geodrake.diagnosis.findings import (
    INERTIA,
    Unnamed,
    findings_of,
    unknown_probability,
    verdict_of,
    without_finding,
)
from geodrake.diagnosis.notes import unnamed_notes
from geodrake.diagnosis.posterior import Posterior
from geodrake.diagnosis.search import searched
from geodrake.effects import StribeckFriction
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.model_errors import Comparison, ErrorTable, JointError
from geodrake.report import page_of

PENDULUM = MODELS / "double_pendulum.urdf"


def rubbing(seen):
    return {1: 0.6 * np.sign(seen.v[:, 1]) + 0.4 * seen.v[:, 1]}


@pytest.fixture(scope="module")
def found():
    log = effort_log("double_pendulum", 4, rubbing, duration=16.0, share=0.01).log
    return searched(open_case(load_model(PENDULUM), [log], candidates=True))


def with_terms(found, *names, width=None):
    """The same search as if it had found one term of each name at the elbow."""
    model, was = found.model, found.fit
    known = {term.name: term for term in model.terms if term.where == ("elbow",)}
    width = was.choice.width if width is None else width
    choice = model.choice(was.choice, [known[name] for name in names], width=width)
    return replace(found, fit=model.unbounded(choice, model.shares(was), was.noise))


def named(findings, name):
    return next(each for each in findings if each.name == name)


def test_what_needs_a_finding_goes_with_it(found):
    """Friction that falls with speed is none without dry friction."""
    stribeck = StribeckFriction.name
    whole = with_terms(found, "coulomb_friction", "viscous_friction", stribeck)
    findings = findings_of(whole)
    fewer, kept = without_finding(whole, findings, named(findings, "coulomb_friction"))
    assert [each.name for each in kept] == ["viscous_friction"]
    assert {term.name for term in fewer.fit.terms} == {"viscous_friction"}
    fewer, kept = without_finding(whole, findings, named(findings, stribeck))
    assert {each.name for each in kept} == {"coulomb_friction", "viscous_friction"}


def test_bodies_are_the_finding_where_nothing_else_is_left(found):
    """They come closer to the logs than those of the file, and that is never silent."""
    model, was = found.model, found.fit
    widest = model.choice(was.choice, (), width=model.widths[-1])
    wide = model.unbounded(widest, model.shares(was), was.variance)
    whole = replace(with_terms(found, "coulomb_friction"), start=wide)
    findings = findings_of(whole)
    fewer, kept = without_finding(whole, findings, named(findings, "coulomb_friction"))
    assert [each.name for each in kept] == [INERTIA]
    assert fewer.fit is wide
    assert without_finding(fewer, kept, kept[0])[1] == []


def table(rms, floor):
    return ErrorTable(tuple(JointError(j, rms, 1.0, floor) for j in ("shoulder", "elbow")))


def test_a_finding_is_the_more_likely_the_more_it_takes_beside_what_is_left(found):
    whole = with_terms(found, "coulomb_friction")
    (finding,) = (each for each in findings_of(whole) if each.name == "coulomb_friction")

    def chance(before, after, end, floor=0.01):
        errors = [table(rms, floor) for rms in (before, after, end)]
        left = replace(whole.fit, noise=np.full(2, end**2))
        return unknown_probability(replace(whole, fit=left), finding, errors)

    chances = [chance(before, 0.1, 0.1) for before in (0.9, 0.3, 0.2, 0.12, 0.1)]
    assert chances == sorted(chances)
    assert chances[0] < 0.1
    assert chances[-1] == 1.0
    # It takes away as much again as the beliefs ask for beside what is more than noise.
    left = 0.1**2 - (1.6 * 0.01) ** 2
    before = np.sqrt(0.1**2 + whole.model.beliefs.part * left)
    assert chance(before, 0.1, 0.1) == pytest.approx(0.5)
    assert chance(0.9, 0.01, 0.01) == 0.0  # only noise is left
    assert chance(0.3, 0.2, 0.2, floor=0.0) == 0.0  # nobody knows what is noise
    # Reversals that are not resolved err in the end, and not in a fit that allows for them.
    errors = [table(rms, 0.01) for rms in (0.3, 0.2, 0.2)]
    noise = replace(whole.fit, noise=np.full(2, 0.01**2))
    assert unknown_probability(replace(whole, fit=noise), finding, errors) == 0.0


def heavier(seen, mass=0.3):
    """Effort of a ball that the last link holds, by Pinocchio."""
    ball = pin.Inertia(mass, np.array([0.05, 0.02, 0.1]), 1e-3 * mass * np.eye(3))
    return seen.with_body(seen.model.njoints - 1, lambda own: own + ball)


@pytest.fixture(scope="module")
def loaded():
    log = effort_log("double_pendulum", 5, heavier, duration=16.0, share=0.01).log
    return searched(open_case(load_model(PENDULUM), [log], candidates=True))


def with_load(found, *, width, has_load=True):
    model, was = found.model, found.fit
    loads = [t for t in model.terms if t.is_whole and t.where == ("lower_link",)]
    terms = loads[-2:-1] if has_load else []
    choice = model.choice(was.choice, terms, width=width)
    return replace(found, fit=model.unbounded(choice, model.shares(was), was.noise))


def test_a_payload_that_bodies_may_have_taken_in_is_said(loaded):
    bodies = with_load(loaded, width=loaded.model.widths[-2], has_load=False)
    loads = Posterior(bodies.model, bodies.fit).of_loads()
    assert loads["lower_link"] > 0.5  # a file that is 30 % off is less probable
    (note,) = (n for n in unnamed_notes(Unnamed((), loads, {})) if n.startswith("lower_link"))
    assert f"{loads['lower_link']:.0%}" in note
    having = with_load(loaded, width=loaded.model.widths[0])
    assert "lower_link" not in Posterior(having.model, having.fit).of_loads()


@pytest.mark.parametrize(
    ("noise", "known", "verdict", "words"),
    [
        (0.1, True, "adequate", "No effect is worth adding."),
        (0.1, False, "undecided", "The noise of elbow cannot be separated"),
        (0.8, True, "undecided", "as large as the explained effort"),
    ],
)
def test_nothing_is_adequate_where_noise_is_not_known(noise, known, verdict, words):
    joints = (
        JointError("shoulder", noise, 1.0, noise),
        JointError("elbow", noise, 1.0, noise, known),
    )
    table = ErrorTable(joints)
    assert verdict_of(table, found=False) == verdict
    comparison = Comparison(table, (), (), ())
    said = page_of(Diagnosis(verdict, (), table, table, comparison, ())).sentence
    assert words in said
    assert (
        verdict_of(ErrorTable((JointError("elbow", 0.9, 1.0, 0.1),)), found=True) == "unexplained"
    )
