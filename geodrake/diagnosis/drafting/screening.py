"""Sparse search: sums of few terms that take most of a joint's held-out error away.

All terms are columns of one dataset. With W = C⁻¹B the projection of the terms onto what the model
may move, a term's coefficient and its held-out error follow for all terms at once from products of
the folds' triangular factors; a beam of sums is kept from one term to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from geodrake.diagnosis.drafting.formula import Formula, FormulaTerm
from geodrake.diagnosis.drafting.term_columns import TermColumns
from geodrake.identification.logs.cross_validation import normal_matrices
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.hypothesis import Hypothesis

Array = NDArray[np.float64]

BEAM = 8
"""So many sums are kept from one term to the next."""

MOST_TERMS = 3

PRICE = 0.02
"""A unit of complexity must take away this share of the squared error."""

_RIDGE = 1e-12
_DEPENDENT = 1e-6
"""A term says nothing new if less than this share of its square is beyond what the model spans."""


@dataclass(frozen=True, eq=False)
class Sum:
    """A sum of terms and its held-out error.

    Attributes:
        terms: Places of the terms in the vocabulary.
        sse: (F,) held-out squared error of each fold at the joint.
        score: Logarithm of the squared error gone, less the price of the terms.
    """

    terms: tuple[int, ...]
    sse: Array
    score: float


@dataclass(frozen=True, eq=False)
class Screen:
    """What the folds say about a joint: model, terms, and effort.

    Attributes:
        vocabulary: (P) terms.
        base: (F, p, p) normal matrices of what the model may move, over all joints, weighted.
        rhs: (F, p) their products with the effort.
        prior: Information (p, p), and its product with the prior mean (p,).
        model: (F, n, p) factors of the model's columns at this joint.
        terms: (F, n, P) those of the terms.
        effort: (F, n) those of the effort.
        weight: Weight of a squared residual of this joint.
    """

    vocabulary: Sequence[FormulaTerm]
    base: Array
    rhs: Array
    prior: tuple[Array, Array]
    model: Array
    terms: Array
    effort: Array
    weight: float

    @classmethod
    def of(cls, hypothesis: Hypothesis, dataset: Dataset, columns: TermColumns) -> Screen:
        """Return what a dataset that has columns for terms adds to a hypothesis that has none.

        Args:
            hypothesis: What is known to be there.
            dataset: The same logs, with the columns of the hypothesis' effects and of the terms.
            columns: The terms.
        """
        unknowns, weights, delay = hypothesis.unknowns, hypothesis.cv.weights, hypothesis.delay
        used = unknowns.columns
        gram, rhs = normal_matrices(hypothesis.dataset, weights, used, delay=delay)
        j = dataset.joints.index(columns.formula.joint)
        data = dataset.data[j]
        local = data.local(hypothesis.moved_columns(dataset))
        on = np.flatnonzero(local >= 0)
        model = np.zeros((*data.factors.shape[:2], len(used)))
        model[:, :, on] = data.factors[:, :, local[on]]
        return cls(
            columns.formula.terms,
            gram,
            rhs,
            (unknowns.information, unknowns.information @ unknowns.mean),
            model,
            data.factors[:, :, data.local(dataset.effect_columns(columns))],
            data.factors[:, :, len(data.columns)],
            float(weights[j]),
        )

    @cached_property
    def _squares(self) -> Array:
        """(F, P) of the terms."""
        return np.square(self.terms).sum(1)

    @cached_property
    def _cross(self) -> Array:
        """(F, p, P) between model and terms."""
        return np.swapaxes(self.model, 1, 2) @ self.terms

    @cached_property
    def _with_effort(self) -> Array:
        """(F, P) of terms and effort."""
        return np.asarray((np.swapaxes(self.terms, 1, 2) @ self.effort[..., None])[..., 0])

    @cached_property
    def single(self) -> tuple[Array, Array]:
        """Held-out errors (F,) without terms, and (F, P) with each of them alone."""
        return self.next_terms(())

    def next_terms(self, chosen: tuple[int, ...]) -> tuple[Array, Array]:
        """Held-out errors at the joint with the terms chosen, and with each one more.

        Args:
            chosen: Places of terms in use.

        Returns:
            (F,) and (F, P); inf for a term that says nothing new.
        """
        among = np.swapaxes(self.terms[:, :, list(chosen)], 1, 2) @ self.terms  # (F, k, P)
        errors = [self._without(f, chosen, among) for f in range(len(self.base))]
        before, after = zip(*errors, strict=True)
        return np.array(before), np.array(after)

    def _without(self, f: int, chosen: tuple[int, ...], among: Array) -> tuple[float, Array]:
        """Errors in one fold, of fits to the others."""
        places, w, p = list(chosen), self.weight, self.base.shape[1]
        cross = np.vstack([self._cross.sum(0) - self._cross[f], among.sum(0) - among[f]])
        B = w * cross
        C = np.empty((p + len(places), p + len(places)))
        C[:p, :p] = self.base.sum(0) - self.base[f] + self.prior[0]
        C[:, p:] = B[:, places]
        C[p:, :p] = B[:p, places].T
        with_effort = w * (self._with_effort.sum(0) - self._with_effort[f])
        c = np.concatenate([self.rhs.sum(0) - self.rhs[f] + self.prior[1], with_effort[places]])
        scale = 1.0 / np.sqrt(np.maximum(np.diag(C), 1e-300))
        factor = cho_factor(C * scale[:, None] * scale + _RIDGE * np.eye(len(C)), lower=True)
        x = scale * cho_solve(factor, scale * c)
        W = scale[:, None] * cho_solve(factor, scale[:, None] * B)
        squares = w * (self._squares.sum(0) - self._squares[f])
        rest = squares - np.einsum("ij,ij->j", B, W)
        new = rest > _DEPENDENT * squares
        alpha = (with_effort - B.T @ x) / np.where(new, rest, 1.0)
        used = np.hstack([self.model[f], self.terms[f][:, places]])
        residual = self.effort[f] - used @ x
        change = self.terms[f] - used @ W  # of the prediction, for each term's unit coefficient
        power = residual @ residual
        after = power - 2 * alpha * (residual @ change) + alpha**2 * np.square(change).sum(0)
        return float(power), np.where(new, after, np.inf)

    def score(self, chosen: Sequence[int], before: Array, after: Array) -> float:
        """Logarithm of the squared error gone, less the price of the terms chosen.

        Args:
            chosen: Indices of the terms in the vocabulary.
            before: (F,) squared errors without them in each fold.
            after: (F,) squared errors with them.
        """
        formula = Formula("", tuple(self.vocabulary[k] for k in chosen))
        least = 1e-12 * np.square(self.effort).sum()
        gone = np.log(max(before.sum(), least) / max(after.sum(), least))
        return float(gone - PRICE * formula.complexity)


def best_sums(screen: Screen, *, most: int = MOST_TERMS, beam: int = BEAM) -> list[Sum]:
    """The best sums of one term, of two, up to `most`, as long as another term is worth its price.

    Args:
        screen: The matrices.
        most: Most terms.
        beam: Sums kept of each number of terms.

    Returns:
        Sums of one term, then of two, best first among those of a length; none where no term is
        worth its price.
    """
    start, _ = screen.single
    found: list[Sum] = []
    frontier: list[tuple[int, ...]] = [()]
    best_score = 0.0
    for _ in range(most):
        grown: dict[tuple[int, ...], Sum] = {}
        for chosen in frontier:
            _, after = screen.next_terms(chosen) if chosen else screen.single
            for k in np.argsort(after.sum(0))[: 8 * beam].tolist():
                terms = tuple(sorted((*chosen, k)))
                if np.isfinite(after[:, k]).all() and terms not in grown:
                    score = screen.score(terms, start, after[:, k])
                    grown[terms] = Sum(terms, after[:, k], score)
        best = sorted(grown.values(), key=lambda s: -s.score)[:beam]
        if not best or best[0].score <= best_score:
            break
        found += best
        best_score, frontier = best[0].score, [s.terms for s in best]
    return found
