"""The search for what a model lacks: climb, make exact what was found, and look once more."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.interrupts import StopSearch
from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.climbing import climb, gain_of, may_come, settled
from geodrake.diagnosis.contact_window import PIECES
from geodrake.diagnosis.episodes import find_episodes
from geodrake.diagnosis.handling import instants, is_short
from geodrake.diagnosis.log_model import Choice, Delay, Fit, LogModel
from geodrake.diagnosis.moves import alone, is_common
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
from geodrake.identification.logs.model_fit import effects_of
from geodrake.logs.folds import assign_folds

Array = NDArray[np.float64]
Places = tuple[tuple[str, ...], ...]
Named = frozenset[object]
"""Names that identify an explanation in any columns: terms are made anew with these."""

_MOST_ROUNDS = 12
_MOST_VISITS = 3  # of an explanation that is made exact
_FIRST_SHARE = 0.05
_FORCED_SHARE = 0.3
_MOST_FADINGS = 3
_FURTHER = 5  # effects that would gain if they left white noise, at each step of one more climb
_OTHER_CARRIED = 0.2  # change of an effect of accelerations, as a share, that changes the noise
_OTHER_DELAY, _ALIKE = 3.0, 0.125  # deviations, and steps, within which delays are alike


@dataclass(frozen=True, eq=False)
class Found:
    """The most probable explanation that a search found."""

    case: Case  # the case, with the columns of what was tried last
    model: LogModel  # the Gaussian model of its logs
    fit: Fit
    start: Fit  # the model without anything new, with bodies that may move
    is_stopped: bool = False  # whether the search was stopped before its end


def searched(
    case: Case, beliefs: Beliefs | None = None, *, progress: Progress | None = None
) -> Found:
    """Find the most probable explanation of the logs of a case.

    Raises:
        StopSearch: It was stopped before it had found anything.
    """
    return Search(case, beliefs, progress).found()


class Search:
    """A search for what a model lacks, and where it is."""

    def __init__(
        self, case: Case, beliefs: Beliefs | None = None, progress: Progress | None = None
    ) -> None:
        self.case, self._beliefs, self._progress = case, beliefs or Beliefs(), progress
        self._accelerated = dict[Effect, Array]()  # effects by accelerations, with their values
        self._noise_of = case.model, case.loads, self._accelerated  # what gave the noise floor
        self._effects = list(dict.fromkeys(case.dataset.effects))
        self._grid = tuple(self._effects)
        self._origin = case.model.delays
        self._step = float(np.abs(case.dataset.delays[1:, 0]).min(initial=np.inf))
        self._delays: list[ArrayLike] = [*case.dataset.delays]
        self._on_time: Delay = (0,) * len(case.model.joints)
        self._levels = dict[Effect, int]()  # of finer shapes around an effect, that come next
        self._is_timed = False
        self._tried = [self._origin]  # delays (nv,) that have columns: the file's come first
        # Explanations for which speeds, shapes and further effects were looked for.
        self._faded, self._crowded, self._looked = set[Named](), set[Named](), set[Named]()
        self._climbed_far, self._doubted = False, False
        # Loads of explanations that had columns, one after the other: two may lead to each other.
        self._loaded = dict[tuple[Named, float], Array]()
        self._told: FoundStep | None = None
        self.model = self._made()
        self.fit = self._common = self._start()

    def found(self) -> Found:
        """Search to the end."""
        search, is_stopped = self, False
        try:
            self._turn()
            more = proposed(self.case, self.model, self.fit)
            if more:  # before anything else makes up for them
                self._offer(more)
            begun = self._copied()
            self._climb_by_common_first()
            if not self._is_all_common():
                search = self._or_by_all_at_once(begun)
            for _ in range(_MOST_ROUNDS):
                if not search._goes_on():
                    break
            search.fit = settled(search.model, search.fit)
        except StopSearch:
            if not search.fit.terms:
                raise
            is_stopped = True
            if search._progress is not None and search._told is not None:
                search._progress(replace(search._told, is_last=True))
        return Found(search.case, search.model, search.fit, search._start(), is_stopped)

    def _turn(self) -> None:
        """Begin with a base that is mounted otherwise, if that explains most errors."""
        turned = self._with_turned_bases()
        if not turned:
            return
        self._anew()
        terms = [term for term in self.model.terms if term.effect in turned]
        widths = [w for w in self.model.widths if w <= self.model.wrong_beyond]
        choices = [self.model.choice(self.fit.choice, (t,), width=w) for t in terms for w in widths]
        self.fit = self._best(choices, self.fit)

    def _with_turned_bases(self) -> set[Effect]:
        """Try far turns of gravity if they explain most errors; return the turned effects."""
        turned = turned_bases(self.case, self._effects)
        self._effects = [turned.get(effect, effect) for effect in self._effects]
        return {*turned.values()}

    def _copied(self) -> Search:
        """Return a search that goes on from here by itself."""
        other = copy(self)
        for name, value in vars(self).items():
            if isinstance(value, list | dict | set):
                setattr(other, name, copy(value))
        return other

    def _is_all_common(self) -> bool:
        """Return whether only noise is left, bodies are near the file, and all found is common."""
        model, fit = self.model, self.fit
        left = np.sqrt(model.seen_noise(fit)) > NOISE_MARGIN * model.dataset.noise_floor
        near = fit.choice.width <= model.wrong_beyond
        return near and all(map(is_common, fit.terms)) and not left.any()

    def _or_by_all_at_once(self, other: Search) -> Search:
        """Climb from the beginning by all effects at once; return the better search.

        Common effects that came first may be in the way of a rare one.
        """
        other._climb(hopeful=True)
        other._climb(hopeful=False)
        other._keep_bodies_near()
        fewer = np.minimum(self.model.shares(self.fit), other.model.shares(other.fit))
        if other._evidence(fewer) <= self._evidence(fewer):
            return self
        return other if other._held_out_score(fewer) > self._held_out_score(fewer) else self

    def _evidence(self, shares: Array) -> float:
        """Return the evidence of the explanation, where rows are worth some samples (nv,)."""
        return self.model.unbounded(self.fit.choice, shares, self.fit.noise).score

    def _held_out_score(self, shares: Array) -> float:
        """Return twice the logarithm of how probable held-out efforts and what was found are.

        `shares` (nv,) are independent samples over rows, the same for all that is compared. Unlike
        in the evidence, errors where joints reverse count in full, and a term that stands in for an
        inertia gains nothing by having no noise of accelerations. But what a fold leaves unknown
        counts as an error here.
        """
        errors = np.maximum(self.model.held_out(self.fit, reversing=False).mse, self.model.floor)
        samples = shares * self.model.rows
        return -float(samples @ np.log(errors)) - self.model.odds_against(self.fit.choice)

    def forced(
        self, kind: type[Effect], places: Places | None, further: Sequence[Effect] = ()
    ) -> Found:
        """Return the explanation with one effect, whatever the evidence for it.

        Places are all joints if None, or the place that helps most. `further` instances are tried
        beside those that the case has columns for.

        Raises:
            ArgumentError: It is one of an episode, and the residual shows none.
        """
        if kind.role is Role.EPISODE or kind.proposer is Proposer.WAVES:
            further = [e for e in self._suggested() if isinstance(e, kind)] or further
            if kind.role is Role.EPISODE and not further:
                raise ArgumentError(
                    f"These logs show no {kind.name}.",
                    advice="Friction may hide it: explain the logs, or add other missing "
                    "effects first.",
                )
        own, tried = effects_of(self.case.model), (*self._effects, *further)
        self._effects = [e for e in tried if isinstance(e, kind) or e in own]
        self._with_turned_bases()
        self._grid = tuple(self._effects)
        self._anew()
        self.fit = self._with_best(kind, places)
        for _ in range(_MOST_ROUNDS):
            if not self._refined():
                break
            self.fit = self._with_best(kind, places)
        return Found(self.case, self.model, self.fit, self._start())

    def _with_best(self, kind: type[Effect], places: Places | None) -> Fit:
        """Return the most probable fit with one effect at some places, in its best shape."""
        model, was = self.model, self._start()
        if kind.role is Role.DELAY:
            return self._latest(was, places)
        if kind.role is Role.INERTIA:
            wrong = model.beliefs.wrong
            widths = [w for w in model.widths if w > wrong] or [model.widths[-1]]
            choices = [Choice((), width, self._on_time) for width in widths]
            return self._best(choices, was)
        known = [w for w in model.widths if w <= model.wrong_beyond]
        options = dict[tuple[str, ...], list[Term]]()
        for term in model.terms:
            if term.effect is not None and isinstance(term.effect, kind):
                options.setdefault(term.where, []).append(term)
        chosen = options if places is None else {p: options[p] for p in places if p in options}
        single = places is None and kind.places != "joint"
        best = dict[tuple[str, ...], Fit]()
        for place, terms in chosen.items():
            choices = [
                model.choice(was.choice, (term,), width=width) for term in terms for width in known
            ]
            best[place] = self._best(choices, was)
        if single:
            return max(best.values(), key=lambda fit: fit.score)
        together = tuple(fit.terms[0] for fit in best.values())
        return self._best([model.choice(was.choice, together, width=w) for w in known], was)

    def _latest(self, was: Fit, places: Places | None) -> Fit:
        """Return the best delay of all efforts, or of those of each of some joints."""
        fit, every = was, [[*range(len(self._on_time))]]
        if places is not None:
            every = [[self.case.model.joints.index(name)] for (name,) in places]
        for moved in every:
            delays = [
                tuple(k if j in moved else own for j, own in enumerate(fit.choice.delay))
                for k in range(len(self.case.dataset.delays))
            ]
            late = [d for d in delays if any(d[j] != self._on_time[j] for j in moved)]
            fit = self._best([Choice((), was.choice.width, delay) for delay in late], was)
        return fit

    def _best(self, choices: Sequence[Choice], was: Fit) -> Fit:
        """Return the most probable of some explanations, even where it is not physical."""
        shares = np.full(len(self.model.rows), _FORCED_SHARE)
        if ranked := self.model.ranked(choices, shares, was.noise):
            return ranked[0]
        fits = [self.model.unbounded(choice, shares, was.noise) for choice in choices]
        return max(fits, key=lambda fit: fit.score)

    def _suggested(self) -> list[Effect]:
        """Return what the residual suggests: shared actuators, ripples, contacts."""
        found = proposed(self.case, self.model, self.fit)
        hypothesis = self.model.hypothesis(self._without_short_loads())
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
        return [e for e in (*found, *contacts) if e not in self._effects]

    def _without_short_loads(self) -> Fit:
        """Return the explanation without what is held for a short while: it may be a contact."""
        was, model = self.fit, self.model
        kept = [term for term in was.terms if not is_short(self.case, term.effect)]
        if len(kept) == len(was.terms):
            return was
        return model.unbounded(model.choice(was.choice, kept), model.shares(was), was.noise)

    def _start(self) -> Fit:
        """Return the model with nothing new, its bodies as near to the file as the logs say."""
        return self.model.bare(np.full(len(self.model.rows), _FIRST_SHARE))

    def _climb(self, *, hopeful: bool, further: int = 0, common: bool = False) -> None:
        def watch(before: Fit, after: Fit) -> None:
            self.fit = after
            if self._progress is not None:
                self._told = progress_of(self.model, before, after)
                self._progress(self._told)

        visited = list[Named]()  # two explanations may lead to each other, each in its own columns
        while visited.count(self._named) < _MOST_VISITS and len(visited) < _MOST_ROUNDS:
            visited.append(self._named)
            self.fit = climb(
                self.model,
                self.fit,
                hopeful=hopeful,
                watch=watch,
                pause=self._is_coarse if hopeful else self._is_inexact,
                further=further,
                common=common,
            )
            if not self._is_inexact(self.fit):
                break
            # A shape may make up for friction that fades.
            faded = bool(self._finer(self.fit.terms)) and self._fades()
            if not faded and not self._refined():
                break
            shaped = {term.where[0] for term in self.fit.terms if term.effect in self._levels}
            if shaped:  # before anything else makes up for a shape that is not exact
                self.fit = climb(self.model, self.fit, hopeful=hopeful, joints=shaped)

    def _climb_by_common_first(self) -> None:
        """Climb by what any joint may have, and payloads; then by all effects.

        Rare effects of several joints together may take the place of common ones and of a payload,
        most easily where joints move little or one after the other. No single step leads back.
        """
        self._climb(hopeful=True, common=True)
        self._common = self.fit
        self._climb(hopeful=True)
        self._climb(hopeful=False)

    def _keep_bodies_near(self) -> None:
        """Climb once more with bodies near the file, if they are far from it; keep the better.

        Bodies that are free to change may explain an effect by themselves, such as a rotor at the
        first joint. Adding the effect then gains nothing until the bodies are held near the file.
        """
        far, delays, most = self.fit, self._delays_of_fit(), self.model.wrong_beyond
        if far.choice.width <= most:
            return
        near = [width for width in self.model.widths if width <= most]
        self.fit = self._best([replace(far.choice, width=width) for width in near], far)
        self._climb(hopeful=True)
        self._climb(hopeful=False)
        self._keep_more_probable(far, delays)

    def _delays_of_fit(self) -> Array:
        """Return (nv,) delays of the explanation, s."""
        at = [*self.fit.choice.delay], np.arange(len(self._on_time))
        return np.asarray(self.case.model.delays + self.case.dataset.delays[at])

    def _keep_more_probable(self, was: Fit, delays: Array) -> None:
        """Go back to an earlier explanation, of some delays (nv,), unless the new one is better."""
        apart = np.abs(self.case.model.delays + self.case.dataset.delays - delays)
        nearest = tuple(apart.argmin(axis=0).tolist())  # columns may have been made anew since
        was = self.model.refitted(replace(was, choice=replace(was.choice, delay=nearest)))
        better = gain_of(self.model, was, self.fit)
        if better is None or better[0] <= 0.0:
            self.fit = was

    def _is_inexact(self, fit: Fit) -> bool:
        """Return whether what was found is to be made exact before anything else is looked for.

        So it is with other loads, but not in a hopeful climb, in which every step changes them.
        """
        return self._is_coarse(fit) or self._other_loads(fit) is not None

    def _is_coarse(self, fit: Fit) -> bool:
        """Return whether a delay or a slope is about another point, or a shape on a coarse grid.

        The error that this leaves looks like further effects.
        """
        if self._is_between(fit) and self._has_other_delays(fit):
            return True
        if expansions(self.case, self.model, fit):
            return True
        return bool(self._finer(fit.terms))

    def _made(self) -> LogModel:
        """Return the Gaussian model of the case with columns for all that is tried."""
        model, logs = self.case.model, self.case.trajectories
        unsure = reversals(model, logs)
        own = effects_of(model)
        self._effects = [e for e in self._effects if e in own or is_resolved(e, unsure)]
        columns = [*self._effects, *unsure]
        noise_of, robot = (model, self.case.loads, self._accelerated), None
        if any(one is not other for one, other in zip(noise_of, self._noise_of, strict=True)):
            carried = (FittedEffect(*each) for each in self._accelerated.items())
            robot = replace(self.case.load_model, effects=(*model.effects, *carried))
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

    def _anew(self, moved: dict[Effect, Effect] | None = None, *, retimed: bool = False) -> None:
        """Make columns for what is tried now, and carry the explanation over.

        `moved` are effects that others take the place of, and `retimed` tells whether the model has
        the delays of the explanation now.
        """
        self.model, was = self._made(), self.fit
        terms = self.model.alike(was.terms, moved)
        delay = was.choice.delay
        if retimed:
            delay = tuple(
                np.where(
                    np.abs(self.case.model.delays - self._origin) < 1e-9, self._on_time, 0
                ).tolist()
            )
        shares = np.full(len(self.model.rows), _FORCED_SHARE)
        for kept in (terms, [term for term in terms if not len(term.positive)]):
            choice = self.model.choice(was.choice, kept, delay=delay)
            fit = self.model.fit(choice, shares, was.noise)
            if fit is not None:
                break
        self.fit = fit or self._start()  # something became negative

    def _offer(self, more: Sequence[Effect]) -> None:
        """Try more effects from now on."""
        self._loaded.clear()
        self._effects += more
        self._grid = (*self._grid, *more)
        self._anew()

    def _has_more(self) -> bool:
        """Climb with what the residual suggests; return whether there is anything to climb with.

        What was found may have followed an episode, so that it is found anew with it. Episodes
        alone change nothing unless they make something more probable.
        """
        before = self.case, self.model, self.fit, [*self._effects], self._grid
        more = self._suggested()
        if not more:
            return False
        self._offer(more)
        was, delays = self.fit, self._delays_of_fit()
        episodes = [effect for effect in more if effect.role is Role.EPISODE]
        common = self.model.refitted(self._common)
        helps = may_come(self.model, was, more) or may_come(self.model, common, episodes)
        if not helps and len(episodes) == len(more):
            self.case, self.model, self.fit, self._effects, self._grid = before
            return False
        if not episodes:
            self._climb(hopeful=True)
            self._climb(hopeful=False)
            return True
        self.fit = self._start()
        try:
            self._climb_by_common_first()
        finally:  # a stop keeps the best explanation so far
            self._keep_more_probable(was, delays)
        return True

    def _goes_on(self) -> bool:
        """Make exact what was found, or find more to try; whether there is anything to search."""
        if self._refined() or self._fades() or self._simplified():
            self._climb(hopeful=False)
            return True
        if self._named not in self._looked:  # the last digits of a contact differ each time
            self._looked.add(self._named)
            if self._has_more():
                return True
        before = self.fit.choice.key
        if not self._doubted:
            self._doubted = True
            joints = self._doubtful()
            if not joints:
                return False
            functions = unknown_functions(self.case, self.model.hypothesis(self.fit), joints)
            self._effects += functions
            self._anew()
            before = self.fit.choice.key
            self._climb(hopeful=False)
            kept = {term.effect for term in self.fit.terms}  # others get no columns anew
            self._effects = [e for e in self._effects if e in kept or e not in functions]
            if self.fit.choice.key != before:
                return True
        if not self._climbed_far:
            self._climbed_far = True
            if any(term.effect and term.effect not in self._effects for term in self.model.terms):
                self._anew()
                before = self.fit.choice.key
            self._climb(hopeful=False, further=_FURTHER)
        return self.fit.choice.key != before

    @property
    def _named(self) -> Named:
        return _names(self.fit)

    def _doubtful(self) -> set[str]:
        """Return joints with more than noise left, or with something found at their motors."""
        left = np.sqrt(self.fit.variance) > NOISE_MARGIN * self.case.dataset.noise_floor
        effects = [term.effect for term in self.fit.terms]
        felt = [self.case.dataset.felt(e) for e in effects if e is not None and e.at_motor]
        joints = np.logical_or.reduce([left, *felt])
        model = self.case.model  # nothing acts in the joints of a free base
        return {model.joints[j] for j in np.flatnonzero(joints)} - set(model.base_joints)

    def _refined(self) -> bool:
        """Return whether delays, shapes, slopes or loads were made anew."""
        retimed = self._retimed()
        changed = retimed
        shaped = (*self.fit.terms, *other_choices(self.model, self.fit, self._grid))
        near = self._finer(shaped)
        self._levels |= near
        self._effects += [effect for effect in near if effect not in self._effects]
        moved = expansions(self.case, self.model, self.fit)
        moved |= instants(self.case, self.model, self.fit)
        if moved:
            self._effects = [moved.get(effect, effect) for effect in self._effects]
            self._levels = {moved.get(e, e): level for e, level in self._levels.items()}
        loads = self._other_loads(self.fit)
        changed |= self._has_other_noise()
        if changed or near or moved:
            self._loaded.clear()
        if loads is not None:
            self.case = replace(self.case, loads=loads)
            self._loaded[(_names(self.fit), self.fit.choice.width)] = loads
        if changed or near or moved or loads is not None:
            self._anew(moved, retimed=retimed)
            return True
        return False

    def _finer(self, terms: Sequence[Term]) -> dict[Effect, int]:
        """Return each term's shape and the untried ones around it, by the level to try next."""
        found = dict[Effect, int]()
        for effect in (term.effect for term in terms if term.effect is not None):
            level = self._levels.get(effect, 0)
            near, level = finer_shapes(effect, self._grid, self._effects, level)
            found |= dict.fromkeys([effect, *near], level) if near else {}
        return found

    def _has_other_noise(self) -> bool:
        """Return whether other effects than before carry noise of accelerations into efforts."""
        model, own = self.model, set(effects_of(self.case.model))
        found = {
            term.effect: model.parameters(self.fit, term)
            for term in self.fit.terms
            if term.effect and term.effect.depends_on == {"vd"} and term.effect not in own
        }
        was = self._accelerated
        if was.keys() == found.keys() and all(
            np.allclose(was[e], x, rtol=_OTHER_CARRIED, atol=0.0) for e, x in found.items()
        ):
            return False
        self._accelerated = found
        return True

    def _other_loads(self, fit: Fit) -> Array | None:
        """Return the loads (nb, 10) of a fit if what scales with them is to be made anew."""
        effects = [term.effect for term in fit.terms if not term.is_body]
        loaded = any(e and "load" in e.depends_on for e in effects)
        if not loaded and not self.case.dataset.gain_uncertainty.any():
            return None
        return fitted_loads(
            self.case, self.model, fit, self._loaded.get((_names(fit), fit.choice.width))
        )

    def _simplified(self) -> bool:
        """Offer finer shapes of one effect for crowded joints; return whether any was new."""
        if self._named in self._crowded:
            return False
        self._crowded.add(self._named)
        offered = False
        for level in range(LEVELS):
            single = [term.effect for term in alone(self.model, self.fit) if term.effect]
            finer = [finer_shapes(e, self._grid, self._effects, level)[0] for e in single]
            if any(finer):
                self._effects += chain.from_iterable(finer)
                self._anew()
                offered = True
        return offered

    def _fades(self) -> bool:
        """Return whether dry friction fades at other speeds than assumed, as fits the finding."""
        if len(self._faded) >= _MOST_FADINGS or self._named in self._faded:
            return False
        self._faded.add(self._named)
        speeds = fading_speeds(self.case, self.model, self.fit)
        if speeds is None:
            return False
        faded = replace(self.case.model, fading_speed=speeds)
        self.case = replace(self.case, model=faded)
        self._anew()
        return True

    def _is_between(self, fit: Fit) -> bool:
        """Return whether a joint has a delay of the grid, about which it was not made exact."""
        return max(fit.choice.delay) >= len(self._tried)

    def _has_other_delays(self, fit: Fit) -> bool:
        """Return whether a joint has another delay than those that have columns."""
        seconds, deviations = delays_of(self.model, fit)
        apart = np.abs(self.case.model.delays + seconds - np.array(self._tried)).min(axis=0)
        known = np.where(np.isfinite(deviations), deviations, 0.0)
        return bool(np.any(apart > np.maximum(_OTHER_DELAY * known, _ALIKE * self._step)))

    def _retimed(self) -> bool:
        """Advance the efforts by the delay that was found, if it is another one than before."""
        delay, model = self.fit.choice.delay, self.case.model
        if not self._is_timed and delay == self._on_time:
            return False
        if not self._has_other_delays(self.fit):
            return False
        seconds, deviations = delays_of(self.model, self.fit)
        lags = fitted_delays(model.delays + seconds, model.joints)
        kept = [each for each in model.effects if each.effect.parameters]
        self.case = replace(self.case, model=replace(model, effects=(*kept, *lags)))
        half = 0.25 * self._step if self._is_timed else 0.5 * self._step
        grid = np.unique(np.concatenate([self._step * np.arange(-3, 4), [half, -half]]))
        others: list[ArrayLike] = [x for x in grid.tolist() if abs(x) > 1e-12]
        found = self.case.model.delays
        known = [delays - found for delays in self._tried]
        common = common_delay(found - self._origin, deviations)
        if common is not None:  # joints that show none by themselves may have it, too
            near = grid[np.abs(grid) <= self._step]
            others += [self._origin + common + x - found for x in near.tolist()]
        self._delays = [0.0, *known, *others]
        self._tried.append(found)
        self._on_time = (1,) * len(delay)
        self._is_timed = True
        return True


def _names(fit: Fit) -> Named:
    """Return what was found, which columns that are made anew do not change."""
    return frozenset(term.effect or term.key for term in fit.terms)
