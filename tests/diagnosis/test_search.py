"""The search: what is offered, tried, chosen, swapped and dropped."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum_logs import JOINTS, NOISE, PENDULUM, friction, pendulum_log
from scipy.optimize import minimize_scalar

from geodrake import load_model
from geodrake.diagnosis import proposals as proposals_module
from geodrake.diagnosis import search as search_module
from geodrake.diagnosis.candidates import Kind, Package, kinds, kinds_at
from geodrake.diagnosis.continuous_shapes import with_continuous_shapes, with_plain_shapes
from geodrake.diagnosis.delay import seconds_of
from geodrake.diagnosis.final_fit import companion_notes
from geodrake.diagnosis.proposal import Proposal
from geodrake.diagnosis.proposals import suggested
from geodrake.diagnosis.pruning import prune, simplify
from geodrake.diagnosis.ranked import Ranked
from geodrake.diagnosis.search import choose, convincing, rank, with_ties
from geodrake.diagnosis.search_rounds import searched
from geodrake.diagnosis.shapes import finer, free_shape, is_round, peak
from geodrake.diagnosis.stepwise_search import Trail, search, tuned
from geodrake.diagnosis.trials import (
    Trial,
    asked_of,
    gain_of,
    quick_fit,
    try_package,
    try_packages,
)
from geodrake.effects import (
    CoulombFriction,
    CoupledFriction,
    CoupledRotorInertia,
    EffortOffset,
    FittedEffect,
    Hysteresis,
    JointEffect,
    JointElasticity,
    JointSpring,
    NonlinearViscousFriction,
    Parameter,
    Payload,
    RotorInertia,
    StribeckFriction,
    TorqueRipple,
    ViscousFriction,
    WrongInertia,
    catalogue,
)
from geodrake.identification.logs import hypothesis as hypothesis_module
from geodrake.identification.logs.candidate_effects import (
    LONGEST_DELAY,
    candidate_delays,
    candidate_effects,
)
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.evidence import Criteria, effective_samples, log_likelihood_gain
from geodrake.identification.logs.hypothesis import first_hypothesis, residual_blocks
from geodrake.identification.logs.model_fit import model_unknowns
from geodrake.identification.logs.reduce import reduce_logs
from geodrake.logs.filtering import design_filter

CRITERIA = Criteria()
COULOMB = tuple(CoulombFriction(joint) for joint in JOINTS)
VISCOUS = tuple(ViscousFriction(joint) for joint in JOINTS)


@pytest.fixture(scope="module")
def model():
    return load_model(PENDULUM)


def start_of(model, hidden, *, seed=1):
    case = open_case(
        model,
        [pendulum_log(seed, hidden), pendulum_log(seed + 100, hidden)],
        candidates=True,
        bandwidth=6.0,
    )
    return first_hypothesis(case.dataset, model_unknowns(case.dataset, model))


@pytest.fixture(scope="module")
def with_friction(model):
    """Dry friction at both joints, viscous friction at the shoulder."""
    return start_of(model, friction((0.2, 0.1), (0.15, 0.0)))


@pytest.fixture(scope="module")
def without(model):
    return start_of(model, None)


def offered(effects, present=()):
    return {kind.names: kind for kind in kinds(effects, present)}


def test_kinds_gather_places_and_shapes():
    grid = [NonlinearViscousFriction("elbow", 0.5), NonlinearViscousFriction("elbow", 2.0)]
    found = offered([*COULOMB, *grid], present=[CoulombFriction("elbow"), ViscousFriction("elbow")])
    assert set(found[("coulomb_friction",)].options) == {("shoulder",)}
    shapes = found[("nonlinear_viscous_friction",)].options[("elbow",)]
    assert [package.effects for package in shapes] == [(grid[0],), (grid[1],)]


def test_dry_and_viscous_friction_are_a_pair():
    found = offered([*COULOMB, *VISCOUS])
    pair = found[("coulomb_friction", "viscous_friction")]
    assert pair.unite
    assert set(pair.options) == {("shoulder",), ("elbow",)}
    assert {len(p.effects) for p in pair.options[("elbow",)]} == {1, 2}
    assert ("coulomb_friction", "viscous_friction") not in offered([*COULOMB, VISCOUS[0]], VISCOUS)


def test_what_is_there_is_not_offered():
    assert offered([*COULOMB], present=COULOMB) == {}


def test_refinements_need_what_they_refine():
    stribeck = StribeckFriction("elbow", 0.1)
    assert offered([stribeck]) == {}
    assert ("stribeck_friction",) in offered([stribeck], present=[*COULOMB])
    root = NonlinearViscousFriction("elbow", 0.5)
    assert offered([root], present=[*COULOMB]) == {}
    assert ("nonlinear_viscous_friction",) in offered([root], present=[*COULOMB, *VISCOUS])


def test_bodies_and_pairs_are_named_one_at_a_time():
    found = offered([Payload("upper_link"), Payload("lower_link"), CoupledFriction(JOINTS)])
    assert not found[("payload",)].unite
    assert not found[("coupled_friction",)].unite


def test_kinds_at_a_place_are_those_of_all_kinds():
    joint = ("elbow",)
    rotors = [RotorInertia(name) for name in JOINTS]
    stribeck = [StribeckFriction("elbow", speed) for speed in (0.1, 0.3)]
    bodies = [Payload("upper_link"), Payload("lower_link")]
    pairs = [CoupledFriction(JOINTS), CoupledRotorInertia(JOINTS)]
    effects = [*COULOMB, *VISCOUS, *rotors, *stribeck, *bodies, *pairs]
    for present in ([], [*COULOMB], [rotors[0]]):
        found = kinds(effects, present)
        for place in {place for kind in found for place in kind.options} | {joint}:
            expected = [
                (kind.names, kind.unite, kind.options[place])
                for kind in found
                if place in kind.options
            ]
            here = kinds_at(effects, present, place)
            assert [(k.names, k.unite, k.options[place]) for k in here] == expected
            assert expected


def test_shapes_count_as_parameters():
    assert Package((CoulombFriction("elbow"),), ("elbow",)).parameters == 1
    assert Package((NonlinearViscousFriction("elbow", 0.5),), ("elbow",)).parameters == 2
    assert Package((*COULOMB, *VISCOUS), ("elbow",)).parameters == 4
    assert Kind((CoulombFriction, StribeckFriction), {}, unite=True).complexity == 2
    assert ViscousFriction.complexity < JointEffect.complexity


def test_candidates_are_all_that_the_robot_can_have(model):
    found = candidate_effects(model, np.array([2.0, 3.0]))
    elsewhere = {e.name for e in catalogue() if not e.parameters}
    elsewhere |= {e.name for e in catalogue() if e.proposer and e.places != "joint_pair"}
    unsure = {effect.name for effect in catalogue() if effect.needs_known_inertia}
    everything = {effect.name for effect in catalogue()} - elsewhere
    assert {e.name for e in found} == everything - unsure
    sure = candidate_effects(replace(model, information=np.eye(20)), np.array([2.0, 3.0]))
    assert {e.name for e in sure} == everything
    assert len(set(found)) == len(found)
    assert {e.where for e in found if e.name == "payload"} == {(body,) for body in model.bodies}
    still = candidate_effects(model, np.array([2.0, 0.0]))
    assert not [e for e in still if e.where == ("elbow",)]


@pytest.mark.parametrize(("period", "bandwidth"), [(0.002, 10.0), (0.01, 2.0), (0.04, 12.0)])
def test_delays_are_those_that_can_be_told_apart(period, bandwidth):
    delays = candidate_delays(period, bandwidth)
    assert delays[0] == 0.0
    assert len(set(delays)) == len(delays)
    assert max(np.abs(delays)) <= LONGEST_DELAY + 1e-12
    assert np.diff(sorted(delays)).min() >= period - 1e-12


def test_first_hypothesis_weighs_joints_by_their_errors(with_friction):
    """Residual rows, effective samples and mean squared errors belong together."""
    hypothesis = with_friction
    blocks = residual_blocks(hypothesis.dataset, hypothesis.unknowns.columns, hypothesis.held_out.x)
    for joint, residuals in enumerate(blocks):
        squares = sum(float(block @ block) for block in residuals)
        assert squares == pytest.approx(hypothesis.held_out.sse[:, joint].sum(), rel=1e-8)
        assert hypothesis.effective[joint] == pytest.approx(effective_samples(residuals), rel=1e-8)
    assert (hypothesis.effective < 0.7 * hypothesis.held_out.samples.sum(0)).all()


def test_trial_of_what_is_missing(with_friction):
    trial = try_package(with_friction, Package((COULOMB[0],), ("shoulder",)), 100)
    refit = with_friction.with_effects([COULOMB[0]])
    assert trial.convinces(CRITERIA)
    assert trial.reduction > 0.3
    assert trial.agreement == 1.0
    # With the weights of the hypothesis instead of its own, a trial is nearly as good.
    settled = gain_of(with_friction, refit)
    assert trial.gain == pytest.approx(settled, rel=0.3)


def test_trials_together_are_those_one_by_one(with_friction, monkeypatch):
    monkeypatch.setattr(hypothesis_module, "_AT_ONCE", 3)
    packages = [Package((e,), e.where) for e in (*COULOMB, *VISCOUS)]
    packages.append(Package((COULOMB[0], VISCOUS[0]), COULOMB[0].where))
    together = try_packages(with_friction, packages, 9)
    for package, trial in zip(packages, together, strict=True):
        alone = try_package(with_friction, package, 9)
        assert trial.package is package
        assert trial.gain == pytest.approx(alone.gain, rel=1e-9)
        assert (trial.alarm, trial.reduction) == pytest.approx((alone.alarm, alone.reduction))
    assert try_packages(with_friction, [], 9) == []


def test_gains_are_those_of_their_packages(with_friction):
    """Where what does not help is spared, first, in the middle and last."""
    useless = [EffortOffset("shoulder"), RotorInertia("elbow"), EffortOffset("elbow")]
    effects = [useless[0], COULOMB[0], useless[1], COULOMB[1], VISCOUS[0], useless[2]]
    packages = [Package((effect,), effect.where) for effect in effects]
    trials = try_packages(with_friction, packages, 9, least=Criteria())
    assert [trial.gain > 0.0 for trial in trials] == [False, True, False, True, True, False]
    for package, trial in zip(packages, trials, strict=True):
        assert trial.package is package
        if trial.gain > 0.0:
            after = quick_fit(with_friction, package)
            columns = with_friction.dataset.effect_columns(package.effects[0])
            both = np.concatenate([with_friction.unknowns.columns, columns])
            blocks = residual_blocks(with_friction.dataset, both, after.x)
            effective = np.array([effective_samples(joint) for joint in blocks])
            kept = np.array([sum(map(len, joint)) for joint in blocks])
            effective *= after.samples.sum(0) / kept
            expected = log_likelihood_gain(with_friction.held_out.mse, after.mse, effective).sum()
            assert trial.gain == pytest.approx(expected, rel=1e-9)


def test_hypothesis_is_stripped_once(with_friction):
    more = with_friction.with_effects(COULOMB)
    bare = more.stripped(COULOMB[0])
    assert bare is more.stripped(COULOMB[0])
    assert bare.unknowns.effects == tuple(COULOMB[1:])
    assert replace(more, looseness=2.0).stripped(COULOMB[0]) is not bare


def test_gain_is_the_log_likelihood_ratio(with_friction):
    after = with_friction.with_effects(COULOMB)
    expected = after.effective * np.log(with_friction.held_out.mse / after.held_out.mse)
    assert gain_of(with_friction, after) == pytest.approx(expected.sum())
    assert gain_of(after, after) == 0.0
    gains = log_likelihood_gain(np.ones(2), np.ones(2), np.array([50.0, 60.0]))
    np.testing.assert_array_equal(gains, 0.0)


def test_joints_are_named_where_they_convince(with_friction):
    with_dry = with_friction.with_effects(COULOMB)
    (viscous,) = [
        kind
        for kind in kinds(with_dry.dataset.effects, with_dry.unknowns.effects)
        if kind.names == ("viscous_friction",)
    ]
    found = convincing(with_dry, viscous, 100, CRITERIA)
    assert [trial.package.place for trial in found] == [("shoulder",)]


def test_ranking_names_the_friction_first(with_friction):
    ranked = rank(tuned(with_friction), CRITERIA)
    chosen = choose(ranked)
    assert set(chosen.names) & {"coulomb_friction", "viscous_friction"}
    assert [r.score for r in ranked] == sorted((r.score for r in ranked), reverse=True)
    assert ranked[0].tied
    assert all(r.alarm <= CRITERIA.alarm for r in ranked)
    assert chosen.hypothesis.nrms < 0.6 * with_friction.nrms


def test_simplest_of_those_that_tie_is_chosen(with_friction):
    ranked = rank(with_friction, CRITERIA)
    first = replace(ranked[0], classes=(WrongInertia,), tied=True, gain=1e6)
    simple = replace(ranked[0], classes=(CoulombFriction,), tied=True)
    better = replace(simple, gain=simple.gain + 1.0)
    apart = replace(simple, classes=(ViscousFriction,), tied=False, gain=1e9)
    assert choose([first, simple, better, apart]) is better


def test_what_does_not_help_is_dropped(with_friction):
    needless = (EffortOffset("elbow"), JointSpring("shoulder", exponent=3))
    full = with_friction.with_effects([*COULOMB, VISCOUS[0], *needless])
    kept = prune(full, [], CRITERIA)
    assert set(kept.unknowns.effects) == {*COULOMB, VISCOUS[0]}
    stays = prune(full, needless[:1], CRITERIA)
    assert set(stays.unknowns.effects) == {*COULOMB, VISCOUS[0], needless[0]}


def test_simple_effect_takes_the_place_of_a_complex_one(with_friction):
    """The asymmetric friction that is found is symmetric: dry friction says as much."""
    asymmetric = next(
        e
        for e in with_friction.dataset.effects
        if e.name == "asymmetric_friction" and e.where == ("elbow",)
    )
    full = with_friction.with_effects([COULOMB[0], VISCOUS[0], asymmetric])
    simple = simplify(full, [], CRITERIA)
    assert set(simple.unknowns.effects) == {*COULOMB, VISCOUS[0]}
    assert simplify(full, [asymmetric], CRITERIA).unknowns.effects == full.unknowns.effects


def test_pair_takes_the_place_of_an_effect_whose_bounds_hide_it(model):
    """An offset pushes as well as it brakes, which friction with one law a direction may not."""
    start = start_of(model, lambda q, v, a, load: np.array([0.0, 0.1]) * v + np.array([0.0, 0.3]))
    asymmetric = next(
        e
        for e in start.dataset.effects
        if e.name == "asymmetric_friction" and e.where == ("elbow",)
    )
    full = start.with_effects([asymmetric])
    simple = simplify(full, [], CRITERIA)
    assert set(simple.unknowns.effects) == {VISCOUS[1], EffortOffset("elbow")}
    assert gain_of(full, simple) > 100.0


def test_search_finds_what_is_missing(with_friction):
    told = []
    trail = search(
        with_friction,
        [],
        CRITERIA,
        tune=True,
        progress=lambda words, nrms: told.append((words, nrms)),
    )
    assert set(trail.end.unknowns.effects) == {*COULOMB, VISCOUS[0]}
    assert trail.start is with_friction
    errors = [nrms for _, nrms in told]
    assert errors == sorted(errors, reverse=True)
    floor = NOISE * design_filter(1 / 200.0, trail.end.dataset.bandwidth).noise_gain
    np.testing.assert_allclose(trail.end.held_out.rms, floor, rtol=0.15)


def test_shape_is_free_where_a_grid_varies_one_number():
    powers = NonlinearViscousFriction.candidates("elbow", 2.0)
    name, values = free_shape(powers[1], [*COULOMB, *powers])
    assert name == "exponent"
    np.testing.assert_array_equal(values, [0.5, 1.5, 2.0, 3.0])
    stribeck = StribeckFriction.candidates("elbow", 2.0)
    assert free_shape(stribeck[0], stribeck)[0] == "stribeck_velocity"
    springs = JointSpring.candidates("elbow", 2.0)
    assert free_shape(springs[0], springs) is None  # an exponent of 1 or 3, nothing between
    assert free_shape(COULOMB[0], COULOMB) is None
    assert is_round(powers[1], powers)
    assert not is_round(replace(powers[1], exponent=1.7), powers)
    assert not is_round(COULOMB[0], COULOMB)


def test_finer_grid_lies_around_a_shape():
    grid = [StribeckFriction("elbow", v) for v in (0.01, 0.1, 1.0)]
    found = sorted(e.stribeck_velocity for e in finer(grid[1], grid, 0.25))
    np.testing.assert_allclose(found, 0.1 * 10.0 ** (np.arange(-2, 3) / 4))
    off = StribeckFriction("elbow", 0.05)
    found = sorted(e.stribeck_velocity for e in finer(off, grid, 0.1))
    np.testing.assert_allclose(found, 0.05 * 10.0 ** (np.arange(-2, 3) / 10))
    assert finer(COULOMB[0], COULOMB, 0.1) == (COULOMB[0],)


def test_finer_grid_stays_away_from_viscous_friction():
    grid = NonlinearViscousFriction.candidates("elbow", 2.0)
    for effect in grid:
        for share in (1.0, 1 / 3, 1 / 12):
            for other in finer(effect, grid, share)[1:]:
                assert abs(np.log(other.exponent)) >= np.log(1.25)
                assert (other.exponent < 1.0) == (effect.exponent < 1.0)


def test_no_peak_is_sought_beyond_a_grid(with_friction):
    grid = [e for e in with_friction.dataset.effects if e.name == "stribeck_friction"]
    edge = min((e for e in grid if e.where == ("elbow",)), key=lambda e: e.stribeck_velocity)
    assert peak(with_friction.with_effects(COULOMB), COULOMB[0], COULOMB) == (COULOMB[0], 0.0)
    assert peak(with_friction.with_effects([edge]), edge, grid) == (edge, 0.0)


@pytest.mark.parametrize("power", [1.7, 2.6])
def test_search_profiles_a_shape(model, power):
    def hidden(q, v, vd, load):
        return np.stack([np.zeros(len(q)), 0.2 * np.sign(v[:, 1]) * np.abs(v[:, 1]) ** power], 1)

    case = open_case(model, [pendulum_log(9, hidden)], candidates=True, bandwidth=6.0)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    end_case, trail = searched(case, start, [], CRITERIA, tune=True)
    (effect,) = trail.end.unknowns.effects
    assert effect not in case.dataset.effects
    assert effect.exponent == pytest.approx(power, rel=0.02)
    assert trail.start.dataset is trail.end.dataset is end_case.dataset
    # A golden section over full reductions finds the same exponent.
    best = minimize_scalar(
        lambda x: nrms_with(case, NonlinearViscousFriction("elbow", x), trail.end),
        bracket=(power - 0.2, power, power + 0.2),
        method="golden",
        options={"xtol": 1e-3},
    )
    assert effect.exponent == pytest.approx(best.x, rel=0.01)


def test_what_only_made_up_for_a_grid_is_left_out_at_every_joint(model):
    """On a coarse grid of exponents v and v² together stand for |v|^1.7."""

    def hidden(q, v, vd, load):
        return np.array([0.2, 0.1]) * np.sign(v) * np.abs(v) ** 1.7

    case = open_case(model, [pendulum_log(9, hidden)], candidates=True, bandwidth=6.0)
    grid = case.dataset.effects
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    squares = [NonlinearViscousFriction(joint, 2.0) for joint in JOINTS]
    trail = Trail(start, start.with_effects([*VISCOUS, *squares]), {})
    _, exact = with_plain_shapes(case, trail, grid, ())
    assert {e.name for e in exact.end.unknowns.effects} == {"nonlinear_viscous_friction"}
    for effect in exact.end.unknowns.effects:
        assert effect.exponent == pytest.approx(1.7, rel=0.05)
    _, kept = with_plain_shapes(case, trail, grid, VISCOUS)
    assert set(VISCOUS) <= set(kept.end.unknowns.effects)


def test_exponents_next_to_one_are_reached(model):
    power = 1.4

    def hidden(q, v, vd, load):
        return np.stack([np.zeros(len(q)), 0.2 * np.sign(v[:, 1]) * np.abs(v[:, 1]) ** power], 1)

    case = open_case(model, [pendulum_log(9, hidden)], candidates=True, bandwidth=6.0)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    found = start.with_effects([NonlinearViscousFriction("elbow", 1.5)])
    _, exact = with_continuous_shapes(case, Trail(start, found, {}), case.dataset.effects, ())
    (effect,) = exact.end.unknowns.effects
    assert effect.exponent == pytest.approx(power, rel=0.03)


def nrms_with(case, effect, hypothesis):
    """Held-out error of a hypothesis with another effect in the place of its only one."""
    effects = (*case.dataset.effects, effect)
    dataset = reduce_logs(case.model, case.trajectories, case.folds, effects=effects)
    bare = hypothesis.without(hypothesis.unknowns.effects).moved(dataset, delay=0)
    return bare.with_effects([effect]).nrms


def test_round_exponents_stay(model):
    """The data cannot tell 2 from 2.001, and 2 it is."""

    def hidden(q, v, vd, load):
        return np.stack([np.zeros(len(q)), 0.2 * v[:, 1] * np.abs(v[:, 1])], 1)

    case = open_case(model, [pendulum_log(9, hidden)], candidates=True, bandwidth=6.0)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    _, trail = searched(case, start, [], CRITERIA, tune=True)
    assert trail.end.unknowns.effects == (NonlinearViscousFriction("elbow", 2.0),)


def test_search_with_no_steps_left_stays(with_friction):
    trail = search(with_friction, [], CRITERIA, max_steps=0)
    assert trail.end.unknowns.effects == ()


@pytest.mark.parametrize("seed", range(3))
def test_search_finds_nothing_where_nothing_is(model, seed):
    trail = search(start_of(model, None, seed=seed), [], CRITERIA, tune=True)
    assert trail.end.unknowns.effects == ()
    assert not any(trail.end.delay)
    assert trail.end.looseness <= 1.0


def test_prior_gets_tighter_where_the_model_is_right(without):
    tight = tuned(without)
    assert tight.looseness <= 1.0
    assert tight.nrms <= without.nrms * 1.001
    loose = without.loosened(10.0)
    assert tuned(loose) is loose


def test_looser_prior_only_concerns_the_bodies(with_friction):
    hypothesis = with_friction.with_effects(COULOMB)
    loose = hypothesis.loosened(10.0)
    before, after = hypothesis.unknowns.information, loose.unknowns.information
    np.testing.assert_allclose(after[:20, :20], before[:20, :20] / 100.0)
    np.testing.assert_array_equal(after[20:, 20:], before[20:, 20:])
    assert loose.looseness == 10.0


def test_delay_is_found(model):
    log = pendulum_log(7, friction((0.2, 0.1)))
    late = replace(log, time=log.time[:-6], position=log.position[6:], effort=log.effort[:-6])
    case = open_case(model, [late], candidates=True, bandwidth=6.0)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    trail = search(start, [], CRITERIA, tune=True)
    step = abs(case.dataset.delays[1, 0])
    np.testing.assert_allclose(seconds_of(trail.end), 0.03, atol=step)
    assert set(trail.end.unknowns.effects) == set(COULOMB)


def test_effect_of_ones_own_is_found(model):
    @dataclass(frozen=True)
    class Hose(JointEffect):
        name = "hose"
        parameters = (Parameter("cosine", "N·m"), Parameter("sine", "N·m"))

        def columns(self, joint):
            return [np.cos(3 * joint.q), np.sin(3 * joint.q)]

    def hidden(q, v, vd, load):
        return np.stack([np.zeros(len(q)), 0.3 * np.cos(3 * q[:, 1])], 1)

    case = open_case(model, [pendulum_log(8, hidden)], candidates=True, extra=[Hose], bandwidth=6.0)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    trail = search(start, [], CRITERIA, tune=True)
    assert trail.end.unknowns.effects == (Hose("elbow"),)
    cosine, sine = trail.end.cv.fit_all()[-2:]
    assert cosine == pytest.approx(0.3, abs=0.02)
    assert sine == pytest.approx(0.0, abs=0.02)


def test_companions_are_told_of_in_the_units_of_their_joint():
    fitted = [FittedEffect(ViscousFriction(joint), np.array([0.25])) for joint in ("arm", "rail")]
    robot = SimpleNamespace(effects=fitted, sliding_joints=("rail",))
    notes = companion_notes(SimpleNamespace(effects=()), SimpleNamespace(model=robot))
    assert notes[0].endswith("of arm was fitted along, though not worth a step: 0.25 N·m·s/rad")
    assert notes[1].endswith("of rail was fitted along, though not worth a step: 0.25 N·s/m")


def test_place_of_least_error_is_named_though_its_score_is_negative(with_friction, monkeypatch):
    """Many parameters make scores negative that convince all the same."""
    bodies = with_friction.dataset.bodies
    trials = [
        Trial(Package((Payload(body),), (body,)), gain, 0.3, 1.0, 1e-3)
        for body, gain in zip(bodies, (50.0, 49.0), strict=False)
    ]
    kind = Kind((Payload,), {t.package.place: (t.package,) for t in trials}, unite=False)
    monkeypatch.setattr(search_module, "try_packages", lambda *_, **__: trials)
    (found,) = convincing(with_friction, kind, 20, CRITERIA)
    assert found in trials


def test_what_leaves_several_times_the_error_is_no_tie(with_friction):
    """However simple it is, and however few samples the other gain is worth."""
    whole = with_friction.with_effects([*COULOMB, VISCOUS[0]])
    part = with_friction.with_effects([VISCOUS[1]])
    assert part.loss().sum() > 4.0 * whole.loss().sum()
    ranked = rank(with_friction, CRITERIA)
    least = min(r.hypothesis.loss().sum() for r in ranked if r.tied)
    assert all(r.hypothesis.loss().sum() <= 4.0 * least for r in ranked if r.tied)


@pytest.mark.parametrize(
    ("effect", "share", "offered"),
    [
        (Hysteresis("elbow", breakaway_angle=0.1), 0.05, False),
        (Hysteresis("elbow", breakaway_angle=0.1), 0.2, True),
        (JointElasticity("elbow"), 0.0, True),
        (TorqueRipple("elbow", order=5.0), 0.2, False),
    ],
)
def test_what_others_may_hide_is_tried_where_more_than_noise_is_left(
    with_friction, without, monkeypatch, effect, share, offered
):
    """Bristles beside friction, and soft joints, though the residual shows nothing for sure."""
    monkeypatch.setattr(
        proposals_module, "proposals", lambda *_: [Proposal((effect,), share, alarm=0.5)]
    )
    cases = [SimpleNamespace(dataset=h.dataset) for h in (with_friction, without)]
    found = suggested(cases[0], with_friction, (), hidden=True)
    assert found == ((effect,) if offered else ())
    assert suggested(cases[0], with_friction, ()) == ()
    assert suggested(cases[0], with_friction, [effect], hidden=True) == ()
    assert suggested(cases[1], without, (), hidden=True) == ()


def candidate(name, hypothesis, gain, *, mse=1.0, possible=True, physical_mse=None):
    """One that would tie with any other, with the errors of fits that know what bodies can be."""
    errors = None if physical_mse is None else SimpleNamespace(mse=np.full(2, physical_mse))
    stand_in = SimpleNamespace(
        dataset=hypothesis.dataset,
        loss=hypothesis.loss,
        held_out=SimpleNamespace(mse=np.full(2, mse)),
        physical=lambda tolerance: np.array([True, possible]),
        physical_held_out=lambda: errors,
    )
    kind = SimpleNamespace(name=name)
    return Ranked((kind,), (), (), stand_in, gain, 1, 0.0)


@pytest.mark.parametrize(("physical_mse", "tied"), [(1.0, True), (100.0, False), (None, False)])
@pytest.mark.parametrize("gain", [10.0, 1000.0])
def test_what_needs_impossible_bodies_is_no_tie(with_friction, gain, physical_mse, tied):
    """Even if it is the best; unless it is as good with bodies that can be."""
    good = candidate("good", with_friction, 100.0)
    odd = candidate("odd", with_friction, gain, possible=False, physical_mse=physical_mse)
    found = {r.names[0]: r.tied for r in with_ties([good, odd], CRITERIA)}
    assert found == {"good": True, "odd": tied}


def test_impossible_bodies_tie_where_all_have_them(with_friction):
    ranked = [candidate(name, with_friction, 1.0, possible=False) for name in "ab"]
    assert all(r.tied for r in with_ties(ranked, CRITERIA))


@pytest.mark.parametrize(("stiffness", "is_spring"), [(0.3, True), (-0.3, False)])
def test_a_spring_without_stiffness_is_none(model, stiffness, is_spring):
    """Though its preload alone explains an offset."""
    hypothesis = start_of(model, lambda q, v, vd, load: [0.0, 0.5] + stiffness * q * [0.0, 1.0])
    spring = JointSpring("elbow")
    trial = try_package(hypothesis, Package((spring,), ("elbow",)), 1)
    assert trial.reduction > 0.5
    assert trial.convinces(CRITERIA) == is_spring
    kept = prune(hypothesis.with_effects([spring]), [], CRITERIA).unknowns.effects
    assert kept == ((spring,) if is_spring else ())


def test_more_of_the_same_is_no_rival(with_friction):
    alone = Ranked((CoulombFriction,), (), (COULOMB[0],), with_friction, 1.0, 1, 0.0)
    both = replace(alone, effects=(COULOMB[0], VISCOUS[0]))
    assert both.includes(alone)
    assert not alone.includes(both)
    assert not both.includes(both)
    assert not both.includes(replace(alone, effects=()))


def test_what_most_joints_have_needs_fewer_folds(with_friction):
    joints = [f"joint_{k}" for k in range(6)]

    def asked(effects):
        dataset = SimpleNamespace(joints=joints)
        unknowns = SimpleNamespace(effects=effects)
        hypothesis = SimpleNamespace(dataset=dataset, unknowns=unknowns)
        return asked_of(["coulomb_friction"], hypothesis, CRITERIA).agreement

    assert asked([CoulombFriction(j) for j in joints[:3]]) == CRITERIA.agreement
    assert asked([CoulombFriction(joints[0])] * 5) == CRITERIA.agreement
    assert 0.5 < asked([CoulombFriction(j) for j in joints[:4]]) < CRITERIA.agreement


def test_rotors_come_with_what_couples_them():
    coupled = CoupledRotorInertia(JOINTS)
    rotors = [RotorInertia(joint) for joint in JOINTS]

    def offered(present):
        (kind,) = [
            k for k in kinds([*rotors, coupled], present) if k.names == ("coupled_rotor_inertia",)
        ]
        return {package.effects for package in kind.options[JOINTS]}

    assert offered([]) == {(coupled,), (coupled, *rotors)}
    assert offered(rotors[:1]) == {(coupled,), (coupled, rotors[1])}
    assert offered(rotors) == {(coupled,)}
