"""Exchanges: other effects in the place of one, or of two of a joint.

What suited a residual best before another effect was known may have been the wrong one, or a
compromise. Of two answers at a place the simpler one is taken, unless the other convinces
against it. A payload moves to the end of the robot where logs do not tell from where it hangs.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from itertools import combinations

import numpy as np

from geodrake.diagnosis.candidates import (
    Package,
    has_base,
    kinds_at,
    pairs_at,
    said_by,
    simple_at,
)
from geodrake.diagnosis.judgement import judge
from geodrake.diagnosis.refusals import Question, Refusals
from geodrake.diagnosis.shapes import variants
from geodrake.diagnosis.trials import Trial, try_packages
from geodrake.effects.base import Effect
from geodrake.identification.logs.criteria import PENALTY, SEVERAL, Criteria
from geodrake.identification.logs.dataset import is_payload
from geodrake.identification.logs.hypothesis import Hypothesis

_FITTED = 2  # the best by quick trials, beside that which reduces the error most

Effects = tuple[Effect, ...]


def exchange(
    hypothesis: Hypothesis,
    fixed: Sequence[Effect],
    criteria: Criteria,
    *,
    refusals: Refusals,
    at: Collection[str] | None = None,
    split: bool = False,
) -> Hypothesis:
    """Exchange effects for what does better at their place, or as well and is simpler.

    Args:
        hypothesis: The hypothesis.
        fixed: Effects that stay.
        criteria: What an effect must show.
        refusals: What was refused before in this search; what is now is added.
        at: Joints or bodies to look at; all by default.
        split: Whether a shape may be split into another one and a simple effect beside it. Only
            shapes that are no longer bound to a coarse grid differ clearly from such a compromise.
    """
    least = criteria.reduction
    for gone in _exchangeable(hypothesis.unknowns.effects, fixed):
        here = at is None or not set(at).isdisjoint(gone[0].where)
        shaped = split and len(gone) == 1 and len(variants(gone[0], hypothesis.dataset.effects)) > 1
        question: Question = "split" if shaped else "exchange"
        there = set(gone) <= set(hypothesis.unknowns.effects)
        if here and there and not refusals.has(hypothesis, gone, question, least=least):
            other = _exchanged(hypothesis, gone, criteria, split)
            if other.unknowns.effects == hypothesis.unknowns.effects:
                refusals.keep(hypothesis, gone, question)
            hypothesis = other
    return hypothesis


def _exchangeable(effects: Sequence[Effect], fixed: Sequence[Effect]) -> Iterator[Effects]:
    """Every effect that may go, then every two of a joint."""
    free = [effect for effect in effects if effect not in fixed]
    yield from ((effect,) for effect in free)
    for one, other in combinations(free, 2):
        if one.where == other.where and one.places == "joint":
            yield one, other


def _exchanged(
    hypothesis: Hypothesis, gone: Effects, criteria: Criteria, split: bool
) -> Hypothesis:
    """The hypothesis with something else in the place of effects, if that is the better answer."""
    own = Package(gone, gone[0].where)
    simpler = _keeping_bases(hypothesis, own, _simpler(hypothesis, own))
    others = _keeping_bases(hypothesis, own, _others(hypothesis, own, split))
    bare = hypothesis.stripped(*gone)
    packages = [own, *simpler, *others]
    as_it_is, *trials = try_packages(bare, packages, len(packages), rivals=True)
    better = [t for t in trials[len(simpler) :] if t.score > as_it_is.score + PENALTY]
    best = _best_of(hypothesis, gone, better)
    if best is not None and _convinces(hypothesis, best, criteria):
        return best
    as_good = [t for t in trials[: len(simpler)] if _may_be_as_good(t, as_it_is)]
    best = _best_of(hypothesis, gone, as_good)
    if best is not None and not _convinces(best, hypothesis, criteria):
        return best
    return _farther_out(hypothesis, gone[0], criteria) if len(gone) == 1 else hypothesis


def _keeping_bases(
    hypothesis: Hypothesis, own: Package, packages: Sequence[Package]
) -> list[Package]:
    """Packages that leave no effect without what it refines."""
    left = [e for e in hypothesis.unknowns.effects if e not in own.effects]
    had = said_by(hypothesis.unknowns.effects)
    based = [e for e in left if e.where == own.place and has_base(e, had)]
    return [
        package
        for package in packages
        if all(has_base(e, said_by([*left, *package.effects])) for e in based)
    ]


def _may_be_as_good(trial: Trial, as_it_is: Trial) -> bool:
    """Whether quick trials, which are rough, leave errors of the same size."""
    return trial.judgement.left <= SEVERAL * as_it_is.judgement.left


def _best_of(hypothesis: Hypothesis, gone: Effects, trials: Sequence[Trial]) -> Hypothesis | None:
    """The best hypothesis with what was tried in the place of effects, if anything was."""
    if not trials:
        return None
    near = sorted(trials, key=lambda trial: -trial.score)[:_FITTED]
    near.append(max(trials, key=lambda trial: trial.judgement.reduction))
    packages = dict.fromkeys(trial.package for trial in near)
    fitted = [hypothesis.exchanged(gone, package.effects) for package in packages]
    return max(fitted, key=lambda other: judge(hypothesis, other).score)


def _simpler(hypothesis: Hypothesis, own: Package) -> list[Package]:
    """Packages that are simpler: of less complexity, or one effect, of no more parameters, for two.

    Args:
        hypothesis: The hypothesis.
        own: What they would take the place of.
    """
    effects = hypothesis.dataset.effects
    left = [e for e in hypothesis.unknowns.effects if e not in own.effects]
    most = max(effect.complexity for effect in own.effects)
    two = len(own.effects) > 1
    return [
        package
        for kind in kinds_at(effects, left, own.place)
        if two or kind.complexity < most
        for package in kind.options[own.place]
        if not two or (len(package.effects) == 1 and package.parameters <= own.parameters)
        if not set(package.effects) <= set(own.effects)
    ]


def _farther_out(hypothesis: Hypothesis, effect: Effect, criteria: Criteria) -> Hypothesis:
    """With the same on the last body that ties: what a robot carries, it carries at its end."""
    if not is_payload(effect):
        return hypothesis
    dataset, present = hypothesis.dataset, hypothesis.unknowns.effects
    others = {e.where[0]: e for e in dataset.effects if is_payload(e) and e not in present}
    here = dataset.bodies.index(effect.where[0])
    farther = [others[body] for body in dataset.bodies[here + 1 :] if body in others]
    carried = [
        e for e in farther if np.all(dataset.felt(e) >= dataset.felt(effect))
    ]  # no other arm
    for other in reversed(carried):
        moved = hypothesis.exchanged([effect], [other])
        if judge(moved, hypothesis).is_tie(criteria):
            return moved
    return hypothesis


def _others(hypothesis: Hypothesis, own: Package, split: bool) -> list[Package]:
    """Packages in the place of one effect of a joint that are as simple as it is, or two for it."""
    (effect, *more), effects = own.effects, hypothesis.dataset.effects
    if more or effect.places != "joint":
        return []
    left = [e for e in hypothesis.unknowns.effects if e != effect]
    pairs = [
        pair for pair in pairs_at(effects, left, own.place) if pair.parameters < own.parameters
    ]
    as_simple = [
        package
        for kind in kinds_at(effects, left, own.place)
        if len(kind.classes) == 1 and kind.complexity == effect.complexity
        for package in kind.options[own.place]
        if package.effects != own.effects and package.effects[0].name != effect.name
    ]
    shared = _shared(hypothesis, effect) if split else []
    return [*pairs, *_based(hypothesis, effect), *shared, *as_simple]


def _based(hypothesis: Hypothesis, effect: Effect) -> list[Package]:
    """Every shape of an effect that came alone but need not, with what it refines otherwise."""
    if () not in effect.refines:
        return []
    effects, present = hypothesis.dataset.effects, hypothesis.unknowns.effects
    bases = {base for refined in effect.refines for base in refined}
    said = said_by(e for e in present if e != effect)
    here = [e for e in effects if e.where == effect.where and type(e) in bases]
    more = tuple(e for e in here if (e.name, e.where) not in said)
    shapes = variants(effect, effects)
    return [Package((*more, shape), effect.where) for shape in shapes] if more else []


def _shared(hypothesis: Hypothesis, effect: Effect) -> list[Package]:
    """Simple effects beside every shape of an effect: its shape may be a compromise with one."""
    effects = hypothesis.dataset.effects
    present = [e for e in hypothesis.unknowns.effects if e != effect]
    shapes = variants(effect, effects)
    if len(shapes) < 2:
        return []
    simple = [e for e in simple_at(effects, present, effect.where) if e.name != effect.name]
    return [
        Package((shape, one), effect.where)
        for shape in shapes
        for one in simple
        if has_base(shape, said_by([*present, one]))
    ]


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


def _convinces(simple: Hypothesis, refined: Hypothesis, criteria: Criteria) -> bool:
    """Whether a hypothesis with refined effects, or others, convinces against a simple one."""
    found = judge(simple, refined)
    much = found.reduction >= criteria.reduction
    return found.is_better and much and not found.is_tie(criteria)
