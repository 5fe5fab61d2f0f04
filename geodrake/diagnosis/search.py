"""The search for what is missing: try candidates, choose, and drop what is not needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geodrake.diagnosis.candidates import Kind, kinds
from geodrake.diagnosis.delay import delayed_at
from geodrake.diagnosis.judgement import gain_of, judge
from geodrake.diagnosis.ranked import Ranked
from geodrake.diagnosis.trials import (
    Trial,
    asked_of,
    open_joints,
    try_packages,
)
from geodrake.effects import Effect, Role
from geodrake.effects.lookup import effect_of
from geodrake.identification.logs.criteria import (
    LOOSER_PRIORS,
    MOST,
    Criteria,
)
from geodrake.identification.logs.dataset import is_payload
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.identification.logs.unknowns import effect_prior


def convincing(hypothesis: Hypothesis, kind: Kind, tried: int, criteria: Criteria) -> list[Trial]:
    """The best convincing package at every place of a kind; one place only if it cannot unite.

    Args:
        hypothesis: What the packages are added to.
        kind: Effects of the same names, with their packages by place.
        tried: Number of candidates that compete, for the probability of a false alarm.
        criteria: What an effect must show.
    """
    criteria = asked_of(kind.names, hypothesis, criteria)
    packages = [package for options in kind.options.values() for package in options]
    tried_ones = iter(try_packages(hypothesis, packages, tried, least=criteria))
    found = []
    for options in kind.options.values():
        trials = [next(tried_ones) for _ in options]
        good = [trial for trial in trials if trial.judgement.convinces(criteria)]
        if good:
            found.append(best_trial(hypothesis, good))
    found.sort(key=lambda trial: -trial.score)
    if kind.unite or len(found) < 2:
        return found
    most = max(trial.judgement.gain for trial in found)
    near = [trial for trial in found if trial.judgement.gain >= MOST * most]
    return [max(near, key=lambda trial: _settled_score(hypothesis, trial))]


def best_trial(hypothesis: Hypothesis, trials: Sequence[Trial]) -> Trial:
    """The best of several trials at a place.

    A trial keeps the weights of the hypothesis, which may be far from those that its own residuals
    deserve; those that stand out by score or by reduction are therefore fitted in full.

    Args:
        hypothesis: What the trials were added to.
        trials: One trial or more.
    """
    by_score = max(trials, key=lambda trial: trial.score)
    by_reduction = max(trials, key=lambda trial: trial.judgement.reduction)
    if by_score is by_reduction:
        return by_score
    return max((by_score, by_reduction), key=lambda trial: _settled_score(hypothesis, trial))


def _settled_score(hypothesis: Hypothesis, trial: Trial) -> float:
    """The score of a trial that is fitted in full."""
    return judge(hypothesis, hypothesis.with_effects(trial.package.effects)).score


def rank(hypothesis: Hypothesis, criteria: Criteria) -> list[Ranked]:
    """All kinds that convince, best first, with those that tie with the best marked.

    Args:
        hypothesis: What the kinds are added to.
        criteria: What an effect must show.
    """
    offered = kinds(hypothesis.dataset.effects, hypothesis.unknowns.effects)
    # A shape costs a parameter, so that places are counted, not shapes. A kind that was found at
    # one joint is a hypothesis of its own at the others: no longer one of all kinds.
    places = sum(len(kind.options) for kind in offered)
    present = {effect.name for effect in hypothesis.unknowns.effects}
    ranked = [
        *_delays(hypothesis, criteria),
        *_late_joints(hypothesis, criteria),
        *_looser_prior(hypothesis, criteria),
        *_other_payloads(hypothesis, criteria),
    ]
    for kind in offered:
        tried = len(kind.options) if present.issuperset(kind.names) else places
        trials = convincing(hypothesis, kind, tried, criteria)
        if trials:
            effects = tuple(effect for t in trials for effect in t.package.effects)
            after = hypothesis.with_effects(effects)
            ranked.append(
                Ranked(
                    kind.classes,
                    tuple(dict.fromkeys(place for t in trials for place in t.package.place)),
                    effects,
                    after,
                    judge(hypothesis, after, tried=tried),
                )
            )
    return with_ties(ranked, criteria)


def choose(ranked: Sequence[Ranked]) -> Ranked:
    """Of those that cannot be distinguished from the best, the simplest; of these the best."""
    return min((r for r in ranked if r.tied), key=lambda r: (r.complexity, -r.score))


def with_ties(ranked: Sequence[Ranked], criteria: Criteria) -> list[Ranked]:
    """Best first, with those marked that cannot be distinguished from the best.

    Args:
        ranked: Kinds that convince.
        criteria: What counts as a tie.
    """
    ordered = sorted(ranked, key=lambda r: -r.score)
    if not ordered:
        return []
    best, *others = ordered
    tied = [replace(r, tied=judge(r.hypothesis, best.hypothesis).is_tie(criteria)) for r in others]
    return [replace(best, tied=True), *tied]


def _delays(hypothesis: Hypothesis, criteria: Criteria) -> list[Ranked]:
    """A delay of all efforts, that which is best with the weights as they are."""
    dataset = hypothesis.dataset
    delays = [dataset.delay_of_each(d) for d in range(len(dataset.delays))]
    others = [delay for delay in delays if delay != hypothesis.delay]
    if not others:
        return []
    gains = hypothesis.quick_gains(others)
    return _whole(
        hypothesis,
        [hypothesis.delayed(others[int(np.argmax(gains))])],
        kind=effect_of(Role.DELAY),
        where=(),
        parameters=1,
        criteria=criteria,
        tried=len(others),
    )


def _late_joints(hypothesis: Hypothesis, criteria: Criteria) -> list[Ranked]:
    """Delays of single joints that err mostly for them."""
    dataset, found = hypothesis.dataset, list[Ranked]()
    for name in open_joints(hypothesis):
        at = dataset.joints.index(name)
        errors = hypothesis.cv.errors_at_delays(at).sum(axis=1)
        best = int(errors.argmin())
        if errors[best] <= (1.0 - MOST) * errors[hypothesis.delay[at]]:
            found += _whole(
                hypothesis,
                [delayed_at(hypothesis, (at,), best)],
                kind=effect_of(Role.DELAY),
                where=(name,),
                parameters=1,
                criteria=criteria,
                tried=len(errors) * len(dataset.joints),
            )
    return found


def _looser_prior(hypothesis: Hypothesis, criteria: Criteria) -> list[Ranked]:
    if hypothesis.looseness > 1.0 or hypothesis.has_fixed_bodies:
        return []
    bodies = hypothesis.dataset.bodies
    return _whole(
        hypothesis,
        hypothesis.with_widths(LOOSER_PRIORS),
        kind=effect_of(Role.INERTIA),
        where=bodies,
        parameters=2 * len(bodies),
        criteria=criteria,
        tried=len(LOOSER_PRIORS),
    )


def _other_payloads(hypothesis: Hypothesis, criteria: Criteria) -> list[Ranked]:
    """Payloads that the model came with, changed or put down since."""
    found = []
    for effect in hypothesis.unknowns.effects:
        known = effect not in hypothesis.released and _is_known(hypothesis, effect)
        if is_payload(effect) and known:
            found += _whole(
                hypothesis,
                [hypothesis.release(effect)],
                kind=type(effect),
                where=effect.where,
                parameters=len(effect.parameters),
                criteria=criteria,
            )
    return found


def _is_known(hypothesis: Hypothesis, effect: Effect) -> bool:
    """Whether more is known about an effect than that it may be there."""
    span = hypothesis.unknowns.span(effect)
    known = hypothesis.unknowns.information[span, span]
    return bool(np.trace(known) > 1.01 * np.trace(effect_prior(hypothesis.dataset, effect)[1]))


def _whole(
    hypothesis: Hypothesis,
    others: Sequence[Hypothesis],
    *,
    kind: type[Effect],
    where: tuple[str, ...],
    parameters: int,
    criteria: Criteria,
    tried: int | None = None,
) -> list[Ranked]:
    """The best of several variants of the whole hypothesis, if it convinces."""
    if not others:
        return []
    best = max(others, key=lambda other: gain_of(hypothesis, other))
    found = judge(hypothesis, best, parameters=parameters, tried=tried or len(others))
    return [Ranked((kind,), where, (), best, found)] if found.convinces(criteria) else []
