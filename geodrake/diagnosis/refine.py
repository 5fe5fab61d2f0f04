"""After a step forward: swap what is needlessly complex, drop what is no longer needed."""

from __future__ import annotations

from collections.abc import Sequence

from geodrake.diagnosis.candidates import Package, kind_complexity, kinds
from geodrake.diagnosis.evidence import Criteria, tie_probability
from geodrake.diagnosis.hypothesis import Hypothesis
from geodrake.diagnosis.search import try_package
from geodrake.effects.base import Effect


def prune(hypothesis: Hypothesis, fixed: Sequence[Effect], criteria: Criteria) -> Hypothesis:
    """Drop effects, weakest first, that would no longer convince if they were offered now.

    Args:
        hypothesis: The hypothesis.
        fixed: Effects that stay (those of the model as it came).
        criteria: When an effect counts.
    """
    while True:
        weakest: tuple[float, Hypothesis] | None = None
        for effect in hypothesis.unknowns.effects:
            if effect not in fixed:
                reduced = hypothesis.without([effect])
                trial = try_package(reduced, Package((effect,), effect.where), 1)
                if not trial.convinces(criteria) and (weakest is None or trial.score < weakest[0]):
                    weakest = (trial.score, reduced)
        if weakest is None:
            return hypothesis
        hypothesis = weakest[1]


def simplify(hypothesis: Hypothesis, fixed: Sequence[Effect], criteria: Criteria) -> Hypothesis:
    """Swap complex effects for simpler ones at the same place where the data cannot tell."""
    for effect in hypothesis.unknowns.effects:
        if effect in fixed or effect not in hypothesis.unknowns.effects:
            continue
        reduced = hypothesis.without([effect])
        simpler = [
            package
            for kind in kinds(hypothesis.dataset.effects, reduced.unknowns.effects)
            if kind.complexity < kind_complexity((effect.name,)) and effect.where in kind.options
            for package in kind.options[effect.where]
        ]
        trials = [try_package(reduced, package, len(simpler)) for package in simpler]
        for trial in sorted(trials, key=lambda t: -t.score)[:1]:
            swapped = reduced.with_effects(trial.package.effects)
            if tie_probability(hypothesis.loss(), swapped.loss()) > criteria.tie:
                hypothesis = swapped
    return hypothesis
