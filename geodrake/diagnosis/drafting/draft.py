"""Search for formulas of the error that no effect of the catalogue explains.

The terms of a formula are effects like those of the catalogue: `LogModel` compares them by the same
evidence, with prior odds by complexity, and the same moves add, drop and swap them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from geodrake.boundary.arguments import function, instance, typed
from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.climbing import climb, gain_of
from geodrake.diagnosis.drafting.clock import clock_correlates
from geodrake.diagnosis.drafting.formula import Formula, FormulaTerm
from geodrake.diagnosis.drafting.results import Array, Draft, DraftedEffect
from geodrake.diagnosis.drafting.vocabulary import TURNS, vocabulary
from geodrake.diagnosis.explain import Investigation, investigate
from geodrake.diagnosis.findings import Finding, holds
from geodrake.diagnosis.log_model import Choice, Fit, LogModel
from geodrake.diagnosis.moves import neighbours
from geodrake.diagnosis.posterior import Certainty
from geodrake.diagnosis.residuals import filtered_columns, full_motion, joint_residuals
from geodrake.diagnosis.results import Correlate, Explanation
from geodrake.diagnosis.search import SearchResult
from geodrake.diagnosis.search_progress import FoundStep, Progress
from geodrake.diagnosis.unknown_efforts import range_of_motion, reversals
from geodrake.effects.base import Effect
from geodrake.effects.robot_motion import RobotMotion
from geodrake.identification.logs.case import Case, error_table, prepare_case, reduced
from geodrake.identification.logs.criteria import NOISE_MARGIN
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.identification.logs.model_fit import effects_of
from geodrake.identification.logs.noise import motion_of
from geodrake.identification.logs.reduce import sign_widths
from geodrake.logs.motion import JointLog
from geodrake.logs.smoothing import Segment
from geodrake.model.carried_payloads import carrying
from geodrake.model.robot_model import RobotModel

_MOST_JOINTS = 3  # joints with reported correlates
_MOST_CORRELATES, _TRIED = 3, 12  # of a joint: reported, and fitted
_NOTABLE = 0.1  # share of the squared error that a reported correlate explains
_NO_FURTHER = 0.05  # additional share for a correlate with more signals
_ROUNDS = 3  # of refinement of breakpoints
_AT_ONCE = 64  # terms whose columns are evaluated together
_STEPS = np.linspace(-1.0, 1.0, 9).tolist()
_LEAST_RIVAL = 0.05  # probability of a reported rival


def draft_effects(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    extra: Sequence[type[Effect]] = (),
    bandwidth: float | None = None,
    blocks: int | None = None,
    hold_resting: bool = True,
    beliefs: Beliefs | None = None,
    progress: Progress | None = None,
) -> tuple[Explanation, Draft]:
    """Explain logs, and draft formulas for the error that remains.

    A formula is a sum of terms at a joint, each a product of up to two simple functions of
    positions, velocities, directions, accelerations and loads of any joints. It is selected by its
    evidence, as effects are, and judged once by held-out error. Arguments are those of `explain`;
    `progress` is also called with each formula.

    Returns:
        The explanation, as from `explain`, and formulas for the remaining error.

    Raises:
        LogError: A log cannot be used.
    """
    if progress is not None:
        function(progress, "progress")
    if beliefs is not None:
        instance(beliefs, "beliefs", Beliefs)
    case = prepare_case(
        model,
        logs,
        candidates=True,
        extra=extra,
        bandwidth=bandwidth,
        blocks=blocks,
        hold_resting=hold_resting,
    )
    investigation = investigate(case, beliefs=beliefs, progress=progress)
    return investigation.explanation, draft_rest(investigation, progress=progress)


@typed
def rest_correlates(investigation: Investigation) -> tuple[Correlate, ...]:
    """Return the signals that correlate with the error left by an investigation.

    No formulas are searched. The result contains signals and products of two signals, for the
    joints with the largest errors beyond noise.
    """
    state, hypothesis = _where_fewest_joints_err(investigation.result)
    erring, known = _erring(hypothesis)[:_MOST_JOINTS], investigation.correlates
    joints = [joint for joint in erring if joint not in {each.joint for each in known}]
    if not joints:
        return known
    single = state.case.model.single_joints
    others = [each for j in joints for each in _correlates(state, j, vocabulary(j, single))]
    return (*known, *others)


def draft_rest(investigation: Investigation, *, progress: Progress | None = None) -> Draft:
    """Draft formulas for the error left by an investigation, largest errors first."""
    state, start = _where_fewest_joints_err(investigation.result)
    model, hypothesis = state.case.model, start
    low, high = range_of_motion(state.case.trajectories)
    ranges = zip(model.joints, low.tolist(), high.tolist(), strict=True)
    reach = {joint: (a, b) for joint, a, b in ranges if joint in model.single_joints}
    drafted, correlates = list[DraftedEffect](), [*investigation.correlates]
    correlated = {correlate.joint for correlate in correlates}
    effects = _effects(state.fit)
    for joint in () if investigation.explanation.is_interrupted else _erring(start):
        if joint not in _erring(hypothesis):
            continue
        terms = vocabulary(joint, model.single_joints, reach)
        offered = _offered(state, [Formula(joint, (term,)) for term in terms])
        correlates += [] if joint in correlated else _correlates(state, joint, terms)
        after = _with_formula(offered, joint, reach)
        finding = _finding(offered, after, joint)
        validated = after.model.validated(after.fit)
        if finding is None or not holds(after, finding, hypothesis.held_out, validated.held_out):
            continue
        drafted.append(_drafted(after, finding, hypothesis, validated))
        if progress is not None:
            floor = error_table(start.dataset, start.held_out).floor_nrms
            nrms = hypothesis.nrms, validated.nrms, floor
            progress(FoundStep("a formula", (joint,), *nrms))
        state, hypothesis = after, validated
    return Draft(
        tuple(drafted),
        tuple(correlates),
        tuple(effect for effect in effects if effect not in _effects(state.fit)),
        error_table(start.dataset, start.held_out),
        error_table(hypothesis.dataset, hypothesis.held_out),
        start.dataset.logs,
    )


def _where_fewest_joints_err(state: SearchResult) -> tuple[SearchResult, Hypothesis]:
    """Return the state, or the same with the narrowest prior of bodies if fewer joints err.

    With a wide prior, bodies absorb part of an unknown effort and spread it over the inner joints:
    a hose whose torque depends on the sum of two angles resembles the weight of a pendulum.
    """
    model, previous, fits = state.model, state.fit.choice, []
    for width in dict.fromkeys((previous.width, model.widths[0])):
        choice = replace(previous, width=width)
        fit = model.unbounded(choice, model.shares(state.fit), state.fit.variance)
        fits.append((replace(state, fit=fit), model.validated(fit)))
    return min(fits, key=lambda item: len(_erring(item[1])))


def _erring(hypothesis: Hypothesis) -> list[str]:
    """Return the joints with held-out error beyond noise, largest first."""
    excess = hypothesis.held_out.rms / np.maximum(hypothesis.dataset.noise_floor, 1e-300)
    joints = hypothesis.dataset.joints
    return [joints[k] for k in np.argsort(-excess) if excess[k] > NOISE_MARGIN]


def _effects(fit: Fit) -> list[Effect]:
    return [term.effect for term in fit.terms if term.effect is not None]


def _offered(state: SearchResult, added: Sequence[Effect]) -> SearchResult:
    """Return the state in a model with columns of further effects."""
    case = state.case
    effects = [*dict.fromkeys([*effects_of(case.model), *_effects(state.fit), *added])]
    columns = [*effects, *reversals(case.model, case.trajectories)]
    case = replace(case, dataset=reduced(case, columns))
    old = state.model
    model = LogModel(case.model, case.dataset, effects, old.beliefs, old.on_time, loads=case.loads)
    return replace(state, case=case, model=model, fit=model.refitted(state.fit))


def _with_formula(
    state: SearchResult, joint: str, reach: dict[str, tuple[float, float]]
) -> SearchResult:
    """Return the state after climbing with the terms at a joint, with refined breakpoints."""
    spacing, effects = float(TURNS[1] - TURNS[0]), _effects(state.fit)
    fit = climb(state.model, state.fit, optimistic=True)
    state = replace(state, fit=fit)
    for _ in range(_ROUNDS):
        refined = list[Effect]()
        for term in _terms(state.fit, joint):
            for k in term.turning:
                factor = term.factors[k]
                low, high = reach[factor.joint]
                for step in _STEPS:
                    term_at = term.turned(k, factor.constant + step * spacing * (high - low))
                    single = FormulaTerm((term_at.factors[k],))
                    refined += [Formula(joint, (each,)) for each in (term_at, single)]
        if not refined:
            break
        state = _offered(state, [*effects, *refined])
        state = replace(state, fit=climb(state.model, state.fit, optimistic=True, joints=[joint]))
        spacing *= 2.0 / (len(_STEPS) - 1)
    fit = climb(state.model, state.fit, optimistic=False)
    return replace(state, fit=_without_needless(state.model, fit))


def _without_needless(model: LogModel, fit: Fit) -> Fit:
    """Return a fit without effects that a formula makes unnecessary, with the best prior width."""
    for term in fit.terms:
        if not isinstance(term.effect, Formula):
            rest = tuple(t for t in fit.terms if t is not term)
            if model.are_compatible(rest):
                fit = _better(model, fit, replace(fit.choice, terms=rest))
    for width in model.widths:
        fit = _better(model, fit, replace(fit.choice, width=width))
    return fit


def _better(model: LogModel, fit: Fit, choice: Choice) -> Fit:
    alternative = model.fit(choice, model.shares(fit), fit.variance)
    gain = None if alternative is None else gain_of(model, fit, alternative)
    return gain[1] if gain is not None and gain[0] > 0.0 else fit


def _terms(fit: Fit, joint: str) -> list[FormulaTerm]:
    return [
        t for e in _effects(fit) if isinstance(e, Formula) and e.joint == joint for t in e.terms
    ]


def _finding(before: SearchResult, after: SearchResult, joint: str) -> Finding | None:
    """Return the formula at a joint with its probability; None if there is none."""
    model, fit = after.model, after.fit
    terms = tuple(t for t in fit.terms if isinstance(t.effect, Formula) and t.joint == joint)
    if not terms:
        return None
    shares = model.shares(fit)
    fit, without = model.unbounded(fit.choice, shares, fit.variance), model.refitted(before.fit)
    gain = fit.score - model.unbounded(without.choice, shares, without.variance).score
    chance = float(1.0 / (1.0 + np.exp(0.5 * np.clip(gain, -1e3, 1e3))))
    name = " + ".join(term.name for term in terms)
    return Finding(name, terms, Certainty(1.0 - chance, chance, ()))


def _rivals(state: SearchResult, joint: str) -> list[str]:
    """Return formulas of at most as many terms that the logs hardly distinguish."""
    model, shares = state.model, state.model.shares(state.fit)
    choices = neighbours(model, state.fit, joints=[joint])
    fits = model.ranked(choices, shares, state.fit.variance)
    scores = np.array([state.fit.score, *(fit.score for fit in fits)])
    weights = np.exp(0.5 * (scores - scores.max()))
    chances = weights[1:] / weights.sum()
    likely = [f for f, chance in zip(fits, chances, strict=True) if chance >= _LEAST_RIVAL]
    count = len(_terms(state.fit, joint))
    formulas = [Formula(joint, tuple(_terms(fit, joint))) for fit in likely]
    return [f.words() for f in formulas if 0 < len(f.terms) <= count]


def _correlates(start: SearchResult, joint: str, terms: Sequence[FormulaTerm]) -> list[Correlate]:
    """Return the strongest correlates of the error at a joint, one for each set of signals.

    Their fits are not kept, and need no physical bodies.
    """
    best = dict[frozenset[tuple[str, str]], FormulaTerm]()
    for k in np.argsort(-_gains(start, joint, terms)):
        if len(best) < _TRIED:
            best.setdefault(terms[k].signals, terms[k])
    state = _offered(start, [Formula(joint, (term,)) for term in best.values()])
    model, fit = state.model, state.fit
    j = model.dataset.joints.index(joint)
    hypothesis = model.validated(fit, physical=False)
    before, shares = float(hypothesis.held_out.sse[:, j].sum()), model.shares(fit)
    fitted = list[tuple[float, FormulaTerm]]()
    for candidate in model.terms:
        effect = candidate.effect
        term = effect.terms[0] if isinstance(effect, Formula) else None
        if term is not None and term in best.values() and candidate not in fit.terms:
            choice = model.choice(fit.choice, (*fit.terms, candidate))
            other = model.validated(model.unbounded(choice, shares, fit.variance), physical=False)
            fitted.append((1.0 - float(other.held_out.sse[:, j].sum()) / before, term))
    fitted.sort(key=lambda pair: -pair[0])
    chosen = list[tuple[float, FormulaTerm]]()
    for share, term in fitted:
        implied = any(c.signals <= term.signals and share < s + _NO_FURTHER for s, c in chosen)
        if share > max(_NOTABLE, 0.5 * fitted[0][0]) and not implied:
            chosen.append((share, term))
    signals = [Correlate(joint, term.words(joint), share) for share, term in chosen]
    clock = clock_correlates(start.case, hypothesis, joint)
    return sorted([*signals[:_MOST_CORRELATES], *clock], key=lambda correlate: -correlate.share)


def _gains(state: SearchResult, joint: str, terms: Sequence[FormulaTerm]) -> Array:
    """Return (m,) gains in evidence by each single term at a joint, from the joint's own rows."""
    case, model, fit = state.case, state.model, state.fit
    j = model.dataset.joints.index(joint)
    blocks = [block for fold in model.dataset.data[j].rows for block in fold]
    A, b = (np.concatenate([getattr(block, name) for block in blocks]) for name in ("A", "b"))
    fitted, effort = model.row_columns(fit, j, A, b)
    at = next(e for e in joint_residuals(case, model.hypothesis(fit)) if e.joint == joint)
    residual, covariance = effort - fitted @ fit.x, np.linalg.inv(model.hessian(fit))
    weights = np.concatenate(model.row_weights(fit, j))
    motion, gains = full_motion(case), list[Array]()
    motions = [_seen(case, *each) for each in motion]
    for batch in np.array_split(np.arange(len(terms)), -(-len(terms) // _AT_ONCE)):
        formula = Formula(joint, tuple(terms[k] for k in batch))
        columns = filtered_columns(case, motion, at, (formula.rows(m)[joint] for m in motions))
        valid = np.isfinite(columns).all(axis=1)
        C, weighted = columns[valid], weights[valid, None] * columns[valid]
        cross, power = fitted[valid].T @ weighted, np.square(C).sum(axis=0)
        size = model.beliefs.size * model.dataset.effort_std[j]
        prior = np.maximum(power / len(C), np.finfo(float).tiny) / size**2
        schur = (weighted * C).sum(axis=0) - (cross * (covariance @ cross)).sum(axis=0) + prior
        gains.append((residual[valid] @ weighted) ** 2 / schur - np.log(schur / prior))
    return np.concatenate(gains)


def _seen(case: Case, log: int, segment: Segment) -> RobotMotion:
    """Return the motion of a log's segment, as passed to effects."""
    trajectory = case.trajectories[log]
    robot = carrying(case.load_model, trajectory.payloads)
    return robot.motion(
        motion_of(segment, robot, trajectory),
        sign_width=sign_widths(robot, case.trajectories),
        load=segment.motor_effort if trajectory.is_grounded else None,
    )


def _drafted(
    state: SearchResult, finding: Finding, before: Hypothesis, after: Hypothesis
) -> DraftedEffect:
    """Return the drafted effect, with coefficients fitted to all logs."""
    effects = [term.effect for term in finding.terms if isinstance(term.effect, Formula)]
    joint = effects[0].joint
    dataset, j = after.dataset, after.dataset.joints.index(joint)
    indices = np.concatenate([np.r_[after.unknowns.span(effect)] for effect in effects])
    return DraftedEffect(
        Formula(joint, tuple(_terms(state.fit, joint))),
        after.cv.fit_all[indices],
        after.cv.deviations[indices],
        float(before.held_out.rms[j]),
        float(after.held_out.rms[j]),
        float(dataset.noise_floor[j]),
        finding.certainty.chance,
        tuple(_rivals(state, joint)),
        *_traces(after, j, indices),
    )


def _traces(hypothesis: Hypothesis, joint: int, at: Array) -> tuple[Array, Array, Array]:
    """Return instants, held-out residual without the formula, and its effort, (K,) each."""
    data, delay = hypothesis.dataset.data[joint], hypothesis.delay[joint]
    local = data.local(hypothesis.unknowns.columns)
    used, parts = local >= 0, []
    for fold, blocks in enumerate(data.rows):
        x = hypothesis.held_out.x[fold]
        for rows in blocks:
            effort = rows.A[:, local[at]] @ x[at]
            residual = rows.b[:, delay] - rows.A[:, local[used]] @ x[used]
            parts.append((rows.time, residual + effort, effort))
    time, residual, effort = (np.concatenate(part) for part in zip(*parts, strict=True))
    return time, residual, effort
