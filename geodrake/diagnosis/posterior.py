"""Probabilities of findings: sums over the explanations that contain them.

The explanations are the most probable one and its neighbours, at each width of the bodies. Each is
weighted by its evidence and prior odds, residuals counted alike. So probabilities add up, and what
was adopted is the most probable.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.log_model import Choice, Fit, LogModel
from geodrake.diagnosis.moves import neighbours, other_widths
from geodrake.diagnosis.terms import Key, Term, names_and_places

Array = NDArray[np.float64]

_MOST = 60
_FAR = 25.0
"""Neighbours whose scores are lower by more are not tried with other widths of the bodies."""
_HOPELESS = 60.0
"""Nor is a width, where it and the change lower the score of the explanation by more together."""
_LEAST = 0.01
"""Rivals are told from this probability on."""


@dataclass(frozen=True)
class Instead:
    """Alternative to a finding in other explanations."""

    effect: str  # name; several joined by " + "
    where: tuple[str, ...]
    probability: float  # sum over the explanations that have it in the place of the finding
    nrms: float  # error of the most probable of them, as `Fit.variance`, over efforts' deviations
    fit: Fit  # the most probable of them


@dataclass(frozen=True)
class Certainty:
    """Probability of a finding."""

    probability: float  # sum over explanations that have all of it
    chance: float  # sum over those that have nothing in its place
    rivals: tuple[Instead, ...]  # what else stands in its place, the most probable first


class Posterior:
    """The most probable explanation and its neighbours, with their probabilities."""

    def __init__(self, model: LogModel, fit: Fit) -> None:
        model.level_noise(fit)
        shares = model.shares(fit)
        own = model.unbounded(fit.choice, shares, fit.noise)
        fits = {own.choice.key: own}

        def add(choices: Iterable[Choice]) -> None:
            new = {choice.key: choice for choice in choices if choice.key not in fits}
            found = {key: model.fit(choice, shares, fit.noise) for key, choice in new.items()}
            fits.update({key: each for key, each in found.items() if each is not None})

        add(neighbours(model, fit, most=_MOST))
        likely = [each for each in fits.values() if each.score > own.score - _FAR]
        alone = {w: fits.get((*own.choice.key[:1], w, *own.choice.key[2:])) for w in model.widths}
        apart = {w: own.score - each.score for w, each in alone.items() if each is not None}
        add(
            other
            for each in likely
            for other in other_widths(model, each.choice)
            if each.score - apart.get(other.width, 0.0) > own.score - _HOPELESS
        )
        self._model, self._fit, self._fits = model, fit, [*fits.values()]
        scores = np.array([model.lead(each, own, shares) for each in self._fits])
        weights = np.exp(0.5 * (scores - scores.max())) * self._shares_of_shapes(scores)
        self._weights = weights / weights.sum()

    def _shares_of_shapes(self, scores: Array) -> Array:
        """Return factors (m,) by which explanations count that differ only in shapes.

        The prior odds of a shape are those of all values near it, however many of them were tried.
        So all shapes of an effect at a place count together as the most probable one. Shapes that
        the logs tell apart weigh little beside it.
        """
        which, seen = dict[Term, tuple[object, int]](), dict[object, int]()
        for term in self._model.terms:  # each prior of an effect is an explanation of its own
            own: object = term.effect or term.where
            seen[own] = seen.get(own, -1) + 1
            which[term] = term.key, seen[own]
        alike = dict[object, list[int]]()
        for k, fit in enumerate(self._fits):
            shapeless = frozenset(which[term] for term in fit.terms), *fit.choice.key[1:]
            alike.setdefault(shapeless, []).append(k)
        shares = np.ones(len(scores))
        for members in alike.values():
            weights = np.exp(0.5 * (scores[members] - scores[members].max()))
            shares[members] = 1.0 / weights.sum()
        return shares

    def of_terms(self, terms: Sequence[Term]) -> Certainty:
        """Return the joint probability of some terms of the explanation."""
        keys = {term.key for term in terms}
        return self._certainty([keys <= _keys(fit) for fit in self._fits], keys)

    def of_delay(self) -> Certainty:
        """Return the probability of the delays that were found."""
        model = self._model
        has = [model.are_apart(fit.choice.delay, model.on_time) for fit in self._fits]
        return self._certainty(has, set())

    def of_bodies(self) -> Certainty:
        """Return the probability that bodies differ from the file by more than its errors."""
        least = self._model.widths[0]
        return self._certainty([fit.choice.width > least for fit in self._fits], set())

    def of_loads(self) -> dict[str, float]:
        """Return the probability of further payloads, by body."""
        own, loads = _keys(self._fit), dict[str, float]()
        for fit, weight in zip(self._fits, self._weights.tolist(), strict=True):
            more = [term for term in fit.terms if term.is_whole and term.key not in own]
            for term in more if own <= _keys(fit) else ():
                loads[term.where[0]] = loads.get(term.where[0], 0.0) + weight
        return {body: p for body, p in loads.items() if p >= _LEAST}

    def _certainty(self, has: list[bool], keys: set[Key]) -> Certainty:
        own, chance = _keys(self._fit), 0.0
        groups = dict[tuple[str, tuple[str, ...]], list[tuple[float, Fit]]]()
        for fit, weight, there in zip(self._fits, self._weights.tolist(), has, strict=True):
            instead = [term for term in fit.terms if term.key not in own]
            if instead and not there:
                groups.setdefault(names_and_places(instead), []).append((weight, fit))
            elif not there:
                chance += weight
        sums = {key: sum(weight for weight, _ in group) for key, group in groups.items()}
        chance += sum(p for p in sums.values() if p < _LEAST)
        rivals = list[Instead]()
        for key, p in sums.items():
            if p >= _LEAST:
                best = max((fit for _, fit in groups[key]), key=lambda fit: fit.score)
                rivals.append(Instead(*key, p, nrms_of(self._model, best), best))
        rivals.sort(key=lambda rival: -rival.probability)
        return Certainty(float(self._weights[np.array(has)].sum()), chance, tuple(rivals))


def _keys(fit: Fit) -> set[Key]:
    return {term.key for term in fit.terms}


def nrms_of(model: LogModel, fit: Fit) -> float:
    """Return the RMS over joints of a fit's error over the deviation of the efforts."""
    deviation = model.dataset.effort_std
    moving = deviation > 0.0
    return float(np.sqrt(np.mean(fit.variance[moving] / np.square(deviation[moving]))))
