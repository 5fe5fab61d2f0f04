"""Search for mistakes in columns: correct the most probable one, then judge the others again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Set
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.evidence import ColumnFit, ColumnModel
from geodrake.diagnosis.columns.kinds import KINDS
from geodrake.diagnosis.columns.mistakes import DIGITS, Mistake, Mistakes
from geodrake.diagnosis.columns.quick_scores import QuickScores

Array = NDArray[np.float64]
Place = tuple[object, ...]

_MOST = 6  # mistakes of a log
_SCREENED, _FINALISTS = 24, 8  # mistakes that are fitted, and that are refined
_HOPELESS = -12.0  # score relative to no mistake, below which a fit is not refined
_HOPELESS_FOR_GOOD = -1.0  # the same per sample, below which it is skipped until a correction
_FAR = -60.0  # score relative to the best, below which a mistake is not reweighted again
_PROMISING = 4  # joints with candidates of gains, zeros or unknown efforts
_STEPS = 8  # of the fit of a mistake's sizes
_LEAST_SHARE = 0.05  # of a Newton step
_TIE = 1e-6  # score difference by rounding
_ALLOWED_LOSS = 0.5  # of score in a step: linearized scores are exact only at convergence


@dataclass(frozen=True, eq=False)
class Judged:
    """A mistake with the corrected fit and its prior odds."""

    mistake: Mistake
    fit: ColumnFit
    price: float  # −2 log prior odds

    @property
    def score(self) -> float:
        """Return twice the logarithm of the evidence times the prior odds."""
        return self.fit.score - self.price


@dataclass(frozen=True, eq=False)
class MistakeFound:
    """Step of the search."""

    before: ColumnFit  # the fit before the correction
    best: Judged  # the mistake
    gain: float  # twice the log-odds against no mistake
    probability: float  # of the mistake, among no mistake and all others
    rivals: tuple[tuple[Judged, float], ...]  # others with their probabilities, likeliest first


class ColumnSearch:
    """Search on the samples of logs."""

    def __init__(self, model: ColumnModel) -> None:
        self.model, self._quick = model, QuickScores(model)
        # Hopeless mistakes and the best zeros, both reset by a correction.
        self._hopeless, self._zeros = set[Place](), dict[tuple[int, ...], Array]()

    def steps(self) -> list[MistakeFound]:
        """Return the steps in order; one whose mistake has no kind corrects no column."""
        model, steps = self.model, list[MistakeFound]()
        base = model.fit(Assignment.as_named(len(model.gains)), model.full_counts())
        while sum(bool(each.best.mistake.kind) for each in steps) < _MOST:
            step = self._step(base, {each.best.mistake.place for each in steps})
            if step is None:
                break
            steps.append(step)
            assignment, kind = step.best.fit.assignment, step.best.mistake.kind
            if kind and KINDS[kind].changes == ("rate",):
                base = model.of_other_rates(base, assignment)
                continue
            base = step.best.fit
            if not kind:
                continue
            self._hopeless.clear()
            self._zeros.clear()
            if assignment.detached | assignment.unknown:
                # An effort that was unknown before may be another mistake.
                retried = replace(assignment, detached=frozenset(), unknown=frozenset())
                base = model.fit(retried, model.full_counts(), base)
        return steps

    def _step(self, base: ColumnFit, settled: Set[Place]) -> MistakeFound | None:
        """Return the most probable further mistake; None if none is more probable than the fit."""
        model, counts, prices = self.model, self.model.full_counts(), self._mistakes(base)
        promising = self._promising(prices, base)

        def judged(mistakes: Iterable[Mistake]) -> list[Judged]:
            fits = list[Judged]()
            for mistake in mistakes:
                # Several sizes may explain the error only together.
                steps = _STEPS if len(mistake.free) > 1 else 1
                fit = self._judged(mistake, base, counts, prices[mistake])
                fits.append(self._refined(fit, counts, steps))
            places = dict[object, Judged]()
            for fit in sorted(fits, key=_score, reverse=True):
                places.setdefault((fit.mistake.place, fit.mistake.sizes), fit)
            return list(places.values())

        candidates = [each for each in promising if each.kind and each.place not in self._hopeless]
        first = [each for each in judged(candidates) if each.mistake.place not in settled]
        plain = self._plain(base, counts, None)
        least, floor = plain.score + _HOPELESS, plain.score + _HOPELESS_FOR_GOOD * counts.mean()
        self._hopeless |= {each.mistake.place for each in first if each.score < floor}
        mistaken = [each for each in first if each.score > least]
        # Fits are linear in errors of zeros and gains, so that these are refined last.
        finalists = mistaken[:_FINALISTS]
        last = [each if each.mistake.free else self._refined(each, counts) for each in finalists]
        zeros = [m for m in (e.mistake for e in reversed(mistaken)) if m.kind == "position_zero"]
        self._zeros |= {mistake.joints: mistake.moved for mistake in zeros}
        if not any(each.score > plain.score for each in last):
            return None
        # Explanations with right columns gain if there are few independent samples.
        last += judged(each for each in promising if not each.kind)
        last += self._together(max((j for j in last if not j.mistake.kind), key=_score), counts)
        # Probabilities use the effective sample sizes of the residuals of the answer.
        best, base_counts = max(last, key=_score), model.effective_counts(base)
        for _ in range(2):
            place = best.mistake.place
            answer_counts = model.effective_counts(best.fit)
            counts = np.where(best.fit.mse < plain.mse, answer_counts, base_counts)
            reweighted = [self._reweighted(each, counts) for each in last]
            least = max(reweighted, key=_score).score + _HOPELESS
            last = [self._refined(j, counts) if j.score > least else j for j in reweighted]
            best = max(last, key=_score)
            plain = self._plain(base, counts, None, best.fit)
            if best.mistake.place == place:
                break
            last = [each for each in last if each.score > best.score + _FAR]
        if best.score <= plain.score + _TIE:
            return None
        weights = np.exp(0.5 * np.array([min(each.score - best.score, 0.0) for each in last]))
        total = weights.sum() + np.exp(0.5 * (plain.score - best.score))
        chances = sorted(zip(last, (weights / total).tolist(), strict=True), key=lambda c: -c[1])
        place = best.mistake.place
        probability = sum(chance for each, chance in chances if each.mistake.place == place)
        others = tuple(c for c in chances if c[0].mistake.place != place)
        return MistakeFound(base, best, best.score - plain.score, probability, others)

    def _together(self, first: Judged, counts: Array) -> list[Judged]:
        """Return combined explanations with right columns, as long as each addition gains."""
        combined, best = list[Judged](), first
        while True:
            prices = self._mistakes(best.fit, others=True).items()
            fits = [
                self._judged(mistake, best.fit, counts, best.price + price)
                for mistake, price in prices
                if not mistake.joints  # unknown efforts of all joints would explain any log
            ]
            refined = [self._refined(fit, counts, 1) for fit in fits]
            candidate = max(refined, key=_score, default=best)
            if candidate.score <= best.score + _TIE:
                return combined
            best = self._refined(candidate, counts)
            combined.append(best)

    def _mistakes(self, base: ColumnFit, *, others: bool = False) -> dict[Mistake, float]:
        """Return candidate mistakes and prices; if `others`, only those with right columns."""
        return Mistakes(self.model, base, self._quick, self._zeros).priced(others=others)

    def _promising(self, mistakes: Mapping[Mistake, float], base: ColumnFit) -> list[Mistake]:
        is_likely, motion = self._likely(base), base.assignment.motion_key
        scored = [mistake for mistake in mistakes if mistake.has_quick_score]
        scored.sort(key=lambda m: -self._quick.score(m.assignment))
        moved = [m for m in scored if m.assignment.motion_key != motion][:_SCREENED]
        # Keep one of several zeros without influence, such as those of a vertical axis.
        keys = [(m.place, round(self._quick.score(m.assignment), DIGITS)) for m in moved]
        moved = list(dict(zip(reversed(keys), reversed(moved), strict=True)).values())[::-1]
        of_efforts = [m for m in scored if m.assignment.motion_key == motion and is_likely(m)]
        unscored = [m for m in mistakes if not m.has_quick_score and is_likely(m)]
        return [*unscored, *moved, *of_efforts[:_SCREENED]]

    def _likely(self, base: ColumnFit) -> Callable[[Mistake], bool]:
        """Return a predicate of mistakes that the errors of a fit make likely."""
        model, p = self.model, len(self.model.mean)
        size = np.abs(base.x[:p]) * np.sqrt(np.diag(model.information))
        groups = (model.zeros, model.gains)
        sizes = {k for at in groups for k in at[np.argsort(-size[at])[:_PROMISING]].tolist()}
        errors = (base.mse / np.maximum(model.noise, 1e-300) ** 2)[base.assignment.effort]
        joints = set(np.argsort(-errors)[:_PROMISING].tolist())

        def is_likely(mistake: Mistake) -> bool:
            if len(mistake.free) == 1:
                return mistake.free[0] in sizes
            return not mistake.joints or not joints.isdisjoint(mistake.joints)

        return is_likely

    def _judged(
        self, mistake: Mistake, near: ColumnFit | None, counts: Array, price: float
    ) -> Judged:
        moved = mistake.moved if len(mistake.moved) else None
        fit = self.model.fit(mistake.assignment, counts, near, wide=mistake.free, moved=moved)
        return Judged(mistake, fit, price)

    def _plain(self, base: ColumnFit, counts: Array, *near: ColumnFit | None) -> ColumnFit:
        """Return the best fit without a further mistake; several starts avoid local optima."""
        fits = [self.model.fit(base.assignment, counts, start) for start in (base, *near)]
        return max(fits, key=lambda fit: fit.score)

    def _reweighted(self, judged: Judged, counts: Array) -> Judged:
        """Return a mistake refitted with other sample counts: the better of two starts."""
        mistake, price = judged.mistake, judged.price
        fits = [self._judged(mistake, start, counts, price) for start in (judged.fit, None)]
        return max(fits, key=_score)

    def _refined(self, judged: Judged, counts: Array, steps: int = _STEPS) -> Judged:
        """Return a mistake with its best sizes after at most `steps` steps."""
        best, last, share = judged, judged, 1.0
        for _ in range(steps):
            mistake = last.mistake.improved(self.model, last.fit, share)
            if mistake is None:
                break
            candidate = self._judged(mistake, last.fit, counts, last.price)
            # The score of signs and limits may rise only after some steps.
            if candidate.score > last.score - _ALLOWED_LOSS or not mistake.free:
                last, share = candidate, 1.0
                best = last if mistake.free else max(best, last, key=_score)
            elif (share := 0.5 * share) < _LEAST_SHARE:
                break
        return best


def _score(judged: Judged) -> float:
    return judged.score
