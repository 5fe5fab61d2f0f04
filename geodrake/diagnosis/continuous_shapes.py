"""Shapes of found effects that are not bound to the grid on which they were found."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from geodrake.diagnosis.exchange import is_free
from geodrake.diagnosis.further_columns import with_columns
from geodrake.diagnosis.judgement import judge
from geodrake.diagnosis.pruning import reshape
from geodrake.diagnosis.shapes import finer, free_shape, is_round, peak
from geodrake.diagnosis.stepwise_search import Trail
from geodrake.effects.base import Effect
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.hypothesis import Hypothesis

_ZOOMS = (1.0 / 3.0, 1.0 / 12.0, 1.0 / 48.0)
"""Steps of finer and finer grids of a shape, in steps of the coarse one."""
_LEAST_GAIN = 1.0
"""A still finer grid is tried if it promises at least this gain."""


def to_profile(
    hypothesis: Hypothesis, grid: Sequence[Effect], profiled: Collection[Effect]
) -> list[Effect]:
    """Effects of a hypothesis that have a shape which nobody refined yet.

    Args:
        hypothesis: The hypothesis.
        grid: Effects that are tried, with the coarse grids of their shapes.
        profiled: Effects whose shape was refined.
    """
    effects = hypothesis.unknowns.effects
    return [e for e in effects if e not in profiled and free_shape(e, grid) is not None]


def with_plain_shapes(
    case: Case, trail: Trail, grid: Sequence[Effect], fixed: Collection[Effect]
) -> tuple[Case, Trail]:
    """The case with exact shapes, less what only made up for a shape that was not.

    On a coarse grid v and v² together may stand for |v|^1.8. See `with_continuous_shapes`.

    Args:
        case: The case.
        trail: A search that found effects with a shape.
        grid: All effects that are tried, with the coarse grids of their shapes.
        fixed: Effects whose shape stays.
    """
    best = with_continuous_shapes(case, trail, grid, fixed)
    powers = [e for e in to_profile(trail.end, grid, fixed) if not e.refines]
    for simple in trail.end.unknowns.effects:
        beside = any(power.where == simple.where for power in powers)
        spare = beside and simple.usual and simple not in fixed
        if spare and is_free(trail.end, simple):
            shaped = {(power.name, power.where) for power in powers}
            less = trail.end.without([simple])
            others = [e for e in less.unknowns.effects if (e.name, e.where) not in shaped]
            plain = replace(trail, end=reshape(less, others, least=0.0))
            exact = with_continuous_shapes(case, plain, grid, fixed)
            if not judge(exact[1].end, best[1].end).is_better:
                best, trail = exact, plain
    return best


def with_continuous_shapes(
    case: Case, trail: Trail, grid: Sequence[Effect], fixed: Collection[Effect]
) -> tuple[Case, Trail]:
    """The case with finer grids around the shapes that were found, and the best of these taken.

    A round shape of the coarse grid stays unless another one gains more than a parameter must:
    simple exponents are likelier than odd ones.

    Args:
        case: The case.
        trail: A search that found effects with a shape.
        grid: All effects that are tried, with the coarse grids of their shapes.
        fixed: Effects whose shape stays.
    """
    was = {(e.name, e.where): e for e in to_profile(trail.end, grid, fixed)}

    def chosen(hypothesis: Hypothesis) -> list[Effect]:
        return [e for e in hypothesis.unknowns.effects if (e.name, e.where) in was]

    for share in _ZOOMS:
        peaks = [peak(trail.end, effect, grid) for effect in chosen(trail.end)]
        if share < _ZOOMS[0] and all(gain < _LEAST_GAIN for _, gain in peaks):
            break
        near = [other for center, _ in peaks for other in finer(center, grid, share)]
        case, trail = with_columns(
            case, trail, [*grid, *trail.end.unknowns.effects, *was.values(), *near]
        )
        others = [e for e in trail.end.unknowns.effects if (e.name, e.where) not in was]
        trail = replace(trail, end=reshape(trail.end, others, least=0.0))
    end = trail.end
    for effect in chosen(end):
        before = was[effect.name, effect.where]
        if is_round(before, grid):
            coarse = end.exchanged([effect], [before])
            end = end if judge(coarse, end).is_better else coarse
    return case, replace(trail, end=end)
