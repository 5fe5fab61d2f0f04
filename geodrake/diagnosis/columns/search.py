"""The search for mistakes in columns: the likeliest is corrected, and the rest judged anew."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.design import Parameters
from geodrake.diagnosis.columns.fit import ColumnFit, ColumnJudge
from geodrake.diagnosis.columns.limits import nearest_limit
from geodrake.diagnosis.columns.proposals import ColumnMistake, mistakes
from geodrake.diagnosis.columns.samples import ColumnSamples
from geodrake.identification.logs.criteria import PENALTY
from geodrake.model.motor_limit import MotorLimit

Array = NDArray[np.float64]
Entry = tuple[ColumnMistake, float]  # a mistake, and what its prior and its parameters cost
Fitter = Callable[[Assignment, ColumnFit, Collection[int]], ColumnFit]

ODDS = 0.01
"""Prior odds that a log has a mistake in its columns; all kinds and places share them."""

SIZES = 300.0
"""A factor or a zero that is to be found may have so many sizes that are usually told apart.

Zeros are usually within 0.02 rad (`USUAL_ZERO`) of a turn, gains within 5 % of six decades.
"""

OTHER_SIZES = 92.0
"""Gains of other joints than the first: motors of one robot are within a decade of each other."""

_EACH, _GAIN = "effort_gains", "effort_gain"  # of each joint its own, of one or all
_OF_EACH = (_EACH, _GAIN, "effort_sign", "effort_unit")
_AS_GAINED = ("effort_limit", "swapped_efforts", "swapped_joints")  # of efforts by gains so far
_MOST = 6  # mistakes of a log
_SCREENED, _FINALISTS = 24, 6  # that are fitted with physical bodies, and to the end
_HOPELESS = -20.0  # gain, at most, of what is fitted no further, unless its size is to be found
_UNSEEN = 1.0  # of twice a log-likelihood: data that gain no more say nothing of a size
_FAR, _SHARE = 50.0, 0.5  # less than the best, and of it: what gains less is not fitted to the end
_STEPS = 8  # of a fit of a mistake's size
_OWN_STEPS = 24  # of one of each joint's gain
_CLOSE = 1e-3  # rad or share: a step that ends it
_LONGEST = 0.7  # rad, or of a logarithm, of a step


@dataclass(frozen=True, eq=False)
class Judged:
    """A mistake and what it gains.

    Attributes:
        mistake: The mistake.
        fit: The fit without it.
        gain: Twice the log-likelihood that it gains, less its cost.
        cost: What its parameters and its prior cost.
    """

    mistake: ColumnMistake
    fit: ColumnFit
    gain: float
    cost: float


@dataclass(frozen=True, eq=False)
class MistakeFound:
    """A step of the search.

    Attributes:
        before: The fit with the mistake.
        best: The mistake.
        rivals: Others, the best first, that are not the same of another size.
    """

    before: ColumnFit
    best: Judged
    rivals: tuple[Judged, ...]


class ColumnSearch:
    """A search on the samples of logs."""

    def __init__(self, samples: ColumnSamples) -> None:
        """Takes the samples."""
        self.judge = ColumnJudge(samples, Parameters.of(samples))
        rows = [np.arange(len(samples))] * samples.v.shape[1]
        self._of_rates = samples.effective(list(samples.v.T), rows)

    def found(self) -> tuple[MistakeFound, ...]:
        """Mistakes, one after the other; those without a kind are none of columns."""
        base = self.settled(Assignment.as_named(len(self._of_rates)))
        steps, base = self._grown([], base)
        together = self._together(steps, base)
        if together is not None:
            steps, _ = self._grown(*together)
        return tuple(steps)

    def _grown(
        self, steps: list[MistakeFound], base: ColumnFit
    ) -> tuple[list[MistakeFound], ColumnFit]:
        """Steps and those that follow, and the fit with all of them."""
        for _ in range(_MOST - len(steps)):
            ranked = self.ranked(base)
            if not ranked or ranked[0].gain <= 0.0:
                break
            best = ranked[0]
            own = best.mistake.kind, best.mistake.joints
            others = [r for r in ranked[1:] if (r.mistake.kind, r.mistake.joints) != own]
            steps = with_step(steps, MistakeFound(base, best, tuple(others)))
            base = self.settled(best.fit.assignment, best.fit)
        return steps, base

    def _together(
        self, steps: Sequence[MistakeFound], base: ColumnFit
    ) -> tuple[list[MistakeFound], ColumnFit] | None:
        """Gains that were found one by one as one mistake, that each joint has its own.

        At first one number for all may explain more than it costs, and gains of single joints then.

        Args:
            steps: What was found.
            base: The fit with all of it.

        Returns:
            Steps and the fit with them; None if such gains explain no more than they cost.
        """
        gains = [step for step in steps if step.best.mistake.kind == _GAIN]
        rivals = gains[0].rivals if gains else ()
        each = next((rival for rival in rivals if rival.mistake.kind == _EACH), None)
        if each is None or _found_as_gained(steps[steps.index(gains[0]) :]):
            return None
        mistake, fit = self._refined(replace(each.mistake, assignment=base.assignment), base)
        spared = sum(step.best.cost for step in gains) - each.cost
        more = fit.gain_over(base, self._of_rates) + spared
        if more <= 0.0:
            return None
        gain = sum(step.best.gain for step in gains) + more
        one = replace(gains[0], best=replace(each, mistake=mistake, fit=fit, gain=gain))
        kept = [one if step is gains[0] else step for step in steps if step not in gains[1:]]
        return kept, self.settled(fit.assignment, fit)

    def nrms(self, fit: ColumnFit) -> float:
        """Root mean square over joints of errors over the deviations of efforts."""
        return float(np.sqrt(np.mean(fit.mse / self.judge.samples.effort.var(axis=0))))

    def settled(self, assignment: Assignment, near: ColumnFit | None = None) -> ColumnFit:
        """The fit by an assignment that others are then judged against.

        Args:
            assignment: The assignment.
            near: A fit whose errors are about as large, if there is one.
        """
        self.judge.keep(assignment)
        return self.judge.fit(assignment, self.judge.fit(assignment, near))

    def ranked(self, base: ColumnFit) -> list[Judged]:
        """The best mistakes beside what an assignment corrects, fitted to the end; best first.

        Args:
            base: The fit by that assignment.
        """
        tried = mistakes(self.judge, base)
        entries = list(zip(tried, _costs(tried), strict=True))
        entries, _ = self._promising(self.judge.screened, base, entries, _SCREENED)
        entries, gains = self._promising(self.judge.quick, base, entries, _FINALISTS)
        best = max(gains, default=0.0)
        ranked = []
        for (mistake, cost), first in zip(entries, gains, strict=True):
            if mistake.kind != _EACH and first < min(best - _FAR, _SHARE * best):
                continue
            refined, fit = self._refined(mistake, base)
            gain = fit.gain_over(base, self._of_rates) - cost
            ranked.append(Judged(refined, fit, gain, cost))
        return sorted(ranked, key=lambda each: -each.gain)

    def _promising(
        self, fitted: Fitter, base: ColumnFit, entries: Sequence[Entry], most: int
    ) -> tuple[list[Entry], list[float]]:
        """Mistakes, with what they cost, that are worth another fit, and what they gain in this.

        What many sizes gain shows only when they are found: such mistakes are always among them.
        """
        plain, gains = fitted(base.assignment, base, ()), []
        for mistake, cost in entries:
            fit = fitted(mistake.assignment, base, mistake.free)
            gains.append(fit.gain_over(plain, self._of_rates) - cost)
        many = [mistake.kind == _EACH for mistake, _ in entries]
        order = sorted(range(len(entries)), key=lambda k: (not many[k], -gains[k]))[:most]
        kept = [k for k in order if many[k] or _is_promising(entries[k], gains[k])]
        return [entries[k] for k in kept], [gains[k] for k in kept]

    def _refined(self, mistake: ColumnMistake, base: ColumnFit) -> tuple[ColumnMistake, ColumnFit]:
        """A mistake of the size that fits best, and the fit."""
        if mistake.kind == "effort_limit":
            return self._of_nearest_limit(mistake, base)
        if mistake.kind == _EACH:
            return self._of_own_gains(mistake, base)
        parameters, assignment = self.judge.parameters, mistake.assignment
        zeros, gains, tilt = parameters.zeros(), parameters.gains(), parameters.tilt()
        for _ in range(_STEPS if mistake.free else 0):
            step = self._step(assignment, mistake, base)
            zero = assignment.zero + step[zeros]
            assignment = replace(assignment, zero=zero, gain=assignment.gain / np.exp(step[gains]))
            if step[tilt].any():
                assignment = assignment.leaning(parameters.model.tree.gravity, step[tilt])
            if np.abs(step).max() < _CLOSE:
                break
        return replace(mistake, assignment=assignment), self.judge.fit(assignment, base)

    def _step(self, assignment: Assignment, mistake: ColumnMistake, base: ColumnFit) -> Array:
        """(p,) step of Newton's method in the sizes of a mistake."""
        free, fit = list(mistake.free), self.judge.quick(assignment, base, mistake.free)
        step = np.zeros(len(fit.x))
        step[free] = np.clip(fit.x[free], -_LONGEST, _LONGEST)
        return step

    def _of_own_gains(
        self, mistake: ColumnMistake, base: ColumnFit
    ) -> tuple[ColumnMistake, ColumnFit]:
        """The gains with which the bodies explain most, and the fit by them.

        Of several gains each hides the others': a step that explains less is halved.
        """
        at = self.judge.parameters.gains()

        def explained(assignment: Assignment) -> float:
            return self.judge.quick(assignment, base).gain_over(base, self._of_rates)

        assignment = mistake.assignment
        most, step = explained(assignment), self._step(assignment, mistake, base)[at]
        for _ in range(_OWN_STEPS):
            if np.abs(step).max() < _CLOSE:
                break
            tried = replace(assignment, gain=assignment.gain / np.exp(step))
            more = explained(tried)
            if more > most:
                assignment, most = tried, more
                step = self._step(assignment, mistake, base)[at]
            else:
                step = 0.5 * step
        return replace(mistake, assignment=assignment), self.judge.fit(assignment, base)

    def _of_nearest_limit(
        self, mistake: ColumnMistake, base: ColumnFit
    ) -> tuple[ColumnMistake, ColumnFit]:
        """The limit of its kind with which the bodies explain most, and the fit by it."""
        (j,), start = mistake.joints, mistake.assignment

        def cost(limit: MotorLimit) -> float:
            fit = self.judge.quick(start.limited(j, limit), base)
            return -fit.gain_over(base, self._of_rates)

        assignment = start.limited(j, nearest_limit(start.limit_of(j), cost))
        return replace(mistake, assignment=assignment), self.judge.fit(assignment, base)


def with_step(steps: Sequence[MistakeFound], step: MistakeFound) -> list[MistakeFound]:
    """Steps with one more; what corrects the gain of a joint again is no other mistake.

    It is one where a limit, or whose efforts they are, was found in between, by the gains so far.

    Args:
        steps: Those before.
        step: The next one.
    """
    kinds = [each.best.mistake.kind for each in steps]
    at = kinds.index(_EACH) if _EACH in kinds else len(kinds)
    if step.best.mistake.kind not in _OF_EACH or at == len(kinds) or _found_as_gained(steps[at:]):
        return [*steps, step]
    first, found = steps[at], step.best
    gain = first.best.gain + found.gain
    better = replace(first.best, fit=found.fit, gain=gain)
    return [*steps[:at], replace(first, best=better), *steps[at + 1 :]]


def _found_as_gained(steps: Sequence[MistakeFound]) -> bool:
    """Whether something was found that is true of efforts by the gains so far."""
    return any(step.best.mistake.kind in _AS_GAINED for step in steps)


def _is_promising(entry: Entry, gain: float) -> bool:
    """Whether a mistake may prove right when it is fitted to the end.

    What data gain from a size grows as it is found.

    Args:
        entry: The mistake, and what it costs.
        gain: What it gains by a first fit, less its cost.
    """
    mistake, cost = entry
    return gain > _HOPELESS or (mistake.sizes > 0 and gain + cost > _UNSEEN)


def _cost_of_sizes(mistake: ColumnMistake) -> float:
    """What the numbers cost that are found in the data."""
    others = max(mistake.sizes - 1, 0) if mistake.kind == _EACH else 0
    return 2.0 * float((mistake.sizes - others) * np.log(SIZES) + others * np.log(OTHER_SIZES))


def _costs(tried: Sequence[ColumnMistake]) -> list[float]:
    """What the prior and the parameters of mistakes cost: kinds are as likely, places too.

    What is none of columns is as likely as not.
    """
    counts = Counter(mistake.kind for mistake in tried if mistake.kind)
    return [
        _cost_of_sizes(mistake)
        - mistake.spared
        - 2.0 * np.log(ODDS / (len(counts) * counts[mistake.kind]))
        if mistake.kind
        else PENALTY * mistake.price
        for mistake in tried
    ]
