"""What was tried in the place of effects and refused, so that nobody asks twice."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.judgement import acted_upon
from geodrake.effects.base import Effect
from geodrake.identification.logs.criteria import Criteria
from geodrake.identification.logs.hypothesis import Hypothesis

Effects = tuple[Effect, ...]
Question = Literal["exchange", "split", "shape", "drop"]


class Refusals:
    """Effects that stayed when others were tried: asked again only where something changed.

    That is another effect that acts on one of their joints, another one on offer at their place,
    another delay or prior, or errors of their joints that differ by as much as an effect must
    remove. Other columns of the same effects, or other folds, need a memory of their own.
    """

    def __init__(self) -> None:
        self._errors: dict[Hashable, NDArray[np.float64]] = {}

    def has(
        self,
        hypothesis: Hypothesis,
        effects: Effects,
        question: Question,
        *,
        least: float = Criteria.reduction,
    ) -> bool:
        """Whether effects stayed in a hypothesis that was the same to them.

        Args:
            hypothesis: The hypothesis.
            effects: Some of its effects, of one place.
            question: What was tried.
            least: From which change of the squared error at a joint on it counts as another one.
        """
        before = self._errors.get(_seen_by(hypothesis, effects, question))
        if before is None:
            return False
        change = np.abs(_errors_of(hypothesis, effects) / before - 1.0)
        return bool(change.max(initial=0.0) < least)

    def keep(self, hypothesis: Hypothesis, effects: Effects, question: Question) -> None:
        """Note that effects of a hypothesis stayed.

        Args:
            hypothesis: The hypothesis.
            effects: Some of its effects, of one place.
            question: What was tried.
        """
        self._errors[_seen_by(hypothesis, effects, question)] = _errors_of(hypothesis, effects)


def _seen_by(hypothesis: Hypothesis, effects: Effects, question: Question) -> Hashable:
    """All that decides an answer but the errors."""
    dataset, present = hypothesis.dataset, hypothesis.unknowns.effects
    joints, where = _joints(hypothesis, effects), effects[0].where
    beside = frozenset(e for e in present if np.any(joints & _joints(hypothesis, (e,))))
    offered = tuple(dataset.effects_at.get(place) for place in where)
    return question, effects, beside, offered, hypothesis.delay, hypothesis.looseness


def _errors_of(hypothesis: Hypothesis, effects: Effects) -> NDArray[np.float64]:
    """Mean squared held-out errors at the joints that effects act upon, (N·m)² or N²."""
    return hypothesis.held_out.mse[_joints(hypothesis, effects)]


def _joints(hypothesis: Hypothesis, effects: Effects) -> NDArray[np.bool_]:
    """(nv,) joints that effects act upon."""
    return acted_upon(hypothesis.dataset, effects)
