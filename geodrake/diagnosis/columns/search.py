"""The search for mistakes in columns: the likeliest is corrected, and the rest judged anew."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterable, Set
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.evidence import ColumnFit, ColumnModel
from geodrake.diagnosis.columns.first_look import FirstLook
from geodrake.diagnosis.columns.limits import nearest_limit
from geodrake.diagnosis.columns.mistakes import Mistake, Mistakes
from geodrake.model.motor_limit import MotorLimit

Array = NDArray[np.float64]

_GAINS = ("effort_gains", "effort_gain", "effort_unit", "effort_sign")
_MOST = 6  # mistakes of a log
_SCREENED, _FINALISTS = 24, 8  # of motion and of efforts, that are fitted, and to the end
_HOPELESS = -12.0  # score beside that of no mistake: less is not fitted to the end
_PROMISING = 4  # joints whose gains, zeros or unknown efforts are looked for
_STEPS = 8  # of a fit of a mistake's sizes
_TIE = 1e-6  # less is rounding
_CLOSE = 1e-3  # rad or share: a step that ends it
_LONGEST = 0.7  # rad, or of a logarithm, of a step


@dataclass(frozen=True, eq=False)
class Judged:
    """A mistake, the fit without it, and what its rarity costs."""

    mistake: Mistake
    fit: ColumnFit
    price: float

    @property
    def score(self) -> float:
        """Return twice the logarithm of the evidence and of the prior odds."""
        return self.fit.score - self.price


@dataclass(frozen=True, eq=False)
class MistakeFound:
    """A step of the search.

    Attributes:
        before: The fit with the mistake.
        best: The mistake.
        gain: Twice the logarithm of its odds against none.
        probability: That of the mistake, among it, none and all others.
        rivals: Others with their probabilities, the likeliest first.
    """

    before: ColumnFit
    best: Judged
    gain: float
    probability: float
    rivals: tuple[tuple[Judged, float], ...]


class ColumnSearch:
    """A search on the samples of logs."""

    def __init__(self, model: ColumnModel) -> None:
        self.model = model
        self._first_look = FirstLook(model)

    def found(self) -> list[MistakeFound]:
        """Return mistakes, one after the other; those without a kind are none of columns."""
        model, steps, settled = self.model, list[MistakeFound](), set[Hashable]()
        base = model.fit(Assignment.as_named(len(model.parameters.model.joints)), model.hopeful())
        for _ in range(_MOST + 2 * len(base.mse)):
            step = self._step(base, settled)
            if step is None or sum(bool(each.best.mistake.kind) for each in steps) == _MOST:
                break
            if _take(steps, step):
                settled.add(_place(step.best))
            base, found = step.best.fit, step.best.fit.assignment
            if step.best.mistake.kind and found.apart | found.unknown:
                # What seemed unknown before may be another mistake beside this one.
                known = replace(found, apart=frozenset(), unknown=frozenset())
                base = model.fit(known, model.hopeful(), base)
        return self._together(steps, base)

    def _together(self, steps: list[MistakeFound], end: ColumnFit) -> list[MistakeFound]:
        """Return gains that were found one by one as one mistake, where that is more probable."""
        gains = [step for step in steps if step.best.mistake.kind == "effort_gain"]
        if len(gains) < 2:
            return steps
        model, first, after = self.model, gains[0], end.assignment
        ratio, at = after.gain / first.before.assignment.gain, model.parameters.gains()
        if (ratio <= 0.0).any() or (after.effort != first.before.assignment.effort).any():
            return steps
        moved = np.zeros(len(end.x))
        moved[at] = -np.log(ratio)
        mistake = Mistake("effort_gains", (), after, tuple(at.tolist()), moved)
        prices = self._priced(first.before).items()
        price = next((price for m, price in prices if m.kind == "effort_gains"), np.inf)
        worth = model.worth(end)
        one = self._again(Judged(mistake, end, price), worth)
        plain = model.fit(first.before.assignment, worth, first.before)
        if one.score - plain.score <= sum(step.gain for step in gains):
            return steps
        chance = 1.0 / (1.0 + np.exp(-0.5 * min(one.score - plain.score, 1e3)))
        found = replace(first, best=one, gain=one.score - plain.score, probability=float(chance))
        return [found if step is first else step for step in steps if step not in gains[1:]]

    def _step(self, base: ColumnFit, settled: Set[Hashable]) -> MistakeFound | None:
        """Return the most probable mistake beside those of a fit; None if none is."""
        model, worth, prices = self.model, self.model.hopeful(), self._priced(base)
        first = [self._judged(m, base, worth, prices[m]) for m in self._promising(prices, base)]
        first += [self._moved(each, worth) for each in first if each.mistake.free]
        places = dict[Hashable, Judged]()
        for each in sorted(first, key=_score, reverse=True):
            if each.mistake.kind and _place(each) in settled:
                continue
            places.setdefault((_place(each), each.mistake.sizes), each)
        plain = model.fit(base.assignment, worth, base)
        least = plain.score + _HOPELESS
        mistaken = [each for each in places.values() if each.mistake.kind and each.score > least]
        last = [self._refined(each, base, worth) for each in mistaken[:_FINALISTS]]
        if not any(each.score > plain.score for each in last):
            return None
        # With few independent samples, what is no mistake may be likelier than it looks at first.
        others = [each for each in places.values() if not each.mistake.kind]
        last += [self._refined(each, base, worth) for each in others]
        # Probabilities are told by the samples that the residuals of the answer are worth.
        best, of_base = max(last, key=_score), model.worth(base)
        for _ in range(2):
            told = best
            worth = np.where(best.fit.mse < plain.mse, model.worth(best.fit), of_base)
            last = [self._again(each, worth) for each in last]
            best, plain = max(last, key=_score), model.fit(base.assignment, worth, base)
            if _place(best) == _place(told):
                break
        if best.score <= plain.score + _TIE:
            return None
        weights = np.exp(0.5 * np.array([min(each.score - best.score, 0.0) for each in last]))
        total = weights.sum() + np.exp(0.5 * (plain.score - best.score))
        chances = dict(zip(last, (weights / total).tolist(), strict=True))
        same = [each for each in last if _place(each) == _place(best)]
        others = sorted((each for each in last if each not in same), key=lambda each: -each.score)
        return MistakeFound(
            base,
            best,
            best.score - plain.score,
            sum(chances[each] for each in same),
            tuple((each, chances[each]) for each in others),
        )

    def _priced(self, base: ColumnFit) -> dict[Mistake, float]:
        """Return everything that may be wrong beside a fit, with what its rarity costs."""
        mistakes = Mistakes(self.model, base).all()
        return dict(zip(mistakes, _prices(mistakes, self.model.beliefs), strict=True))

    def _promising(self, mistakes: Collection[Mistake], base: ColumnFit) -> list[Mistake]:
        """Return the mistakes that are worth a fit."""
        worth, is_likely = self.model.hopeful(), self._likely(base)
        found, motion = [m for m in mistakes if not m.is_seen and is_likely(m)], base.assignment
        seen = [mistake for mistake in mistakes if mistake.is_seen]
        seen.sort(key=lambda each: -self._first_look.score(each.assignment, worth))
        moved = [m for m in seen if m.assignment.motion_key != motion.motion_key]
        others = [m for m in seen if m not in moved and is_likely(m)]
        return [*found, *moved[:_SCREENED], *others[:_SCREENED]]

    def _likely(self, base: ColumnFit) -> Callable[[Mistake], bool]:
        """Return a test of what the errors of a fit make likely."""
        parameters = self.model.parameters
        far = np.abs(base.x) * np.sqrt(np.diag(parameters.information))
        ends = (parameters.zeros(), parameters.gains())
        sizes = {k for at in ends for k in at[np.argsort(-far[at])[:_PROMISING]].tolist()}
        errors = (base.mse / np.maximum(self.model.noise, 1e-300) ** 2)[base.assignment.effort]
        joints = set(np.argsort(-errors)[:_PROMISING].tolist())

        def is_likely(mistake: Mistake) -> bool:
            if len(mistake.free) == 1:
                return mistake.free[0] in sizes
            return not mistake.joints or not joints.isdisjoint(mistake.joints)

        return is_likely

    def _judged(
        self, mistake: Mistake, near: ColumnFit | None, worth: Array, price: float
    ) -> Judged:
        moved = mistake.moved if len(mistake.moved) else None
        fit = self.model.fit(mistake.assignment, worth, near, wide=mistake.free, moved=moved)
        return Judged(mistake, fit, price)

    def _again(self, judged: Judged, worth: Array) -> Judged:
        """Judge a mistake by other samples, by the better of two fits that begin differently."""
        mistake, price = judged.mistake, judged.price
        fits = [self._judged(mistake, near, worth, price) for near in (judged.fit, None)]
        return max(fits, key=_score)

    def _refined(self, judged: Judged, base: ColumnFit, worth: Array) -> Judged:
        """Return a mistake of the sizes that fit best."""
        mistake = judged.mistake
        if mistake.kind == "effort_limit":
            mistake = self._of_nearest_limit(mistake, base, worth)
        elif mistake.kind == "effort_magnitude":
            mistake = self._of_likely_signs(judged, worth)
        elif mistake.free:
            mistake = self._of_nearest_sizes(judged, worth)
        return self._judged(mistake, base, worth, judged.price)

    def _of_nearest_sizes(self, judged: Judged, worth: Array) -> Mistake:
        """Return the mistake moved to where the errors of its sizes vanish."""
        best, step = judged, self._way(judged)
        for _ in range(_STEPS):
            if np.abs(step).max() < _CLOSE:
                break
            tried = self._judged(self._by(best.mistake, step), best.fit, worth, best.price)
            if tried.score > best.score:
                best, step = tried, self._way(tried)
            else:
                step = 0.5 * step
        return best.mistake

    def _moved(self, judged: Judged, worth: Array) -> Judged:
        """Return a mistake moved by one step: what it explains may show only there."""
        mistake = self._by(judged.mistake, self._way(judged))
        return self._judged(mistake, judged.fit, worth, judged.price)

    def _way(self, judged: Judged) -> Array:
        """(p,) step of Newton's method in the sizes of a mistake."""
        free, x = list(judged.mistake.free), judged.fit.x
        step = np.zeros(len(x))
        step[free] = np.clip(x[free], -_LONGEST, _LONGEST)
        return step

    def _by(self, mistake: Mistake, step: Array) -> Mistake:
        """Return a mistake whose sizes are moved by a step (p,)."""
        parameters, start = self.model.parameters, mistake.assignment
        zeros, gains, tilt = parameters.zeros(), parameters.gains(), parameters.tilt()
        moved = replace(start, zero=start.zero + step[zeros], gain=start.gain / np.exp(step[gains]))
        if step[tilt].any():
            moved = moved.leaning(parameters.model.tree.gravity, step[tilt])
        return replace(mistake, assignment=moved, moved=mistake.moved + step)

    def _of_likely_signs(self, judged: Judged, worth: Array) -> Mistake:
        """Return the mistake with the signs that bodies and effects need."""
        model, mistake, fit = self.model, judged.mistake, judged.fit
        for _ in range(_STEPS):
            start = mistake.assignment
            signs, needed = {**start.signs}, model.needed(fit)
            for j in mistake.joints:
                source = int(start.effort[j])
                signs[source] = signs[source].copy()
                signs[source][model.designs(start)[j].rows] = np.where(needed[j] < 0.0, -1.0, 1.0)
            mistake = replace(mistake, assignment=replace(start, signs=signs))
            fit = model.fit(mistake.assignment, worth, fit)
        return mistake

    def _of_nearest_limit(self, mistake: Mistake, base: ColumnFit, worth: Array) -> Mistake:
        """Return the limit of its kind with the most evidence."""
        (j,), start = mistake.joints, mistake.assignment

        def cost(limit: MotorLimit) -> float:
            return -self.model.fit(start.limited(j, limit), worth, base).score

        return replace(mistake, assignment=start.limited(j, nearest_limit(start.limit_of(j), cost)))


def _take(steps: list[MistakeFound], step: MistakeFound) -> bool:
    """Add a step, or correct a former one; return whether it is one that was found before.

    Gains that are corrected again are one mistake with the former.
    """
    for k, former in enumerate(steps):
        is_gain = former.best.mistake.kind == "effort_gains" and step.best.mistake.kind in _GAINS
        is_again = step.best.mistake.kind and _place(former.best) == _place(step.best)
        if is_gain or is_again:
            best = replace(former.best, fit=step.best.fit)
            least = min(former.probability, step.probability)
            steps[k] = replace(former, best=best, gain=former.gain + step.gain, probability=least)
            return True
    steps.append(step)
    return False


def _score(judged: Judged) -> float:
    return judged.score


def _place(judged: Judged) -> Hashable:
    """Return what two hypotheses have in common that differ by their sizes alone."""
    mistake, fitted = judged.mistake, judged.fit.assignment
    if mistake.kind:
        return mistake.kind, mistake.joints
    return fitted.carrying, fitted.tilted, fitted.unknown, fitted.apart


def _prices(mistakes: Iterable[Mistake], beliefs: Beliefs) -> list[float]:
    """Return −2 log prior odds: all kinds are equally likely, and so are the places of each.

    A payload or a slope is as likely as not; unknown efforts have odds of their own.
    """
    places = dict[str, set[tuple[int, ...]]]()
    for mistake in mistakes:
        places.setdefault(mistake.kind, set()).add(mistake.joints)
    kinds = len(places.keys() - {""})
    joints = max(1, len(places.get("", {()})) - 1)
    found = []
    for mistake in mistakes:
        odds = beliefs.columns / (kinds * len(places[mistake.kind]))
        if not mistake.kind:
            odds = beliefs.odd_joint / joints if mistake.joints else 1.0
        found.append(2.0 * (np.log(mistake.sizes) - np.log(odds)))
    return found
