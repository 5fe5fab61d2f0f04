"""Gains of neighbouring explanations at the noise of a fit.

Terms that are added or replaced need only small Schur complements of the normal matrix of all
columns, so that all of them are tried at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotri, dtrtrs

from geodrake.diagnosis.block_solution import prior_matrix
from geodrake.diagnosis.log_model import Delay, Fit, LogModel
from geodrake.diagnosis.normal_kernels import (
    Schur,
    calc_gains,
    calc_products,
    calc_squares,
    packed_blocks,
)
from geodrake.diagnosis.terms import Term, Terms
from geodrake.identification.normal_equations import scaled_cholesky
from geodrake.model.servos import servos_of

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_MOST_TAKEN = 1.0 - 1e-6  # largest reduction of a joint's squared errors
_TINY = np.finfo(float).tiny


@dataclass(frozen=True, eq=False)
class Dropped:
    """Change of a fit when terms are dropped, at its noise."""

    around: Neighbourhood
    loss: float  # change of the score without prior odds
    at: Indices  # (i,) the dropped parameters among those of the fit
    inverse: Array  # (i, i) inverse of their covariance
    x: Array  # (i,) their values
    squares: float  # increase of the weighted squared errors
    joint: int  # the only joint that the terms affect; −1 if several

    @cached_property
    def rows(self) -> Array:
        """(i, D) rows of the dropped parameters in H⁻¹AᵀA, over distinct columns."""
        around = self.around
        return around.turned[self.at - around.first_term]


class Neighbourhood:
    """Schur complements of all distinct columns beside a fit, at its noise."""

    def __init__(self, model: LogModel, fit: Fit) -> None:
        self._model, self.fit = model, fit
        # The transpose is in Fortran order; LAPACK writes its upper triangle.
        factor, self._scale = scaled_cholesky(model.hessian(fit), ridge=0.0)
        self._root, self.first_term = factor.T, model.first_term
        upper, _ = dpotri(self._root, lower=0)
        upper = np.triu(upper) + np.triu(upper, 1).T
        self.inverse = upper * self._scale * self._scale[:, None]
        self._most_taken = np.minimum(1.0 - model.floor / fit.variance, _MOST_TAKEN)
        spans = model.spans(fit.terms).items()
        self._at = {term: np.arange(span.start, span.stop) for term, span in spans}

    @cached_property
    def _cross(self) -> Array:
        """(n, D) products of the fit's columns with all distinct ones."""
        model, fit = self._model, self.fit
        places = model.places.take(fit.columns, axis=1), self._places
        found: Array = calc_products(model.grams, fit.weights, places)
        return found

    @cached_property
    def _places(self) -> Indices:
        return np.asarray(self._model.places.take(self._model.distinct, axis=1))

    @cached_property
    def turned(self) -> Array:
        """(·, D) rows of all terms of the fit in H⁻¹AᵀA, over distinct columns."""
        return np.asarray(self.inverse[self.first_term :] @ self._cross)

    @cached_property
    def schur(self) -> tuple[Schur, Array]:
        """Schur complement of all candidate columns, and their pull (P,)."""
        model, fit = self._model, self.fit
        moments, _ = model.moments(model.distinct, fit.choice.delay)
        scaled = self._scale[:, None] * self._cross
        rows, _ = dtrtrs(self._root, scaled, lower=0, trans=1)
        normal = model.grams, fit.weights, self._places
        known = np.zeros((len(model.distinct),) * 2)
        right = fit.weights @ moments - fit.x @ self._cross
        return (known, normal, rows.T), right[model.same_as] + model.pull

    def delays(self) -> list[tuple[Delay, float]]:
        """Return the best other delay of all joints and of each single joint, with their gains.

        The model's own delay is also returned. Delays are compared as exact ones, as the delay
        errors of a fit average noise away. A single joint is not delayed if it belongs to a free
        base, which has no motor, if rows mix the efforts of several joints, or if it has a servo,
        whose delay was fitted with it.
        """
        model, current = self._model, self.fit.choice.delay
        columns, fit, joints = self.fit.columns, self.fit, [*range(len(current))]
        count = len(model.dataset.delays)
        if count < 2:
            return []
        packed, now, power = model.normal(columns, current)
        shifted = [model.moments(columns, (k,) * len(current)) for k in range(count)]
        errors = self.inverse[:, model.delay_errors]
        solved = np.linalg.solve(errors[model.delay_errors], errors.T)
        inverse, exact = self.inverse - errors @ solved, fit.x - fit.x[model.delay_errors] @ solved
        samples, sse = self._samples(), np.maximum(calc_squares((packed, now, power), exact), _TINY)
        prior, mean = prior_matrix(model.prior(fit.choice)[0]), model.mean[columns]
        best = list[tuple[Delay, float]]()

        def distances(x: Array) -> Array:
            """Return (K,) squared distances of parameters (K, n) from the prior."""
            return np.asarray(np.sum((x - mean) @ prior * (x - mean), axis=1))

        def odds(delay: Delay) -> float:
            return model.odds_against(replace(fit.choice, delay=delay))

        base, servos = model.model.base_joints, servos_of(model.model)
        free = [
            [j]
            for j, joint in enumerate(model.model.joints)
            if joint not in base and servos[j] is None and not model.dataset.is_mixed
        ]
        for moved in free if any(servos) else (joints, *free):
            tried, at = [], np.flatnonzero(np.isin(model.joint_of, moved))
            part = packed if len(at) == len(sse) else packed_blocks(packed, at)
            pulls = [fit.weights[at] @ (moments[at] - now[at]) for moments, _ in shifted]
            x = exact + np.array(pulls) @ inverse
            nearer = distances(exact[None]) - distances(x)
            for k, (moments, powers) in enumerate(shifted):
                residual = calc_squares((part, moments[at], powers[at]), x[k])
                ratio = np.maximum(residual / sse[at], 1e-12)
                delay = tuple(k if j in moved else current[j] for j in joints)
                tried.append((delay, float(nearer[k] - samples[at] @ np.log(ratio))))
            tried = [each for each in tried if model.delays_differ(each[0], current)]
            best.append(max(tried, key=lambda each: each[1] - odds(each[0])))
            on_time = tuple(model.on_time[j] if j in moved else current[j] for j in joints)
            best += [each for each in tried if each[0] == on_time and each != best[-1]]
        return best

    def _samples(self) -> Array:
        """Return the effective sample size (B,) of each block of rows."""
        fit, model = self.fit, self._model
        floor = model.floor[model.joint_of]
        return np.asarray(fit.weights * np.maximum(fit.noise, floor) * model.block_rows)

    def dropped(self, terms: Sequence[Term]) -> Dropped:
        """Return the change when some of the fit's terms are dropped."""
        at = np.concatenate([self._at[term] for term in terms])
        covariance, x = self.inverse[np.ix_(at, at)], self.fit.x[at]
        inverse = np.linalg.inv(covariance)
        known = self._model.prior_scores[np.concatenate([self._model.at[t] for t in terms])].sum()
        loss = -x @ inverse @ x - np.linalg.slogdet(covariance)[1] - known
        squares = float(x @ inverse @ x)
        joints = {self._model.only_joint[term] for term in terms}
        joint = joints.pop() if len(joints) == 1 else -1
        return Dropped(self, float(loss), at, inverse, x, squares, joint)

    def gains(self, packages: Sequence[Terms], dropped: Dropped | None = None) -> Array:
        """Return the gain (m,) in score of each package of terms, without prior odds.

        Packages contain no terms of the fit, except those in `dropped`, which are dropped first.
        Gains exclude `dropped.loss`; they are −∞ where a positive parameter would be negative.
        """
        return self._gained(packages, dropped)[0]

    def profiled_gains(self, packages: Sequence[Terms], dropped: Dropped | None = None) -> Array:
        """Return gains (m,) with updated noise where only one joint is affected.

        Other gains are those of `gains`. At the old noise, two effects that explain the error only
        together would gain too little.
        """
        gains, falls, joints = self._gained(packages, dropped)
        if dropped is not None:
            joints, falls = np.where(joints == dropped.joint, joints, -1), falls - dropped.squares
        samples = self._model.sum_by_joint(self._samples())
        return np.where(joints >= 0, self._profiled(gains, falls, joints, samples), gains)

    def white_noise_gains(self, terms: Sequence[Term], dropped: Dropped | None = None) -> Array:
        """Return gains (m,) of effects of single joints, if they left only white noise.

        Gains exclude `dropped.loss`, of dropped terms of the same joint. Missing effects make
        residuals vary slowly, which lowers their effective sample size.
        """
        gains, falls, joints = self._gained([(term,) for term in terms], dropped)
        falls = falls if dropped is None else falls - dropped.squares
        return self._profiled(gains, falls, joints, self._model.rows)

    def _profiled(self, gains: Array, falls: Array, at: Indices, samples: Array) -> Array:
        """Return gains (m,) with the remaining noise of joints `at` (m,), of `samples` (nv,).

        `falls` (m,) are those of the weighted squared errors.
        """
        share = falls / self._model.sum_by_joint(self._samples())[at]
        return gains - falls - samples[at] * np.log1p(-np.minimum(share, self._most_taken[at]))

    def _gained(
        self, packages: Sequence[Terms], dropped: Dropped | None
    ) -> tuple[Array, Array, Indices]:
        """Return gains (m,), reductions (m,) of weighted squared errors, and the only joints (m,).

        A joint is −1 if several are affected.
        """
        model, order = self._model, self._model.order
        if not packages:
            return np.zeros(0), np.zeros(0), np.zeros(0, np.intp)
        terms = np.array([order[term] for package in packages for term in package], np.intp)
        ends = np.cumsum([0, *map(len, packages)])
        schur, pull = self.schur
        dropped_rows = (np.zeros((0, len(model.distinct))), np.zeros((0, 0)), np.zeros(0))
        if dropped is not None:
            dropped_rows = (dropped.rows, dropped.inverse, dropped.x)
        result: tuple[Array, Array, Indices] = calc_gains(
            schur,
            (pull, model.prior_scores),
            (model.positive, model.term_spans),
            ((model.same_as, model.information), dropped_rows),
            (terms, ends),
        )
        return result
