"""Held-out errors: every fold predicted by a fit to the others.

The normal matrices are assembled from the per-fold, per-joint factors of a `Dataset`, so that a
fit costs one Cholesky factorization. Bodies are physical in every fit, as far as is asked for: data
that pull them out cost some steps more.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.identification.logs.dataset import Dataset, Delay
from geodrake.identification.logs.unknowns import Unknowns
from geodrake.identification.normal_equations import RIDGE, choleskies, cholesky, solved
from geodrake.identification.physical_minimizers import (
    are_physical,
    inner_bodies,
    physical_minimizers,
)
from geodrake.inertia import PARAMETERS_PER_BODY

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_MOST_SEEN = 0.3
"""If a joint sees more than this share of the products, adding zeros to the others is quicker."""

_ROUNDING = 1e-12
"""Rounding may take a parameter so far beyond its bound."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Held-out squared errors.

    Attributes:
        sse: (F, nv) sums of squared held-out residuals, (N·m)² or N².
        samples: (F, nv) rows behind them.
        x: (F, p) parameters fitted without each fold.
    """

    sse: Array
    samples: NDArray[np.int_]
    x: Array

    @property
    def mse(self) -> Array:
        """(nv,) mean squared held-out error of each joint."""
        return self.sse.sum(0) / self.samples.sum(0)

    @property
    def rms(self) -> Array:
        """(nv,) RMS held-out error of each joint."""
        return np.sqrt(self.mse)


def hold_out(dataset: Dataset, columns: Indices, x: Array, *, delay: Delay = 0) -> HeldOut:
    """Errors of given parameters in every fold, through the triangular factors.

    Args:
        dataset: The reduced logs.
        columns: (p,) columns in use.
        x: (F, p) parameters for each fold.
        delay: Index of the effort column.
    """
    sse = np.empty((len(dataset.folds), len(dataset.joints)))
    for j, (data, late) in enumerate(zip(dataset.data, dataset.delay_of_each(delay), strict=True)):
        n = len(data.columns)
        predicted = (data.factors[:, :, :n] @ data.parameters(columns, x)[..., None])[..., 0]
        sse[:, j] = np.square(data.factors[:, :, n + late] - predicted).sum(1)
    return HeldOut(sse, dataset.samples, x)


def normal_matrices(
    dataset: Dataset, weights: Array, left: Indices, right: Indices, *, delay: Delay = 0
) -> tuple[Array, Array]:
    """Weighted AᵀA between two sets of columns, and Aᵀb of the second, of every fold.

    Args:
        dataset: The reduced logs.
        weights: (nv,) weight of a squared residual of each joint, 1 / (N·m)² or 1 / N².
        left: (l,) columns of the dataset.
        right: (r,) columns of the dataset.
        delay: Index of the effort column that b is.

    Returns:
        (F, l, r) and (F, r).
    """
    gram = np.zeros((len(left), len(right), len(dataset.folds)))
    rhs = np.zeros((1, len(right), len(dataset.folds)))
    delays = dataset.delay_of_each(delay)
    for data, weight, late in zip(dataset.data, weights, delays, strict=True):
        at_left, at_right = data.local(left), data.local(right)
        rows, columns = np.flatnonzero(at_left >= 0), np.flatnonzero(at_right >= 0)
        if len(columns):
            effort = np.array([len(data.columns) + late])
            rhs += weight * data.products(effort, at_right)
            if len(rows) * len(columns) > _MOST_SEEN * len(left) * len(right):
                gram += weight * data.products(at_left, at_right)
            else:
                seen = weight * data.products(at_left[rows], at_right[columns])
                gram[rows[:, None], columns] += seen
    return np.ascontiguousarray(np.moveaxis(gram, 2, 0)), np.ascontiguousarray(rhs[0].T)


class CrossValidation:
    """Fits of given unknowns to all folds but one.

    Args:
        dataset: The reduced logs.
        unknowns: What the fit may move.
        weights: (nv,) weight of a squared residual of each joint, 1 / (N·m)².
        delay: Index of the effort column to fit.
        held_out: The held-out errors, if they are known already.
        start: (F, p) parameters of like fits with physical bodies, to save some steps.
        physical: Whether bodies are kept physical.
    """

    def __init__(
        self,
        dataset: Dataset,
        unknowns: Unknowns,
        weights: Array,
        *,
        delay: Delay = 0,
        held_out: HeldOut | None = None,
        start: Array | None = None,
        physical: bool = True,
    ) -> None:
        self._start, self._physical = start, physical
        self.dataset, self.unknowns, self.weights = dataset, unknowns, weights
        self.delay = dataset.delay_of_each(delay)
        self.held_out = self._hold_out() if held_out is None else held_out

    def _hold_out(self) -> HeldOut:
        gram, rhs = self._whole
        own_gram, own_rhs = self._own
        x = self._solved(gram - own_gram, rhs - own_rhs, self._start, self._physical)
        return hold_out(self.dataset, self.unknowns.columns, x, delay=self.delay)

    @cached_property
    def _own(self) -> tuple[Array, Array]:
        """Normal matrix (F, p, p) and right side (F, p) of each fold."""
        columns = self.unknowns.columns
        return normal_matrices(self.dataset, self.weights, columns, columns, delay=self.delay)

    @cached_property
    def _whole(self) -> tuple[Array, Array]:
        """Normal matrix (p, p) and right side (p,) of all folds with the prior."""
        (gram, rhs), prior = self._own, self.unknowns.information
        return gram.sum(0) + prior, rhs.sum(0) + prior @ self.unknowns.mean

    def physical(self, start: Array | None = None) -> CrossValidation:
        """These fits with physical bodies; themselves if they are so already.

        Args:
            start: (F, p) parameters of like fits with physical bodies, to save some steps.
        """
        if are_physical(self.held_out.x, self.unknowns.inertia_blocks).all():
            return self
        return CrossValidation(
            self.dataset, self.unknowns, self.weights, delay=self.delay, start=start
        )

    def _solved(self, grams: Array, rhs: Array, start: Array | None, physical: bool) -> Array:
        """(F, p) fits of matrices (F, p, p) and right sides (F, p), physical if asked for."""
        x, blocks = self._within_bounds(grams, rhs), self.unknowns.inertia_blocks
        beyond = np.flatnonzero(~are_physical(x, blocks)) if physical else np.zeros(0, int)
        if len(beyond):
            begin = np.broadcast_to(self.unknowns.mean, x.shape) if start is None else start
            begin = inner_bodies(begin[beyond], blocks, self.dataset.payload)
            inertial, bounds = self._inertial_and_bounds
            begin = np.where(inertial, begin, x[beyond])
            x[beyond] = physical_minimizers(grams[beyond], rhs[beyond], blocks, begin, bounds)
        return x

    @cached_property
    def _inertial_and_bounds(self) -> tuple[NDArray[np.bool_], tuple[Array, Array]]:
        """(p,) which unknowns are of bodies, and the bounds (p,) of the others."""
        unknowns = self.unknowns
        inertial = np.zeros(len(unknowns.mean), bool)
        for block in unknowns.inertia_blocks:
            inertial[block : block + PARAMETERS_PER_BODY] = True
        lower = np.where(inertial, -np.inf, unknowns.lower)
        return inertial, (lower, np.where(inertial, np.inf, unknowns.upper))

    def _within_bounds(self, grams: Array, rhs: Array) -> Array:
        """(F, p) minimizers within the bounds."""
        scales = 1.0 / np.sqrt(np.diagonal(grams, axis1=1, axis2=2))
        scaled = grams * scales[:, :, None] * scales[:, None, :]
        found = np.empty_like(rhs)
        for f, factor in enumerate(choleskies(scaled)):
            free = scales[f] * solved(factor, scales[f] * rhs[f])
            found[f] = _within(free, rhs[f], (scaled[f], scales[f]), self.unknowns)
        return found

    def fit_all(self) -> Array:
        """(p,) parameters fitted to all folds."""
        return self._all

    def covariance(self) -> Array:
        """(p, p) covariance of `fit_all`, bounds left aside."""
        return self._covariance

    def deviations(self) -> Array:
        """(p,) standard deviations of `fit_all`, bounds left aside."""
        return np.sqrt(np.diag(self._covariance))

    @cached_property
    def _all(self) -> Array:
        gram, rhs = self._whole
        near = self.held_out.x.mean(0, keepdims=True)  # physical, if each of them is
        return self._solved(gram[None], rhs[None], near, physical=True)[0]

    @cached_property
    def _covariance(self) -> Array:
        gram, _ = self._whole
        scale = 1.0 / np.sqrt(np.diag(gram))
        matrix = gram * scale[:, None] * scale + RIDGE * np.eye(len(scale))
        return np.asarray(scale[:, None] * np.linalg.inv(matrix) * scale)


def _within(x: Array, rhs: Array, scaled: tuple[Array, Array], unknowns: Unknowns) -> Array:
    """Return the minimizer (p,) within the bounds of unknowns, from that without them.

    Args:
        x: (p,) the minimizer without bounds.
        rhs: (p,) right side of the normal equations.
        scaled: Their matrix (p, p) of unit diagonal, and by what (p,) it was scaled.
        unknowns: The unknowns.
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
