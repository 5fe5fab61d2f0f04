"""Findings: the effects of an explanation by name, and their probabilities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.log_model import Choice, Fit
from geodrake.diagnosis.posterior import Certainty, Posterior
from geodrake.diagnosis.results import Correlate, Verdict
from geodrake.diagnosis.search import Found
from geodrake.diagnosis.terms import Term, names_and_places
from geodrake.diagnosis.unknown_efforts import CURVES, UNKNOWN
from geodrake.effects import Effect, Role
from geodrake.effects.episode import Episode
from geodrake.effects.lookup import effect_of
from geodrake.identification.logs.case import Case, error_table
from geodrake.identification.logs.criteria import JOINT_NOISE_MARGIN
from geodrake.identification.logs.hypothesis import HeldOut, Hypothesis
from geodrake.identification.logs.model_errors import ErrorTable
from geodrake.inertia import pullback_metric

Array = NDArray[np.float64]

DELAY, INERTIA = effect_of(Role.DELAY).name, effect_of(Role.INERTIA).name

_MOST_OF_REVERSALS = 2.0
"""Reversals that logs do not resolve add at most this, over the noise, to what is explained."""
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class Finding:
    """Addition of one step: effects of one name, a delay, or bodies that are wrong."""

    name: str
    terms: tuple[Term, ...]  # its terms; none for a delay, and for bodies that all move a little
    certainty: Certainty

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Return its effects."""
        return tuple(term.effect for term in self.terms if term.effect is not None)

    @property
    def places(self) -> tuple[str, ...]:
        """Return the joints and bodies of its terms."""
        return names_and_places(self.terms)[1]


def believed(found: Found) -> tuple[Found, Posterior]:
    """Return the explanation without terms that are less probable than their alternatives.

    The most probable explanation may have a term that most others have not: what they agree on is
    adopted, another term or none. Where explanations lead to each other, the one is adopted whose
    least probable term is the most probable.
    """
    seen, visited = {found.fit.choice.key}, list[tuple[float, Found, Posterior]]()
    while True:
        posterior = Posterior(found.model, found.fit)
        told = sorted(
            ((term, posterior.of_terms([term])) for term in found.fit.terms),
            key=lambda each: each[1].probability,
        )
        visited.append((told[0][1].probability if told else 1.0, found, posterior))
        others = [fit for each in told if (fit := _instead(found, *each)) is not None]
        if not others:
            return found, posterior
        better = next((fit for fit in others if fit.choice.key not in seen), None)
        if better is None:
            return max(visited, key=lambda each: each[0])[1:]
        found = replace(found, fit=better)
        seen.add(better.choice.key)


def _instead(found: Found, term: Term, told: Certainty) -> Fit | None:
    """Return the explanation without a term that is less probable than an alternative."""
    likely = max(told.rivals, key=lambda rival: rival.probability, default=None)
    if likely is not None and likely.probability > max(told.probability, told.chance):
        return likely.fit
    fewer = without(found, [term]).fit if told.chance > told.probability else found.fit
    return None if fewer is found.fit else fewer


def without(found: Found, gone: Sequence[Term]) -> Found:
    """Return the explanation without some of its terms, if the others do not need them."""
    fit, model = found.fit, found.model
    kept = tuple(term for term in fit.terms if term not in gone)
    if not gone or not model.are_compatible(kept):
        return found
    return _refitted(found, model.choice(fit.choice, kept))


def _refitted(found: Found, choice: Choice) -> Found:
    """Return the result of the search with another explanation."""
    model, was = found.model, found.fit
    return replace(found, fit=model.unbounded(choice, model.shares(was), was.noise))


@dataclass(frozen=True)
class Unnamed:
    """Evidence for something that is not a finding."""

    motion: tuple[Correlate, ...]  # what no effect describes varies with
    loads: Mapping[str, float]  # body -> how probable a payload is that bodies take in
    gains: Mapping[str, tuple[float, float]]  # as `LogModel.usual_gains`


def named(found: Found) -> tuple[Found, list[Finding], Unnamed]:
    """Return the findings, and evidence that is not a finding.

    A function of a joint's motion that no effect describes is not fitted.
    """
    found, posterior = believed(found)
    unknown = [term for term in found.fit.terms if isinstance(term.effect, UNKNOWN)]
    findings = findings_of(found, posterior)
    left = without(found, unknown)
    motion = _correlates(found, left, unknown)
    return left, findings, Unnamed(motion, posterior.of_loads(), found.model.usual_gains(found.fit))


def _correlates(found: Found, left: Found, unknown: Sequence[Term]) -> tuple[Correlate, ...]:
    """Return the signals that correlate with unexplained efforts, by the error they remove."""
    if not unknown:
        return ()
    end, start, told = _squares(found), _squares(left), list[Correlate]()
    for term in unknown:
        (joint, *_), others = term.where, _squares(without(found, [term]))
        share = (others[joint] - end[joint]) / max(start[joint], np.finfo(float).tiny)
        if share > 0.0:
            told.append(Correlate(joint, _signal(term), share))
    return tuple(sorted(told, key=lambda each: -each.share))


def _squares(found: Found) -> dict[str, float]:
    """Return the squared held-out error of each joint."""
    squares = found.model.validated(found.fit).held_out.sse.sum(axis=0)
    return dict(zip(found.case.model.joints, squares.tolist(), strict=True))


def _signal(term: Term) -> str:
    """Return the signal of an unknown function, in words."""
    if isinstance(term.effect, CURVES):
        return term.effect.curve.words(*term.where[1:])
    return "its position and its velocity"


def findings_of(found: Found, posterior: Posterior | None = None) -> list[Finding]:
    """Return the findings of a search; every payload is a finding of its own.

    A function that no effect describes is not a finding.
    """
    groups = dict[object, list[Term]]()
    posterior = Posterior(found.model, found.fit) if posterior is None else posterior
    for term in found.fit.terms:
        if isinstance(term.effect, UNKNOWN):
            continue
        groups.setdefault(term.key if term.is_whole else term.name, []).append(term)
    findings = [Finding(t[0].name, tuple(t), posterior.of_terms(t)) for t in groups.values()]
    if found.model.are_apart(found.fit.choice.delay, found.model.on_time):
        findings.append(Finding(DELAY, (), posterior.of_delay()))
    width, least, wrong = found.fit.choice.width, found.model.widths[0], found.model.beliefs.wrong
    far = found.model.model.information is not None or width > wrong or not findings
    if INERTIA not in groups and width > least and far:
        findings.append(Finding(INERTIA, (), posterior.of_bodies()))
    return findings


@dataclass(frozen=True, eq=False)
class StagedFinding:
    """A finding in the order of steps."""

    finding: Finding
    fit: Fit  # the explanation with it and all before it
    validated: Hypothesis  # that, validated fold by fold


def staged(found: Found, findings: Sequence[Finding]) -> tuple[Hypothesis, list[StagedFinding]]:
    """Return the model before the first step, and findings in the order of their gains.

    What refines others, as a Stribeck curve does dry friction, comes after these.
    """
    model, moved = found.model, any(f.name == INERTIA and not f.terms for f in findings)
    width = model.widths[0] if moved else found.fit.choice.width
    at = _fitted(found, Choice((), width, model.on_time))
    start, stages, left = model.validated(at), list[StagedFinding](), [*findings]
    while left:
        ready = [each for each in left if not refines(each, left)] or left
        tried = [(each, _with(found, at.choice, each)) for each in ready]
        # By held-out errors: gains of what is carried would absorb a payload that is not added yet.
        errors = [model.validated(fit, physical=False).nrms for _, fit in tried]
        finding, at = tried[int(np.argmin(errors))]
        left.remove(finding)
        stages.append(StagedFinding(finding, at, model.validated(at)))
    return start, stages


def refines(finding: Finding, others: Sequence[Finding]) -> bool:
    """Return whether a finding refines one of others at its place."""
    bases = {key for term in finding.terms for keys in term.needs for key in keys}
    return any(term.key in bases for other in others for term in other.terms)


def _with(found: Found, was: Choice, finding: Finding) -> Fit:
    """Return an explanation with one finding added."""
    end = found.fit.choice
    width = end.width if finding.name == INERTIA and not finding.terms else was.width
    delay = end.delay if finding.name == DELAY else was.delay
    terms = (*was.terms, *finding.terms)
    choice = found.model.choice(was, terms, width=width, delay=delay)
    return _fitted(found, choice)


def _fitted(found: Found, choice: Choice) -> Fit:
    shares = found.model.shares(found.fit)
    # Beside what is missing still, something may be negative.
    return found.model.fit(choice, shares) or found.model.unbounded(choice, shares)


def probable(
    case: Case, found: Found, findings: Sequence[Finding]
) -> tuple[Found, Hypothesis, list[StagedFinding]]:
    """Return the result and its stages without findings that are likely part of an unknown."""
    while True:
        start, stages = staged(found, findings)
        hypotheses = [start, *(stage.validated for stage in stages)]
        tables = [error_table(case.dataset, each.held_out) for each in hypotheses]
        findings = [stage.finding for stage in stages]
        unknown = unknown_probabilities(found, findings, tables)
        if 1.0 - max(unknown, default=0.0) >= found.model.beliefs.least:
            return found, start, stages
        found, findings = without_finding(found, findings, findings[int(np.argmax(unknown))])


def without_finding(
    found: Found, findings: Sequence[Finding], gone: Finding, terms: Sequence[Term] = ()
) -> tuple[Found, list[Finding]]:
    """Return the explanation without one finding, or without some of its terms if any are given.

    Findings that need what goes go with it. Where none is left, bodies that come closer to the logs
    than those of the file are one.
    """
    rest = tuple(term for term in gone.terms if terms and term not in terms)
    fewer = [replace(f, terms=rest) if f is gone else f for f in findings if f is not gone or rest]
    kept = _compatible(found, fewer)
    if gone.name == INERTIA and not gone.terms:  # bodies go back to the file
        found = _refitted(found, replace(found.fit.choice, width=found.model.widths[0]))
    if kept:
        found = replace(found, fit=staged(found, kept)[1][-1].fit)
        own = Posterior(found.model, found.fit).of_terms(rest) if rest else gone.certainty
        return found, [replace(f, certainty=own) if f.terms == rest else f for f in kept]
    found = replace(found, fit=found.start)
    return found, [] if gone.name == INERTIA else findings_of(found)


def _compatible(found: Found, findings: Sequence[Finding]) -> list[Finding]:
    """Return findings without those that need what is not among them."""
    left, kept, terms = [*findings], list[Finding](), tuple[Term, ...]()
    while able := [f for f in left if found.model.are_compatible((*terms, *f.terms))]:
        left.remove(able[0])
        kept.append(able[0])
        terms = (*terms, *able[0].terms)
    return kept


def unknown_probabilities(
    found: Found, findings: Sequence[Finding], tables: Sequence[ErrorTable]
) -> list[float]:
    """Return the probability that each finding is part of something unknown.

    What others cannot be without is as likely as they are. `tables` are the errors before the first
    finding and after each.
    """
    pairs = zip(pairwise(tables), findings, strict=True)
    own = [unknown_probability(found, f, [*pair, tables[-1]]) for pair, f in pairs]
    left = [_compatible(found, [f for f in findings if f is not each]) for each in findings]
    return [
        min(u for f, u in zip(findings, own, strict=True) if f not in others) for others in left
    ]


def unknown_probability(found: Found, finding: Finding, errors: Sequence[ErrorTable]) -> float:
    """Return the probability that a finding is part of an effort that no effect describes.

    Whatever is unknown, some effect takes a part of its squared error away. One that takes away
    many times of what is left in the end is likely to be there itself. What reversals leave that
    logs do not resolve is known, and not counted. Bodies that may go far from the file take in what
    a payload does, and are its rival already: it is told with bodies that stay.

    `errors` are those before and after it, and in the end, whose noise floor counts.
    """
    if not errors[2].shows_noise:
        return 0.0
    before, after = (np.array([e.rms**2 for e in table.joints]) for table in errors[:2])
    rows = found.model.dataset.has_rows  # joints without are in no table
    weight = felt(found, finding)[rows] / np.array([e.std**2 for e in errors[2].joints])
    noise = JOINT_NOISE_MARGIN**2 * np.array([e.floor**2 for e in errors[2].joints])
    left = float(weight @ np.maximum(found.fit.variance[rows] - noise, 0.0))
    if left <= 0.0:
        return 0.0
    if any(term.is_whole for term in finding.terms):
        fits = _beside(found, finding, found.model.widths[0])
        before, after = (fit.variance[rows] for fit in fits)
    gone = max(0.0, float(weight @ (before - after)))
    beliefs = found.model.beliefs
    return 1.0 / (1.0 + (gone / (beliefs.part * left)) ** beliefs.sharpness)


def _beside(found: Found, finding: Finding, width: float) -> tuple[Fit, Fit]:
    """Return the explanation without a finding and with it, bodies known to a width."""
    model, was = found.model, found.fit
    rest = [term for term in was.terms if term not in finding.terms]
    without, whole = (
        model.unbounded(model.choice(was.choice, terms, width=width), model.shares(was), was.noise)
        for terms in (rest, was.terms)
    )
    return without, whole


def felt(found: Found, finding: Finding) -> NDArray[np.bool_]:
    """Return (nv,) which joints a finding acts on; all if it is no effect."""
    data = found.model.dataset
    known = [data.felt(effect) for effect in finding.effects]
    return np.logical_or.reduce(known) if known else np.ones(len(data.joints), bool)


def holds(found: Found, finding: Finding, before: HeldOut, after: HeldOut) -> bool:
    """Return whether held-out data agree with a finding.

    Gains of efforts that are off may spoil what the model predicts, so effects are also judged with
    gains fitted. Bodies that may be far from the file can replace a payload, so a payload is judged
    in this way alone, and also with bodies that stay near the file. Effects that are there for a
    part of a log only are judged by what the model predicts.
    """
    pairs = [(before, after)]
    if finding.terms and not any(isinstance(t.effect, Episode) for t in finding.terms):
        model, widths = found.model, [found.fit.choice.width]
        if any(t.is_whole for t in finding.terms):
            pairs, widths = [], [model.widths[0], *widths]
        fits = [_beside(found, finding, width) for width in widths]
        pairs += [(model.held_out(without), model.held_out(whole)) for without, whole in fits]
    return any(_falls(found, finding, *pair) for pair in pairs)


def _falls(found: Found, finding: Finding, before: HeldOut, after: HeldOut) -> bool:
    """Return whether held-out errors are smaller with a finding.

    The logarithms of the squared errors of the joints that feel it must fall, in the mean over the
    folds, by more than the standard error of that mean. The squared error of all joints, as nrms
    counts them, must not rise.
    """
    scale = np.maximum(found.model.dataset.effort_std, np.finfo(float).tiny)
    falls = _log_ratios(before, after) @ felt(found, finding)
    total = (before.sse - after.sse) @ scale**-2.0
    return _is_fall(falls) and bool(total.mean() > -_ROUNDING * np.abs(total).mean())


def terms_not_held(found: Found, finding: Finding, before: HeldOut, after: HeldOut) -> list[Term]:
    """Return terms of a finding at joints whose own held-out errors do not fall with it.

    They must fall as those of all joints together must. There are none where all do, or none does,
    or where several joints feel a term.
    """
    joints = [found.model.felt_by[term] for term in finding.terms]
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
    """Return whether falls of folds are more than their standard error, in the mean.

    A fall in one fold alone just counts.
    """
    error = 0.0
    if len(falls) > 1:
        error = (1.0 - _ROUNDING) * float(falls.std(ddof=1)) / np.sqrt(len(falls))
    return bool(falls.mean() > error)


def _log_ratios(before: HeldOut, after: HeldOut) -> Array:
    """Return (F, nv) logarithms of how many times smaller squared errors are; 0 without rows."""
    least = np.finfo(float).tiny
    return np.asarray(np.log(np.maximum(before.sse, least) / np.maximum(after.sse, least)))


def largest_residual(found: Found) -> float:
    """Return the largest ratio of residual to noise, unresolved reversals left aside."""
    noise = found.model.dataset.noise_floor
    left = np.sqrt(found.fit.variance)
    return float(np.max(left / np.where(noise > 0.0, noise, 1e-300)))


def at_found_gains(found: Found) -> ErrorTable | None:
    """Return held-out errors with the gains of efforts that the logs show; None if they show none.

    Gains are not the model's: an error by them is no missing effect.
    """
    model, fit = found.model, found.fit
    shown = model.usual_gains(fit) if fit.terms else {}
    return error_table(model.dataset, model.held_out(fit)) if shown else None


def verdict_of(errors: ErrorTable, found: bool, *, left: float = np.inf) -> Verdict:
    """Return the verdict on an end result.

    `left` is the largest ratio of a joint's residual to its noise, in a fit that allows for
    reversals that the logs do not resolve and for gains, as those are no missing effect.
    """
    near = errors.shows_noise and errors.nrms <= _MOST_OF_REVERSALS * errors.floor_nrms
    if not (errors.is_noise or (near and left <= JOINT_NOISE_MARGIN)):
        return "unexplained"
    if not errors.knows_noise:
        return "undecided"
    return "explained" if found else "adequate"


def where_of(found: Found, finding: Finding, phi: Array) -> tuple[str, ...]:
    """Return the joints or bodies of a finding; bodies as changed by a fit (nb, 10)."""
    if finding.name == INERTIA:
        return tuple(moved_bodies(found.case, phi, finding))
    if finding.name == DELAY:
        return late_joints(found)
    model = found.case.model
    order = {name: i for i, name in enumerate((*model.joints, *model.bodies))}
    return tuple(sorted(finding.places, key=lambda place: order.get(place, 0)))


def late_joints(found: Found) -> tuple[str, ...]:
    """Return the joints with delays of their own; empty if all are alike."""
    late = found.model.lateness(found.fit.choice)
    if np.ptp(late) < 1e-9:
        return ()
    return tuple(found.model.dataset.joints[j] for j in np.flatnonzero(np.abs(late) > 1e-9))


def moved_bodies(case: Case, phi: Array, finding: Finding) -> dict[str, float]:
    """Return the bodies that a fit (nb, 10) changed, and how much: wrong ones, or the farthest."""
    wrong, step = {term.where[0] for term in finding.terms}, phi - case.model.phi
    distance = np.sqrt(np.einsum("bi,bij,bj->b", step, pullback_metric(case.model.phi), step))
    far = distance >= max(0.5 * distance.max(), 1e-9)
    ways = zip(case.model.bodies, distance.tolist(), far.tolist(), strict=True)
    return {body: way for body, way, moved in ways if (body in wrong if wrong else moved)}
