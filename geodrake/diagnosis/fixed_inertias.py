"""Effects that the inertias take in: logs explained with every body as the model has it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geodrake.diagnosis.candidates import kinds
from geodrake.diagnosis.further_columns import is_within, with_columns, without_inner_payloads
from geodrake.diagnosis.judgement import judge
from geodrake.diagnosis.pruning import prune
from geodrake.diagnosis.steps import refit_evidence
from geodrake.diagnosis.stepwise_search import Trail, search
from geodrake.diagnosis.trials import quick_fit
from geodrake.effects import Effect, Role
from geodrake.effects.lookup import effect_of
from geodrake.identification.logs.case import Case, error_table
from geodrake.identification.logs.criteria import FIXED, SEVERAL, Criteria
from geodrake.identification.logs.evidence import false_alarm_probability
from geodrake.identification.logs.hypothesis import Hypothesis, settle

_INERTIAS = effect_of(Role.INERTIA).name
_MOST_KINDS = 2
_FEW = 3
"""At most so many parameters more may stand for moved inertias: fewer than a body has.

Effects of one kind may have more, if all bodies stay then.
"""
_ITERATIONS = 6
_REST = 0.01
"""Effects may leave this share of what moved bodies explain."""
_WIDTHS = (FIXED, 10.0 * FIXED, 100.0 * FIXED)


@dataclass(frozen=True, eq=False)
class FixedInertias:
    """What explains the logs with the inertias fixed, or less moved.

    Attributes:
        case: The case that the searches are on.
        trails: The search that explains the logs as well as moved inertias do, if there is one.
        rivals: Names of effects that moved inertias cannot be distinguished from.
    """

    case: Case
    trails: tuple[Trail, ...] = ()
    rivals: tuple[str, ...] = ()


def with_fixed_inertias(
    case: Case, trail: Trail, fixed: Sequence[Effect], criteria: Criteria
) -> FixedInertias:
    """Explanations in which no body moves, or moves less, where moved inertias explain the logs.

    A prior that is weak lets a payload, a rotor or a compensator pass into the inertias, and then
    nothing is left to find. Effects that explain the logs as well while every body stays as the
    model has it are the simpler answer, from which moved inertias cannot be distinguished. Where
    bodies must move, an effect is the better answer still if it spares them a way that is
    improbable by the prior.

    Args:
        case: The case.
        trail: A search that has come to its end.
        fixed: Effects that stay.
        criteria: When an effect counts as found.
    """
    end, start = trail.end, trail.start
    found = _added(end, start.unknowns.effects)
    explained = error_table(case.dataset, end.held_out).is_noise
    moved = explained if found else refit_evidence(case, end, criteria) is not None
    if not moved or end.released or len(found) > _MOST_KINDS:
        return FixedInertias(case)
    if not found:
        case, trail = _with_hidden_effects(case, trail)
        end, start = trail.end, trail.start
    other = _unmoved(without_inner_payloads(case, trail)[1], fixed, criteria)
    if other is not None:
        gone = found - _added(other.end, fixed)
        rivals = gone.union({_INERTIAS}, *(trail.rivals.get(name, ()) for name in gone))
        stays = {name: trail.rivals.get(name, ()) for name in found - gone}
        other = replace(other, fits=(*other.fits, *trail.fits))
        return _answer(case, [other], fixed, rivals, found=stays)
    if found:
        return FixedInertias(case)
    end = _widened(end, min(end.looseness, 1.0))  # a looser prior makes no way improbable
    sparing = [Trail(start, after) for after in _sparing(end, criteria)]
    answer = _answer(case, sparing, fixed, {_INERTIAS})
    # The way that inertias go is judged by an assumed width: held-out data must say the same.
    better = sparing and _convinces(end, sparing[0].end, criteria)
    return answer if better else replace(answer, trails=())


def _with_hidden_effects(case: Case, trail: Trail) -> tuple[Case, Trail]:
    """The case with columns for what inertias easily take in, such as soft joints, everywhere."""
    kinds = [
        kind for kind in case.effect_classes if kind.hidden_share == 0.0 and kind.places == "joint"
    ]
    hidden = [e for kind in kinds for joint in case.model.single_joints for e in kind.shaped(joint)]
    new = [effect for effect in hidden if effect not in case.dataset.effects]
    return with_columns(case, trail, [*case.dataset.effects, *new]) if new else (case, trail)


def _unmoved(trail: Trail, fixed: Sequence[Effect], criteria: Criteria) -> Trail | None:
    """A search with the inertias fixed, if they would have to move and it explains as much.

    It starts anew, and if that fails from what was found; after a delay only from there, as efforts
    were advanced by it.

    Args:
        trail: The search where they may move.
        fixed: Effects that stay.
        criteria: When an effect counts as found.
    """
    end, start = trail.end, trail.start
    found = _added(end, start.unknowns.effects)
    moved, most = _widened(end, end.looseness), 1.0 + criteria.reduction
    every = np.ones(len(end.delay), bool)
    unmoved = judge(moved, _widened(end, FIXED), joints=every).left
    # Beside effects, bodies that move a little are only not quite those of the model.
    if unmoved <= (SEVERAL if found else 1.0) * most:
        return None
    rest = _REST * (unmoved - most)

    def explains(hypothesis: Hypothesis) -> bool:
        widened = (_widened(hypothesis, width) for width in _WIDTHS)
        near = judge(moved, hypothesis, joints=every).left <= most + rest
        return near and any(judge(moved, each, joints=every).left <= most for each in widened)

    begins = [end] if end.delay != start.delay else [start, end] if found else [start]
    for begin in begins:
        unmoving = begin.loosened(FIXED / begin.looseness)
        other = search(Trail(unmoving, unmoving), fixed, criteria, max_steps=len(found) + 1)
        if explains(other.end) and _is_little(other.end, end, found, fixed):
            less = _less(other.end, fixed, criteria, explains)
            return replace(other, start=start.loosened(FIXED / start.looseness), end=less)
    return None


def _less(
    end: Hypothesis,
    fixed: Sequence[Effect],
    criteria: Criteria,
    explains: Callable[[Hypothesis], bool],
) -> Hypothesis:
    """The hypothesis without what only bodies that are not quite those of the model need.

    Args:
        end: What was found with every body as the model has it.
        fixed: Effects that stay.
        criteria: When an effect counts as found.
        explains: Whether a hypothesis explains the logs as well as moved inertias do.
    """
    pruned = prune(_widened(end, _WIDTHS[-1]), fixed, criteria)
    for effect in end.unknowns.effects:
        if effect not in pruned.unknowns.effects:
            less = settle(end.without([effect]), iterations=_ITERATIONS)
            end = less if explains(less) else end
    return end


def _is_little(
    other: Hypothesis, end: Hypothesis, found: Collection[str], fixed: Sequence[Effect]
) -> bool:
    """Whether a hypothesis has little more than another, beside its inertias: see `_FEW`.

    Args:
        other: The hypothesis with the inertias fixed.
        end: The one where they moved.
        found: Names of what was added to that one.
        fixed: Effects that stay.
    """
    more = len(other.unknowns.columns) - len(end.unknowns.columns)
    if more <= _FEW:
        return True
    new = _added(other, fixed).difference(found)
    own = sum(len(e.parameters) for e in other.unknowns.effects if e.name in new)
    one_more = len(new) == 1 and _added(other, fixed).issuperset(found)
    return one_more and more - own <= _FEW


def _added(hypothesis: Hypothesis, fixed: Sequence[Effect]) -> set[str]:
    """Names of the effects that were added."""
    return {effect.name for effect in hypothesis.unknowns.effects if effect not in fixed}


def _answer(
    case: Case,
    trails: Sequence[Trail],
    fixed: Sequence[Effect],
    rivals: Collection[str],
    found: Mapping[str, tuple[str, ...]] | None = None,
) -> FixedInertias:
    """The best of some trails, unless it says rather that a body is wrong; all their names.

    Args:
        case: The case.
        trails: Trails, best first.
        fixed: Effects that stay.
        rivals: What those effects cannot be distinguished from that are new.
        found: Rivals of those that are not.
    """
    added = [[e for e in t.end.unknowns.effects if e not in fixed] for t in trails]
    names = tuple(sorted({effect.name for effects in added for effect in effects}))
    if not trails or any(is_within(case, effect) for effect in added[0]):
        return FixedInertias(case, (), names)
    best, effects, found = trails[0], tuple(added[0]), found or {}
    new = {
        e.name: {*rivals, *names, *best.rivals.get(e.name, ())}
        for e in effects
        if e.name not in found
    }
    also = {name: tuple(sorted(more - {name})) for name, more in new.items()} | dict(found)
    return FixedInertias(
        case, (replace(best, rivals={**best.rivals, **also}, kept=effects),), names
    )


def _convinces(before: Hypothesis, after: Hypothesis, criteria: Criteria) -> bool:
    """Whether held-out errors alone speak for what was added."""
    return judge(before, after, tried=len(after.dataset.effects)).alarm <= criteria.alarm


def _widened(hypothesis: Hypothesis, looseness: float) -> Hypothesis:
    """The hypothesis with the inertial prior so wide, as a share of that assumed, settled."""
    return settle(hypothesis.loosened(looseness / hypothesis.looseness), iterations=_ITERATIONS)


def _sparing(hypothesis: Hypothesis, criteria: Criteria) -> list[Hypothesis]:
    """The hypothesis with one effect that spares the inertias an improbable way, best first."""
    offered = kinds(hypothesis.dataset.effects, hypothesis.unknowns.effects)
    packages = [p for kind in offered for place in kind.options.values() for p in place]
    way, found = hypothesis.squared_distance(), list[tuple[float, Hypothesis]]()
    every = np.ones(len(hypothesis.delay), bool)
    for package in packages:
        quick = way - hypothesis.squared_distance(quick_fit(hypothesis, package).x.mean(0))
        if false_alarm_probability(quick, package.parameters, len(packages)) <= criteria.alarm:
            after = hypothesis.with_effects(package.effects)
            judged = judge(hypothesis, after, joints=every, tried=len(packages))
            spared = replace(judged, gain=judged.gain + way - after.squared_distance())
            if spared.alarm <= criteria.alarm and judged.left <= 1.0 + criteria.reduction:
                found.append((spared.score, after))
    return [after for _, after in sorted(found, key=lambda scored: -scored[0])]
