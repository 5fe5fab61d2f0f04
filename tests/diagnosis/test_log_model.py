"""Evidence of explanations: axioms, dense computations of the same numbers, and findings."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from pendulum_logs import JOINTS, friction, pendulum_log
from pinocchio_logs import MODELS, effort_log
from pydrake.solvers import ClarabelSolver, MathematicalProgram
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from geodrake import load_model
from geodrake.diagnosis import Beliefs, Diagnosis, explain, findings
from geodrake.diagnosis.explain import explained
from geodrake.diagnosis.final_fit import final_fit
from geodrake.diagnosis.findings import (
    Unnamed,
    findings_of,
    most_believed,
    terms_not_held,
    unknown_probability,
    verdict_of,
    without_finding,
)
from geodrake.diagnosis.log_model import Choice, LogModel
from geodrake.diagnosis.moves import together
from geodrake.diagnosis.neighbourhood import Neighbourhood
from geodrake.diagnosis.normal_kernels import calc_distance, calc_noise_changes
from geodrake.diagnosis.notes import left_out_notes, unnamed_notes
from geodrake.diagnosis.posterior import Posterior
from geodrake.diagnosis.refinements import gain_of_finer_shape
from geodrake.diagnosis.search import find_explanation
from geodrake.effects import (
    CoulombFriction,
    EffortOffset,
    FittedEffect,
    GravityCompensator,
    Payload,
    StribeckFriction,
    ViscousFriction,
)
from geodrake.identification.logs.case import prepare_case
from geodrake.identification.logs.dataset import Dataset, JointData
from geodrake.identification.logs.model_errors import Comparison, ErrorTable, JointError
from geodrake.identification.logs.unknowns import pullback_information
from geodrake.inertia import from_mass_com_inertia
from geodrake.inertia.parameters import pseudo_inertia_basis
from geodrake.logs.filtering import design_filter
from geodrake.report import page_of

pytest.importorskip("pinocchio")


PENDULUM = load_model(MODELS / "double_pendulum.urdf")
BELIEFS = Beliefs()
WIDTH = 0.1
ROWS = 40
GAINS = np.array([0.03, 0.05])  # deviations of the efforts' gains
OFFSETS = tuple(EffortOffset(joint) for joint in JOINTS)
COMPENSATORS = tuple(GravityCompensator(joint) for joint in JOINTS)
PAYLOAD, RUBBING = Payload("lower_link"), CoulombFriction("elbow")
EFFECTS = (*OFFSETS, *COMPENSATORS, PAYLOAD, RUBBING)
BALL = from_mass_com_inertia(50.0, np.zeros(3), 30.0 * np.eye(3))
BODIES = 10 * len(PENDULUM.bodies)
SHARES = np.ones(2)


def random_problem():
    """Return random rows of two joints, as a dataset, and as columns by effect and efforts."""
    rng = np.random.default_rng(5)
    bodies = rng.normal(size=(2, ROWS, BODIES))
    own = {effect: rng.normal(size=(2, ROWS, len(effect.parameters))) for effect in EFFECTS}
    own[PAYLOAD] = bodies[:, :, 10:20]
    for effect in EFFECTS:
        if effect.places == "joint":
            own[effect][1 - JOINTS.index(effect.where[0])] = 0.0
    effort = bodies @ PENDULUM.phi.ravel() + rng.normal(size=(2, ROWS))
    effort += 0.5 * own[OFFSETS[0]][:, :, 0] + 0.4 * own[RUBBING][:, :, 0]
    joints = []
    for j in range(2):
        columns = [bodies[j], *(own[e][j] for e in EFFECTS if e is not PAYLOAD)]
        columns = np.column_stack(columns)
        (felt,) = columns.any(axis=0).nonzero()
        rows = np.column_stack([columns[:, felt], effort[j]])
        n, peaks = np.array([ROWS]), np.abs(rows[:, :-1]).max(0)
        sums = np.array([[effort[j].sum(), np.square(effort[j]).sum()]])
        none = np.zeros((1, len(felt)))
        joints.append(JointData(felt, rows[None], n, ((),), none, n, sums, peaks))
    dataset = Dataset(
        JOINTS, PENDULUM.bodies, EFFECTS, np.zeros((1, 2)), ("0",), ("log",),
        tuple(joints), effort.std(1), np.full(2, 0.1), 5.0, np.zeros(2),
        BALL, GAINS,
    )  # fmt: skip
    model = LogModel(PENDULUM, dataset, EFFECTS, BELIEFS, (0, 0))
    return model, bodies, own, effort


def settled(model, *effects):
    """Return the converged fit with some effects, whose noise is that of its residuals."""
    own = {term.effect: term for term in model.terms if term.effect in effects}
    terms = tuple(own.values())
    assert len(terms) == len(effects)
    fit = None
    for _ in range(10):
        choice = model.choice(Choice((), WIDTH, (0, 0)), terms)
        fit = model.unbounded(choice, SHARES, None if fit is None else fit.variance)
    return fit


def dense(problem, terms):
    """Return columns of all rows with some terms, and the prior information and mean."""
    _, bodies, own, _ = problem
    mean = PENDULUM.phi.ravel()
    gains = block_diag(*(bodies[j][:, :, None].swapaxes(1, 2) @ mean for j in range(2)))
    columns = [np.concatenate(bodies), gains.reshape(2 * ROWS, 2)]
    columns += [np.concatenate(own[term.effect]) for term in terms]
    known = [pullback_information(PENDULUM.phi, WIDTH), np.diag(GAINS**-2.0)]
    known += [term.information for term in terms]
    means = np.concatenate([mean, np.zeros(2), *(term.mean for term in terms)])
    return np.concatenate(columns, axis=1), block_diag(*known), means


def dense_evidence(problem, fit, terms):
    """Return twice the log density of the efforts with some terms, at the noise of a fit."""
    (A, known, means), effort = dense(problem, terms), problem[3]
    covariance = A @ np.linalg.inv(known) @ A.T
    covariance += np.diag(np.repeat(1.0 / fit.weights, ROWS))
    expected = A @ means
    return 2.0 * multivariate_normal(expected, covariance).logpdf(effort.ravel())


def prior_odds(model, fit):
    """Return the parts of a score besides the evidence: prior odds and truncated priors."""
    shares = sum(t.log_information - np.linalg.slogdet(t.information)[1] for t in fit.terms)
    return shares - model.odds_against(fit.choice)


@pytest.fixture(scope="module")
def problem():
    return random_problem()


SETS = [(), OFFSETS[:1], (*OFFSETS, COMPENSATORS[1]), (RUBBING,), (RUBBING, *COMPENSATORS)]


def test_a_score_is_the_evidence(problem):
    """They differ by a constant that is the same for all explanations."""
    constants = []
    for effects in SETS:
        fit = settled(problem[0], *effects)
        evidence = dense_evidence(problem, fit, fit.terms)
        constants.append(fit.score - prior_odds(problem[0], fit) - evidence)
    assert np.ptp(constants) < 1e-3
    assert len({round(settled(problem[0], *effects).score, 1) for effects in SETS}) == len(SETS)


def test_gains_and_losses_are_differences_of_evidence(problem):
    """At the noise of the fit that terms come to, go from, or change places in."""
    model = problem[0]
    fit = settled(model, *OFFSETS, RUBBING)
    around, by_effect = Neighbourhood(model, fit), {term.effect: term for term in model.terms}
    now = dense_evidence(problem, fit, fit.terms)
    come = [(by_effect[COMPENSATORS[0]],), tuple(by_effect[e] for e in COMPENSATORS)]
    for package, gain in zip(come, around.gains(come), strict=True):
        after = dense_evidence(problem, fit, (*fit.terms, *package))
        assert gain == pytest.approx(after - now, abs=1e-3)
    for gone in (OFFSETS[:1], OFFSETS):
        left = [term for term in fit.terms if term.effect not in gone]
        without = around.dropped([by_effect[effect] for effect in gone])
        after = dense_evidence(problem, fit, left)
        assert without.loss == pytest.approx(after - now, abs=1e-3)
        instead = around.gains(come, without) + without.loss
        for package, gain in zip(come, instead, strict=True):
            after = dense_evidence(problem, fit, (*left, *package))
            assert gain == pytest.approx(after - now, abs=1e-3)


def test_the_best_changes_of_joints_are_combined(problem):
    model = problem[0]
    fit, by_effect = settled(model, RUBBING), {term.effect: term for term in model.terms}

    def after(*effects, **changed):
        terms = [by_effect[effect] for effect in effects]
        return replace(model.choice(fit.choice, terms), **changed)

    shoulder, worse = (after(RUBBING, each[0]) for each in (OFFSETS, COMPENSATORS))
    elbow = after(OFFSETS[1])  # in the place of dry friction
    both = together(model, fit, [shoulder, worse, elbow])
    assert {term.effect for term in both.terms} == {*OFFSETS}
    for others in ([worse], [after(RUBBING, PAYLOAD)], [replace(elbow, width=2.0 * WIDTH)]):
        assert together(model, fit, [shoulder, *others]) is None


def test_the_gain_of_a_finer_shape_is_that_of_a_parabola():
    """Other parameters of the shapes are the same, and prior odds do not count."""
    speeds, best, deviation = np.array([0.1, 0.15, 0.22, 0.3]), 0.17, 0.2
    grid = [StribeckFriction("elbow", stribeck_velocity=speed) for speed in speeds.tolist()]
    terms = [SimpleNamespace(effect=effect, key="stribeck") for effect in grid]

    def fitted(choice, *_):
        (term,) = choice
        away = np.log(term.effect.stribeck_velocity / best) / deviation
        return SimpleNamespace(score=-(away**2) - 7.0 * (term is terms[1]))

    model = SimpleNamespace(
        terms=terms,
        fit=fitted,
        shares=lambda fit: None,
        choice=lambda was, terms: terms,
        odds_against=lambda choice: 7.0 * (choice[0] is terms[1]),
    )
    fit = SimpleNamespace(terms=[terms[1]], choice=None, noise=None)
    gains = [gain_of_finer_shape(model, fit, term, grid) for term in terms]
    assert gains[1] == pytest.approx((np.log(0.15 / best) / deviation) ** 2)
    assert gains[0] == gains[2] == gains[3] == np.inf  # at an end, or beside a better one


# What a search ends with.


def told(found):
    """Return probability and error of the findings, by effect and places."""
    return {(s.effect, frozenset(s.where)): (s.probability, s.error_after) for s in found.steps}


def test_units_of_efforts_are_none(unit=1e-3):
    """Efforts and masses in others, the answer is the same in others."""
    log = pendulum_log(1, friction((0.2, 0.1), (0.15, 0.0)), seconds=16.0)
    found = explain(PENDULUM, [log], bandwidth=6.0)
    model = replace(PENDULUM, phi=unit * PENDULUM.phi)
    other = explain(model, [replace(log, effort=unit * log.effort)], bandwidth=6.0)
    assert told(other).keys() == told(found).keys()
    for key, (probability, error) in told(found).items():
        assert told(other)[key][0] == pytest.approx(probability, abs=0.01)
        assert told(other)[key][1] == pytest.approx(error, rel=0.01)
    np.testing.assert_allclose(other.model.phi[:, 0], unit * found.model.phi[:, 0], rtol=0.01)


# What logs do not resolve, and what they do.


def noisy_at_low_speeds(seed):
    """Return friction with full height above 0.01 rad/s, by noisier velocities."""
    coulomb, viscous = np.array([0.2, 0.1]), np.array([0.08, 0.05])

    def rubbing(seen):
        return coulomb * np.tanh(seen.v / 0.01) + viscous * seen.v

    log = effort_log("double_pendulum", seed, rubbing, rate=100.0, share=0.01, pace=0.15).log
    rng = np.random.default_rng(seed)
    return replace(log, velocity=log.velocity + 0.03 * rng.normal(size=log.velocity.shape))


def test_speeds_below_the_noise_of_velocities_say_nothing_of_friction_there():
    found = explain(PENDULUM, [noisy_at_low_speeds(1)])
    places = {step.effect: set(step.where) for step in found.steps}
    assert places == {"coulomb_friction": set(JOINTS), "viscous_friction": set(JOINTS)}


# How far bodies are from the file, and gains of efforts.


@pytest.mark.parametrize("seed", range(4))
def test_the_nearest_body_that_can_exist(seed):
    """By a precision; a semidefinite program says the same."""
    rng, basis = np.random.default_rng(seed), pseudo_inertia_basis()
    inside = from_mass_com_inertia(1.0, np.array([0.02, 0.0, 0.05]), 4e-3 * np.eye(3))
    factor = rng.normal(size=(10, 10)) * 10.0 ** rng.uniform(0.0, 1.5)
    precision, mean = factor @ factor.T + np.eye(10), inside - np.eye(10)[0] * 2.0 * inside[0]
    mean = mean + 0.05 * rng.normal(size=10)
    program = MathematicalProgram()
    x = program.NewContinuousVariables(10)
    program.AddQuadraticErrorCost(precision, mean, x)
    program.AddLinearMatrixInequalityConstraint([np.zeros((4, 4)), *basis], x)
    least = ClarabelSolver().Solve(program).get_optimal_cost()
    assert least > 0.0
    found = calc_distance(mean, inside, precision, np.ascontiguousarray(basis))
    assert least <= found <= least + 0.5


def test_noise_at_other_instants_is_no_evidence_of_a_delay():
    """Sums of squares fall by what noise says of a delay, not by when it is sampled."""
    rng, low_pass = np.random.default_rng(8), design_filter(0.005, 8.3)
    steps, at = np.arange(-6, 7), np.arange(100, 11_900, low_pass.decimation)
    late, time = steps * low_pass.period, at * low_pass.period
    late_by, raw, left = late[:, None], list[np.ndarray](), list[np.ndarray]()
    for _ in range(40):
        noise = low_pass.smooth(rng.normal(size=(12_000, 1)))[:, 0] / low_pass.noise_gain
        efforts = np.sin(time + late_by) + [noise[at + step] for step in steps]
        squares = np.square(efforts - np.sin(time)).sum(axis=1)
        columns = [np.ascontiguousarray(x.T) for x in (efforts, np.square(efforts - np.sin(time)))]
        signals, period = (time, np.sin(time), *columns), float(np.median(np.diff(time)))
        change = calc_noise_changes(signals, np.arange(len(time)), 6, late, period)
        raw.append(squares - squares[6])
        left.append(squares - change - squares[6])
    lost = np.square(np.sin(time) - np.sin(time - late_by)).sum(axis=1)
    spread = 2.0 * np.sqrt(lost)  # of the product of what a delay changes with white noise
    assert np.min(raw, axis=0)[0] < lost[0] - 8.0 * spread[0]
    assert (np.min(left, axis=0) > lost - 4.0 * spread - 0.1).all()
    assert (np.array(left) >= raw).all()


PENDULUM_FILE = MODELS / "double_pendulum.urdf"


def rubbing(seen):
    return {1: 0.6 * np.sign(seen.v[:, 1]) + 0.4 * seen.v[:, 1]}


@pytest.fixture(scope="module")
def found():
    log = effort_log("double_pendulum", 4, rubbing, duration=16.0, share=0.01).log
    return find_explanation(prepare_case(load_model(PENDULUM_FILE), [log], candidates=True))


def with_terms(found, *names, width=None):
    """The same search as if it had found one term of each name at the elbow."""
    model, was = found.model, found.fit
    known = {term.name: term for term in model.terms if term.where == ("elbow",)}
    width = was.choice.width if width is None else width
    choice = model.choice(was.choice, [known[name] for name in names], width=width)
    return replace(found, fit=model.unbounded(choice, model.shares(was), was.noise))


def named(findings, name):
    return next(each for each in findings if each.name == name)


def test_what_holds_at_one_joint_alone_stays_there(found):
    """The shoulder has no friction, which leaves that of the elbow as it is."""
    model, was = found.model, found.fit
    known = [term for term in model.terms if term.name == "coulomb_friction"]
    both = replace(
        found, fit=model.unbounded(model.choice(was.choice, known), model.shares(was), was.noise)
    )
    findings = findings_of(both)
    finding = named(findings, "coulomb_friction")
    before, after = (
        model.held_out(fit) for fit in (model.without_terms(model.shares(was)), both.fit)
    )
    worse = np.array([[1.1 if name == "shoulder" else 0.5 for name in model.dataset.joints]])
    changed = replace(after, sse=before.sse * worse)
    (gone,) = terms_not_held(both, finding, before, changed)
    assert gone.where == ("shoulder",)
    fewer, kept = without_finding(both, findings, finding, [gone])
    assert [each.places for each in kept if each.name == finding.name] == [("elbow",)]
    assert [term.where for term in fewer.fit.terms] == [("elbow",)]
    assert terms_not_held(both, finding, before, replace(after, sse=0.5 * before.sse)) == []
    assert terms_not_held(both, finding, before, replace(after, sse=1.1 * before.sse)) == []
    (note,) = left_out_notes([finding], [SimpleNamespace(effect=finding.name, where=("elbow",))])
    assert "shoulder was found" in note


@pytest.mark.parametrize("name", ["viscous_friction", StribeckFriction.name])
def test_effects_that_are_zero_in_the_final_fit_are_no_steps(found, monkeypatch, name):
    """What the search allows for beside it, such as unresolved reversals, may have taken it in."""
    whole = with_terms(found, "coulomb_friction", name)

    def zeroed(case, found):
        after, fit = final_fit(case, found)
        effects = [
            replace(f, parameters=0.0 * f.parameters) if f.effect.name == name else f
            for f in fit.model.effects
        ]
        return after, replace(fit, model=replace(fit.model, effects=tuple(effects)))

    monkeypatch.setattr(sys.modules[explained.__module__], "final_fit", zeroed)
    told = explained(whole.case, whole, findings_of(whole)).explanation
    assert [step.effect for step in told.steps] == ["coulomb_friction"]
    assert any(note.startswith(f"{name} ") and "was found" in note for note in told.notes)


def test_friction_that_a_model_states_and_the_robot_has_not_is_a_step():
    stated = FittedEffect(ViscousFriction("elbow"), np.array([0.3]))
    told = explain(
        replace(PENDULUM, effects=(stated,)), [pendulum_log(3, seconds=12.0)], bandwidth=6.0
    )
    (step,) = told.steps
    assert (step.effect, step.parameters["elbow"]["viscous"]) == ("viscous_friction", 0.0)
    assert told.end.nrms < 0.1 * told.start.nrms


def table(rms, floor):
    return ErrorTable(tuple(JointError(j, rms, 1.0, floor) for j in ("shoulder", "elbow")))


def test_a_finding_that_lowers_the_error_only_beside_later_ones_is_likely(found):
    """A first effect of joints that move in turn may even raise the error of held-out motions."""
    whole = with_terms(found, "coulomb_friction", "viscous_friction")
    (finding,) = (each for each in findings_of(whole) if each.name == "coulomb_friction")
    errors = [table(rms, 1e-4) for rms in (0.5, 0.6, 0.1)]
    assert unknown_probability(whole, finding, errors) < 0.1


def test_a_finding_is_the_more_likely_the_more_it_takes_beside_what_is_left(found, monkeypatch):
    whole = with_terms(found, "coulomb_friction")
    (finding,) = (each for each in findings_of(whole) if each.name == "coulomb_friction")
    monkeypatch.setattr(findings, "_with_and_without", lambda *_: [whole.fit] * 2)

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
    """Return the effort of a ball that the last link holds, by Pinocchio."""
    ball = pin.Inertia(mass, np.array([0.05, 0.02, 0.1]), 1e-3 * mass * np.eye(3))
    return seen.with_body(seen.model.njoints - 1, lambda own: own + ball)


@pytest.fixture(scope="module")
def loaded():
    log = effort_log("double_pendulum", 5, heavier, duration=16.0, share=0.01).log
    return find_explanation(prepare_case(load_model(PENDULUM_FILE), [log], candidates=True))


def with_load(found, *, width, has_load=True):
    model, was = found.model, found.fit
    loads = [t for t in model.terms if t.is_whole and t.where == ("lower_link",)]
    terms = loads[-2:-1] if has_load else []
    choice = model.choice(was.choice, terms, width=width)
    return replace(found, fit=model.unbounded(choice, model.shares(was), was.noise))


def test_a_payload_of_overwhelming_evidence_is_certain(loaded, monkeypatch):
    having = with_load(loaded, width=loaded.model.widths[0])
    finding = named(findings_of(having), Payload.name)
    fits = [replace(having.fit, score=score) for score in (0.0, 1e9)]
    monkeypatch.setattr(findings, "_with_and_without", lambda *_: fits)
    errors = [table(1.0, 1e-9)] * 3
    assert unknown_probability(having, finding, errors) == pytest.approx(0.0, abs=1e-12)


def test_a_payload_that_bodies_may_have_taken_in_is_said(loaded):
    bodies = with_load(loaded, width=loaded.model.widths[-2], has_load=False)
    load, fit = Posterior(bodies.model, bodies.fit).of_loads()["lower_link"]
    assert load > 0.5  # a file that is 30 % off is less probable
    assert most_believed(bodies)[0].fit.choice.key == fit.choice.key
    unnamed = Unnamed((), {"lower_link": load}, {})
    (note,) = (n for n in unnamed_notes(unnamed) if n.startswith("lower_link"))
    assert f"{load:.0%}" in note
    finding = named(findings_of(*most_believed(bodies)), Payload.name)
    (left_out,) = left_out_notes([finding], [])
    assert left_out.startswith("lower_link may carry a payload")
    having = with_load(loaded, width=loaded.model.widths[0])
    assert "lower_link" not in Posterior(having.model, having.fit).of_loads()


@pytest.mark.parametrize(
    ("noise", "known", "verdict", "words"),
    [
        (0.1, True, "adequate", "Adequate. No effect is worth adding."),
        (0.1, False, "undecided", "inseparable from the noise of elbow"),
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
    page = page_of(Diagnosis(verdict, (), table, table, comparison, ()))
    assert words in " ".join(page.answer.values())
    assert (
        verdict_of(ErrorTable((JointError("elbow", 0.9, 1.0, 0.1),)), found=True) == "unexplained"
    )
