"""What stayed when others were tried in its place, so that nobody asks twice."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.candidates import Package
from geodrake.diagnosis.trials import acted_upon
from geodrake.effects.base import Effect
from geodrake.identification.logs.criteria import Criteria
from geodrake.identification.logs.hypothesis import Hypothesis

Effects = tuple[Effect, ...]


class Stayed:
    """Effects that stayed when others were tried: asked again only where something changed.

    That is another effect at their place, there or offered, another delay or prior, or errors of
    their joints that differ by more than an effect must remove.
    """

    def __init__(self) -> None:
        self._errors: dict[Hashable, NDArray[np.float64]] = {}

    def has(self, hypothesis: Hypothesis, effects: Effects, question: str) -> bool:
        """Whether effects stayed in a hypothesis that was the same to them.

        Args:
            hypothesis: The hypothesis.
            effects: Some of its effects, of one place.
            question: What was tried.
        """
        before = self._errors.get(_seen_by(hypothesis, effects, question))
        if before is None:
            return False
        change = np.abs(_errors_of(hypothesis, effects) / before - 1.0)
        return bool(change.max(initial=0.0) <= Criteria.reduction)

    def keep(self, hypothesis: Hypothesis, effects: Effects, question: str) -> None:
        """Note that effects of a hypothesis stayed.

        Args:
            hypothesis: The hypothesis.
            effects: Some of its effects, of one place.
            question: What was tried.
        """
        self._errors[_seen_by(hypothesis, effects, question)] = _errors_of(hypothesis, effects)


def _seen_by(hypothesis: Hypothesis, effects: Effects, question: str) -> Hashable:
    """All that decides an answer but the errors."""
    here = set(effects[0].where)
    all_effects = hypothesis.unknowns.effects, hypothesis.dataset.effects
    near = (frozenset(e for e in each if here & set(e.where)) for each in all_effects)
    return question, effects, *near, hypothesis.delay, hypothesis.looseness


def _errors_of(hypothesis: Hypothesis, effects: Effects) -> NDArray[np.float64]:
    """Mean squared held-out errors at the joints that effects act upon, (N·m)² or N²."""
    package = Package(effects, effects[0].where)
    return hypothesis.held_out.mse[acted_upon(hypothesis.dataset, package)]
