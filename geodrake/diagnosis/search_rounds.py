"""The search with delays and shapes that are not bound to a grid.

A delay or a shape that is off by a part of the grid's step leaves an error that looks like further
effects. So as soon as a step brings one, the logs are reduced again with what lies around it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.interrupts import StopSearch
from geodrake.diagnosis.continuous_shapes import to_profile, with_plain_shapes
from geodrake.diagnosis.delay import fine_delays, fitted_delays, later
from geodrake.diagnosis.exchange import exchange
from geodrake.diagnosis.further_columns import (
    to_expand,
    with_episodes,
    with_expansions,
    with_fitted_loads,
    with_refined_episodes,
    with_suggestions,
)
from geodrake.diagnosis.ranked import Ranked
from geodrake.diagnosis.search_progress import FoundStep, Progress, found_step
from geodrake.diagnosis.stepwise_search import Trail, search
from geodrake.diagnosis.transition_speed import with_transition_speed
from geodrake.effects import Effect, Role
from geodrake.identification.logs.case import Case, reduced
from geodrake.identification.logs.criteria import DOMINANT, Criteria
from geodrake.identification.logs.hypothesis import Hypothesis

Array = NDArray[np.float64]

_MOST_ROUNDS = 12
_MOST_FADINGS = 3
_DEVIATIONS = 3.0
"""A delay is another one if it differs by more than so many standard deviations."""


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
        progress: Called with each step.

    Returns:
        The case as it was reduced last, and the trail on its dataset.

    Raises:
        StopSearch: It was stopped before it had found anything.
    """
    case, trail = with_suggestions(case, Trail(start, start), criteria, least_share=DOMINANT)
    state = _State(case, trail, tuple(fixed), criteria, progress)
    try:
        for _ in range(_MOST_ROUNDS):
            state.trail = search(
                state.trail,
                state.fixed,
                criteria,
                tune=tune,
                pause=state.to_pause,
                watch=state.note,
            )
            if not state.goes_on():
                break
    except StopSearch:
        if not state.stops():
            raise
    if state.timed is not None:
        state.retime(0.5)
    return state.case, state.trail


class _State:
    """Where a search is, and what of it has been made exact.

    Attributes:
        case: The case as it was reduced last.
        trail: The trail on its dataset.
        fixed: Effects that stay.
        criteria: When an effect counts as found.
        timed: Effects with which the delay was found last; None if there is none.
    """

    def __init__(
        self,
        case: Case,
        trail: Trail,
        fixed: tuple[Effect, ...],
        criteria: Criteria,
        progress: Progress | None = None,
    ) -> None:
        self.case, self.trail, self.fixed, self.criteria = case, trail, fixed, criteria
        self.timed: tuple[Effect, ...] | None = None
        self._progress = progress
        self._last: FoundStep | None = None
        self._given = fixed
        self._grid, self._origin = case.dataset.effects, case.model.delays
        self._delays = case.dataset.delays[1:, 0].tolist()
        self._profiled, self._expanded = set(fixed), set(fixed)
        self._episodes: tuple[Effect, ...] = ()
        self._looked = False
        self._fadings: list[tuple[Effect, ...]] = []

    def note(self, chosen: Ranked, trail: Trail) -> None:
        """Keep a step, also if nothing more follows, and tell of it."""
        before, self.trail = self.trail, trail
        self._last = found_step(trail.start, before.end, trail.end, chosen.reported)
        if self._progress is not None:
            self._progress(self._last)

    def stops(self) -> bool:
        """End the trail where it is; false if there is no step yet."""
        if self._last is None:
            return False
        self.trail = replace(self.trail, is_stopped=True)
        if self._progress is not None:
            self._progress(replace(self._last, is_last=True))
        return True

    def to_pause(self, hypothesis: Hypothesis) -> bool:
        """Whether a hypothesis has something that is to be made exact before the search goes on."""
        return (
            (not self._looked and _rubs(hypothesis))
            or self._is_delayed(hypothesis)
            or bool(to_profile(hypothesis, self._grid, self._profiled))
            or bool(to_expand(self.case.model, hypothesis, self._expanded))
        )

    def goes_on(self) -> bool:
        """Make exact what was found, or find more to try; whether there is anything to search."""
        end = self.trail.end
        paused = self.to_pause(end)
        if self._is_delayed(end):
            self.retime(1.0 if self.timed is None else 0.5)
        if not self._looked and _rubs(end):  # what friction hid may come before what is small
            self._looked = True
            self._suggest(least_share=DOMINANT)
            return True
        if not paused:
            if self._find_episodes() or self._find_transition_speed():
                return True
            loads = with_fitted_loads(self.case, self.trail)
            self.case, self.trail = loads or (self.case, self.trail)
            if not self._suggest() and loads is None:
                return False
        self._refine()
        return True

    def retime(self, share: float) -> None:
        """Advance the efforts by the delay; later ones are tried by this share of half a step."""
        self.case, self.trail = with_fine_delays(
            self.case, self.trail, origin=self._origin, grid=share * np.array(self._delays)
        )
        self.timed = self.trail.end.unknowns.effects

    def _is_delayed(self, hypothesis: Hypothesis) -> bool:
        """Whether there is a delay, or by what is known now clearly another one than before."""
        if self.timed is None:
            return hypothesis.delay != self.trail.start.delay
        if hypothesis.unknowns.effects == self.timed:
            return False
        if any(hypothesis.delay):
            return True
        late = later(self.trail.start, self.trail.end)
        delays, deviations = fine_delays(hypothesis, late)
        return bool(np.any(np.abs(delays) > _DEVIATIONS * deviations))

    def _suggest(self, *, least_share: float = 0.0) -> bool:
        """Make columns for what the residual suggests; whether it suggests anything."""
        had = self.case.dataset.effects
        self.case, self.trail = with_suggestions(
            self.case, self.trail, self.criteria, known=self._grid, least_share=least_share
        )
        more = tuple(e for e in self.case.dataset.effects if e not in had)
        self._grid += more
        return bool(more)

    def _find_episodes(self) -> bool:
        """Look for episodes, or anew at those that were found; whether there are any."""
        self.case, self.trail, found = with_episodes(
            self.case, self.trail, alarm=self.criteria.alarm
        )
        if not found and self._episodes:
            self.case, self.trail, found = with_refined_episodes(self.case, self.trail)
            self._episodes = ()
        else:
            self._episodes += found
        if found:
            contacts = [e for e in self.trail.end.unknowns.effects if e.role is Role.EPISODE]
            self.fixed = (*self._given, *contacts)
        return bool(found)

    def _find_transition_speed(self) -> bool:
        """Let dry friction fade at low speeds, as suits what was found; whether that is new."""
        effects = self.trail.end.unknowns.effects
        if effects in self._fadings[-1:] or len(self._fadings) >= _MOST_FADINGS:
            return False
        self._fadings.append(effects)
        faded = with_transition_speed(self.case, self.trail)
        if faded is None:
            return False
        self.case, self.trail = faded
        # Shapes and delay were those that suited friction which jumps.
        self._profiled &= set(self._given)
        self.timed = None if self.timed is None else ()
        return True

    def _refine(self) -> None:
        """Shapes and places between those that were tried."""
        if to_profile(self.trail.end, self._grid, self._profiled):
            self.case, trail = with_plain_shapes(self.case, self.trail, self._grid, self._profiled)
            self._profiled.update(trail.end.unknowns.effects)
            end = exchange(
                trail.end, self._given, self.criteria, refusals=trail.refusals, split=True
            )
            self.trail = replace(trail, end=end)
        if to_expand(self.case.model, self.trail.end, self._expanded):
            self.case, self.trail = with_expansions(self.case, self.trail, self._expanded)
            self._expanded.update(self.trail.end.unknowns.effects)


def _rubs(hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis has the friction that a robot is hardly without."""
    return any(
        kind.usual
        for effect in hypothesis.unknowns.effects
        for kind in (type(effect), *effect.contains)
    )


def with_fine_delays(case: Case, trail: Trail, *, origin: Array, grid: Array) -> tuple[Case, Trail]:
    """The case with its efforts advanced by the delays that were found, and the trail carried over.

    A delay that is off by a part of the grid's step would look like further effects.

    Args:
        case: The case, its dataset with delays around that of the trail's end.
        trail: A search that found a delay.
        origin: (nv,) delays of the model before the search, s: where the trail starts.
        grid: Delays on a grid, s, by which joints may be late beside. Half its step is the next
            one around the delays that were found.
    """
    late = later(trail.start, trail.end)
    delays = case.model.delays + fine_delays(trail.end, late)[0]
    lags = fitted_delays(delays, case.model.joints)
    kept = [f for f in case.model.effects if f.effect.role is not Role.DELAY]
    case = replace(case, model=replace(case.model, effects=(*kept, *lags)))
    near = [0.5 * abs(grid[0]), -0.5 * abs(grid[0])]
    tried = (0.0, origin - delays, *near, *grid)
    dataset = reduced(case, case.dataset.effects, delays=tried)
    start, end = trail.start.moved(dataset, delay=1), trail.end.moved(dataset, delay=0)
    return replace(case, dataset=dataset), replace(trail, start=start, end=end)
