"""Probabilities of findings, as sums over the explanations that contain them.

The explanations are the most probable one and its neighbours, at each width of the bodies, weighted
by evidence and prior odds with equal sample sizes. Probabilities therefore add up, and the adopted
explanation is the most probable.
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
"""Largest score deficit of a neighbour to be tried with other widths of the bodies."""
_HOPELESS = 60.0
"""Largest sum of the score deficits of a neighbour and of a width, for both to be tried."""
_LEAST = 0.01
"""Least probability of a reported rival."""


@dataclass(frozen=True)
class RivalFit:
    """Alternative to a finding in other explanations."""

    effect: str  # name; several joined by " + "
    where: tuple[str, ...]
    probability: float  # sum over the explanations with it in place of the finding
    nrms: float  # error of the most probable of them, relative to the efforts' deviations
    fit: Fit  # the most probable of them


@dataclass(frozen=True)
class Certainty:
    """Probability of a finding."""

    probability: float  # sum over explanations that contain all of it
    chance: float  # sum over those with nothing in its place
    rivals: tuple[RivalFit, ...]  # alternatives in its place, the most probable first


class Posterior:
    """The most probable explanation and its neighbours, with their probabilities."""

    def __init__(self, model: LogModel, fit: Fit) -> None:
        model.level_noise(fit)
        shares = model.shares(fit)
        best = model.unbounded(fit.choice, shares, fit.noise)
        fits = {best.choice.key: best}

        def add(choices: Iterable[Choice]) -> None:
            new = {choice.key: choice for choice in choices if choice.key not in fits}
            fitted = {key: model.fit(choice, shares, fit.noise) for key, choice in new.items()}
            fits.update({key: each for key, each in fitted.items() if each is not None})

        add(neighbours(model, fit, most=_MOST))
        likely = [each for each in fits.values() if each.score > best.score - _FAR]
        terms, _, delay = best.choice.key
        wider = {width: fits.get((terms, width, delay)) for width in model.widths}
        deficits = {w: best.score - each.score for w, each in wider.items() if each is not None}
        add(
            other
            for each in likely
            for other in other_widths(model, each.choice)
            if each.score - deficits.get(other.width, 0.0) > best.score - _HOPELESS
        )
        self._model, self._fit, self._fits = model, fit, [*fits.values()]
        scores = np.array([model.lead(each, best, shares) for each in self._fits])
        weights = np.exp(0.5 * (scores - scores.max())) * self._shares_of_shapes(scores)
        self._weights = weights / weights.sum()

    def _shares_of_shapes(self, scores: Array) -> Array:
        """Return factors (m,) that make explanations with different shapes count as one.

        The prior odds of a shape are those of all values near it, however many were tried. All
        shapes of an effect at a place therefore count together as the most probable one. Shapes
        that the logs can distinguish have little weight.
        """
        indices, counts = dict[Term, tuple[object, int]](), dict[object, int]()
        for term in self._model.terms:  # different priors of an effect are distinct explanations
            effect: object = term.effect or term.where
            counts[effect] = counts.get(effect, -1) + 1
            indices[term] = term.key, counts[effect]
        groups = dict[object, list[int]]()
        for k, fit in enumerate(self._fits):
            shapeless = frozenset(indices[term] for term in fit.terms), *fit.choice.key[1:]
            groups.setdefault(shapeless, []).append(k)
        shares = np.ones(len(scores))
        for members in groups.values():
            weights = np.exp(0.5 * (scores[members] - scores[members].max()))
            shares[members] = 1.0 / weights.sum()
        return shares

    def of_terms(self, terms: Sequence[Term]) -> Certainty:
        """Return the joint probability of some terms of the explanation."""
        keys = {term.key for term in terms}
        return self._certainty([keys <= _keys(fit) for fit in self._fits], keys)

    def of_delay(self) -> Certainty:
        """Return the probability of the fitted delays."""
        model = self._model
        has = [model.delays_differ(fit.choice.delay, model.on_time) for fit in self._fits]
        return self._certainty(has, set())

    def of_bodies(self) -> Certainty:
        """Return the probability that bodies differ from the file by more than its tolerance."""
        least = self._model.widths[0]
        return self._certainty([fit.choice.width > least for fit in self._fits], set())

    def of_loads(self) -> dict[str, tuple[float, Fit]]:
        """Return the probability of a further payload, by body, and the most probable fit with it.

        Only payloads beside all terms of the explanation count.
        """
        keys, fits = _keys(self._fit), dict[str, list[tuple[float, Fit]]]()
        for fit, weight in zip(self._fits, self._weights.tolist(), strict=True):
            added = [term for term in fit.terms if term.is_whole and term.key not in keys]
            for term in added if keys <= _keys(fit) else ():
                fits.setdefault(term.where[0], []).append((weight, fit))
        loads = {
            body: (sum(p for p, _ in each), max(each, key=lambda pair: pair[0])[1])
            for body, each in fits.items()
        }
        return {body: load for body, load in loads.items() if load[0] >= _LEAST}

    def _certainty(self, has: list[bool], keys: set[Key]) -> Certainty:
        keys_of_fit, chance = _keys(self._fit), 0.0
        groups = dict[tuple[str, tuple[str, ...]], list[tuple[float, Fit]]]()
        for fit, weight, contains in zip(self._fits, self._weights.tolist(), has, strict=True):
            instead = [term for term in fit.terms if term.key not in keys_of_fit]
            if instead and not contains:
                groups.setdefault(names_and_places(instead), []).append((weight, fit))
            elif not contains:
                chance += weight
        sums = {key: sum(weight for weight, _ in group) for key, group in groups.items()}
        chance += sum(p for p in sums.values() if p < _LEAST)
        rivals = list[RivalFit]()
        for key, p in sums.items():
            if p >= _LEAST:
                best = max((fit for _, fit in groups[key]), key=lambda fit: fit.score)
                rivals.append(RivalFit(*key, p, nrms_of(self._model, best), best))
        rivals.sort(key=lambda rival: -rival.probability)
        return Certainty(float(self._weights[np.array(has)].sum()), chance, tuple(rivals))


def _keys(fit: Fit) -> set[Key]:
    return {term.key for term in fit.terms}


def nrms_of(model: LogModel, fit: Fit) -> float:
    """Return the RMS over joints of a fit's errors, relative to the efforts' deviations."""
    deviation = model.dataset.effort_std
    moving = deviation > 0.0
    return float(np.sqrt(np.mean(fit.variance[moving] / np.square(deviation[moving]))))
