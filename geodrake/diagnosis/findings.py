"""Findings: the named effects of an explanation, with their probabilities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.log_model import Choice, Fit
from geodrake.diagnosis.posterior import Certainty, Posterior
from geodrake.diagnosis.results import Correlate, Verdict
from geodrake.diagnosis.search import SearchResult
from geodrake.diagnosis.terms import Term, names_and_places
from geodrake.diagnosis.unknown_efforts import CURVES, UNKNOWN
from geodrake.effects import Effect, Role
from geodrake.effects.episode import Episode
from geodrake.effects.lookup import effect_of
from geodrake.identification.logs.case import Case, error_table
from geodrake.identification.logs.criteria import JOINT_NOISE_MARGIN
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.hypothesis import HeldOut, Hypothesis
from geodrake.identification.logs.model_errors import ErrorTable
from geodrake.inertia import pullback_metric

Array = NDArray[np.float64]

DELAY, INERTIA = effect_of(Role.DELAY).name, effect_of(Role.INERTIA).name

_MOST_OF_REVERSALS = 2.0
"""Largest nrms, over that of the noise, of an explanation with unresolved reversals."""
_ROUNDING = 1e-6
_LARGEST_GAIN = 100.0  # per sample, beyond which a payload is certain and powers overflow


@dataclass(frozen=True, eq=False)
class Finding:
    """Addition of one step: effects of one name, a delay, or wrong bodies."""

    name: str
    terms: tuple[Term, ...]  # empty for a delay, and for small changes of all bodies
    certainty: Certainty

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Return its effects."""
        return tuple(term.effect for term in self.terms if term.effect is not None)

    @property
    def places(self) -> tuple[str, ...]:
        """Return the joints and bodies of its terms."""
        return names_and_places(self.terms)[1]


def most_believed(result: SearchResult) -> tuple[SearchResult, Posterior]:
    """Return the explanation with terms replaced by more probable alternatives.

    The most probable explanation may have a term that most others lack, or lack a payload that
    most others have, in one of several sizes. What they agree on is adopted. If explanations lead
    to each other, the result is the one whose least probable term is the most probable.
    """
    seen, visited = {result.fit.choice.key}, list[tuple[float, SearchResult, Posterior]]()
    while True:
        posterior = Posterior(result.model, result.fit)
        certainties = sorted(
            ((term, posterior.of_terms([term])) for term in result.fit.terms),
            key=lambda pair: pair[1].probability,
        )
        visited.append((certainties[0][1].probability if certainties else 1.0, result, posterior))
        others = [fit for pair in certainties if (fit := _alternative(result, *pair)) is not None]
        others += [fit for p, fit in posterior.of_loads().values() if p > 0.5]
        if not others:
            return result, posterior
        better = next((fit for fit in others if fit.choice.key not in seen), None)
        if better is None:
            return max(visited, key=lambda pair: pair[0])[1:]
        result = replace(result, fit=better)
        seen.add(better.choice.key)


def _alternative(result: SearchResult, term: Term, certainty: Certainty) -> Fit | None:
    """Return the explanation with an alternative to a less probable term; None if there is none."""
    rival = max(certainty.rivals, key=lambda r: r.probability, default=None)
    if rival is not None and rival.probability > max(certainty.probability, certainty.chance):
        return rival.fit
    fewer = without(result, [term]).fit if certainty.chance > certainty.probability else result.fit
    return None if fewer is result.fit else fewer


def without(result: SearchResult, gone: Sequence[Term]) -> SearchResult:
    """Return the explanation without some of its terms, if the others do not need them."""
    fit, model = result.fit, result.model
    kept = tuple(term for term in fit.terms if term not in gone)
    if not gone or not model.are_compatible(kept):
        return result
    return _refitted(result, model.choice(fit.choice, kept))


def _refitted(result: SearchResult, choice: Choice) -> SearchResult:
    model, was = result.model, result.fit
    return replace(result, fit=model.unbounded(choice, model.shares(was), was.noise))


@dataclass(frozen=True)
class Unnamed:
    """Evidence for something that is not a finding."""

    motion: tuple[Correlate, ...]  # signals that correlate with unexplained efforts
    loads: Mapping[str, float]  # body -> probability of a payload that changed bodies replace
    gains: Mapping[str, tuple[float, float]]  # see `LogModel.usual_gains`


def named(result: SearchResult) -> tuple[SearchResult, list[Finding], Unnamed]:
    """Return the findings, and evidence that is not a finding.

    Unknown functions of a joint's motion are removed from the fit.
    """
    result, posterior = most_believed(result)
    unknown = [term for term in result.fit.terms if isinstance(term.effect, UNKNOWN)]
    findings = findings_of(result, posterior)
    left = without(result, unknown)
    motion = _correlates(result, left, unknown)
    gains = result.model.usual_gains(result.fit)
    loads = {body: p for body, (p, _) in posterior.of_loads().items()}
    return left, findings, Unnamed(motion, loads, gains)


def _correlates(
    result: SearchResult, named_only: SearchResult, unknown: Sequence[Term]
) -> tuple[Correlate, ...]:
    """Return the signals that correlate with unexplained efforts, by the error they remove."""
    if not unknown:
        return ()
    end, start, correlates = _squares(result), _squares(named_only), list[Correlate]()
    for term in unknown:
        (joint, *_), others = term.where, _squares(without(result, [term]))
        share = (others[joint] - end[joint]) / max(start[joint], np.finfo(float).tiny)
        if share > 0.0:
            correlates.append(Correlate(joint, _signal(term), share))
    return tuple(sorted(correlates, key=lambda correlate: -correlate.share))


def _squares(result: SearchResult) -> dict[str, float]:
    """Return the squared held-out error of each joint."""
    squares = result.model.validated(result.fit).held_out.sse.sum(axis=0)
    return dict(zip(result.case.model.joints, squares.tolist(), strict=True))


def _signal(term: Term) -> str:
    if isinstance(term.effect, CURVES):
        return term.effect.curve.words(*term.where[1:])
    return "its position and its velocity"


def findings_of(result: SearchResult, posterior: Posterior | None = None) -> list[Finding]:
    """Return the findings of a search; every payload is a finding of its own.

    Unknown functions are not findings.
    """
    groups = dict[object, list[Term]]()
    posterior = Posterior(result.model, result.fit) if posterior is None else posterior
    for term in result.fit.terms:
        if isinstance(term.effect, UNKNOWN):
            continue
        groups.setdefault(term.key if term.is_whole else term.name, []).append(term)
    findings = [Finding(t[0].name, tuple(t), posterior.of_terms(t)) for t in groups.values()]
    if result.model.delays_differ(result.fit.choice.delay, result.model.on_time):
        findings.append(Finding(DELAY, (), posterior.of_delay()))
    model, width = result.model, result.fit.choice.width
    far = model.model.information is not None or width > model.beliefs.wrong or not findings
    if INERTIA not in groups and width > model.widths[0] and far:
        findings.append(Finding(INERTIA, (), posterior.of_bodies()))
    return findings


@dataclass(frozen=True, eq=False)
class StagedFinding:
    """Finding in the order of steps."""

    finding: Finding
    fit: Fit  # the explanation with it and all previous findings
    validated: Hypothesis  # the explanation, cross-validated


def staged(
    result: SearchResult, findings: Sequence[Finding]
) -> tuple[Hypothesis, list[StagedFinding]]:
    """Return the model before the first step, and findings in the order of their gains.

    Refinements, such as a Stribeck curve of dry friction, follow the effects they refine.
    """
    model, moved = result.model, any(f.name == INERTIA and not f.terms for f in findings)
    width = model.widths[0] if moved else result.fit.choice.width
    latest = _fitted(result, Choice((), width, model.on_time))
    start, stages, remaining = model.validated(latest), list[StagedFinding](), [*findings]
    while remaining:
        ready = [each for each in remaining if not refines(each, remaining)] or remaining
        tried = [(each, _with(result, latest.choice, each)) for each in ready]
        # Without gains, which would absorb a payload that is not added yet.
        errors = [model.validated(fit, physical=False).nrms for _, fit in tried]
        finding, latest = tried[int(np.argmin(errors))]
        remaining.remove(finding)
        stages.append(StagedFinding(finding, latest, model.validated(latest)))
    return start, stages


def refines(finding: Finding, others: Sequence[Finding]) -> bool:
    """Return whether a finding refines another one at its place."""
    bases = {key for term in finding.terms for keys in term.needs for key in keys}
    return any(term.key in bases for other in others for term in other.terms)


def _with(result: SearchResult, previous: Choice, finding: Finding) -> Fit:
    end = result.fit.choice
    width = end.width if finding.name == INERTIA and not finding.terms else previous.width
    delay = end.delay if finding.name == DELAY else previous.delay
    terms = (*previous.terms, *finding.terms)
    choice = result.model.choice(previous, terms, width=width, delay=delay)
    return _fitted(result, choice)


def _fitted(result: SearchResult, choice: Choice) -> Fit:
    shares = result.model.shares(result.fit)
    # Parameters may violate their bounds while other findings are missing.
    return result.model.fit(choice, shares) or result.model.unbounded(choice, shares)


def probable(
    case: Case, result: SearchResult, findings: Sequence[Finding]
) -> tuple[SearchResult, Hypothesis, list[StagedFinding]]:
    """Return the result and its stages without findings that are likely part of an unknown."""
    while True:
        start, stages = staged(result, findings)
        hypotheses = [start, *(stage.validated for stage in stages)]
        tables = [error_table(case.dataset, each.held_out) for each in hypotheses]
        findings = [stage.finding for stage in stages]
        unknown = unknown_probabilities(result, findings, tables)
        if 1.0 - max(unknown, default=0.0) >= result.model.beliefs.least:
            return result, start, stages
        result, findings = without_finding(result, findings, findings[int(np.argmax(unknown))])


def without_finding(
    result: SearchResult, findings: Sequence[Finding], gone: Finding, terms: Sequence[Term] = ()
) -> tuple[SearchResult, list[Finding]]:
    """Return the explanation without one finding, or without some of its terms.

    Dependent findings are removed too. If none is left, the change of bodies by the logs is a
    finding.
    """
    rest = tuple(term for term in gone.terms if terms and term not in terms)
    fewer = [replace(f, terms=rest) if f is gone else f for f in findings if f is not gone or rest]
    kept = _compatible(result, fewer)
    if gone.name == INERTIA and not gone.terms:  # restore the bodies of the file
        result = _refitted(result, replace(result.fit.choice, width=result.model.widths[0]))
    if kept:
        result = replace(result, fit=staged(result, kept)[1][-1].fit)
        certainty = Posterior(result.model, result.fit).of_terms(rest) if rest else gone.certainty
        return result, [replace(f, certainty=certainty) if f.terms == rest else f for f in kept]
    result = replace(result, fit=result.start)
    return result, [] if gone.name == INERTIA else findings_of(result)


def _compatible(result: SearchResult, findings: Sequence[Finding]) -> list[Finding]:
    """Return findings without those that need missing effects."""
    remaining, kept, terms = [*findings], list[Finding](), tuple[Term, ...]()
    while possible := [f for f in remaining if result.model.are_compatible((*terms, *f.terms))]:
        remaining.remove(possible[0])
        kept.append(possible[0])
        terms = (*terms, *possible[0].terms)
    return kept


def unknown_probabilities(
    result: SearchResult, findings: Sequence[Finding], tables: Sequence[ErrorTable]
) -> list[float]:
    """Return the probability that each finding is part of something unknown.

    A finding on which others depend is at least as likely known as they are. `tables` are the
    errors before the first finding and after each.
    """
    pairs = zip(pairwise(tables), findings, strict=True)
    chances = [unknown_probability(result, f, [*pair, tables[-1]]) for pair, f in pairs]
    others = [_compatible(result, [f for f in findings if f is not each]) for each in findings]
    return [
        min(u for f, u in zip(findings, chances, strict=True) if f not in kept) for kept in others
    ]


def unknown_probability(
    result: SearchResult, finding: Finding, errors: Sequence[ErrorTable]
) -> float:
    """Return the probability that a finding is part of an effort that no effect describes.

    Some effect always removes part of an unknown effort's squared error; one that removes many
    times the remaining error is likely real. It may do so only beside later ones, so that it is
    judged both in its order and as the last. Errors of unresolved reversals are not counted. As
    bodies far from the file can replace a payload, payloads are judged by the ratio of errors that
    would gain as much evidence with equal bodies, at the width up to the fit's that favours them.

    `errors` are those before it, after it, and in the end, with the noise floor.
    """
    if not errors[2].shows_noise:
        return 0.0
    rows = result.model.dataset.has_rows  # tables contain these joints
    left, affected = result.fit.variance[rows], affected_joints(result, finding)[rows]
    noise = JOINT_NOISE_MARGIN**2 * np.array([e.floor**2 for e in errors[2].joints])
    remaining = float(np.sum(affected * np.maximum(1.0 - noise / left, 0.0)))
    if remaining <= 0.0:
        return 0.0
    if any(term.is_whole for term in finding.terms):
        pairs = [_with_and_without(result, finding, w) for w in _widths_up_to_fit(result)]
        samples = (result.model.shares(result.fit) * result.model.rows)[rows]
        gain = max(whole.score - without.score for without, whole in pairs)
        gain /= samples[affected].sum()
        removed = affected.sum() * np.expm1(min(gain, _LARGEST_GAIN))
    else:
        tables = [*errors[:2]]
        if finding.terms:
            data, fits = result.model.dataset, _with_and_without(result, finding)
            tables += [error_table(data, result.model.held_out(fit)) for fit in fits]
        squares = np.array([[e.rms**2 for e in table.joints] for table in tables])
        removed = np.max(((squares[::2] - squares[1::2]) / left) @ affected)
    removed = max(0.0, float(removed))
    beliefs = result.model.beliefs
    return 1.0 / (1.0 + (removed / (beliefs.part * remaining)) ** beliefs.sharpness)


def _widths_up_to_fit(result: SearchResult) -> list[float]:
    return [width for width in result.model.widths if width <= result.fit.choice.width]


def _with_and_without(
    result: SearchResult, finding: Finding, width: float | None = None
) -> tuple[Fit, Fit]:
    """Return the explanation without a finding and with it, with one prior width of bodies."""
    model, fit = result.model, result.fit
    width = fit.choice.width if width is None else width
    rest = [term for term in fit.terms if term not in finding.terms]
    without, whole = (
        model.unbounded(model.choice(fit.choice, terms, width=width), model.shares(fit), fit.noise)
        for terms in (rest, fit.terms)
    )
    return without, whole


def affected_joints(result: SearchResult, finding: Finding) -> NDArray[np.bool_]:
    """Return (nv,) whether a finding acts on each joint; all if it is not an effect."""
    data = result.model.dataset
    masks = [data.affected_joints(effect) for effect in finding.effects]
    return np.logical_or.reduce(masks) if masks else np.ones(len(data.joints), bool)


def holds(result: SearchResult, finding: Finding, before: HeldOut, after: HeldOut) -> bool:
    """Return whether held-out data agree with a finding.

    Errors of effort gains may spoil predictions, so effects are also judged with gains fitted.
    Bodies far from the file can replace a payload, so payloads are only judged with gains fitted,
    at all widths up to the fit's. Episodes are judged by predictions only.
    """
    pairs = [(before, after)]
    if finding.terms and not any(isinstance(t.effect, Episode) for t in finding.terms):
        model, widths = result.model, [result.fit.choice.width]
        if any(t.is_whole for t in finding.terms):
            pairs, widths = [], _widths_up_to_fit(result)
        fits = [_with_and_without(result, finding, width) for width in widths]
        pairs += [(model.held_out(without), model.held_out(whole)) for without, whole in fits]
    return any(_is_better(result, finding, *pair) for pair in pairs)


def _is_better(result: SearchResult, finding: Finding, before: HeldOut, after: HeldOut) -> bool:
    """Return whether held-out errors are smaller with a finding.

    The mean over the folds of the log ratio of squared errors, summed over the affected joints,
    must exceed its standard error, and the nrms of all joints must not rise.
    """
    scale = np.maximum(result.model.dataset.effort_std, np.finfo(float).tiny)
    falls = _log_ratios(before, after) @ affected_joints(result, finding)
    total = (before.sse - after.sse) @ scale**-2.0
    return _is_fall(falls) and bool(total.mean() > -_ROUNDING * np.abs(total).mean())


def terms_not_held(
    result: SearchResult, finding: Finding, before: HeldOut, after: HeldOut
) -> list[Term]:
    """Return terms of a finding at joints whose own held-out errors do not fall with it.

    Each joint is judged as all of them together are. The result is empty if all or none fail, or if
    a term affects several joints.
    """
    joints = [result.model.only_joint[term] for term in finding.terms]
    if min(joints, default=-1) < 0:
        return []
    ratios, squares = _log_ratios(before, after), before.sse.sum(axis=0) > after.sse.sum(axis=0)
    bad = [
        term
        for term, j in zip(finding.terms, joints, strict=True)
        if not (squares[j] and _is_fall(ratios[before.samples[:, j] > 0, j]))
    ]
    return bad if len(bad) < len(joints) else []


def _is_fall(falls: Array) -> bool:
    """Return whether the mean fall over folds exceeds its standard error; a single fold counts."""
    error = 0.0
    if len(falls) > 1:
        error = (1.0 - _ROUNDING) * float(falls.std(ddof=1)) / np.sqrt(len(falls))
    return bool(falls.mean() > error)


def _log_ratios(before: HeldOut, after: HeldOut) -> Array:
    """Return (F, nv) log ratios of squared errors before and after; 0 without rows."""
    least = np.finfo(float).tiny
    return np.asarray(np.log(np.maximum(before.sse, least) / np.maximum(after.sse, least)))


def largest_residual(result: SearchResult, dataset: Dataset | None = None) -> float:
    """Return the largest ratio of residual to noise, excluding unresolved reversals.

    The noise is that of the search, or of a `dataset` reduced with the final model.
    """
    noise = (dataset or result.model.dataset).noise_floor
    left = np.sqrt(result.fit.variance)
    return float(np.max(left / np.where(noise > 0.0, noise, 1e-300)))


def at_found_gains(result: SearchResult, dataset: Dataset | None = None) -> ErrorTable | None:
    """Return held-out errors with the effort gains that the logs show; None if they show none.

    Such gains belong to the logs, not to the model, and are no missing effect. The noise is that of
    the search, or of a `dataset` reduced with the final model.
    """
    model, fit = result.model, result.fit
    shown = model.usual_gains(fit)
    return error_table(dataset or model.dataset, model.held_out(fit)) if shown else None


def verdict_of(errors: ErrorTable, found: bool, *, left: float = np.inf) -> Verdict:
    """Return the verdict on a final result.

    `left` is the largest ratio of a joint's residual to its noise, in a fit that includes
    unresolved reversals and gains, which are no missing effects.
    """
    near = errors.shows_noise and errors.nrms <= _MOST_OF_REVERSALS * errors.floor_nrms
    if not (errors.is_noise or (near and left <= JOINT_NOISE_MARGIN)):
        return "unexplained"
    if not errors.knows_noise:
        return "undecided"
    return "explained" if found else "adequate"


def where_of(result: SearchResult, finding: Finding, phi: Array) -> tuple[str, ...]:
    """Return the joints or bodies of a finding; changed bodies by a fit (nb, 10)."""
    if finding.name == INERTIA:
        return tuple(moved_bodies(result.case, phi, finding))
    if finding.name == DELAY:
        return late_joints(result)
    model = result.case.model
    order = {name: i for i, name in enumerate((*model.joints, *model.bodies))}
    return tuple(sorted(finding.places, key=lambda place: order.get(place, 0)))


def late_joints(result: SearchResult) -> tuple[str, ...]:
    """Return the joints with delays of their own; empty if all delays are equal."""
    late = result.model.lateness(result.fit.choice)
    if np.ptp(late) < 1e-9:
        return ()
    return tuple(result.model.dataset.joints[j] for j in np.flatnonzero(np.abs(late) > 1e-9))


def moved_bodies(case: Case, phi: Array, finding: Finding) -> dict[str, float]:
    """Return the bodies that a fit (nb, 10) changed, wrong ones or the farthest, with distances."""
    wrong, step = {term.where[0] for term in finding.terms}, phi - case.model.phi
    distance = np.sqrt(np.einsum("bi,bij,bj->b", step, pullback_metric(case.model.phi), step))
    is_far = distance >= max(0.5 * distance.max(), 1e-9)
    distances = zip(case.model.bodies, distance.tolist(), is_far.tolist(), strict=True)
    return {body: d for body, d, moves in distances if (body in wrong if wrong else moves)}
