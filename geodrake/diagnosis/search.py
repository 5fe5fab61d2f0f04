"""Search for the most probable explanation: climb, refine the result, and look for more."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.interrupts import StopSearch
from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.climbing import can_gain, climb, gain_of, settled
from geodrake.diagnosis.contact_window import PIECES
from geodrake.diagnosis.episodes import find_episodes
from geodrake.diagnosis.handling import is_short, refined_instants
from geodrake.diagnosis.log_model import Choice, Delay, Fit, LogModel
from geodrake.diagnosis.moves import single_replacements
from geodrake.diagnosis.proposals import proposed
from geodrake.diagnosis.refinements import (
    LEVELS,
    common_delay,
    delays_of,
    expansions,
    fading_speeds,
    finer_shapes,
    fitted_delays,
    fitted_loads,
    gain_of_finer_shape,
    other_choices,
)
from geodrake.diagnosis.search_progress import FoundStep, Progress, progress_of
from geodrake.diagnosis.terms import Term
from geodrake.diagnosis.turned_base import turned_bases
from geodrake.diagnosis.unknown_efforts import is_resolved, reversals, unknown_functions
from geodrake.effects import Effect
from geodrake.effects.base import FittedEffect
from geodrake.effects.declarations import Proposer, Role
from geodrake.effects.robot_motion import log_number
from geodrake.errors import ArgumentError
from geodrake.identification.logs.case import Case, reduced
from geodrake.identification.logs.criteria import NOISE_MARGIN
from geodrake.identification.logs.dataset import is_body
from geodrake.identification.logs.model_fit import effects_of
from geodrake.logs.folds import assign_folds

Array = NDArray[np.float64]
Places = tuple[tuple[str, ...], ...]
Names = frozenset[object]
"""Names of an explanation, which are independent of its columns."""

_MOST_ROUNDS = 12
_MOST_VISITS = 3  # of an explanation during refinement
_FIRST_SHARE = 0.05
_FORCED_SHARE = 0.3
_MOST_FADINGS = 3
_FURTHER = 5  # effects that would gain if they left white noise, in each step of the last climb
_CHANGED = 0.2  # relative change of an effect of accelerations that updates the noise
_FINER = 0.25  # least gain in score by a finer shape
_OTHER_DELAY, _ALIKE = 3.0, 0.125  # largest difference of equal delays: deviations, and steps


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The most probable explanation of a search."""

    case: Case  # the case, with the last columns
    model: LogModel  # the Gaussian model of its logs
    fit: Fit
    start: Fit  # the model without new terms, its bodies refitted
    is_stopped: bool = False  # whether the search was stopped before its end


def find_explanation(
    case: Case, beliefs: Beliefs | None = None, *, progress: Progress | None = None
) -> SearchResult:
    """Find the most probable explanation of the logs of a case.

    Raises:
        StopSearch: The search was stopped before the first step.
    """
    return Search(case, beliefs, progress).run()


class Search:
    """Search for the terms that a model lacks."""

    def __init__(
        self,
        case: Case,
        beliefs: Beliefs | None = None,
        progress: Progress | None = None,
        *,
        everywhere: bool = False,
    ) -> None:
        """Start with the model without new terms.

        Unless `everywhere`, payloads are on bodies that may carry loads: a heavier body that
        carries others is a wrong one.
        """
        self.case, self._beliefs, self._progress = case, beliefs or Beliefs(), progress
        self._accelerated = dict[Effect, Array]()  # effects of accelerations -> their values
        self._noise_of = case.model, case.loads, self._accelerated  # sources of the noise floor
        loaded, known = case.model.load_bodies, effects_of(case.model)
        self._effects = [
            effect
            for effect in dict.fromkeys(case.dataset.effects)
            if everywhere or effect in known or not is_body(effect) or effect.where[0] in loaded
        ]
        self._grid = tuple(self._effects)
        self._origin = case.model.delays
        self._step = float(np.abs(case.dataset.delays[1:, 0]).min(initial=np.inf))
        self._delays: list[ArrayLike] = [*case.dataset.delays]
        self._on_time: Delay = (0,) * len(case.model.joints)
        self._levels = dict[Effect, int]()  # effect -> next level of finer shapes
        self._is_fine = dict[tuple[object, Term], bool]()  # by explanation and term
        self._moved = dict[Effect, Effect]()  # effects -> the same, expanded about other points
        self._has_fitted_delays = False
        self._tried_delays = [self._origin]  # delays (nv,) with columns, the file's first
        # Dry friction whose fading speeds were searched; explanations whose shapes and further
        # effects were.
        self._fading_for, self._simplified_for = set[Names](), set[Names]()
        self._suggested_for = set[Names]()
        self._has_climbed_far, self._has_tried_unknowns = False, False
        # Previous loads of explanations, as two may lead to each other.
        self._loads_tried = dict[tuple[Names, float], Array]()
        self._last_step: FoundStep | None = None
        self.model = self._build_model()
        self.fit = self._start()
        self._common = self.fit, self._delays_of_fit()

    def run(self) -> SearchResult:
        """Search to the end."""
        is_stopped = False
        try:
            self._start_with_turned_base()
            effects = proposed(self.case, self.model, self.fit)
            if effects:  # before other effects imitate them
                self._add_candidates(effects)
            self._climb_by_common_first()
            for _ in range(_MOST_ROUNDS):
                if not self._continue():
                    break
            self.fit = settled(self.model, self.fit)
        except StopSearch:
            if not self.fit.terms:
                raise
            is_stopped = True
            if self._progress is not None and self._last_step is not None:
                with suppress(StopSearch):  # it is stopped already
                    self._progress(replace(self._last_step, is_last=True))
        return SearchResult(self.case, self.model, self.fit, self._start(), is_stopped)

    def _start_with_turned_base(self) -> None:
        """Start with a base that is mounted differently, if that explains most errors."""
        turned = self._offer_turned_bases()
        if not turned:
            return
        self._rebuild()
        terms = [term for term in self.model.terms if term.effect in turned]
        widths = [w for w in self.model.widths if w <= self.model.wrong_beyond]
        choices = [self.model.choice(self.fit.choice, (t,), width=w) for t in terms for w in widths]
        self.fit = self._best(choices, self.fit)

    def _offer_turned_bases(self) -> set[Effect]:
        """Replace effects by large turns of gravity if they explain most errors; return those."""
        turned = turned_bases(self.case, self._effects)
        self._effects = [turned.get(effect, effect) for effect in self._effects]
        return {*turned.values()}

    def forced(
        self, kind: type[Effect], places: Places | None, further: Sequence[Effect] = ()
    ) -> SearchResult:
        """Return the explanation with one effect, whatever the evidence for it.

        If `places` is None, they are all joints, or the best place. `further` instances are tried
        beside those with columns in the case.

        Raises:
            ArgumentError: The effect is an episode, and the residual shows none.
        """
        if kind.role is Role.EPISODE or kind.proposer is Proposer.WAVES:
            further = [e for e in self._suggestions() if isinstance(e, kind)] or further
            if kind.role is Role.EPISODE and not further:
                raise ArgumentError(
                    f"These logs show no {kind.name}.",
                    advice="Friction may hide it: explain the logs, or add other missing "
                    "effects first.",
                )
        known, candidates = effects_of(self.case.model), (*self._effects, *further)
        self._effects = [e for e in candidates if isinstance(e, kind) or e in known]
        self._offer_turned_bases()
        self._grid = tuple(self._effects)
        self._rebuild()
        self.fit = self._best_fit_with(kind, places)
        for _ in range(_MOST_ROUNDS):
            if not self._refine():
                break
            self.fit = self._best_fit_with(kind, places)
        return SearchResult(self.case, self.model, self.fit, self._start())

    def _best_fit_with(self, kind: type[Effect], places: Places | None) -> Fit:
        """Return the most probable fit with one effect at some places, in its best shape."""
        model, start = self.model, self._start()
        if kind.role is Role.DELAY:
            return self._best_delays(start, places)
        if kind.role is Role.INERTIA:
            wrong = model.beliefs.wrong
            widths = [w for w in model.widths if w > wrong] or [model.widths[-1]]
            choices = [Choice((), width, self._on_time) for width in widths]
            return self._best(choices, start)
        near = [w for w in model.widths if w <= model.wrong_beyond]
        options = dict[tuple[str, ...], list[Term]]()
        for term in model.terms:
            if term.effect is not None and isinstance(term.effect, kind):
                options.setdefault(term.where, []).append(term)
        chosen = options if places is None else {p: options[p] for p in places if p in options}
        single = places is None and kind.places != "joint"
        best = dict[tuple[str, ...], Fit]()
        for place, terms in chosen.items():
            choices = [
                model.choice(start.choice, (term,), width=width) for term in terms for width in near
            ]
            best[place] = self._best(choices, start)
        if single:
            return max(best.values(), key=lambda fit: fit.score)
        together = tuple(fit.terms[0] for fit in best.values())
        return self._best([model.choice(start.choice, together, width=w) for w in near], start)

    def _best_delays(self, start: Fit, places: Places | None) -> Fit:
        """Return the best delay of all efforts, or of those of each of some joints."""
        fit, groups = start, [[*range(len(self._on_time))]]
        if places is not None:
            groups = [[self.case.model.joints.index(name)] for (name,) in places]
        for moved in groups:
            delays = [
                tuple(k if j in moved else index for j, index in enumerate(fit.choice.delay))
                for k in range(len(self.case.dataset.delays))
            ]
            delayed = [d for d in delays if any(d[j] != self._on_time[j] for j in moved)]
            fit = self._best([Choice((), start.choice.width, delay) for delay in delayed], start)
        return fit

    def _best(self, choices: Sequence[Choice], previous: Fit) -> Fit:
        """Return the most probable of some explanations, physical if possible."""
        shares = np.full(len(self.model.rows), _FORCED_SHARE)
        if ranked := self.model.ranked(choices, shares, previous.noise):
            return ranked[0]
        fits = [self.model.unbounded(choice, shares, previous.noise) for choice in choices]
        return max(fits, key=lambda fit: fit.score)

    def _suggestions(self) -> list[Effect]:
        """Return effects that the residual suggests, such as ripples, payloads and contacts."""
        proposals = proposed(self.case, self.model, self.fit)
        hypothesis = self.model.hypothesis(self._without_short_payloads())
        contacts = find_episodes(self.case, hypothesis, self._on_time)
        if contacts:
            numbers = [log_number(trajectory.name) for trajectory in self.case.trajectories]
            windows = list[tuple[int, float, float]]()
            for c in contacts:  # two may be of one window
                log = numbers.index(c.log)
                if not any(
                    log == k and c.start < end and start < c.end for k, start, end in windows
                ):
                    windows.append((log, c.start, c.end))
            folds = assign_folds(self.case.folds, self.case.trajectories, windows, pieces=PIECES)
            self.case = replace(self.case, folds=folds)
        return [e for e in (*proposals, *contacts) if e not in self._effects]

    def _without_short_payloads(self) -> Fit:
        """Return the explanation without short payloads, which may be contacts."""
        fit, model = self.fit, self.model
        kept = [term for term in fit.terms if not is_short(self.case, term.effect)]
        if len(kept) == len(fit.terms):
            return fit
        return model.unbounded(model.choice(fit.choice, kept), model.shares(fit), fit.noise)

    def _start(self) -> Fit:
        """Return the fit without new terms, with the most probable width of bodies."""
        return self.model.without_terms(np.full(len(self.model.rows), _FIRST_SHARE))

    def _climb(self, *, optimistic: bool, further: int = 0, common: bool = False) -> None:
        def watch(before: Fit, after: Fit) -> None:
            self.fit = after
            if self._progress is not None:
                self._last_step = progress_of(self.model, before, after)
                self._progress(self._last_step)

        visited = list[Names]()  # explanations may lead to each other with changing columns
        while visited.count(self._names) < _MOST_VISITS and len(visited) < _MOST_ROUNDS:
            visited.append(self._names)
            self.fit = climb(
                self.model,
                self.fit,
                optimistic=optimistic,
                watch=watch,
                pause=self._is_coarse if optimistic else self._needs_refinement,
                further=further,
                common=common,
            )
            if not self._needs_refinement(self.fit):
                break
            # A shape may imitate fading friction.
            has_faded = bool(self._finer_shapes(self.fit)) and self._update_fading()
            if not has_faded and not self._refine():
                break
            shaped = {term.where[0] for term in self.fit.terms if term.effect in self._levels}
            if shaped:  # before other effects compensate an inexact shape
                self.fit = climb(self.model, self.fit, optimistic=optimistic, joints=shaped)

    def _climb_by_common_first(self) -> None:
        """Climb with common effects and payloads only, then with all effects.

        Rare effects of several joints may replace common ones and a payload, most easily if joints
        move little or one after the other; no single step leads back.
        """
        self._climb(optimistic=True, common=True)
        self._common = self.fit, self._delays_of_fit()
        self._climb(optimistic=True)
        self._climb(optimistic=False)

    def _climb_from(self, start: Fit) -> None:
        """Climb from another explanation, unless that ends at a less probable one or is stopped."""
        found, delays = self.fit, self._delays_of_fit()
        before = {
            name: copy(value) if isinstance(value, list | dict | set) else value
            for name, value in vars(self).items()
        }
        self.fit, is_better = start, False
        try:
            self._climb(optimistic=True)
            self._climb(optimistic=False)
            gain = gain_of(self.model, self._refitted(found, delays), self.fit)
            is_better = gain is not None and gain[0] > 0.0
        finally:
            if not is_better:
                vars(self).update(before)

    def _delays_of_fit(self) -> Array:
        """Return the delays (nv,) of the explanation, s."""
        at = [*self.fit.choice.delay], np.arange(len(self._on_time))
        return np.asarray(self.case.model.delays + self.case.dataset.delays[at])

    def _refitted(self, was: Fit, delays: Array) -> Fit:
        """Return an earlier explanation with some delays (nv,), fitted with these columns."""
        differences = np.abs(self.case.model.delays + self.case.dataset.delays - delays)
        nearest = tuple(differences.argmin(axis=0).tolist())
        delayed = replace(was, choice=replace(was.choice, delay=nearest))
        return self.model.refitted(delayed, self._moved)

    def _needs_refinement(self, fit: Fit) -> bool:
        """Return whether a fit must be refined before anything else is tried, including its loads.

        An optimistic climb ignores loads, which every step changes.
        """
        return self._is_coarse(fit) or self._changed_loads(fit) is not None

    def _is_coarse(self, fit: Fit) -> bool:
        """Return whether a delay, expansion point or shape is inexact.

        The remaining error would look like further effects.
        """
        if self._is_on_delay_grid(fit) and self._has_new_delays(fit):
            return True
        if expansions(self.case, self.model, fit):
            return True
        return bool(self._finer_shapes(fit))

    def _build_model(self) -> LogModel:
        """Return the Gaussian model of the case with columns for all candidates."""
        model, logs = self.case.model, self.case.trajectories
        unsure = reversals(model, logs)
        known = effects_of(model)
        self._effects = [e for e in self._effects if e in known or is_resolved(e, unsure)]
        columns = [*self._effects, *unsure]
        noise_of, robot = (model, self.case.loads, self._accelerated), None
        if any(one is not other for one, other in zip(noise_of, self._noise_of, strict=True)):
            accelerated = (FittedEffect(*each) for each in self._accelerated.items())
            robot = replace(self.case.load_model, effects=(*model.effects, *accelerated))
        self._noise_of = noise_of
        dataset = reduced(self.case, columns, delays=self._delays, noise_of=robot)
        self.case = replace(self.case, dataset=dataset)
        return LogModel(
            model,
            dataset,
            self._effects,
            self._beliefs,
            self._on_time,
            loads=self.case.loads,
            file_delays=self._origin,
        )

    def _rebuild(self, moved: dict[Effect, Effect] | None = None, *, retimed: bool = False) -> None:
        """Recompute the columns of all candidates, and transfer the explanation.

        `moved` maps replaced effects to new ones; `retimed` states whether the model has the
        explanation's delays now.
        """
        self.model, previous = self._build_model(), self.fit
        self._is_fine.clear()
        terms = self.model.matching(previous.terms, moved)
        delay = previous.choice.delay
        if retimed:
            delay = tuple(
                np.where(
                    np.abs(self.case.model.delays - self._origin) < 1e-9, self._on_time, 0
                ).tolist()
            )
        shares = np.full(len(self.model.rows), _FORCED_SHARE)
        for kept in (terms, [term for term in terms if not len(term.positive)]):
            choice = self.model.choice(previous.choice, kept, delay=delay)
            fit = self.model.fit(choice, shares, previous.noise)
            if fit is not None:
                break
        self.fit = fit or self._start()  # None if parameters violate their bounds

    def _add_candidates(self, more: Sequence[Effect]) -> None:
        self._loads_tried.clear()
        self._effects += more
        self._grid = (*self._grid, *more)
        self._rebuild()

    def _climb_with_suggestions(self) -> bool:
        """Climb with effects that the residual suggests; return whether any of them may gain.

        The explanation may have imitated an episode, so that it is searched again with the episode.
        """
        before = self.case, self.model, self.fit, [*self._effects], self._grid
        more = self._suggestions()
        if not more:
            return False
        self._add_candidates(more)
        previous = self.fit
        episodes = [effect for effect in more if effect.role is Role.EPISODE]
        others = [effect for effect in more if effect not in episodes]
        common = self._refitted(*self._common)
        if not any(can_gain(self.model, fit, episodes) for fit in (previous, common)):
            if not can_gain(self.model, previous, others, optimistic=True):
                self.case, self.model, self.fit, self._effects, self._grid = before
                return False
            self._climb(optimistic=True)
            self._climb(optimistic=False)
            return True
        self._climb_from(common)
        return True

    def _continue(self) -> bool:
        """Refine the explanation, or find more candidates; return whether the search goes on."""
        if self._refine() or self._update_fading() or self._offer_simpler():
            self._climb(optimistic=False)
            return True
        if self._names not in self._suggested_for:  # contacts differ each time by rounding
            self._suggested_for.add(self._names)
            if self._climb_with_suggestions():
                return True
        before = self.fit.choice.key
        if not self._has_tried_unknowns:
            self._has_tried_unknowns = True
            joints = self._doubtful_joints()
            if not joints:
                return False
            functions = unknown_functions(self.case, self.model.hypothesis(self.fit), joints)
            self._effects += functions
            self._rebuild()
            before = self.fit.choice.key
            self._climb(optimistic=False)
            kept = {term.effect for term in self.fit.terms}  # the others lose their columns
            self._effects = [e for e in self._effects if e in kept or e not in functions]
            if self.fit.choice.key != before:
                return True
        if not self._has_climbed_far:
            self._has_climbed_far = True
            if any(term.effect and term.effect not in self._effects for term in self.model.terms):
                self._rebuild()
                before = self.fit.choice.key
            self._climb(optimistic=False, further=_FURTHER)
        return self.fit.choice.key != before

    @property
    def _names(self) -> Names:
        return _names_of(self.fit)

    def _doubtful_joints(self) -> set[str]:
        """Return joints with more than noise left, or with a finding at their motors."""
        exceeds_noise = np.sqrt(self.fit.variance) > NOISE_MARGIN * self.case.dataset.noise_floor
        effects = [term.effect for term in self.fit.terms]
        affected = [
            self.case.dataset.affected_joints(e) for e in effects if e is not None and e.at_motor
        ]
        joints = np.logical_or.reduce([exceeds_noise, *affected])
        model = self.case.model  # joints of a free base have no own effects
        return {model.joints[j] for j in np.flatnonzero(joints)} - set(model.base_joints)

    def _refine(self) -> bool:
        """Update delays, shapes, expansion points and loads; return whether any changed."""
        retimed = self._update_delays()
        changed = retimed
        near = self._finer_shapes(self.fit, other_choices(self.model, self.fit, self._grid))
        self._levels |= near
        self._effects += [effect for effect in near if effect not in self._effects]
        moved = expansions(self.case, self.model, self.fit)
        moved |= refined_instants(self.case, self.model, self.fit)
        if moved:
            self._effects = [moved.get(effect, effect) for effect in self._effects]
            self._levels = {moved.get(e, e): level for e, level in self._levels.items()}
            self._moved = {e: moved.get(new, new) for e, new in self._moved.items()} | moved
        loads = self._changed_loads(self.fit)
        changed |= self._update_noise()
        if changed or near or moved:
            self._loads_tried.clear()
        if loads is not None:
            self.case = replace(self.case, loads=loads)
            self._loads_tried[(_names_of(self.fit), self.fit.choice.width)] = loads
        if changed or near or moved or loads is not None:
            self._rebuild(moved, retimed=retimed)
            return True
        return False

    def _finer_shapes(self, fit: Fit, others: Iterable[Term] = ()) -> dict[Effect, int]:
        """Return the shape of each term and the untried ones around it, with the next level.

        Terms are those of a fit and `others`. After the first level, their shapes are refined only
        if that gains.
        """
        shapes = dict[Effect, int]()
        for term in (*fit.terms, *others):
            effect = term.effect
            if effect is None:
                continue
            level = self._levels.get(effect, 0)
            near, following = finer_shapes(effect, self._grid, self._effects, level)
            if near and not (level and self._has_fine_shape(fit, term)):
                shapes |= dict.fromkeys([effect, *near], following)
        return shapes

    def _has_fine_shape(self, fit: Fit, term: Term) -> bool:
        """Return whether a finer shape of a term that was refined would gain next to nothing."""
        key = fit.choice.key, term
        if key not in self._is_fine:
            gain = gain_of_finer_shape(self.model, fit, term, self._grid)
            self._is_fine[key] = gain < _FINER
        return self._is_fine[key]

    def _update_noise(self) -> bool:
        """Update effects that add noise of accelerations; return whether they changed."""
        model, known = self.model, set(effects_of(self.case.model))
        current = {
            term.effect: model.parameters(self.fit, term)
            for term in self.fit.terms
            if term.effect and term.effect.depends_on == {"vd"} and term.effect not in known
        }
        previous = self._accelerated
        if previous.keys() == current.keys() and all(
            np.allclose(previous[e], x, rtol=_CHANGED, atol=0.0) for e, x in current.items()
        ):
            return False
        self._accelerated = current
        return True

    def _changed_loads(self, fit: Fit) -> Array | None:
        """Return the loads (nb, 10) of a fit if load-dependent columns must be recomputed."""
        effects = [term.effect for term in fit.terms if not term.is_body]
        loaded = any(e and "load" in e.depends_on for e in effects)
        if not loaded and not self.case.dataset.gain_uncertainty.any():
            return None
        return fitted_loads(
            self.case, self.model, fit, self._loads_tried.get((_names_of(fit), fit.choice.width))
        )

    def _offer_simpler(self) -> bool:
        """Offer finer shapes of single effects for crowded joints; return whether any is new."""
        if self._names in self._simplified_for:
            return False
        self._simplified_for.add(self._names)
        offered = False
        for level in range(LEVELS):
            terms = single_replacements(self.model, self.fit)
            single = [term.effect for term in terms if term.effect]
            finer = [finer_shapes(e, self._grid, self._effects, level)[0] for e in single]
            if any(finer):
                self._effects += chain.from_iterable(finer)
                self._rebuild()
                offered = True
        return offered

    def _update_fading(self) -> bool:
        """Update the speeds at which friction fades; return whether they changed."""
        effects = [term.effect for term in self.fit.terms]
        friction = frozenset(effect for effect in effects if effect is not None and effect.jumps)
        if len(self._fading_for) >= _MOST_FADINGS or friction in self._fading_for:
            return False
        self._fading_for.add(friction)
        speeds = fading_speeds(self.case, self.model, self.fit)
        if speeds is None:
            return False
        faded = replace(self.case.model, fading_speed=speeds)
        self.case = replace(self.case, model=faded)
        self._rebuild()
        return True

    def _is_on_delay_grid(self, fit: Fit) -> bool:
        """Return whether a joint has a delay of the grid that was not refined."""
        return max(fit.choice.delay) >= len(self._tried_delays)

    def _has_new_delays(self, fit: Fit) -> bool:
        """Return whether a joint has a delay without exact columns."""
        seconds, deviations = delays_of(self.model, fit)
        delays = self.case.model.delays + seconds
        differences = np.abs(delays - np.array(self._tried_delays)).min(axis=0)
        spreads = np.where(np.isfinite(deviations), deviations, 0.0)
        return bool(np.any(differences > np.maximum(_OTHER_DELAY * spreads, _ALIKE * self._step)))

    def _update_delays(self) -> bool:
        """Advance the efforts by the fitted delays; return whether these changed."""
        delay, model = self.fit.choice.delay, self.case.model
        if not self._has_fitted_delays and delay == self._on_time:
            return False
        if not self._has_new_delays(self.fit):
            return False
        seconds, deviations = delays_of(self.model, self.fit)
        lags = fitted_delays(model.delays + seconds, model.joints)
        kept = [each for each in model.effects if each.effect.parameters]
        self.case = replace(self.case, model=replace(model, effects=(*kept, *lags)))
        half = 0.25 * self._step if self._has_fitted_delays else 0.5 * self._step
        grid = np.unique(np.concatenate([self._step * np.arange(-3, 4), [half, -half]]))
        others: list[ArrayLike] = [x for x in grid.tolist() if abs(x) > 1e-12]
        advanced = self.case.model.delays
        known = [delays - advanced for delays in self._tried_delays]
        common = common_delay(advanced - self._origin, deviations)
        if common is not None:  # joints that show no delay of their own may have it, too
            near = grid[np.abs(grid) <= self._step]
            others += [self._origin + common + x - advanced for x in near.tolist()]
        self._delays = [0.0, *known, *others]
        self._tried_delays.append(advanced)
        self._on_time = (1,) * len(delay)
        self._has_fitted_delays = True
        return True


def _names_of(fit: Fit) -> Names:
    """Return the names of an explanation, independent of its columns."""
    return frozenset(term.effect or term.key for term in fit.terms)
