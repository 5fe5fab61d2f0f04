"""The search for mistakes in columns: the likeliest is corrected, and the rest judged anew."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Set
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.evidence import ColumnFit, ColumnModel
from geodrake.diagnosis.columns.first_look import FirstLook
from geodrake.diagnosis.columns.kinds import KINDS
from geodrake.diagnosis.columns.mistakes import DIGITS, Mistake, Mistakes

Array = NDArray[np.float64]
Place = tuple[object, ...]

_MOST = 6  # mistakes of a log
_SCREENED, _FINALISTS = 24, 8  # of motion and of efforts, that are fitted, and to the end
_HOPELESS = -12.0  # score beside that of no mistake: less is not fitted to the end
_HOPELESS_FOR_GOOD = -1.0  # the same for each sample: less is not tried again before a correction
_FAR = -60.0  # score beside the best: less is not judged by other samples again
_PROMISING = 4  # joints whose gains, zeros or unknown efforts are looked for
_STEPS = 8  # of a fit of a mistake's sizes
_LEAST_SHARE = 0.05  # of a step, that is tried where more of it is no better
_TIE = 1e-6  # less is rounding
_LEVEL = 0.5  # a step that loses less is taken: scores are exact where no step is left


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
    """A step of the search."""

    before: ColumnFit  # the fit with the mistake
    best: Judged  # the mistake
    gain: float  # twice the logarithm of its odds against none
    probability: float  # that of the mistake, among it, none and all others
    rivals: tuple[tuple[Judged, float], ...]  # others with their probabilities, likeliest first


class ColumnSearch:
    """A search on the samples of logs."""

    def __init__(self, model: ColumnModel) -> None:
        self.model, self._look = model, FirstLook(model)
        # Until a mistake is corrected: those that are hopeless, and where other zeros were found.
        self._hopeless, self._zeros = set[Place](), dict[tuple[int, ...], Array]()

    def found(self) -> list[MistakeFound]:
        """Return mistakes, one after the other; those without a kind are none of columns."""
        model, steps = self.model, list[MistakeFound]()
        base = model.fit(Assignment.as_named(len(model.gains)), model.hopeful())
        while sum(bool(each.best.mistake.kind) for each in steps) < _MOST:
            step = self._step(base, {each.best.mistake.place for each in steps})
            if step is None:
                break
            steps.append(step)
            found, kind = step.best.fit.assignment, step.best.mistake.kind
            if kind and KINDS[kind].changes == ("rate",):
                base = model.of_other_rates(base, found)
                continue
            base = step.best.fit
            if not kind:
                continue
            self._hopeless.clear()
            self._zeros.clear()
            if found.apart | found.unknown:
                # What seemed unknown before may be another mistake beside this one.
                known = replace(found, apart=frozenset(), unknown=frozenset())
                base = model.fit(known, model.hopeful(), base)
        return steps

    def _step(self, base: ColumnFit, settled: Set[Place]) -> MistakeFound | None:
        """Return the most probable mistake beside those of a fit; None if none is."""
        model, worth, prices = self.model, self.model.hopeful(), self._mistakes(base)
        promising = self._promising(prices, base)

        def judged(mistakes: Iterable[Mistake]) -> list[Judged]:
            found = list[Judged]()
            for mistake in mistakes:
                # What several sizes explain may show only where they are right.
                steps = _STEPS if len(mistake.free) > 1 else 1
                own = self._judged(mistake, base, worth, prices[mistake])
                found.append(self._refined(own, worth, steps))
            places = dict[object, Judged]()
            for each in sorted(found, key=_score, reverse=True):
                places.setdefault((each.mistake.place, each.mistake.sizes), each)
            return list(places.values())

        tried = [each for each in promising if each.kind and each.place not in self._hopeless]
        first = [each for each in judged(tried) if each.mistake.place not in settled]
        plain = self._plain(base, worth, None)
        least, never = plain.score + _HOPELESS, plain.score + _HOPELESS_FOR_GOOD * worth.mean()
        self._hopeless |= {each.mistake.place for each in first if each.score < never}
        mistaken = [each for each in first if each.score > least]
        # Errors of zeros and gains are in a fit to first order: their sizes are found last.
        finalists = mistaken[:_FINALISTS]
        last = [each if each.mistake.free else self._refined(each, worth) for each in finalists]
        zeros = [m for m in (e.mistake for e in reversed(mistaken)) if m.kind == "position_zero"]
        self._zeros |= {mistake.joints: mistake.moved for mistake in zeros}
        if not any(each.score > plain.score for each in last):
            return None  # whatever else the model lacks
        # With few independent samples, what is no mistake may be likelier than it looks at first.
        last += judged(each for each in promising if not each.kind)
        last += self._together(max((j for j in last if not j.mistake.kind), key=_score), worth)
        # Probabilities are told by the samples that the residuals of the answer are worth.
        best, of_base = max(last, key=_score), model.worth(base)
        for _ in range(2):
            told = best.mistake.place
            worth = np.where(best.fit.mse < plain.mse, model.worth(best.fit), of_base)
            again = [self._again(each, worth) for each in last]
            least = max(again, key=_score).score + _HOPELESS
            last = [self._refined(each, worth) if each.score > least else each for each in again]
            best = max(last, key=_score)
            plain = self._plain(base, worth, None, best.fit)
            if best.mistake.place == told:
                break
            last = [each for each in last if each.score > best.score + _FAR]
        if best.score <= plain.score + _TIE:
            return None
        weights = np.exp(0.5 * np.array([min(each.score - best.score, 0.0) for each in last]))
        total = weights.sum() + np.exp(0.5 * (plain.score - best.score))
        chances = sorted(zip(last, (weights / total).tolist(), strict=True), key=lambda c: -c[1])
        place = best.mistake.place
        same = sum(chance for each, chance in chances if each.mistake.place == place)
        others = tuple(c for c in chances if c[0].mistake.place != place)
        return MistakeFound(base, best, best.score - plain.score, same, others)

    def _together(self, first: Judged, worth: Array) -> list[Judged]:
        """Return more and more of what the model lacks together, as long as it is likelier."""
        found, best = list[Judged](), first
        while True:
            prices = self._mistakes(best.fit, others=True).items()
            tried = [
                self._judged(mistake, best.fit, worth, best.price + price)
                for mistake, price in prices
                if not mistake.joints  # functions of all joints together explain any log
            ]
            refined = [self._refined(each, worth, 1) for each in tried]
            more = max(refined, key=_score, default=best)
            if more.score <= best.score + _TIE:
                return found
            best = self._refined(more, worth)
            found.append(best)

    def _mistakes(self, base: ColumnFit, *, others: bool = False) -> dict[Mistake, float]:
        """Return everything that may be wrong beside a fit, or but columns, with its price."""
        return Mistakes(self.model, base, self._look, self._zeros).priced(others=others)

    def _promising(self, mistakes: Mapping[Mistake, float], base: ColumnFit) -> list[Mistake]:
        """Return the mistakes that are worth a fit."""
        is_likely, motion = self._likely(base), base.assignment.motion_key
        seen = [mistake for mistake in mistakes if mistake.is_seen]
        seen.sort(key=lambda each: -self._look.score(each.assignment))
        moved = [m for m in seen if m.assignment.motion_key != motion][:_SCREENED]
        # Zeros on which nothing depends, such as an upright axis has, are one.
        looks = [(m.place, round(self._look.score(m.assignment), DIGITS)) for m in moved]
        moved = list(dict(zip(reversed(looks), reversed(moved), strict=True)).values())[::-1]
        others = [m for m in seen if m.assignment.motion_key == motion and is_likely(m)]
        found = [m for m in mistakes if not m.is_seen and is_likely(m)]
        return [*found, *moved, *others[:_SCREENED]]

    def _likely(self, base: ColumnFit) -> Callable[[Mistake], bool]:
        """Return a test of what the errors of a fit make likely."""
        model, p = self.model, len(self.model.mean)
        far = np.abs(base.x[:p]) * np.sqrt(np.diag(model.information))
        ends = (model.zeros, model.gains)
        sizes = {k for at in ends for k in at[np.argsort(-far[at])[:_PROMISING]].tolist()}
        errors = (base.mse / np.maximum(model.noise, 1e-300) ** 2)[base.assignment.effort]
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

    def _plain(self, base: ColumnFit, worth: Array, *near: ColumnFit | None) -> ColumnFit:
        """Fit without a mistake, as well as from wherever one was: noise has several optima."""
        fits = [self.model.fit(base.assignment, worth, each) for each in (base, *near)]
        return max(fits, key=lambda fit: fit.score)

    def _again(self, judged: Judged, worth: Array) -> Judged:
        """Judge a mistake by other samples, by the better of two fits that begin differently."""
        mistake, price = judged.mistake, judged.price
        fits = [self._judged(mistake, near, worth, price) for near in (judged.fit, None)]
        return max(fits, key=_score)

    def _refined(self, judged: Judged, worth: Array, steps: int = _STEPS) -> Judged:
        """Return a mistake of the sizes that fit best, after some steps at most."""
        best, last, share = judged, judged, 1.0
        for _ in range(steps):
            mistake = last.mistake.nearer(self.model, last.fit, share)
            if mistake is None:
                break
            tried = self._judged(mistake, last.fit, worth, last.price)
            # Signs and limits may be likelier only some steps later.
            if tried.score > last.score - _LEVEL or not mistake.free:
                last, share = tried, 1.0
                best = last if mistake.free else max(best, last, key=_score)
            elif (share := 0.5 * share) < _LEAST_SHARE:
                break
        return best


def _score(judged: Judged) -> float:
    return judged.score
