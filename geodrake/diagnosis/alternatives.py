"""What else a finding could be: its rivals in its place, beside everything else that was found.

A rival tied with an effect when that was chosen, often before others were known. So it is asked
again at the end, and how probable either is follows from the held-out errors of the same blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geodrake.diagnosis.candidates import Kind, Package, kinds
from geodrake.diagnosis.judgement import gain_of, judge
from geodrake.diagnosis.results import FittedRival
from geodrake.diagnosis.trials import try_packages
from geodrake.effects.lookup import effect_of
from geodrake.effects.role import Role
from geodrake.identification.logs.criteria import LOOSER_PRIORS, RARER
from geodrake.identification.logs.hypothesis import Hypothesis

_LEAST = 1e-6
"""A comparison of some blocks makes nothing more certain than this."""


def weighed(
    start: Hypothesis, end: Hypothesis, bare: Hypothesis | None, rivals: Sequence[FittedRival]
) -> tuple[FittedRival, ...]:
    """Rivals of a finding as they are beside everything else that was found, best first.

    Args:
        start: Where the search began.
        end: What was found.
        bare: The same without the finding; None if it cannot be taken out.
        rivals: Its rivals, as they were when it was chosen.

    Returns:
        The rivals with the errors that they leave at the end; as they were where they cannot be
        put in its place.
    """
    found = []
    for rival in rivals:
        other = None if bare is None else instead(bare, rival.names, rival.where)
        if other is None:
            found.append(replace(rival, odds=_odds(rival.tie_probability, 0)))
        else:
            chance = judge(other, end).chance_of_other
            more = _complexity(other, start) - _complexity(end, start)
            seen = replace(rival, error=other.nrms, error_of_choice=end.nrms)
            found.append(replace(seen, tie_probability=chance, odds=_odds(chance, more)))
    return tuple(sorted(found, key=lambda rival: rival.error))


def instead(bare: Hypothesis, names: Sequence[str], where: Sequence[str]) -> Hypothesis | None:
    """A hypothesis with effects of some names at some places.

    Args:
        bare: The hypothesis without what they take the place of.
        names: Names of the effects.
        where: Their joints or bodies; all joints for a delay without any.

    Returns:
        None where they cannot be added, or are there already.
    """
    present = {(e.name, place) for e in bare.unknowns.effects for place in e.where}
    names = tuple(n for n in names if not where or not {(n, p) for p in where} <= present)
    if names == (effect_of(Role.INERTIA).name,):
        return _looser(bare)
    if names == (effect_of(Role.DELAY).name,):
        return _later(bare, where)
    offered = kinds(bare.dataset.effects, bare.unknowns.effects)
    same = next((kind for kind in offered if set(kind.names) == set(names)), None)
    if same is not None:
        packages = _placed(bare, same, where)
        return bare.with_effects([e for p in packages for e in p.effects]) if packages else None
    if len(names) < 2:
        return None
    first = instead(bare, names[:1], where)
    return None if first is None else instead(first, names[1:], where)


def _looser(bare: Hypothesis) -> Hypothesis | None:
    """With the width of the inertial prior that is best, if that is wider."""
    widths = [1.0] if bare.has_fixed_bodies else []
    widths += LOOSER_PRIORS if bare.looseness <= 1.0 else []
    others = [bare.loosened(width / bare.looseness) for width in widths]
    return max(others, key=lambda other: gain_of(bare, other), default=None)


def _later(bare: Hypothesis, where: Sequence[str]) -> Hypothesis | None:
    """With the delay of some joints that is best, if others were tried."""
    joints = bare.dataset.joints
    late = [at for at, joint in enumerate(joints) if joint in where or not where]
    tried = [
        [delay if at in late else own for at, own in enumerate(bare.delay)]
        for delay in range(len(bare.dataset.delays))
    ]
    others = [delays for delays in tried if tuple(delays) != bare.delay]
    return bare.delayed(others[int(np.argmax(bare.quick_gains(others)))]) if others else None


def _placed(bare: Hypothesis, kind: Kind, where: Sequence[str]) -> list[Package]:
    """The best package of a kind at each of some places; none where it cannot be there."""
    best = [
        max(try_packages(bare, options, 1), key=lambda trial: trial.score)
        for place, options in kind.options.items()
        if set(place) <= set(where)
    ]
    if best and not kind.unite:
        best = [max(best, key=lambda trial: trial.score)]
    return [trial.package for trial in best]


def _odds(no_worse: float, more: int) -> float:
    """Odds of a hypothesis, by its chance to be no worse and by how much more complex it is."""
    chance = float(np.clip(no_worse, _LEAST, 1.0 - _LEAST))
    return float(chance / (1.0 - chance) * RARER**more)


def _complexity(hypothesis: Hypothesis, start: Hypothesis) -> int:
    """How complex a hypothesis is: the sum over its kinds of effects, delays and loose bodies.

    Args:
        hypothesis: The hypothesis.
        start: Where the search began: the same delay and prior are no complexity.
    """
    found = {type(effect) for effect in hypothesis.unknowns.effects}
    if hypothesis.delay != start.delay:
        found.add(effect_of(Role.DELAY))
    if hypothesis.looseness > 1.0 or (start.has_fixed_bodies and not hypothesis.has_fixed_bodies):
        found.add(effect_of(Role.INERTIA))
    return sum(kind.complexity for kind in found)
