"""The loop of the search: rank, choose, refine, until nothing convinces any more."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from geodrake.diagnosis.evidence import Criteria
from geodrake.diagnosis.hypothesis import Hypothesis
from geodrake.diagnosis.refine import prune, reshape, simplify
from geodrake.diagnosis.search import PENALTY, Ranked, choose, gain_of, rank
from geodrake.effects.base import Effect

TIGHTER_PRIORS = (0.1, 1.0 / 3.0, 1.0)
"""Widths of the inertial prior, as shares of that assumed, from which the data may choose."""

Progress = Callable[[str, float], None]
"""Called with what is going on, in words, and the held-out nrms so far."""


@dataclass(frozen=True, eq=False)
class Trail:
    """Where a search went.

    Attributes:
        start: The first hypothesis: the model refitted within its prior.
        end: The last one.
        rivals: Effect name -> names that tied with it when it was chosen.
    """

    start: Hypothesis
    end: Hypothesis
    rivals: dict[str, tuple[str, ...]]


def search(
    start: Hypothesis,
    fixed: Sequence[Effect],
    criteria: Criteria,
    *,
    tune: bool = False,
    pause_at_delay: bool = False,
    max_steps: int = 20,
    progress: Progress | None = None,
) -> Trail:
    """Add what convinces most, step by step, with swaps and backward elimination after each.

    Args:
        start: The model refitted within its prior.
        fixed: Effects that stay.
        criteria: When an effect counts as found.
        tune: Whether the data may say that the inertial prior is better than assumed.
        pause_at_delay: Whether to return as soon as an effort delay was chosen.
        max_steps: Largest number of steps.
        progress: Told about each step.
    """
    hypothesis, rivals = tuned(start) if tune else start, dict[str, tuple[str, ...]]()
    for _ in range(max_steps):
        ranked = rank(hypothesis, criteria)
        better = None
        while ranked and better is None:
            chosen = choose([replace(r, tied=r.tied or r is ranked[0]) for r in ranked])
            better = _refined(hypothesis, chosen, fixed, criteria)
            if better is None:
                ranked = [r for r in ranked if r.hypothesis is not chosen.hypothesis]
        if better is None:
            break
        hypothesis = tuned(better) if tune else better
        tied = {name for r in ranked if r.tied for name in r.names}
        for name in chosen.names:
            rivals.setdefault(name, tuple(sorted(tied.difference(chosen.names))))
        if progress is not None:
            progress(" and ".join(chosen.names), hypothesis.nrms)
        if pause_at_delay and "effort_delay" in chosen.names:
            return Trail(start, hypothesis, rivals)
    return Trail(start, _settled(hypothesis, fixed, criteria, tune=tune), rivals)


def tuned(hypothesis: Hypothesis) -> Hypothesis:
    """The hypothesis with the inertial prior as tight as the held-out error likes best.

    Only tighter than assumed, or back to that: a looser prior is an effect of its own.
    """
    if hypothesis.looseness > 1.0:
        return hypothesis
    others = [hypothesis.loosened(to / hypothesis.looseness) for to in TIGHTER_PRIORS]
    best = max(others, key=lambda other: gain_of(hypothesis, other))
    return best if gain_of(hypothesis, best) > PENALTY else hypothesis


def _settled(
    hypothesis: Hypothesis, fixed: Sequence[Effect], criteria: Criteria, *, tune: bool
) -> Hypothesis:
    """The hypothesis once nothing is left to simplify, prune or tune."""
    for _ in range(3):
        before = hypothesis.unknowns.effects
        hypothesis = reshape(simplify(hypothesis, fixed, criteria), fixed)
        hypothesis = prune(hypothesis, fixed, criteria)
        hypothesis = tuned(hypothesis) if tune else hypothesis
        if set(hypothesis.unknowns.effects) == set(before):
            break
    return hypothesis


def _refined(
    hypothesis: Hypothesis, chosen: Ranked, fixed: Sequence[Effect], criteria: Criteria
) -> Hypothesis | None:
    """The chosen hypothesis, simplified and pruned as far as it stays better; None if it is not."""
    simple = simplify(chosen.hypothesis, fixed, criteria)
    for shaped in (reshape(simple, fixed), reshape(chosen.hypothesis, fixed)):
        after = prune(shaped, fixed, criteria)
        added = len(after.unknowns.columns) - len(hypothesis.unknowns.columns)
        if gain_of(hypothesis, after) > PENALTY * max(added, 1):
            return after
    return None
