"""The search for a formula at one joint: screen, sharpen, judge."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geodrake.diagnosis.drafting.clock import clock_correlates
from geodrake.diagnosis.drafting.formula import Formula, FormulaTerm
from geodrake.diagnosis.drafting.judgement import LEAST_REDUCTION, judge
from geodrake.diagnosis.drafting.results import Correlate
from geodrake.diagnosis.drafting.screening import Screen, best_sums
from geodrake.diagnosis.drafting.term_columns import TermColumns
from geodrake.diagnosis.drafting.vocabulary import TURNS, vocabulary
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.hypothesis import Hypothesis, settle
from geodrake.identification.logs.reduce import reduce_logs

FINALISTS = 4
"""So many sums of each number of terms are fitted in full."""

MOST_CORRELATES = 3
"""At most so many correlates are reported of each joint."""

_NOTABLE = 0.1
"""A correlate is reported if it explains at least this share of the squared error."""

_ITERATIONS = 6  # refits until weights stay: a formula may take away most of an error
_STEPS = np.linspace(-1.0, 1.0, 9)
_ROUNDS = 3  # in which the constants at which a function turns are tried, closer each time


@dataclass(frozen=True, eq=False)
class FoundFormula:
    """A formula that convinces.

    Attributes:
        columns: The formula, as an effect.
        before: The hypothesis without it.
        after: The hypothesis with it.
        alarm: Probability of a false alarm, all that was tried counted.
        rivals: Formulas of no more terms that cannot be distinguished from it.
    """

    columns: TermColumns
    before: Hypothesis
    after: Hypothesis
    alarm: float
    rivals: tuple[Formula, ...]


@dataclass(frozen=True, eq=False)
class JointSearch:
    """The search at one joint.

    Attributes:
        case: The logs; its model has the effects of the hypothesis.
        hypothesis: What is known to be there.
        joint: The joint.
    """

    case: Case
    hypothesis: Hypothesis
    joint: str

    def screened(self) -> Screen:
        """Return the screen of the whole vocabulary."""
        joints = self.case.model.single_joints
        terms = vocabulary(self.joint, joints, {joint: self._reach(joint) for joint in joints})
        return self._screen(terms)

    def correlates(self, screen: Screen) -> list[Correlate]:
        """Return what the error goes with, each set of signals once.

        Args:
            screen: That of the vocabulary.
        """
        before, after = screen.single
        shares = 1.0 - after.sum(0) / before.sum()
        best: dict[frozenset[tuple[str, str]], Correlate] = {}
        for k in np.argsort(-shares):
            term, share = screen.vocabulary[k], float(shares[k])
            known = any(seen <= term.signals and share < c.share + 0.05 for seen, c in best.items())
            if share > max(_NOTABLE, 0.5 * shares.max()) and not known:
                best[term.signals] = Correlate(self.joint, term.words(self.joint), share)
        found = list(best.values())[:MOST_CORRELATES]
        return sorted(
            [*found, *clock_correlates(self.hypothesis, self.joint)], key=lambda c: -c.share
        )

    def formulas(self, screen: Screen) -> list[Formula]:
        """The formulas that stand out, of one term, of two, of three; none twice but for constants.

        Args:
            screen: That of the vocabulary.
        """
        kinds: dict[int, dict[frozenset[FormulaTerm], list[FormulaTerm]]] = defaultdict(dict)
        for found in best_sums(screen):
            terms = [screen.vocabulary[k] for k in found.terms]
            kinds[len(terms)].setdefault(frozenset(term.kind for term in terms), terms)
        finalists = [terms for same in kinds.values() for terms in list(same.values())[:FINALISTS]]
        return [self._sharpened(terms) for terms in finalists]

    def judged(self, formulas: Sequence[Formula], tried: int) -> FoundFormula | None:
        """Return the simplest of those that are as good as the best; None if it does not convince.

        Args:
            formulas: The formulas.
            tried: Terms that each of them could have had.
        """
        if not formulas:
            return None
        dataset, columns = self._with_columns(formulas)
        before = self.hypothesis.moved(dataset, delay=0)
        trials = [(c, settle(before.with_effects([c]), iterations=_ITERATIONS)) for c in columns]

        def score(trial: tuple[TermColumns, Hypothesis]) -> float:
            return judge(before, trial[1], parameters=trial[0].formula.free).score

        best = max(trials, key=score)
        here = np.isin(before.dataset.joints, [self.joint])

        def ties(other: Hypothesis) -> bool:
            judged = judge(other, best[1], joints=here)
            return judged.is_tie or judged.reduction < LEAST_REDUCTION

        tied = [t for t in trials if ties(t[1])]
        chosen, after = min(tied, key=lambda t: (t[0].formula.complexity, -score(t)))
        formula = chosen.formula
        among = tried ** len(formula.terms)
        found = judge(before, after, joints=here, parameters=formula.free, tried=among)
        if not found.convinces:
            return None
        rivals = [
            columns.formula
            for columns, _ in sorted(tied, key=lambda t: -score(t))
            if len(columns.formula.terms) <= len(formula.terms) and columns is not chosen
        ]
        return FoundFormula(chosen, before, after, found.alarm, tuple(rivals))

    def _with_columns(self, formulas: Sequence[Formula]) -> tuple[Dataset, list[TermColumns]]:
        """Return a dataset that has columns for formulas beside those of the hypothesis."""
        columns = [TermColumns(formula) for formula in dict.fromkeys(formulas)]
        dataset = reduce_logs(
            self.case.model,
            self.case.trajectories,
            self.case.folds,
            effects=[*self.hypothesis.unknowns.effects, *columns],
        )
        return dataset, columns

    def _screen(self, terms: Sequence[FormulaTerm]) -> Screen:
        dataset, (columns,) = self._with_columns([Formula(self.joint, tuple(terms))])
        return Screen.of(self.hypothesis, dataset, columns)

    def _sharpened(self, terms: list[FormulaTerm]) -> Formula:
        """Return a formula of terms, the constants at which its functions turn found by trial."""
        turning = [(i, place) for i, term in enumerate(terms) for place in term.turning]
        spacing = TURNS[1] - TURNS[0]
        for _ in range(_ROUNDS if turning else 0):
            for i, place in turning:
                low, high = self._reach(terms[i].factors[place].joint)
                center, step = terms[i].factors[place].constant, spacing * (high - low)
                variants = [terms[i].turned(place, float(center + s * step)) for s in _STEPS]
                others = [term for k, term in enumerate(terms) if k != i]
                _, after = self._screen([*others, *variants]).next_terms(tuple(range(len(others))))
                terms[i] = variants[int(np.argmin(after[:, len(others) :].sum(0)))]
            spacing *= 2.0 / (len(_STEPS) - 1)
        return Formula(self.joint, tuple(terms))

    def _reach(self, joint: str) -> tuple[float, float]:
        """Least and greatest position of a joint in the logs."""
        data = self.case.dataset.data[self.case.dataset.joints.index(joint)]
        positions = [rows.motion[:, 0] for blocks in data.rows for rows in blocks if len(rows.time)]
        return min(float(p.min()) for p in positions), max(float(p.max()) for p in positions)
