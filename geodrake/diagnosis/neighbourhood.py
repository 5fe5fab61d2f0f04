"""Changes of a fit where terms come and go, at its noise.

Terms that come, go or take the place of others are small Schur complements of the normal matrices
of all columns, and all of them are tried at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotri, dtrtrs

from geodrake.diagnosis.log_model import Delay, Fit, LogModel
from geodrake.diagnosis.normal_kernels import (
    Beside,
    calc_gains,
    calc_products,
    calc_squares,
    packed_of,
)
from geodrake.diagnosis.terms import Term, Terms
from geodrake.identification.normal_equations import scaled_cholesky
from geodrake.model.servos import servos_of

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_MOST_TAKEN = 1.0 - 1e-6  # share of a joint's squared errors
_TINY = np.finfo(float).tiny


@dataclass(frozen=True, eq=False)
class Dropped:
    """Changes of a fit that terms are left out of, at its noise."""

    around: Neighbourhood
    loss: float  # what is lost of the score, prior odds left aside
    at: Indices  # (i,) the dropped parameters among those of the fit
    inverse: Array  # (i, i) inverse of their covariance
    x: Array  # (i,) their values
    squares: float  # by how much weighted squared errors rise
    joint: int  # the joint that alone feels the terms; −1 if several do

    @cached_property
    def rows(self) -> Array:
        """(i, D) rows of the dropped parameters in H⁻¹AᵀA, of distinct columns."""
        around = self.around
        return around.turned[self.at - around.first_term]


class Neighbourhood:
    """Schur complements of all distinct columns beside a fit, at its noise."""

    def __init__(self, model: LogModel, fit: Fit) -> None:
        self._model, self.fit = model, fit
        # The transpose is in Fortran's order, of which the upper triangle is written.
        factor, self._scale = scaled_cholesky(fit.hessian, ridge=0.0)
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
        """(·, D) rows of all terms of the fit in H⁻¹AᵀA, of distinct columns."""
        return np.asarray(self.inverse[self.first_term :] @ self._cross)

    @cached_property
    def beside(self) -> tuple[Beside, Array]:
        """The Schur complement of all that may come, and its pull (P,)."""
        model, fit = self._model, self.fit
        moments, _ = model.moments(model.distinct, fit.choice.delay)
        scaled = self._scale[:, None] * self._cross
        rows, _ = dtrtrs(self._root, scaled, lower=0, trans=1)
        normal = model.grams, fit.weights, self._places
        known = np.full((len(model.distinct),) * 2, np.nan)
        right = fit.weights @ moments - fit.x @ self._cross
        return (known, normal, rows.T), right[model.same_as] + model.pull

    def delays(self) -> list[tuple[Delay, float]]:
        """Return other delays of all joints, and of each joint alone, with their gains.

        Each time that is the best delay, and none where efforts are late now.

        Delays are compared as exact ones. The small errors that a fit allows them are columns of
        rates of efforts, which could average noise away.

        Joints of a free base have no motor that could be late alone, and rows that have efforts of
        several joints do not show one alone. A servo has a delay of its own, found with it: its
        effort is not late once more.
        """
        model, was = self._model, self.fit.choice.delay
        columns, fit, joints = self.fit.columns, self.fit, [*range(len(was))]
        count = len(model.dataset.delays)
        if count < 2:
            return []
        packed, now, power = model.normal(columns, was)
        late = [model.moments(columns, (k,) * len(was)) for k in range(count)]
        errors = self.inverse[:, model.delay_errors]
        solved = np.linalg.solve(errors[model.delay_errors], errors.T)
        inverse, exact = self.inverse - errors @ solved, fit.x - fit.x[model.delay_errors] @ solved
        samples, own = self._samples(), np.maximum(calc_squares((packed, now, power), exact), _TINY)
        (prior, _), mean = model.prior(fit.choice), model.mean[columns]
        found = list[tuple[Delay, float]]()

        def away(x: Array) -> float:
            return float((x - mean) @ prior @ (x - mean))

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
            alone = packed if len(at) == len(own) else packed_of(packed, at)
            for k, (moments, powers) in enumerate(late):
                x = exact + inverse @ (fit.weights[at] @ (moments[at] - now[at]))
                left = calc_squares((alone, moments[at], powers[at]), x)
                ratio = np.maximum(left / own[at], 1e-12)
                delay = tuple(k if j in moved else was[j] for j in joints)
                tried.append((delay, away(exact) - away(x) - float(samples[at] @ np.log(ratio))))
            tried = [each for each in tried if model.are_apart(each[0], was)]
            found.append(max(tried, key=lambda each: each[1] - odds(each[0])))
            on_time = tuple(model.on_time[j] if j in moved else was[j] for j in joints)
            found += [each for each in tried if each[0] == on_time and each != found[-1]]
        return found

    def _samples(self) -> Array:
        """Return (B,) how many independent samples each block of rows is worth."""
        fit, model = self.fit, self._model
        floor = model.floor[model.joint_of]
        return np.asarray(fit.weights * np.maximum(fit.noise, floor) * model.block_rows)

    def dropped(self, terms: Sequence[Term]) -> Dropped:
        """Return what leaving some of the fit's terms out changes."""
        at = np.concatenate([self._at[term] for term in terms])
        covariance, x = self.inverse[np.ix_(at, at)], self.fit.x[at]
        inverse = np.linalg.inv(covariance)
        known = self._model.prior_scores[np.concatenate([self._model.at[t] for t in terms])].sum()
        loss = -x @ inverse @ x - np.linalg.slogdet(covariance)[1] - known
        squares = float(x @ inverse @ x)
        return Dropped(self, float(loss), at, inverse, x, squares, self._joint(terms))

    def gains(self, packages: Sequence[Terms], dropped: Dropped | None = None) -> Array:
        """Return (m,) what each package of terms adds to the score, without prior odds.

        No term of a package is in the fit, or only in `dropped`, which is left out first. Gains are
        without `dropped.loss`, and −∞ where something is negative that cannot be.
        """
        return self._gained(packages, dropped)[0]

    def promises(self, packages: Sequence[Terms], dropped: Dropped | None = None) -> Array:
        """Return gains (m,) as after the noise has fallen, where one joint alone feels the change.

        Elsewhere they are those of `gains`. At the old noise, two effects that help only together
        would promise too little.
        """
        gains, falls = self._gained(packages, dropped)
        at = np.array([self._joint(package) for package in packages], int)
        if dropped is not None:
            at, falls = np.where(at == dropped.joint, at, -1), falls - dropped.squares
        samples = self._model.of_joints(self._samples())
        return np.where(at >= 0, self._quieter(gains, falls, at, samples), gains)

    def hopes(self, terms: Sequence[Term], dropped: Dropped | None = None) -> Array:
        """Return gains (m,) of effects that one joint feels, if they left only white noise.

        They are without `dropped.loss`, of what that joint alone feels and is left out first.

        What is missing makes residuals vary slowly, so that they count for few samples.
        """
        gains, falls = self._gained([(term,) for term in terms], dropped)
        falls = falls if dropped is None else falls - dropped.squares
        at = np.array([self._joint([term]) for term in terms], int)
        return self._quieter(gains, falls, at, self._model.rows)

    def _quieter(self, gains: Array, falls: Array, at: Indices, worth: Array) -> Array:
        """Return gains (m,) with the noise that is left at joints `at` (m,), worth (nv,) samples.

        Weighted squared errors there fall by `falls` (m,).
        """
        share = falls / self._model.of_joints(self._samples())[at]
        return gains - falls - worth[at] * np.log1p(-np.minimum(share, self._most_taken[at]))

    def _joint(self, terms: Sequence[Term]) -> int:
        """Return the joint that alone feels terms; −1 if several feel them."""
        felt = {self._model.felt_by[term] for term in terms}
        return felt.pop() if len(felt) == 1 else -1

    def _gained(self, packages: Sequence[Terms], dropped: Dropped | None) -> tuple[Array, Array]:
        """Return gains (m,) and by how much weighted squared errors fall (m,)."""
        model = self._model
        if not packages:
            return np.zeros(0), np.zeros(0)
        own = [[model.at[term] for term in package] for package in packages]
        columns = np.concatenate([at for each in own for at in each])
        counts = [sum(map(len, each)) for each in own]
        beside, pull = self.beside
        gone = (np.zeros((0, len(model.distinct))), np.zeros((0, 0)), np.zeros(0))
        if dropped is not None:
            gone = (dropped.rows, dropped.inverse, dropped.x)
        found: tuple[Array, Array] = calc_gains(
            beside,
            (pull, model.prior_scores),
            (model.owner, model.positive),
            ((model.same_as, model.information), gone),
            (columns, np.cumsum([0, *counts])),
        )
        return found
