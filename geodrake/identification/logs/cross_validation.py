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
from geodrake.identification.normal_equations import (
    RIDGE,
    are_physical,
    cholesky,
    inner_bodies,
    physical_minimizers,
    solved,
)

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_ROUNDING = 1e-12  # by which a parameter may be beyond its bound


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
        return self.sse.sum(0) / self.samples.sum(0)

    @property
    def rms(self) -> Array:
        """(nv,) RMS held-out error of each joint."""
        return np.sqrt(self.mse)


def hold_out(dataset: Dataset, columns: Indices, x: Array, *, delay: Delay = 0) -> HeldOut:
    """Return the errors of given parameters in every fold, through the triangular factors.

    Args:
        columns: (p,) columns in use.
        x: (F, p) parameters for each fold.
    """
    sse = np.empty((len(dataset.folds), len(dataset.joints)))
    for j, (data, late) in enumerate(zip(dataset.data, dataset.delay_of_each(delay), strict=True)):
        n = len(data.columns)
        predicted = (data.factors[:, :, :n] @ data.parameters(columns, x)[..., None])[..., 0]
        sse[:, j] = np.square(data.factors[:, :, n + late] - predicted).sum(1)
    return HeldOut(sse / dataset.inertias(columns, x).T ** 2, dataset.samples, x)


def normal_matrices(
    dataset: Dataset, weights: Array, columns: Indices, *, delay: Delay = 0
) -> tuple[Array, Array]:
    """Return the weighted AᵀA (F, p, p) and Aᵀb (F, p) of every fold.

    Args:
        weights: (nv,) weight of a squared residual of each joint, 1 / (N·m)² or 1 / N².
        columns: (p,) columns of A in the dataset.
    """
    p, folds = len(columns), len(dataset.folds)
    gram, rhs = np.zeros((p, p, folds)), np.zeros((p, folds))
    delays = dataset.delay_of_each(delay)
    for data, weight, late in zip(dataset.data, weights, delays, strict=True):
        local = data.local(columns)
        seen = np.flatnonzero(local >= 0)
        effort = np.array([len(data.columns) + late])
        gram[seen[:, None], seen] += weight * data.products(local[seen], local[seen])
        rhs[seen] += weight * data.products(effort, local[seen])[0]
    return np.ascontiguousarray(np.moveaxis(gram, 2, 0)), np.ascontiguousarray(rhs.T)


class CrossValidation:
    """Fits of given unknowns to all folds but one.

    Args:
        weights: (nv,) weight of a squared residual of each joint, 1 / (N·m)².
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
        physical: bool = True,
    ) -> None:
        self.dataset, self.unknowns, self.weights = dataset, unknowns, weights
        self.delay = dataset.delay_of_each(delay)
        if held_out is None:
            (gram, rhs), (own_gram, own_rhs) = self._whole, self._own
            own_rhs = own_rhs + dataset.fold_shares[:, None] * unknowns.pull
            x = self._solved(gram - own_gram, rhs - own_rhs, unknowns.mean, physical=physical)
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

    @property
    def is_physical(self) -> bool:
        """Return whether the bodies of the fits are physical."""
        return bool(are_physical(self.held_out.x, self.unknowns.inertia_blocks).all())

    def _solved(self, grams: Array, rhs: Array, near: Array, *, physical: bool) -> Array:
        """Return fits (F, p) of matrices (F, p, p); physical ones begin at `near` (p,)."""
        scales = 1.0 / np.sqrt(np.diagonal(grams, axis1=1, axis2=2))
        scaled, x = grams * scales[:, :, None] * scales[:, None, :], np.empty_like(rhs)
        for f, factor in enumerate(cholesky(scaled)):
            free = scales[f] * solved(factor, scales[f] * rhs[f])
            x[f] = _within(free, rhs[f], (scaled[f], scales[f]), self.unknowns)
        blocks = self.unknowns.inertia_blocks
        beyond = np.flatnonzero(~are_physical(x, blocks)) if physical else np.zeros(0, int)
        if len(beyond):
            near = np.tile(near, (len(beyond), 1))
            begin = inner_bodies(near, blocks, self.dataset.payload)
            begin = np.where(self.unknowns.is_inertial, begin, x[beyond])
            bounds = self.unknowns.scalar_bounds
            x[beyond] = physical_minimizers(grams[beyond], rhs[beyond], blocks, begin, bounds)
        return x

    @cached_property
    def fit_all(self) -> Array:
        """(p,) parameters fitted to all folds."""
        gram, rhs = self._whole
        near = self.held_out.x.mean(0)  # physical, if each of them is
        return self._solved(gram[None], rhs[None], near, physical=True)[0]

    @cached_property
    def deviations(self) -> Array:
        """Return (p,) standard deviations of `fit_all`, bounds left aside."""
        gram, _ = self._whole
        scale = 1.0 / np.sqrt(np.diag(gram))
        matrix = gram * scale[:, None] * scale + RIDGE * np.eye(len(scale))
        return scale * np.sqrt(np.diag(np.linalg.inv(matrix)))


def _within(x: Array, rhs: Array, scaled: tuple[Array, Array], unknowns: Unknowns) -> Array:
    """Return the minimizer (p,) within the bounds of unknowns, from that without them.

    Args:
        x: (p,) the minimizer without bounds.
        rhs: (p,) right side of the normal equations.
        scaled: Their matrix (p, p) of unit diagonal, and by what (p,) it was scaled.
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
