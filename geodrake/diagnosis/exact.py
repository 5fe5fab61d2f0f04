"""The search with delays and shapes that are not bound to a grid.

A delay or a shape that is off by a part of the grid's step leaves an error that looks like further
effects. So as soon as a step brings one, the logs are reduced again with what lies around it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from geodrake.diagnosis.candidates import DRY_AND_VISCOUS
from geodrake.diagnosis.case import Case, reduced
from geodrake.diagnosis.columns import (
    to_expand,
    with_columns,
    with_episodes,
    with_exact_episodes,
    with_exact_expansions,
    with_fitted_loads,
    with_suggestions,
)
from geodrake.diagnosis.delay import fine_delay
from geodrake.diagnosis.evidence import Criteria
from geodrake.diagnosis.forward import Progress, Trail, search
from geodrake.diagnosis.hypothesis import Hypothesis
from geodrake.diagnosis.proposals import DOMINANT
from geodrake.diagnosis.refine import reshape, split_compromises
from geodrake.diagnosis.shapes import finer, free_shape, is_round, peak
from geodrake.diagnosis.trials import PENALTY, gain_of
from geodrake.effects import Contact, EffortDelay
from geodrake.effects.base import Effect
from geodrake.model import FittedEffect

_MOST_ROUNDS = 12
_ZOOMS = (1.0 / 3.0, 1.0 / 12.0, 1.0 / 48.0)
"""Steps of the finer grids of a shape, as shares of the coarse one's."""
_LEAST_GAIN = 1.0
"""Gain that a still finer grid must promise."""


def searched(
    case: Case,
    start: Hypothesis,
    fixed: Sequence[Effect],
    criteria: Criteria,
    *,
    tune: bool = False,
    progress: Progress | None = None,
) -> tuple[Case, Trail]:
    """Search to the end, delays and shapes refined as they come.

    Args:
        case: The case.
        start: The model refitted within its prior.
        fixed: Effects that stay.
        criteria: When an effect counts as found.
        tune: Whether the data may say that the inertial prior is better than assumed.
        progress: Told about each step.

    Returns:
        The case as it was reduced last, and the trail on its dataset.
    """
    case, trail = with_suggestions(case, Trail(start, start, {}), criteria, least_share=DOMINANT)
    grid, origin, late, looked = case.dataset.effects, case.model.delay, False, False
    step = abs(case.dataset.delays[1]) if len(case.dataset.delays) > 1 else 0.0
    profiled, expanded, held = set(fixed), set(fixed), tuple(fixed)
    episodes: tuple[Effect, ...] = ()

    def pause(hypothesis: Hypothesis) -> bool:
        if not looked and _rubs(hypothesis):
            return True
        new_delay = not late and hypothesis.delay != trail.start.delay
        new_shape = bool(to_profile(hypothesis, grid, profiled))
        return new_delay or new_shape or bool(to_expand(case.model, hypothesis, expanded))

    look = partial(search, criteria=criteria, tune=tune, pause=pause, progress=progress)
    for _ in range(_MOST_ROUNDS):
        more = look(trail.end, held, rivals=trail.rivals)
        trail = replace(more, start=trail.start)
        if not looked and _rubs(trail.end):  # what friction hid may come before what is small
            looked, had = True, case.dataset.effects
            case, trail = with_suggestions(case, trail, criteria, known=grid, least_share=DOMINANT)
            grid = (*grid, *(e for e in case.dataset.effects if e not in had))
            continue
        if not pause(trail.end):
            case, trail, found = with_episodes(case, trail)
            if not found and episodes:
                case, trail, found = with_exact_episodes(case, trail)
                episodes = ()
            else:
                episodes = (*episodes, *found)
            if found:
                held = (*fixed, *(e for e in trail.end.unknowns.effects if isinstance(e, Contact)))
                continue
            was = case
            case, trail = with_suggestions(*with_fitted_loads(case, trail), criteria, known=grid)
            if _is_last(case, was, trail.end):
                break
            grid = (*grid, *(e for e in case.dataset.effects if e not in was.dataset.effects))
        if not late and trail.end.delay != trail.start.delay:
            case, trail = with_exact_delay(case, trail, origin=origin, step=step)
            late = True
        if to_profile(trail.end, grid, profiled):
            case, trail = with_exact_shapes(case, trail, grid, profiled)
            profiled.update(trail.end.unknowns.effects)
            trail = replace(trail, end=split_compromises(trail.end, fixed, criteria))
        if to_expand(case.model, trail.end, expanded):
            case, trail = with_exact_expansions(case, trail, expanded)
            expanded.update(trail.end.unknowns.effects)
    if late:
        case, trail = with_exact_delay(case, trail, origin=origin, step=0.5 * step)
    return case, trail


def _is_last(case: Case, before: Case, end: Hypothesis) -> bool:
    """Whether a case has nothing new to search: no columns, and no loads that are told right.

    Loads by fitted bodies know nothing of what acts on the whole robot, such as a tilted base.
    """
    tilted = any(effect.places == "robot" for effect in end.unknowns.effects)
    return case is before or (tilted and case.dataset.effects == before.dataset.effects)


def _rubs(hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis has friction."""
    return any(
        effect.name in (*DRY_AND_VISCOUS, "asymmetric_friction")
        for effect in hypothesis.unknowns.effects
    )


def to_profile(
    hypothesis: Hypothesis, grid: Sequence[Effect], profiled: Collection[Effect]
) -> list[Effect]:
    """Effects of a hypothesis that have a shape which nobody refined yet."""
    effects = hypothesis.unknowns.effects
    return [e for e in effects if e not in profiled and free_shape(e, grid) is not None]


def with_exact_shapes(
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
            coarse = end.exchanged(effect, [before])
            end = coarse if gain_of(coarse, end) <= PENALTY else end
    return case, replace(trail, end=end)


def with_exact_delay(case: Case, trail: Trail, *, origin: float, step: float) -> tuple[Case, Trail]:
    """The case with its efforts advanced by the delay that was found, and the trail carried over.

    A delay that is off by a part of the grid's step would look like further effects.

    Args:
        case: The case, its dataset with delays around that of the trail's end.
        trail: A search that found a delay.
        origin: Delay of the model before the search, s: where the trail starts.
        step: Step of the grid of delays, s; the next grid has half of it.
    """
    delay = case.model.delay + fine_delay(trail.end)[0]
    lag = FittedEffect(EffortDelay(delay), np.empty(0), np.empty(0))
    kept = [f for f in case.model.effects if not isinstance(f.effect, EffortDelay)]
    model = replace(case.model, effects=(*kept, lag))
    case = replace(case, model=model, kept={})
    dataset = reduced(
        case, case.dataset.effects, delays=(0.0, origin - delay, 0.5 * step, -0.5 * step)
    )
    start, end = trail.start.moved(dataset, delay=1), trail.end.moved(dataset, delay=0)
    return replace(case, dataset=dataset), replace(trail, start=start, end=end)
