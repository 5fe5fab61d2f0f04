"""After a step forward: swap what is needlessly complex, drop what is no longer needed."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.special import chdtri

from geodrake.diagnosis.candidates import (
    Package,
    has_base,
    kinds_at,
    pairs_at,
    said_by,
    simple_at,
)
from geodrake.diagnosis.shapes import variants
from geodrake.diagnosis.trials import (
    PENALTY,
    Trial,
    acted_upon,
    asked_of,
    gain_of,
    improvement,
    is_nothing,
    net_gain,
    settled_trial,
    try_package,
    try_packages,
)
from geodrake.effects.base import Effect
from geodrake.identification.logs.evidence import (
    SEVERAL,
    Criteria,
    chi2_tail,
    log_likelihood_gain,
    tie_probability,
)
from geodrake.identification.logs.hypothesis import Hypothesis

_BY_FAR = 4.0  # times what a criterion asks for
_NEARLY_ALL = 0.8  # of the folds
_FITTED = 2  # the best by quick trials, beside that which reduces the error most


def prune(hypothesis: Hypothesis, fixed: Sequence[Effect], criteria: Criteria) -> Hypothesis:
    """Drop effects, weakest first, that would no longer convince if they were offered now.

    Args:
        hypothesis: The hypothesis.
        fixed: Effects that stay (those of the model as it came).
        criteria: When an effect counts.
    """
    needed = set(fixed)
    while True:
        offered = [e for e in hypothesis.unknowns.effects if e not in needed]
        offered = [e for e in offered if not _is_base(hypothesis, e)]
        trials = [(effect, _quick_trial(hypothesis, effect)) for effect in offered]
        for effect, quick in sorted(trials, key=lambda tried: tried[1].score if tried[1] else 0.0):
            reduced = _without_needless(hypothesis, effect, quick, criteria)
            if reduced is not None:
                hypothesis = reduced
                break
            needed.add(effect)  # without another one, it is all the more
        else:
            return hypothesis


def _without_needless(
    hypothesis: Hypothesis, effect: Effect, quick: Trial | None, criteria: Criteria
) -> Hypothesis | None:
    """The hypothesis without an effect; None if it is needed."""
    own = hypothesis.held_out.x[:, hypothesis.unknowns.span(effect)]
    stands = not is_nothing([effect], own) and stands_out(hypothesis, effect)
    if stands and quick is not None and _by_far(quick, criteria):
        return None
    reduced = hypothesis.without([effect])
    package = Package((effect,), effect.where)
    asked = asked_of([effect.name], reduced, criteria)
    needed = stands and (
        try_package(reduced, package, 1).convinces(asked)
        or settled_trial(reduced, hypothesis, package).convinces(asked)
    )
    return None if needed else reduced


def _quick_trial(hypothesis: Hypothesis, effect: Effect) -> Trial | None:
    """The evidence for an effect with the weights as they are; None where bounds are in the way."""
    cv, span = hypothesis.cv, hypothesis.unknowns.span(effect)
    without = cv.without_columns(np.arange(span.start, span.stop))
    if without is None:
        return None
    package = Package((effect,), effect.where)
    seen = acted_upon(hypothesis.dataset, package)
    reduction, agreement = improvement((without, cv.held_out), seen)
    gain = float(log_likelihood_gain(without.mse, cv.held_out.mse, hypothesis.effective).sum())
    return Trial(package, gain, reduction, agreement, 0.0)


def _by_far(trial: Trial, criteria: Criteria) -> bool:
    """Whether an effect passes all criteria by far."""
    return (
        trial.reduction > _BY_FAR * criteria.reduction
        and trial.agreement >= max(criteria.agreement, _NEARLY_ALL)
        and trial.gain > _BY_FAR**2 * PENALTY * trial.package.parameters
    )


def _is_base(hypothesis: Hypothesis, effect: Effect) -> bool:
    """Whether a refinement stands on an effect that is there.

    By three deviations; by one beside a refinement of several effects at once, such as |v|^α, which
    lies between them and takes the place of either as soon as it is left out.
    """
    refined = [
        other
        for other in hypothesis.unknowns.effects
        if other.refines and other.where == effect.where
    ]
    if not any(type(effect) in bases for other in refined for bases in other.refines):
        return False
    between = any(all(len(bases) > 1 for bases in other.refines) for other in refined)
    return stands_out(hypothesis, effect, deviations=1.0 if between else 3.0)


def stands_out(hypothesis: Hypothesis, effect: Effect, *, deviations: float = 3.0) -> bool:
    """Whether the parameters of an effect are together as unlikely as some deviations of one.

    Args:
        hypothesis: The hypothesis, with the effect.
        effect: The effect.
        deviations: How many standard deviations of a normal variable are as unlikely.
    """
    span = hypothesis.unknowns.span(effect)
    x, covariance = hypothesis.cv.fit_all()[span], hypothesis.cv.covariance()[span, span]
    distance = x @ np.linalg.solve(covariance, x)
    return bool(distance > chdtri(len(x), chi2_tail(deviations**2, 1)))


def reshape(
    hypothesis: Hypothesis, fixed: Sequence[Effect], *, least: float = PENALTY
) -> Hypothesis:
    """Choose shape parameters anew: what fitted best before other effects came may not now.

    Args:
        hypothesis: The hypothesis.
        fixed: Effects that stay.
        least: Gain from which on another shape is taken.
    """
    for effect in hypothesis.unknowns.effects:
        shapes = [
            other for other in variants(effect, hypothesis.dataset.effects) if other != effect
        ]
        if effect not in fixed and shapes:
            others = [hypothesis.exchanged([effect], [shape]) for shape in shapes]
            best = max(others, key=lambda other: gain_of(hypothesis, other))
            if gain_of(hypothesis, best) > least:
                hypothesis = best
    return hypothesis


def simplify(hypothesis: Hypothesis, fixed: Sequence[Effect], criteria: Criteria) -> Hypothesis:
    """Swap effects for simpler ones at their place that do as well, or for pairs that do better.

    Args:
        hypothesis: The hypothesis.
        fixed: Effects that stay.
        criteria: What an effect must show.
    """
    for effect in hypothesis.unknowns.effects:
        if effect in fixed or effect not in hypothesis.unknowns.effects:
            continue
        others = [other for other in hypothesis.unknowns.effects if other != effect]
        effects = hypothesis.dataset.effects
        pair = _best_instead(hypothesis, [effect], _pairs(effects, others, effect))
        if pair is not None and _worth_it(hypothesis, pair, (effect,), criteria):
            hypothesis = pair
            continue
        simple = _best_instead(hypothesis, [effect], _simpler(effects, others, effect))
        if simple is not None and not _worth_it(simple, hypothesis, (effect,), criteria):
            hypothesis = simple
    return hypothesis


def merge(hypothesis: Hypothesis, fixed: Sequence[Effect], criteria: Criteria) -> Hypothesis:
    """Swap two effects of a joint for one, of no more parameters, that does as well.

    What came first may have been a compromise, and what came next what it left.

    Args:
        hypothesis: The hypothesis.
        fixed: Effects that stay.
        criteria: What effects must show.
    """
    free = [e for e in hypothesis.unknowns.effects if e not in fixed and e.places == "joint"]
    for two in combinations(free, 2):
        one, other = two
        present = hypothesis.unknowns.effects
        if one.where != other.where or not set(two) <= set(present):
            continue
        left = [effect for effect in present if effect not in two]
        most = Package(two, one.where).parameters
        packages = [
            package
            for kind in kinds_at(hypothesis.dataset.effects, left, one.where)
            for package in kind.options[one.where]
            if len(package.effects) == 1
            and package.parameters <= most
            and not set(package.effects) <= set(two)
        ]
        merged = _best_instead(hypothesis, two, packages)
        if merged is not None and not _worth_it(merged, hypothesis, two, criteria):
            hypothesis = merged
    return hypothesis


def swap(hypothesis: Hypothesis, fixed: Sequence[Effect], criteria: Criteria) -> Hypothesis:
    """Swap effects of joints for others, no more complex, that do clearly better by now.

    What suited a residual best before another effect was known may have been the wrong one.

    Args:
        hypothesis: The hypothesis.
        fixed: Effects that stay.
        criteria: What an effect must show.
    """
    for effect in hypothesis.unknowns.effects:
        if effect in fixed or effect.places != "joint" or not is_free(hypothesis, effect):
            continue
        others = [other for other in hypothesis.unknowns.effects if other != effect]
        packages = [
            package
            for kind in kinds_at(hypothesis.dataset.effects, others, effect.where)
            if len(kind.classes) == 1 and kind.complexity <= effect.complexity
            for package in kind.options[effect.where]
            if package.effects != (effect,)
        ]
        bare = hypothesis.stripped(effect)
        as_it_is = Package((effect,), effect.where)
        own, *trials = try_packages(bare, [as_it_is, *packages], 1 + len(packages))
        best = max(trials, key=lambda trial: trial.score, default=own)
        if best.score > own.score + PENALTY:
            other = hypothesis.exchanged([effect], best.package.effects)
            if _worth_it(hypothesis, other, (effect,), criteria):
                hypothesis = other
    return hypothesis


def is_free(hypothesis: Hypothesis, effect: Effect) -> bool:
    """Whether no other effect at its place stands on an effect.

    Args:
        hypothesis: The hypothesis, with the effect.
        effect: The effect.
    """
    present = hypothesis.unknowns.effects
    own = (effect.name, effect.where)
    taken = said_by(present)
    less = said_by(other for other in present if (other.name, other.where) != own)
    here = [other for other in present if other.where == effect.where and other != effect]
    return all(has_base(other, less) or not has_base(other, taken) for other in here)


def split_compromises(
    hypothesis: Hypothesis, fixed: Sequence[Effect], criteria: Criteria
) -> Hypothesis:
    """Split effects whose shape is a compromise of another shape and a simple effect beside it.

    Only shapes that are no longer bound to a coarse grid differ clearly from such a compromise.

    Args:
        hypothesis: The hypothesis.
        fixed: Effects that stay.
        criteria: What an effect must show.
    """
    for effect in hypothesis.unknowns.effects:
        others = [other for other in hypothesis.unknowns.effects if other != effect]
        pairs = [] if effect in fixed else _shared(hypothesis.dataset.effects, others, effect)
        pair = _best_instead(hypothesis, [effect], pairs)
        if pair is not None and _worth_it(hypothesis, pair, (effect,), criteria):
            hypothesis = pair
    return hypothesis


def _best_instead(
    hypothesis: Hypothesis, gone: Sequence[Effect], packages: Sequence[Package]
) -> Hypothesis | None:
    """The hypothesis with the best of some packages in the place of effects, if there are any."""
    if not packages:
        return None
    trials = try_packages(hypothesis.stripped(*gone), packages, len(packages))
    by_score = sorted(trials, key=lambda trial: -trial.score)[:_FITTED]
    by_reduction = max(trials, key=lambda trial: trial.reduction)
    fitted = {
        trial.package: hypothesis.exchanged(gone, trial.package.effects)
        for trial in (*by_score, by_reduction)
    }
    return max(fitted.values(), key=lambda other: net_gain(hypothesis, other))


def _simpler(
    effects: Sequence[Effect], present: Sequence[Effect], effect: Effect
) -> Sequence[Package]:
    """Packages of less complexity at the place of an effect."""
    return [
        package
        for kind in kinds_at(effects, present, effect.where)
        if kind.complexity < effect.complexity
        for package in kind.options[effect.where]
    ]


def _pairs(
    effects: Sequence[Effect], present: Sequence[Effect], effect: Effect
) -> Sequence[Package]:
    """Pairs of simple effects at the joint of an effect of more parameters.

    An effect with bounds, such as friction that brakes, may stand for what two others do better.
    """
    own = Package((effect,), effect.where).parameters
    pairs = pairs_at(effects, present, effect.where) if effect.places == "joint" else ()
    return [pair for pair in pairs if pair.parameters < own]


def _shared(
    effects: Sequence[Effect], present: Sequence[Effect], effect: Effect
) -> Sequence[Package]:
    """Simple effects beside every shape of an effect of a joint."""
    shapes = variants(effect, effects)
    if effect.places != "joint" or len(shapes) < 2:
        return ()
    simple = [e for e in simple_at(effects, present, effect.where) if e.name != effect.name]
    return [
        Package((shape, one), effect.where)
        for shape in shapes
        for one in simple
        if has_base(shape, said_by([*present, one]))
    ]


def _worth_it(
    simple: Hypothesis, refined: Hypothesis, effects: tuple[Effect, ...], criteria: Criteria
) -> bool:
    """Whether what refines effects, or others in their place, convinces against these."""
    more = len(refined.unknowns.columns) - len(simple.unknowns.columns)
    joints = acted_upon(refined.dataset, Package(effects, effects[0].where))
    left = refined.held_out.mse[joints] / simple.held_out.mse[joints]
    # What goes with time alone is large in few folds, so that these differ: half of it is no tie,
    # at the joint where it shows most.
    timed = any("time" in effect.depends_on for effect in effects)
    clear = left.min() <= 0.5 if timed else left.mean() <= 1.0 / SEVERAL
    tied = not clear and tie_probability(refined.loss(joints), simple.loss(joints)) > criteria.tie
    gains = gain_of(simple, refined) > PENALTY * max(more, 1)
    return bool(gains and left.mean() <= 1.0 - criteria.reduction and not tied)
