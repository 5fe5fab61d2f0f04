"""After a step forward: drop what is no longer needed, choose shapes anew."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from geodrake.diagnosis.candidates import Package
from geodrake.diagnosis.judgement import (
    Judgement,
    acted_upon,
    gain_of,
    judge,
    judge_errors,
    parameters_of,
)
from geodrake.diagnosis.refusals import Refusals
from geodrake.diagnosis.shapes import variants
from geodrake.diagnosis.trials import (
    asked_of,
    is_nothing,
    judge_package,
    try_package,
    try_packages,
)
from geodrake.effects.base import Effect
from geodrake.identification.logs.criteria import PENALTY, SEVERAL, Criteria
from geodrake.identification.logs.evidence import chi2_tail
from geodrake.identification.logs.hypothesis import Hypothesis

_FITTED = 2  # shapes of an effect, the best by quick trials
_NEARLY_ALL = 0.8  # of the folds


def prune(
    hypothesis: Hypothesis,
    fixed: Sequence[Effect],
    criteria: Criteria,
    *,
    refusals: Refusals | None = None,
) -> Hypothesis:
    """Drop effects, weakest first, that would no longer convince if they were offered now.

    Then bodies go back within the assumed prior if leaving it is not worth it any more.

    Args:
        hypothesis: The hypothesis.
        fixed: Effects that stay (those of the model as it came).
        criteria: When an effect counts.
        refusals: What was refused before in this search; what is now is added. None to ask anew.
    """
    refusals = Refusals() if refusals is None else refusals
    needed, least = set(fixed), criteria.reduction
    while True:
        offered = [e for e in hypothesis.unknowns.effects if e not in needed]
        offered = [e for e in offered if not refusals.has(hypothesis, (e,), "drop", least=least)]
        offered = [e for e in offered if not _is_base(hypothesis, e)]
        trials = [(effect, _quick_trial(hypothesis, effect)) for effect in offered]
        for effect, quick in sorted(trials, key=lambda tried: tried[1].score if tried[1] else 0.0):
            reduced = _without_needless(hypothesis, effect, quick, criteria)
            if reduced is not None:
                hypothesis = reduced
                break
            needed.add(effect)  # without another one, it is all the more
            refusals.keep(hypothesis, (effect,), "drop")
        else:
            return _with_bodies_held(hypothesis)


def _with_bodies_held(hypothesis: Hypothesis) -> Hypothesis:
    """The hypothesis with bodies back within the assumed prior, unless leaving it is worth it."""
    if hypothesis.looseness <= 1.0:
        return hypothesis
    held = hypothesis.loosened(1.0 / hypothesis.looseness)
    freed = judge(held, hypothesis, parameters=2 * len(hypothesis.dataset.bodies))
    return hypothesis if freed.score > 0.0 else held


def _without_needless(
    hypothesis: Hypothesis, effect: Effect, quick: Judgement | None, criteria: Criteria
) -> Hypothesis | None:
    """The hypothesis without an effect; None if it is needed."""
    own = hypothesis.held_out.x[:, hypothesis.unknowns.span(effect)]
    stands = not is_nothing(hypothesis.dataset, [effect], own) and stands_out(hypothesis, effect)
    if stands and quick is not None and _by_far(quick, criteria):
        return None
    reduced = hypothesis.without([effect])
    package = Package((effect,), effect.where)
    asked = asked_of([effect.name], reduced, criteria)
    needed = stands and (
        try_package(reduced, package, 1).judgement.convinces(asked)
        or judge_package(reduced, hypothesis, package).convinces(asked)
    )
    return None if needed else reduced


def _quick_trial(hypothesis: Hypothesis, effect: Effect) -> Judgement | None:
    """The evidence for an effect with the weights as they are; None where bounds are in the way."""
    cv, span = hypothesis.cv, hypothesis.unknowns.span(effect)
    without = cv.without_columns(np.arange(span.start, span.stop))
    if without is None:
        return None
    return judge_errors(
        (without, cv.held_out),
        hypothesis.effective,
        joints=acted_upon(hypothesis.dataset, [effect]),
        parameters=parameters_of([effect]),
    )


def _by_far(found: Judgement, criteria: Criteria) -> bool:
    """Whether an effect passes all criteria by far."""
    return (
        found.reduction > SEVERAL * criteria.reduction
        and found.agreement >= max(criteria.agreement, _NEARLY_ALL)
        and found.gain > SEVERAL**2 * PENALTY * found.parameters
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
    hypothesis: Hypothesis,
    fixed: Sequence[Effect],
    *,
    refusals: Refusals | None = None,
    least: float = PENALTY,
) -> Hypothesis:
    """Choose shape parameters anew: what fitted best before other effects came may not now.

    Args:
        hypothesis: The hypothesis.
        fixed: Effects that stay.
        refusals: What was refused before in this search; what is now is added. None to ask anew.
        least: Gain from which on another shape is taken.
    """
    refusals = Refusals() if refusals is None else refusals
    for effect in hypothesis.unknowns.effects:
        shapes = [e for e in variants(effect, hypothesis.dataset.effects) if e != effect]
        if effect in fixed or not shapes or refusals.has(hypothesis, (effect,), "shape"):
            continue
        if len(shapes) > _FITTED:
            packages = [Package((shape,), shape.where) for shape in shapes]
            trials = try_packages(hypothesis.stripped(effect), packages, 1, rivals=True)
            trials.sort(key=lambda trial: -trial.judgement.reduction)
            shapes = [trial.package.effects[0] for trial in trials[:_FITTED]]
        others = [hypothesis.exchanged([effect], [shape]) for shape in shapes]
        best = max(others, key=lambda other: gain_of(hypothesis, other))
        if gain_of(hypothesis, best) > least:
            hypothesis = best
        else:
            refusals.keep(hypothesis, (effect,), "shape")
    return hypothesis
