"""Hypotheses: the model with certain effects, fitted and cross-validated.

Every fold is predicted by a fit to the others. Normal matrices are assembled from the factors of
each fold and joint of a `Dataset`, so that a fit costs one Cholesky factorization. If its bodies
are not physical, `fit_problem` is solved instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.identification.conic_fit import solve_with_fallback
from geodrake.identification.logs.dataset import Dataset, Delay
from geodrake.identification.logs.evidence import effective_samples_of_each
from geodrake.identification.logs.unknowns import Unknowns, fit_problem, fold_factors
from geodrake.identification.normal_equations import RIDGE, cholesky, solved
from geodrake.inertia import PARAMETERS_PER_BODY, is_physical

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_ROUNDING = 1e-12  # tolerance of bounds
_SETTLED = 0.3  # change of the weights' logarithms below which they have converged
_MOST_REFITS = 8
_FIRST_SHARE = 0.05  # effective samples over samples in the first fit


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Held-out squared errors."""

    # (F, nv) sums of squared held-out residuals, (N·m)² or N²; for joints without motors those of
    # accelerations times the prior inertia.
    sse: Array
    samples: NDArray[np.int_]  # (F, nv) numbers of rows
    x: Array  # (F, p) parameters fitted without each fold

    @property
    def mse(self) -> Array:
        """(nv,) mean squared held-out error of each joint."""
        return self.sse.sum(0) / np.maximum(self.samples.sum(0), 1)

    @property
    def rms(self) -> Array:
        """(nv,) RMS held-out error of each joint."""
        return np.sqrt(self.mse)


def hold_out(dataset: Dataset, columns: Indices, x: Array, *, delay: Delay = 0) -> HeldOut:
    """Return the errors of parameters x (F, p) of columns (p,) in every fold."""
    sse, delays = np.empty((len(dataset.folds), len(dataset.joints))), dataset.delay_of_each(delay)
    for j, (data, delay_index) in enumerate(zip(dataset.data, delays, strict=True)):
        n = len(data.columns)
        predicted = (data.factors[:, :, :n] @ data.parameters(columns, x)[..., None])[..., 0]
        sse[:, j] = np.square(data.factors[:, :, n + delay_index] - predicted).sum(1)
    return HeldOut(sse / dataset.inertias(columns, x).T ** 2, dataset.samples, x)


def normal_matrices(
    dataset: Dataset, weights: Array, columns: Indices, *, delay: Delay = 0
) -> tuple[Array, Array]:
    """Return the weighted AᵀA (F, p, p) and Aᵀb (F, p) of every fold, for columns (p,) of A.

    `weights` (nv,) are those of the joints' squared residuals, 1 / (N·m)² or 1 / N².
    """
    p, folds = len(columns), len(dataset.folds)
    gram, rhs = np.zeros((folds, p, p)), np.zeros((folds, p))
    delays = dataset.delay_of_each(delay)
    for data, weight, delay_index in zip(dataset.data, weights, delays, strict=True):
        seen = np.flatnonzero(data.local(columns) >= 0)
        rows = data.factors_of(columns[seen], delay_index)
        products = weight * np.swapaxes(rows, 1, 2)[:, :-1] @ rows
        gram[:, seen[:, None], seen] += products[:, :, :-1]
        rhs[:, seen] += products[:, :, -1]
    return gram, rhs


class CrossValidation:
    """Fits of unknowns to all folds but one, optionally with physical bodies.

    `weights` (nv,) are those of the joints' squared residuals, 1 / (N·m)² or 1 / N².
    """

    def __init__(
        self,
        dataset: Dataset,
        unknowns: Unknowns,
        weights: Array,
        *,
        delay: Delay = 0,
        held_out: HeldOut | None = None,
        physical: bool = True,
    ) -> None:
        self.dataset, self.unknowns, self.weights = dataset, unknowns, weights
        self.delay = dataset.delay_of_each(delay)
        if held_out is None:
            (gram, rhs), (fold_gram, fold_rhs) = self._total, self._of_folds
            fold_rhs = fold_rhs + dataset.fold_shares[:, None] * unknowns.pull
            folds = range(len(dataset.folds))
            x = self._solved(gram - fold_gram, rhs - fold_rhs, folds, physical=physical)
            held_out = hold_out(dataset, unknowns.columns, x, delay=self.delay)
        self.held_out = held_out

    @cached_property
    def _of_folds(self) -> tuple[Array, Array]:
        """Normal matrix (F, p, p) and right-hand side (F, p) of each fold."""
        return normal_matrices(self.dataset, self.weights, self.unknowns.columns, delay=self.delay)

    @cached_property
    def _total(self) -> tuple[Array, Array]:
        """Normal matrix (p, p) and right-hand side (p,) of all folds and the prior."""
        (gram, rhs), prior = self._of_folds, self.unknowns.information
        return gram.sum(0) + prior, rhs.sum(0) + prior @ self.unknowns.mean + self.unknowns.pull

    @cached_property
    def _factors(self) -> list[Array]:
        """Triangular factor (p + 1, p + 1) of each fold."""
        columns = self.unknowns.columns
        return fold_factors(self.dataset, columns, self.weights, delay=self.delay)

    def _solved(
        self, grams: Array, rhs: Array, without: Sequence[int | None], *, physical: bool
    ) -> Array:
        """Return the solutions (F, p) for matrices (F, p, p), each `without` a fold."""
        scales = 1.0 / np.sqrt(np.diagonal(grams, axis1=1, axis2=2))
        scaled, x = grams * scales[:, :, None] * scales[:, None, :], np.empty_like(rhs)
        for f, factor in enumerate(cholesky(scaled)):
            free = scales[f] * solved(factor, scales[f] * rhs[f])
            x[f] = _within(free, rhs[f], (scaled[f], scales[f]), self.unknowns)
            if physical and not self._are_physical(x[f]):
                args = self.dataset, self.unknowns, self.weights
                problem = fit_problem(*args, without=without[f], factors=self._factors)
                x[f] = solve_with_fallback(problem).x
        return x

    def _are_physical(self, x: Array) -> bool:
        """Return whether all bodies of parameters (…, p) are physical."""
        places = np.array(self.unknowns.inertia_blocks, int)[:, None]
        return bool(is_physical(x[..., places + np.arange(PARAMETERS_PER_BODY)]).all())

    @property
    def is_physical(self) -> bool:
        """Whether the bodies of all fits are physical."""
        return self._are_physical(self.held_out.x)

    @cached_property
    def fit_all(self) -> Array:
        """(p,) parameters fitted to all folds."""
        gram, rhs = self._total
        return self._solved(gram[None], rhs[None], [None], physical=True)[0]

    @cached_property
    def deviations(self) -> Array:
        """(p,) standard deviations of `fit_all`, ignoring bounds."""
        gram, _ = self._total
        scale = 1.0 / np.sqrt(np.diag(gram))
        matrix = gram * scale[:, None] * scale + RIDGE * np.eye(len(scale))
        return scale * np.sqrt(np.diag(np.linalg.inv(matrix)))


def _within(x: Array, rhs: Array, scaled: tuple[Array, Array], unknowns: Unknowns) -> Array:
    """Return the minimizer (p,) within the bounds of the unknowns, from the unbounded one x (p,).

    The normal equations have the right-hand side `rhs` (p,), and a matrix (p, p) scaled to unit
    diagonal by factors (p,).
    """
    free, (matrix, scale) = np.ones(len(x), bool), scaled
    lower, upper = unknowns.lower - _ROUNDING, unknowns.upper + _ROUNDING
    while np.any(outside := (x < lower) | (x > upper)):
        free &= ~outside
        x = np.clip(x, unknowns.lower, unknowns.upper)
        fixed = (matrix[np.ix_(free, ~free)] @ (x[~free] / scale[~free])) / scale[free]
        right = scale[free] * (rhs[free] - fixed)
        x[free] = scale[free] * solved(cholesky(matrix[np.ix_(free, free)]), right)
    return x


@dataclass(frozen=True, eq=False)
class Hypothesis(Short):
    """The model with the effects among `unknowns`, and its held-out errors."""

    dataset: Dataset
    unknowns: Unknowns
    weights: Array  # (nv,) of squared residuals: effective share of the samples over the MSE
    delay: tuple[int, ...]  # index of the dataset's effort delay of each joint
    prior_scale: float  # factor by which the prior of the bodies is widened
    cv: CrossValidation
    effective: Array  # (nv,) effective number of samples

    @property
    def held_out(self) -> HeldOut:
        """Held-out errors."""
        return self.cv.held_out

    @property
    def nrms(self) -> float:
        """Held-out error over effort standard deviation, root mean square over joints."""
        relative = self.held_out.mse / self.dataset.effort_std**2
        return float(np.sqrt(np.mean(relative[self.dataset.has_rows])))

    @property
    def power(self) -> Array:
        """(nv,) weighted sums of squared residuals; see `Dataset.passive_pull`."""
        inertias = self.dataset.inertias(self.unknowns.columns, self.held_out.x.mean(0))
        return np.asarray(self.weights * self.held_out.sse.sum(0) * inertias**2)


def residual_blocks(
    dataset: Dataset, columns: Indices, x: Array, *, delay: Delay = 0
) -> list[list[Array]]:
    """Return held-out residuals (K_i,) of each joint and block, for x (F, p) of columns (p,)."""
    return [
        [
            rows.b[:, delay_index] - rows.A @ parameters
            for parameters, blocks in zip(data.parameters(columns, x), data.rows, strict=True)
            for rows in blocks
        ]
        for data, delay_index in zip(dataset.data, dataset.delay_of_each(delay), strict=True)
    ]


def effective_of_rows(blocks: Sequence[Sequence[Array]], rows: Array | NDArray[np.int_]) -> Array:
    """Return the effective samples (nv,) of rows (nv,), from residuals of the kept rows.

    It is 1 for a joint without rows.
    """
    kept = np.array([sum(map(len, joint)) for joint in blocks])
    effective = effective_samples_of_each(blocks) * (rows / np.maximum(kept, 1))
    return np.where(kept > 0, effective, 1.0)


def reweight(hypothesis: Hypothesis, *, iterations: int = 2) -> Hypothesis:
    """Refit iteratively with weights from the held-out residuals.

    A joint's weight is the inverse of the geometric mean of its own squared error and that of the
    mean relative error of all joints, so that no joint is ignored. It is scaled to effective
    samples, so that coloured residuals do not outweigh the prior. Effective samples are updated at
    most `iterations` times, each time with converged weights.
    """
    dataset, unknowns, delay = hypothesis.dataset, hypothesis.unknowns, hypothesis.delay
    samples, variance = dataset.rows, dataset.effort_std**2
    weights, effective = hypothesis.weights, hypothesis.effective
    x, mse = unknowns.mean, hypothesis.held_out.mse

    def weights_of(cv: CrossValidation) -> Array:
        mse = np.maximum(cv.held_out.mse, 1e-12 * variance)
        mean = np.mean((mse / variance)[dataset.has_rows])
        return np.asarray(effective / samples / np.sqrt(mse * mean * variance))

    def effective_of(cv: CrossValidation) -> Array:
        blocks = residual_blocks(dataset, unknowns.columns, cv.held_out.x, delay=delay)
        return effective_of_rows(blocks, samples)

    for _ in range(iterations):
        for _ in range(_MOST_REFITS):
            power = weights * samples * mse * dataset.inertias(unknowns.columns, x) ** 2
            unknowns = unknowns.pulled(dataset, x, power)
            cv = CrossValidation(dataset, unknowns, weights, delay=delay, physical=False)
            x, mse = cv.held_out.x.mean(0), cv.held_out.mse
            previous, weights = weights, weights_of(cv)
            if _have_converged(weights, previous):
                break
        effective = effective_of(cv)
        previous, weights = weights, weights_of(cv)
        if _have_converged(weights, previous):
            break
    if not cv.is_physical:
        cv = CrossValidation(dataset, unknowns, cv.weights, delay=delay)
        effective = effective_of(cv)
        weights = weights_of(cv)
    return replace(hypothesis, unknowns=unknowns, weights=weights, cv=cv, effective=effective)


def _have_converged(weights: Array, previous: Array) -> bool:
    return bool(np.all(np.abs(np.log(weights / previous)) < _SETTLED))


def first_hypothesis(dataset: Dataset, unknowns: Unknowns) -> Hypothesis:
    """Return the model with its parameters refitted within their prior."""
    weights = _FIRST_SHARE / dataset.effort_std**2
    cv = CrossValidation(dataset, unknowns, weights)
    effective = np.asarray(_FIRST_SHARE * dataset.rows, float)
    first = Hypothesis(dataset, unknowns, weights, cv.delay, 1.0, cv, effective)
    return reweight(first, iterations=3)
