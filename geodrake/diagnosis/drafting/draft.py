"""Formulas for what no effect of the catalogue explains.

Terms of a formula are effects like those of the catalogue: `LogModel` weighs them by the same
evidence, with prior odds by their complexity, and the same moves add, drop and swap them.
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
from geodrake.diagnosis.search import Found
from geodrake.diagnosis.search_progress import FoundStep, Progress
from geodrake.diagnosis.unknown_efforts import range_of_motion, reversals
from geodrake.effects.base import Effect
from geodrake.effects.robot_motion import RobotMotion
from geodrake.identification.logs.case import Case, error_table, open_case, reduced
from geodrake.identification.logs.criteria import NOISE_MARGIN
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.identification.logs.model_fit import effects_of
from geodrake.identification.logs.noise import motion_of
from geodrake.identification.logs.reduce import sign_widths
from geodrake.logs.motion import JointLog
from geodrake.logs.smoothing import Segment
from geodrake.model.carried_payloads import carrying
from geodrake.model.robot_model import RobotModel

_MOST_JOINTS = 3  # of which it is reported what their error varies with
_MOST_CORRELATES, _TRIED = 3, 12  # of a joint, and sets of signals of which each is fitted
_NOTABLE = 0.1  # share of the squared error that is reported
_NO_FURTHER = 0.05  # share more than a simpler correlate has, to be reported beside it
_ROUNDS = 3  # of closer and closer constants at which terms turn
_AT_ONCE = 64  # terms of which columns are made
_STEPS = np.linspace(-1.0, 1.0, 9).tolist()
_TOLD = 0.05  # probability of a rival


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
    """Explain, and draft formulas for what stays unexplained.

    A formula is a sum of terms at a joint, each a product of up to two simple functions of
    positions, velocities, directions, accelerations and loads of any joints. It is found by its
    evidence, as effects are, and judged once by held-out error.

    Args:
        model: The model as it stands.
        logs: Logs or their files; several logs are several trajectories.
        extra: Effect classes of the user's own to try beside the catalogue's.
        bandwidth: Bandwidth of the filter, Hz; by default that of the model's fit to the same logs,
            or chosen from the data.
        blocks: Blocks into which every log is cut for validation.
        hold_resting: Whether joints that hardly move in any log are held; see
            `geodrake.model.logged_joints.holding_resting`.
        beliefs: Prior odds and widths of effects.
        progress: Called with each `FoundStep`, and with each formula.

    Returns:
        The explanation as `explain` gives it, and formulas for the rest.

    Raises:
        LogError: A log cannot be used.
    """
    if progress is not None:
        function(progress, "progress")
    if beliefs is not None:
        instance(beliefs, "beliefs", Beliefs)
    case = open_case(
        model,
        logs,
        candidates=True,
        extra=extra,
        bandwidth=bandwidth,
        blocks=blocks,
        hold_resting=hold_resting,
    )
    found = investigate(case, beliefs=beliefs, progress=progress)
    return found.explanation, draft_rest(found, progress=progress)


@typed
def rest_correlates(investigation: Investigation) -> tuple[Correlate, ...]:
    """Return what the error that an investigation left varies with, without a search for formulas.

    Returns:
        Signals and products of two of them, for the joints that err most beyond noise.
    """
    found, hypothesis = _where_fewest_joints_err(investigation.found)
    erring, known = _erring(hypothesis)[:_MOST_JOINTS], investigation.correlates
    joints = [joint for joint in erring if joint not in {each.joint for each in known}]
    if not joints:
        return known
    every = found.case.model.single_joints
    others = [each for j in joints for each in _correlates(found, j, vocabulary(j, every))]
    return (*known, *others)


def draft_rest(investigation: Investigation, *, progress: Progress | None = None) -> Draft:
    """Draft formulas for what an investigation left, joint by joint, the worst first."""
    found, start = _where_fewest_joints_err(investigation.found)
    model, hypothesis = found.case.model, start
    low, high = range_of_motion(found.case.trajectories)
    ends = zip(model.joints, low.tolist(), high.tolist(), strict=True)
    reach = {joint: (a, b) for joint, a, b in ends if joint in model.single_joints}
    drafted, correlates = list[DraftedEffect](), [*investigation.correlates]
    known = {each.joint for each in correlates}
    before = _effects(found.fit)
    for joint in () if investigation.explanation.is_interrupted else _erring(start):
        if joint not in _erring(hypothesis):
            continue
        words = vocabulary(joint, model.single_joints, reach)
        offered = _offered(found, [Formula(joint, (term,)) for term in words])
        correlates += [] if joint in known else _correlates(found, joint, words)
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
        found, hypothesis = after, validated
    return Draft(
        tuple(drafted),
        tuple(correlates),
        tuple(effect for effect in before if effect not in _effects(found.fit)),
        error_table(start.dataset, start.held_out),
        error_table(hypothesis.dataset, hypothesis.held_out),
        start.dataset.logs,
    )


def _where_fewest_joints_err(found: Found) -> tuple[Found, Hypothesis]:
    """Return what was found, or the same with bodies as the model has them if fewer joints err.

    Bodies that follow what is unknown at one joint, as a hose on the sum of two angles varies with
    a pendulum's weight, spread it over the joints further in.
    """
    model, was, kinds = found.model, found.fit.choice, []
    for width in dict.fromkeys((was.width, model.widths[0])):
        choice = replace(was, width=width)
        fit = model.unbounded(choice, model.shares(found.fit), found.fit.variance)
        kinds.append((replace(found, fit=fit), model.validated(fit)))
    return min(kinds, key=lambda kind: len(_erring(kind[1])))


def _erring(hypothesis: Hypothesis) -> list[str]:
    """Return the joints with more held-out error than noise, the worst first."""
    excess = hypothesis.held_out.rms / np.maximum(hypothesis.dataset.noise_floor, 1e-300)
    joints = hypothesis.dataset.joints
    return [joints[k] for k in np.argsort(-excess) if excess[k] > NOISE_MARGIN]


def _effects(fit: Fit) -> list[Effect]:
    return [term.effect for term in fit.terms if term.effect is not None]


def _offered(found: Found, more: Sequence[Effect]) -> Found:
    """Return what was found, in a model that has columns for other effects beside it."""
    case = found.case
    effects = [*dict.fromkeys([*effects_of(case.model), *_effects(found.fit), *more])]
    columns = [*effects, *reversals(case.model, case.trajectories)]
    case = replace(case, dataset=reduced(case, columns))
    was = found.model
    model = LogModel(case.model, case.dataset, effects, was.beliefs, was.on_time, loads=case.loads)
    return replace(found, case=case, model=model, fit=model.refitted(found.fit))


def _with_formula(found: Found, joint: str, reach: dict[str, tuple[float, float]]) -> Found:
    """Climb with the terms that are offered at a joint, then with closer and closer constants."""
    spacing, before = float(TURNS[1] - TURNS[0]), _effects(found.fit)
    fit = climb(found.model, found.fit, hopeful=True)
    found = replace(found, fit=fit)
    for _ in range(_ROUNDS):
        near = list[Effect]()
        for term in _terms(found.fit, joint):
            for place in term.turning:
                factor = term.factors[place]
                low, high = reach[factor.joint]
                for step in _STEPS:
                    closer = term.turned(place, factor.constant + step * spacing * (high - low))
                    alone = FormulaTerm((closer.factors[place],))
                    near += [Formula(joint, (each,)) for each in (closer, alone)]
        if not near:
            break
        found = _offered(found, [*before, *near])
        found = replace(found, fit=climb(found.model, found.fit, hopeful=True, joints=[joint]))
        spacing *= 2.0 / (len(_STEPS) - 1)
    fit = climb(found.model, found.fit, hopeful=False)
    return replace(found, fit=_without_needless(found.model, fit))


def _without_needless(model: LogModel, fit: Fit) -> Fit:
    """Return a fit without the effects that a formula makes needless, bodies as near as can be."""
    for term in fit.terms:
        if not isinstance(term.effect, Formula):
            was = fit.choice
            less = replace(was, terms=tuple(t for t in fit.terms if t is not term))
            fit = _better(model, fit, less) if model.are_compatible(less.terms) else fit
    for width in model.widths:
        fit = _better(model, fit, replace(fit.choice, width=width))
    return fit


def _better(model: LogModel, fit: Fit, choice: Choice) -> Fit:
    """Return the more probable of a fit and another explanation."""
    other = model.fit(choice, model.shares(fit), fit.variance)
    found = None if other is None else gain_of(model, fit, other)
    return found[1] if found is not None and found[0] > 0.0 else fit


def _terms(fit: Fit, joint: str) -> list[FormulaTerm]:
    return [
        t for e in _effects(fit) if isinstance(e, Formula) and e.joint == joint for t in e.terms
    ]


def _finding(before: Found, after: Found, joint: str) -> Finding | None:
    """Return the formula at a joint with its probability; None if there is none."""
    model, fit = after.model, after.fit
    terms = tuple(t for t in fit.terms if isinstance(t.effect, Formula) and t.joint == joint)
    if not terms:
        return None
    shares = model.shares(fit)
    fit, less = model.unbounded(fit.choice, shares, fit.variance), model.refitted(before.fit)
    gain = fit.score - model.unbounded(less.choice, shares, less.variance).score
    chance = float(1.0 / (1.0 + np.exp(0.5 * np.clip(gain, -1e3, 1e3))))
    name = " + ".join(term.name for term in terms)
    return Finding(name, terms, Certainty(1.0 - chance, chance, ()))


def _rivals(found: Found, joint: str) -> list[str]:
    """Return formulas of no more terms from which the logs hardly tell the one that was found."""
    model, shares = found.model, found.model.shares(found.fit)
    choices = neighbours(model, found.fit, joints=[joint])
    near = model.ranked(choices, shares, found.fit.variance)
    scores = np.array([found.fit.score, *(fit.score for fit in near)])
    weights = np.exp(0.5 * (scores - scores.max()))
    likely = [f for f, w in zip(near, weights[1:] / weights.sum(), strict=True) if w >= _TOLD]
    most = len(_terms(found.fit, joint))
    others = [Formula(joint, tuple(_terms(fit, joint))) for fit in likely]
    return [f.words() for f in others if 0 < len(f.terms) <= most]


def _correlates(found: Found, joint: str, words: Sequence[FormulaTerm]) -> list[Correlate]:
    """Return what the error at a joint varies with, each set of signals once.

    Shares are of fits whose bodies need not exist, as none of them is kept.
    """
    best = dict[frozenset[tuple[str, str]], FormulaTerm]()
    for k in np.argsort(-_gains(found, joint, words)):
        if len(best) < _TRIED:
            best.setdefault(words[k].signals, words[k])
    offered = _offered(found, [Formula(joint, (term,)) for term in best.values()])
    model, fit = offered.model, offered.fit
    j = model.dataset.joints.index(joint)
    hypothesis, was = model.validated(fit, physical=False), fit.choice
    before, shares = float(hypothesis.held_out.sse[:, j].sum()), model.shares(fit)
    told = list[tuple[float, FormulaTerm]]()
    for each in model.terms:
        term = each.effect.terms[0] if isinstance(each.effect, Formula) else None
        if term is not None and term in best.values() and each not in fit.terms:
            choice = model.choice(was, (*fit.terms, each))
            other = model.validated(model.unbounded(choice, shares, fit.variance), physical=False)
            told.append((1.0 - float(other.held_out.sse[:, j].sum()) / before, term))
    told.sort(key=lambda each: -each[0])
    chosen = list[tuple[float, FormulaTerm]]()
    for share, term in told:
        known = any(c.signals <= term.signals and share < s + _NO_FURTHER for s, c in chosen)
        if share > max(_NOTABLE, 0.5 * told[0][0]) and not known:
            chosen.append((share, term))
    found_ones = [Correlate(joint, term.words(joint), share) for share, term in chosen]
    clock = clock_correlates(found.case, hypothesis, joint)
    return sorted([*found_ones[:_MOST_CORRELATES], *clock], key=lambda each: -each.share)


def _gains(found: Found, joint: str, words: Sequence[FormulaTerm]) -> Array:
    """Return (m,) what each term alone adds to the evidence at a joint, by the joint's own rows."""
    case, model, fit = found.case, found.model, found.fit
    j = model.dataset.joints.index(joint)
    rows = [each for fold in model.dataset.data[j].rows for each in fold]
    A, b = (np.concatenate([getattr(each, name) for each in rows]) for name in ("A", "b"))
    known, effort = model.row_columns(fit, j, A, b)
    at = next(e for e in joint_residuals(case, model.hypothesis(fit)) if e.joint == joint)
    left, covariance = effort - known @ fit.x, np.linalg.inv(fit.hessian)
    weights = np.concatenate(model.row_weights(fit, j))
    motion, gains = full_motion(case), list[Array]()
    seen = [_seen(case, *each) for each in motion]
    for few in np.array_split(np.arange(len(words)), -(-len(words) // _AT_ONCE)):
        formula = Formula(joint, tuple(words[k] for k in few))
        columns = filtered_columns(case, motion, at, (formula.rows(each)[joint] for each in seen))
        there = np.isfinite(columns).all(axis=1)
        C, weighted = columns[there], weights[there, None] * columns[there]
        half, power = known[there].T @ weighted, np.square(C).sum(axis=0)
        size = model.beliefs.size * model.dataset.effort_std[j]
        prior = np.maximum(power / len(C), np.finfo(float).tiny) / size**2
        schur = (weighted * C).sum(axis=0) - (half * (covariance @ half)).sum(axis=0) + prior
        gains.append((left[there] @ weighted) ** 2 / schur - np.log(schur / prior))
    return np.concatenate(gains)


def _seen(case: Case, log: int, segment: Segment) -> RobotMotion:
    """Return a segment of a log as effects see it."""
    trajectory = case.trajectories[log]
    robot = carrying(case.load_model, trajectory.payloads)
    return robot.motion(
        motion_of(segment, robot, trajectory),
        sign_width=sign_widths(robot, case.trajectories),
        load=segment.motor_effort if trajectory.is_grounded else None,
    )


def _drafted(
    found: Found, finding: Finding, before: Hypothesis, after: Hypothesis
) -> DraftedEffect:
    """Return what was found, with the coefficients of the fit to all logs."""
    effects = [term.effect for term in finding.terms if isinstance(term.effect, Formula)]
    joint = effects[0].joint
    dataset, j = after.dataset, after.dataset.joints.index(joint)
    at = np.concatenate([np.r_[after.unknowns.span(effect)] for effect in effects])
    return DraftedEffect(
        Formula(joint, tuple(_terms(found.fit, joint))),
        after.cv.fit_all[at],
        after.cv.deviations[at],
        float(before.held_out.rms[j]),
        float(after.held_out.rms[j]),
        float(dataset.noise_floor[j]),
        finding.certainty.chance,
        tuple(_rivals(found, joint)),
        *_traces(after, j, at),
    )


def _traces(end: Hypothesis, joint: int, at: Array) -> tuple[Array, Array, Array]:
    """Return instants, held-out residual without a formula, and the formula's effort, (K,) each."""
    data, late = end.dataset.data[joint], end.delay[joint]
    local = data.local(end.unknowns.columns)
    used, parts = local >= 0, []
    for fold, blocks in enumerate(data.rows):
        x = end.held_out.x[fold]
        for rows in blocks:
            effort = rows.A[:, local[at]] @ x[at]
            residual = rows.b[:, late] - rows.A[:, local[used]] @ x[used]
            parts.append((rows.time, residual + effort, effort))
    time, residual, effort = (np.concatenate(part) for part in zip(*parts, strict=True))
    return time, residual, effort
