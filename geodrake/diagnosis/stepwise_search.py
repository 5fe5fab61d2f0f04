"""The loop of the search: rank, choose, refine, until nothing convinces any more."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from geodrake.diagnosis.exchange import exchange
from geodrake.diagnosis.judgement import gain_of, judge
from geodrake.diagnosis.pairs import rank_pairs
from geodrake.diagnosis.pruning import prune, reshape
from geodrake.diagnosis.ranked import Ranked
from geodrake.diagnosis.refusals import Refusals
from geodrake.diagnosis.results import FittedRival
from geodrake.diagnosis.search import choose, rank
from geodrake.diagnosis.trials import open_joints
from geodrake.effects.base import Effect
from geodrake.identification.logs.criteria import RESTART_MARGIN, TIGHTER_PRIORS, Criteria
from geodrake.identification.logs.hypothesis import Hypothesis


@dataclass(frozen=True, eq=False)
class Trail:
    """Where a search went.

    Attributes:
        start: The first hypothesis: the model refitted within its prior.
        end: The last one.
        rivals: Effect name -> names that tied with it when it was chosen.
        kept: Effects that stay though inertias could take them in.
        fits: The rivals that were fitted, with their errors.
        refusals: What was tried and refused; shared by all trails that go on from this one.
        is_stopped: Whether the search was stopped before its end.
    """

    start: Hypothesis
    end: Hypothesis
    rivals: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    kept: tuple[Effect, ...] = ()
    fits: tuple[FittedRival, ...] = ()
    refusals: Refusals = field(default_factory=Refusals)
    is_stopped: bool = False

    def asking_anew(self) -> Trail:
        """This trail with nothing refused, for other columns of its effects, or folds."""
        return replace(self, refusals=Refusals())


def search(
    trail: Trail,
    fixed: Sequence[Effect],
    criteria: Criteria,
    *,
    tune: bool = False,
    pause: Callable[[Hypothesis], bool] | None = None,
    max_steps: int = 20,
    watch: Callable[[Ranked, Trail], None] | None = None,
) -> Trail:
    """Add what convinces most, step by step, with swaps and backward elimination after each.

    Args:
        trail: Where to go on; its start is the model refitted within its prior.
        fixed: Effects that stay.
        criteria: When an effect counts as found.
        tune: Whether the data may say that the inertial prior is better than assumed.
        pause: Whether to return with a hypothesis that a step led to, as it is.
        max_steps: Largest number of steps.
        watch: Called with what each step added, and the trail so far.
    """
    hypothesis = tuned(trail.end) if tune else trail.end
    rivals, fits = dict(trail.rivals), [*trail.fits]

    def so_far(end: Hypothesis) -> Trail:
        return replace(trail, end=end, rivals=rivals, fits=tuple(fits))

    for _ in range(max_steps):
        step = next_step(hypothesis, fixed, criteria, trail.refusals)
        if step is None:
            break
        names = step.chosen.reported
        tied = {name for r in step.others for name in r.reported}
        for name in names:
            rivals.setdefault(name, tuple(sorted(tied.difference(names))))
        rivals |= rivals_of_swapped(rivals, hypothesis, step.after, names)
        fits += fitted_rivals(hypothesis, step)
        hypothesis = tuned(step.after) if tune else step.after
        if watch is not None:
            watch(step.chosen, so_far(hypothesis))
        if pause is not None and pause(hypothesis):
            return so_far(hypothesis)
    end = simplified(hypothesis, fixed, criteria, trail.refusals, tune=tune)
    rivals |= rivals_of_swapped(rivals, hypothesis, end)
    fits += _swapped(hypothesis, end)
    return so_far(end)


def rivals_of_swapped(
    rivals: Mapping[str, tuple[str, ...]],
    before: Hypothesis,
    after: Hypothesis,
    chosen: Sequence[str] = (),
) -> dict[str, tuple[str, ...]]:
    """Rivals of effects that took the place of others, from which the data cannot distinguish them.

    Args:
        rivals: Those known so far.
        before: The hypothesis before.
        after: The hypothesis after swaps for simpler effects.
        chosen: Names of effects that were added first, and may have been swapped since.
    """
    had, has = before.unknowns.effects, after.unknowns.effects
    kept = {effect.name for effect in has}
    lost = {e.name for e in had if e not in has}.union(chosen).difference(kept)
    if not lost:
        return {}
    heirs = {name for one in lost for name in rivals.get(one, ())} | lost
    came = {effect.name for effect in has if effect not in had}.difference(chosen)
    return {
        name: tuple(sorted(heirs.union(rivals.get(name, ())).difference({name}))) for name in came
    }


def fitted_rivals(before: Hypothesis, step: Forward) -> list[FittedRival]:
    """The rivals of a step with their errors, best first.

    Args:
        before: The hypothesis before.
        step: What was tried and taken.
    """
    came, _ = _exchanged(before, step.after)
    added = tuple(came) or step.chosen.reported
    others = step.others
    if not set(step.chosen.reported) >= set(added):  # it was swapped for what is simpler
        others.append(step.chosen)
    fits = [_fit(r.reported, r.where, added, r.hypothesis, step.after) for r in others]
    return sorted(fits, key=lambda rival: rival.error)


def _swapped(before: Hypothesis, after: Hypothesis) -> list[FittedRival]:
    """What others took the place of, as their rival."""
    came, lost = _exchanged(before, after)
    if not came or not lost:
        return []
    places = dict.fromkeys(place for effects in lost.values() for e in effects for place in e.where)
    return [_fit(tuple(lost), tuple(places), tuple(came), before, after)]


def _exchanged(
    before: Hypothesis, after: Hypothesis
) -> tuple[dict[str, list[Effect]], dict[str, list[Effect]]]:
    """Effects by name that came, and those of which none is left."""
    had, has = before.unknowns.effects, after.unknowns.effects
    kept, came, lost = {e.name for e in has}, dict[str, list[Effect]](), dict[str, list[Effect]]()
    for effect in has:
        if effect not in had:
            came.setdefault(effect.name, []).append(effect)
    for effect in had:
        if effect.name not in kept:
            lost.setdefault(effect.name, []).append(effect)
    return came, lost


def _fit(
    names: tuple[str, ...],
    where: tuple[str, ...],
    added: tuple[str, ...],
    other: Hypothesis,
    taken: Hypothesis,
) -> FittedRival:
    """A rival by its hypothesis and that which was taken."""
    chance = judge(other, taken).chance_of_other
    return FittedRival(" + ".join(names), where, added, other.nrms, taken.nrms, chance)


@dataclass(frozen=True, eq=False)
class Forward:
    """One step forward.

    Attributes:
        ranked: What convinced, best first.
        chosen: The one of these that was taken.
        after: The hypothesis with it, simplified and pruned.
    """

    ranked: tuple[Ranked, ...]
    chosen: Ranked
    after: Hypothesis

    @property
    def others(self) -> list[Ranked]:
        """Those that could have been taken instead."""
        tied = [r for r in self.ranked if r.tied and r is not self.chosen]
        return [r for r in tied if not r.is_same(self.chosen) and not r.includes(self.chosen)]


def next_step(
    hypothesis: Hypothesis,
    fixed: Sequence[Effect],
    criteria: Criteria,
    refusals: Refusals | None = None,
) -> Forward | None:
    """The step that convinces most, simplified and pruned; None if nothing convinces.

    Args:
        hypothesis: Where to start from.
        fixed: Effects that stay.
        criteria: When an effect counts as found.
        refusals: What was refused before in this search; what is now is added. None to ask anew.
    """
    refusals = Refusals() if refusals is None else refusals
    for ranking in (rank, rank_pairs):
        ranked = ranking(hypothesis, criteria)
        while ranked:
            if not any(r.tied for r in ranked):
                ranked[0] = replace(ranked[0], tied=True)
            chosen = choose(ranked)
            after = _refined(hypothesis, chosen, fixed, criteria, refusals)
            if after is not None:
                return Forward(tuple(ranked), chosen, after)
            ranked = [r for r in ranked if r.hypothesis is not chosen.hypothesis]
    return _anew(hypothesis, fixed, criteria, refusals)


def _anew(
    hypothesis: Hypothesis, fixed: Sequence[Effect], criteria: Criteria, refusals: Refusals
) -> Forward | None:
    """A pair of effects in the place of all that was found at a joint, where that is too little.

    Effects that came first may be compromises, which no effect more can mend.
    """
    for joint in open_joints(hypothesis, RESTART_MARGIN):
        present = hypothesis.unknowns.effects
        here = [e for e in present if e.where == (joint,) and e.places == "joint"]
        gone = [e for e in here if e not in fixed]
        if gone:
            bare = hypothesis.without(gone)
            ranked = rank_pairs(bare, criteria, joints=[joint])
            chosen = choose(ranked) if ranked else None
            if chosen is None or gain_of(hypothesis, chosen.hypothesis) <= 0.0:
                continue
            after = _refined(bare, chosen, fixed, criteria, refusals)
            if after and judge(hypothesis, after).is_better:
                return Forward(tuple(ranked), chosen, after)
    return None


def tuned(hypothesis: Hypothesis) -> Hypothesis:
    """The hypothesis with the inertial prior as tight as the held-out error likes best.

    Only tighter than assumed, or back to that: a looser prior is an effect of its own.
    """
    if hypothesis.looseness > 1.0:
        return hypothesis
    others = hypothesis.with_widths(TIGHTER_PRIORS)
    best = max(others, key=lambda other: gain_of(hypothesis, other), default=hypothesis)
    return best if judge(hypothesis, best).is_better else hypothesis


def simplified(
    hypothesis: Hypothesis,
    fixed: Sequence[Effect],
    criteria: Criteria,
    refusals: Refusals | None = None,
    *,
    tune: bool = False,
) -> Hypothesis:
    """The hypothesis once nothing is left to simplify, prune or tune.

    Args:
        hypothesis: The hypothesis.
        fixed: Effects that stay.
        criteria: When an effect counts as found.
        refusals: What was refused before in this search; what is now is added. None to ask anew.
        tune: Whether the data may say that the inertial prior is better than assumed.
    """
    refusals = Refusals() if refusals is None else refusals
    for _ in range(3):
        before = hypothesis.unknowns.effects
        hypothesis = exchange(hypothesis, fixed, criteria, refusals=refusals)
        hypothesis = reshape(hypothesis, fixed, refusals=refusals)
        hypothesis = prune(hypothesis, fixed, criteria, refusals=refusals)
        hypothesis = tuned(hypothesis) if tune else hypothesis
        if set(hypothesis.unknowns.effects) == set(before):
            break
    return hypothesis


def _refined(
    hypothesis: Hypothesis,
    chosen: Ranked,
    fixed: Sequence[Effect],
    criteria: Criteria,
    refusals: Refusals,
) -> Hypothesis | None:
    """The chosen hypothesis, simplified and pruned as far as it stays better; None if it is not."""
    simple = exchange(
        chosen.hypothesis, fixed, criteria, refusals=refusals, at=chosen.where or None
    )
    for found in dict.fromkeys((simple, chosen.hypothesis)):
        after = prune(reshape(found, fixed, refusals=refusals), fixed, criteria, refusals=refusals)
        if judge(hypothesis, after).is_better:
            return after
    return None
