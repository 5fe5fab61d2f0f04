"""A hypothesis: the model with certain effects, fitted and validated fold by fold.

Every fold is predicted by a fit to the others. The normal matrices are assembled from the factors
of each fold and joint of a `Dataset`, so that a fit costs one Cholesky factorization; where bodies
come out that cannot exist, `fit_problem` keeps them physical.
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

_ROUNDING = 1e-12  # by which a parameter may be beyond its bound
_SETTLED = 0.3  # weights are settled if they change by less than this share
_MOST_REFITS = 8
_FIRST_SHARE = 0.05  # of the samples that count as effective ones in the first fit


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Held-out squared errors."""

    # (F, nv) sums of squared held-out residuals, (N·m)² or N²; of joints without motors those of
    # accelerations times the inertia that the model gave the joint before.
    sse: Array
    samples: NDArray[np.int_]  # (F, nv) rows behind them
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
    sse = np.empty((len(dataset.folds), len(dataset.joints)))
    for j, (data, late) in enumerate(zip(dataset.data, dataset.delay_of_each(delay), strict=True)):
        n = len(data.columns)
        predicted = (data.factors[:, :, :n] @ data.parameters(columns, x)[..., None])[..., 0]
        sse[:, j] = np.square(data.factors[:, :, n + late] - predicted).sum(1)
    return HeldOut(sse / dataset.inertias(columns, x).T ** 2, dataset.samples, x)


def normal_matrices(
    dataset: Dataset, weights: Array, columns: Indices, *, delay: Delay = 0
) -> tuple[Array, Array]:
    """Return the weighted AᵀA (F, p, p) and Aᵀb (F, p) of every fold, for columns (p,) of A.

    The weights (nv,) are those of a squared residual of each joint, 1 / (N·m)² or 1 / N².
    """
    p, folds = len(columns), len(dataset.folds)
    gram, rhs = np.zeros((folds, p, p)), np.zeros((folds, p))
    delays = dataset.delay_of_each(delay)
    for data, weight, late in zip(dataset.data, weights, delays, strict=True):
        seen = np.flatnonzero(data.local(columns) >= 0)
        rows = data.factors_of(columns[seen], late)
        own = weight * np.swapaxes(rows, 1, 2)[:, :-1] @ rows
        gram[:, seen[:, None], seen] += own[:, :, :-1]
        rhs[:, seen] += own[:, :, -1]
    return gram, rhs


class CrossValidation:
    """Fits of given unknowns to all folds but one, optionally with physical bodies.

    The weights (nv,) are those of a squared residual of each joint, 1 / (N·m)².
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
            (gram, rhs), (own_gram, own_rhs) = self._whole, self._own
            own_rhs = own_rhs + dataset.fold_shares[:, None] * unknowns.pull
            folds = range(len(dataset.folds))
            x = self._solved(gram - own_gram, rhs - own_rhs, folds, physical=physical)
            held_out = hold_out(dataset, unknowns.columns, x, delay=self.delay)
        self.held_out = held_out

    @cached_property
    def _own(self) -> tuple[Array, Array]:
        """Normal matrix (F, p, p) and right side (F, p) of each fold."""
        return normal_matrices(self.dataset, self.weights, self.unknowns.columns, delay=self.delay)

    @cached_property
    def _whole(self) -> tuple[Array, Array]:
        """Normal matrix (p, p) and right side (p,) of all folds with the prior."""
        (gram, rhs), prior = self._own, self.unknowns.information
        return gram.sum(0) + prior, rhs.sum(0) + prior @ self.unknowns.mean + self.unknowns.pull

    @cached_property
    def _factors(self) -> list[Array]:
        """Triangular factor (p + 1, p + 1) of each fold."""
        columns = self.unknowns.columns
        return fold_factors(self.dataset, columns, self.weights, delay=self.delay)

    def _solved(
        self, grams: Array, rhs: Array, without: Sequence[int | None], *, physical: bool
    ) -> Array:
        """Return fits (F, p) of matrices (F, p, p), by `without` which folds they are."""
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
        """Return whether all bodies of parameters (…, p) can exist."""
        places = np.array(self.unknowns.inertia_blocks, int)[:, None]
        return bool(is_physical(x[..., places + np.arange(PARAMETERS_PER_BODY)]).all())

    @property
    def is_physical(self) -> bool:
        """Whether the bodies of all fits can exist."""
        return self._are_physical(self.held_out.x)

    @cached_property
    def fit_all(self) -> Array:
        """(p,) parameters fitted to all folds."""
        gram, rhs = self._whole
        return self._solved(gram[None], rhs[None], [None], physical=True)[0]

    @cached_property
    def deviations(self) -> Array:
        """Return (p,) standard deviations of `fit_all`, bounds left aside."""
        gram, _ = self._whole
        scale = 1.0 / np.sqrt(np.diag(gram))
        matrix = gram * scale[:, None] * scale + RIDGE * np.eye(len(scale))
        return scale * np.sqrt(np.diag(np.linalg.inv(matrix)))


def _within(x: Array, rhs: Array, scaled: tuple[Array, Array], unknowns: Unknowns) -> Array:
    """Return the minimizer (p,) within the bounds of unknowns, from that without them, x (p,).

    The normal equations have the right side (p,), and a matrix (p, p) scaled to unit diagonal by
    factors (p,).
    """
    free, (matrix, scale) = np.ones(len(x), bool), scaled
    lower, upper = unknowns.lower - _ROUNDING, unknowns.upper + _ROUNDING
    while np.any(outside := (x < lower) | (x > upper)):
        free &= ~outside
        x = np.clip(x, unknowns.lower, unknowns.upper)
        held = (matrix[np.ix_(free, ~free)] @ (x[~free] / scale[~free])) / scale[free]
        right = scale[free] * (rhs[free] - held)
        x[free] = scale[free] * solved(cholesky(matrix[np.ix_(free, free)]), right)
    return x


@dataclass(frozen=True, eq=False)
class Hypothesis(Short):
    """The model with the effects among `unknowns`, and its held-out errors."""

    dataset: Dataset
    unknowns: Unknowns
    weights: Array  # (nv,) of squared residuals: effective share of the samples / mse
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
            rows.b[:, late] - rows.A @ own
            for own, blocks in zip(data.parameters(columns, x), data.rows, strict=True)
            for rows in blocks
        ]
        for data, late in zip(dataset.data, dataset.delay_of_each(delay), strict=True)
    ]


def effective_of_rows(blocks: Sequence[Sequence[Array]], rows: Array | NDArray[np.int_]) -> Array:
    """Return (nv,) effective samples of rows (nv,), by the residuals of those that are kept.

    A joint without rows is given one.
    """
    kept = np.array([sum(map(len, joint)) for joint in blocks])
    found = effective_samples_of_each(blocks) * (rows / np.maximum(kept, 1))
    return np.where(kept > 0, found, 1.0)


def reweight(hypothesis: Hypothesis, *, iterations: int = 2) -> Hypothesis:
    """Refit with weights that follow from the held-out residuals themselves.

    The weight of a joint is the inverse of its squared error (half its own, half what the same
    relative error of all joints would be, so that no joint is given up), reduced to its effective
    samples so that coloured residuals do not outvote the prior. Effective samples are counted in so
    many `iterations` at most, each time with weights that agree with the errors.
    """
    dataset, unknowns, delay = hypothesis.dataset, hypothesis.unknowns, hypothesis.delay
    samples, variance = dataset.rows, dataset.effort_std**2
    weights, effective = hypothesis.weights, hypothesis.effective
    x, mse = unknowns.mean, hypothesis.held_out.mse

    def deserved(cv: CrossValidation) -> Array:
        mse = np.maximum(cv.held_out.mse, 1e-12 * variance)
        mean = np.mean((mse / variance)[dataset.has_rows])
        return np.asarray(effective / samples / np.sqrt(mse * mean * variance))

    def counted(cv: CrossValidation) -> Array:
        blocks = residual_blocks(dataset, unknowns.columns, cv.held_out.x, delay=delay)
        return effective_of_rows(blocks, samples)

    for _ in range(iterations):
        for _ in range(_MOST_REFITS):
            power = weights * samples * mse * dataset.inertias(unknowns.columns, x) ** 2
            unknowns = unknowns.pulled(dataset, x, power)
            cv = CrossValidation(dataset, unknowns, weights, delay=delay, physical=False)
            x, mse = cv.held_out.x.mean(0), cv.held_out.mse
            before, weights = weights, deserved(cv)
            if _alike(weights, before):
                break
        effective = counted(cv)
        before, weights = weights, deserved(cv)
        if _alike(weights, before):
            break
    if not cv.is_physical:
        cv = CrossValidation(dataset, unknowns, cv.weights, delay=delay)
        effective = counted(cv)
        weights = deserved(cv)
    return replace(hypothesis, unknowns=unknowns, weights=weights, cv=cv, effective=effective)


def _alike(weights: Array, before: Array) -> bool:
    return bool(np.all(np.abs(np.log(weights / before)) < _SETTLED))


def first_hypothesis(dataset: Dataset, unknowns: Unknowns, *, delay: Delay = 0) -> Hypothesis:
    """Return the given model with its parameters refitted within their prior."""
    weights = _FIRST_SHARE / dataset.effort_std**2
    cv = CrossValidation(dataset, unknowns, weights, delay=delay)
    effective = np.asarray(_FIRST_SHARE * dataset.rows, float)
    first = Hypothesis(dataset, unknowns, weights, cv.delay, 1.0, cv, effective)
    return reweight(first, iterations=3)
