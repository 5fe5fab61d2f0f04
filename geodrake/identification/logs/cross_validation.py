"""Held-out errors: every fold predicted by a fit to the others.

The normal matrices are assembled from the per-fold, per-joint factors of a `Dataset`, so that a
fit costs one Cholesky factorization and a candidate effect one small Schur complement. Bodies are
physical in every fit, as far as is asked for: data that pull them out cost some steps more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.identification.logs.dataset import Dataset, Delay
from geodrake.identification.logs.unknowns import Unknowns
from geodrake.identification.normal_equations import (
    RIDGE,
    bounded_minimizers,
    choleskies,
    cholesky,
    solved,
)
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


@dataclass(frozen=True, eq=False)
class ExtraColumns:
    """Columns that may come beside the unknowns.

    Attributes:
        columns: (k,) the candidate's columns.
        information: (k, k) its prior information about zero.
        lower: (k,) lower bounds.
        upper: (k,) upper bounds.
    """

    columns: Indices
    information: Array
    lower: Array
    upper: Array


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
    """Fits to all folds but one, of given unknowns, and of unknowns with one candidate more.

    Args:
        dataset: The reduced logs.
        unknowns: What the fit may move.
        weights: (nv,) weight of a squared residual of each joint, 1 / (N·m)².
        delay: Index of the effort column to fit.
        held_out: The held-out errors, if they are known already.
        start: (F, p) parameters of like fits with physical bodies, to save some steps.
        physical: Whether bodies are kept physical.
        fits: The fits, if they are known already.
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
        fits: list[_Fit] | None = None,
    ) -> None:
        self._start, self._physical, self._known_fits = start, physical, fits
        self.dataset, self.unknowns, self.weights = dataset, unknowns, weights
        self.delay = dataset.delay_of_each(delay)
        self.held_out = self._hold_out() if held_out is None else held_out

    def _hold_out(self) -> HeldOut:
        x = np.array([fit.x for fit in self._fits])
        return hold_out(self.dataset, self.unknowns.columns, x, delay=self.delay)

    @cached_property
    def _solution(self) -> tuple[Array, Array, list[_Fit]]:
        """Normal matrix and right side of all folds with the prior, and the fit without each."""
        unknowns = self.unknowns
        own_gram, own_rhs = self._assemble(unknowns.columns, unknowns.columns)
        gram = own_gram.sum(0) + unknowns.information
        rhs = own_rhs.sum(0) + unknowns.information @ unknowns.mean
        return gram, rhs, self._solved(gram - own_gram, rhs - own_rhs, self._start, self._physical)

    @property
    def _fits(self) -> list[_Fit]:
        return self._solution[2] if self._known_fits is None else self._known_fits

    def less(self, unknowns: Unknowns, kept: Indices) -> CrossValidation:
        """These fits without some of the unknowns, with the same weights.

        Args:
            unknowns: What the fit may move still.
            kept: (p,) places of those among the unknowns of these fits.
        """
        if any(fit.constrained for fit in self._fits):  # bodies are to be physical anew
            return CrossValidation(self.dataset, unknowns, self.weights, delay=self.delay)
        fits, blocks = [fit.less(kept, unknowns) for fit in self._fits], unknowns.inertia_blocks
        left = np.array([fit.x for fit in fits])
        were = are_physical(self.held_out.x, self.unknowns.inertia_blocks).all()
        known = None if were and not are_physical(left, blocks).all() else fits
        return CrossValidation(self.dataset, unknowns, self.weights, delay=self.delay, fits=known)

    def at_delay(self, delay: Delay) -> HeldOut:
        """Held-out errors against the effort with another delay, refitted with the same weights.

        Where bodies are kept from what cannot be, to first order.

        Args:
            delay: Index of the effort column, of all joints or of each.
        """
        columns, none = self.unknowns.columns, np.zeros(0, np.intp)
        own, new = (
            normal_matrices(self.dataset, self.weights, none, columns, delay=late)[1]
            for late in (self.delay, delay)
        )
        change = (new - own).sum(0) - (new - own)
        x = np.array([self._pushed(*each) for each in zip(self._fits, change, strict=True)])
        return hold_out(self.dataset, columns, x, delay=delay)

    def _pushed(self, fit: _Fit, change: Array) -> Array:
        """(p,) the minimizer of a fit once the right side of its normal equations has changed."""
        if fit.constrained:
            x = fit.x + fit.solve(change[:, None])[:, 0]
            return np.clip(x, self.unknowns.lower, self.unknowns.upper)
        x = fit.unbounded + fit.solve(change[:, None])[:, 0]
        return _within(x, fit.right(x), (fit.scaled, fit.scale), self.unknowns)

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

    def _assemble(self, left: Indices, right: Indices) -> tuple[Array, Array]:
        return normal_matrices(self.dataset, self.weights, left, right, delay=self.delay)

    def _solved(self, grams: Array, rhs: Array, start: Array | None, physical: bool) -> list[_Fit]:
        """Fits of (F, p, p) normal matrices and (F, p) right sides, physical if asked for."""
        fits = self._within_bounds(grams, rhs)
        x, blocks = np.array([fit.x for fit in fits]), self.unknowns.inertia_blocks
        beyond = np.flatnonzero(~are_physical(x, blocks)) if physical else np.zeros(0, int)
        if len(beyond):
            begin = np.broadcast_to(self.unknowns.mean, x.shape) if start is None else start
            begin = inner_bodies(begin[beyond], blocks, self.dataset.payload)
            inertial, bounds = self._inertial_and_bounds
            begin = np.where(inertial, begin, x[beyond])
            left = [block for block in blocks if not are_physical(x[beyond], [block]).all()]
            found = physical_minimizers(
                grams[beyond], rhs[beyond], blocks, begin, bounds, beyond=left
            )
            parts = zip(beyond, found.x, found.slope, found.hessian, strict=True)
            for f, at, slope, hessian in parts:
                scale = 1.0 / np.sqrt(np.diag(hessian))
                factor = cholesky(hessian * scale[:, None] * scale)
                unbounded = at - scale * solved(factor, scale * slope)
                fits[f] = _Fit(at, unbounded, factor, scale, constrained=True)
        return fits

    @cached_property
    def _inertial_and_bounds(self) -> tuple[NDArray[np.bool_], tuple[Array, Array]]:
        """(p,) which unknowns are of bodies, and the bounds (p,) of the others."""
        unknowns = self.unknowns
        inertial = np.zeros(len(unknowns.mean), bool)
        for block in unknowns.inertia_blocks:
            inertial[block : block + PARAMETERS_PER_BODY] = True
        lower = np.where(inertial, -np.inf, unknowns.lower)
        return inertial, (lower, np.where(inertial, np.inf, unknowns.upper))

    def _within_bounds(self, grams: Array, rhs: Array) -> list[_Fit]:
        """Minimizers within the bounds, and the factors of the unbounded problems, of each."""
        scales = 1.0 / np.sqrt(np.diagonal(grams, axis1=1, axis2=2))
        scaled = grams * scales[:, :, None] * scales[:, None, :]
        fits = []
        for f, factor in enumerate(choleskies(scaled)):
            scale = scales[f]
            x = unbounded = scale * solved(factor, scale * rhs[f])
            x = _within(x, rhs[f], (scaled[f], scale), self.unknowns)
            fits.append(_Fit(x, unbounded, factor, scale))
        return fits

    def fit_all(self) -> Array:
        """(p,) parameters fitted to all folds."""
        return self._whole.x

    def covariance(self) -> Array:
        """(p, p) covariance of `fit_all`, bounds left aside."""
        return self._covariance

    def deviations(self) -> Array:
        """(p,) standard deviations of `fit_all`, bounds left aside."""
        return np.sqrt(np.diag(self._covariance))

    @cached_property
    def _whole(self) -> _Fit:
        gram, rhs, _ = self._solution
        near = self.held_out.x.mean(0, keepdims=True)  # physical, if each of them is
        return self._solved(gram[None], rhs[None], near, physical=True)[0]

    @cached_property
    def _covariance(self) -> Array:
        gram, _, _ = self._solution
        scale = 1.0 / np.sqrt(np.diag(gram))
        matrix = gram * scale[:, None] * scale + RIDGE * np.eye(len(scale))
        return np.asarray(scale[:, None] * np.linalg.inv(matrix) * scale)

    @cached_property
    def _residuals(self) -> list[tuple[Array, Indices, Array]]:
        """Per joint: factors (F, m, l) of the unknowns it sees, which, and residuals (F, m)."""
        found = []
        for data, late in zip(self.dataset.data, self.delay, strict=True):
            local = data.local(self.unknowns.columns)
            used = np.flatnonzero(local >= 0)
            factor = data.factors[:, :, local[used]]
            predicted = (factor @ self.held_out.x[:, used, None])[..., 0]
            left = data.factors[:, :, len(data.columns) + late] - predicted
            found.append((factor, used, left))
        return found

    def with_candidates(self, candidates: Sequence[ExtraColumns]) -> list[HeldOut]:
        """Held-out errors with each of some candidates beside the unknowns, one at a time.

        What they share, the products and solutions of all their columns, is computed together.
        """
        columns = np.unique(np.concatenate([candidate.columns for candidate in candidates]))
        cross, right = self._assemble(self.unknowns.columns, columns)
        own, _ = self._assemble(columns, columns)
        cross, right, own = (part.sum(0) - part for part in (cross, right, own))
        moved = np.stack([fit.solve(part) for fit, part in zip(self._fits, cross, strict=True)])
        turned = np.swapaxes(cross, 1, 2)
        schur = own - turned @ moved
        pull = right - (turned @ self.held_out.x[:, :, None])[..., 0]
        places = [np.searchsorted(columns, candidate.columns) for candidate in candidates]
        y = np.zeros((len(cross), len(columns), len(candidates)))
        for width in {len(at) for at in places}:
            alike = [k for k, at in enumerate(places) if len(at) == width]
            at = np.array([places[k] for k in alike])
            known, low, high = (
                np.array([getattr(candidates[k], name) for k in alike])
                for name in ("information", "lower", "upper")
            )
            blocks = schur[:, at[:, :, None], at[:, None]] + known
            shape = pull[:, at].shape
            low, high = (np.broadcast_to(bound, shape).reshape(-1, width) for bound in (low, high))
            found = bounded_minimizers(
                blocks.reshape(-1, width, width), pull[:, at].reshape(-1, width), low, high
            )
            y[:, at, np.array(alike)[:, None]] = found.reshape(shape)
        change = -(moved @ y)
        sse, samples, before = (
            self._errors_after(columns, y, change),
            self.dataset.samples,
            self.held_out.x,
        )
        return [
            HeldOut(sse[..., k], samples, np.hstack([before + change[:, :, k], y[:, at, k]]))
            for k, at in enumerate(places)
        ]

    def _errors_after(self, columns: Indices, y: Array, change: Array) -> Array:
        """(F, nv, n) squared errors with y (F, m, n) at columns (m,) and unknowns changed."""
        sse = np.empty((*self.held_out.sse.shape, y.shape[2]))
        for j, (data, (factor, used, left)) in enumerate(
            zip(self.dataset.data, self._residuals, strict=True)
        ):
            local = data.local(columns)
            on = np.flatnonzero(local >= 0)
            effect = data.factors[:, :, local[on]] @ y[:, on] + factor @ change[:, used]
            sse[:, j] = np.square(left[:, :, None] - effect).sum(1)
        return sse

    def errors_at_delays(self, joint: int) -> Array:
        """(d, F) squared held-out errors of a joint against its effort with every delay.

        All else is refitted with the same weights; bounds are left aside.
        """
        data, (factor, used, _) = self.dataset.data[joint], self._residuals[joint]
        efforts = len(data.columns) + np.arange(len(self.dataset.delays))
        rhs = self.weights[joint] * data.products(data.local(self.unknowns.columns), efforts)
        change = rhs - rhs[:, [self.delay[joint]]]
        others = np.moveaxis(change.sum(axis=2, keepdims=True) - change, 2, 0)
        x = [fit.x[:, None] + fit.solve(own) for fit, own in zip(self._fits, others, strict=True)]
        left = data.factors[:, :, efforts] - factor @ np.array(x)[:, used]
        return np.asarray(np.square(left).sum(axis=1).T)

    def without_columns(self, places: Indices) -> HeldOut | None:
        """Held-out errors without some of the unknowns, all else refitted with the same weights.

        Parameters at a bound stay there, and others are not kept from passing theirs.

        Args:
            places: (k,) their places among the unknowns.

        Returns:
            The errors; None where a parameter would leave its bound, which this leaves aside.
        """
        x = self.held_out.x
        side = 1.0 * (x <= self.unknowns.lower) - (x >= self.unknowns.upper)
        side[:, places] = 0.0
        held = side != 0.0
        y = np.empty_like(x)
        for f, fit in enumerate(self._fits):
            at = np.concatenate([places, np.flatnonzero(held[f])])
            step = np.zeros(len(at))
            step[: len(places)] = x[f, places]
            moved = fit.solve(np.eye(x.shape[1])[:, at])
            y[f] = x[f] - moved @ np.linalg.solve(moved[at], step)
            if held[f].any() and np.any(fit.slope(y[f])[held[f]] * side[f, held[f]] < 0.0):
                return None
        sse = np.empty_like(self.held_out.sse)
        for j, (factor, used, left) in enumerate(self._residuals):
            change = (factor @ (y - x)[:, used, None])[..., 0]
            sse[:, j] = np.square(left - change).sum(1)
        return HeldOut(sse, self.dataset.samples, y)


@dataclass(frozen=True, eq=False)
class _Fit:
    """A solution, that without bounds, and the scaled Cholesky factor of the normal matrix.

    Where bodies are kept from what cannot be, the matrix is that of the constrained problem.
    """

    x: Array
    unbounded: Array
    factor: Array
    scale: Array
    constrained: bool = False

    def solve(self, right: Array) -> Array:
        return self.scale[:, None] * solved(self.factor, self.scale[:, None] * right)

    def slope(self, x: Array) -> Array:
        """(p,) slope of half the weighted squared error at other parameters (p,)."""
        return self.right(x - self.unbounded)

    def right(self, x: Array) -> Array:
        """(p,) product of the normal matrix with parameters (p,)."""
        triangle = np.tril(self.factor)
        return np.asarray((triangle @ (triangle.T @ (x / self.scale))) / self.scale)

    @property
    def scaled(self) -> Array:
        """(p, p) scaled normal matrix, without the ridge of its factor."""
        triangle = np.tril(self.factor)
        return np.asarray(triangle @ triangle.T - RIDGE * np.eye(len(triangle)))

    def less(self, kept: Indices, unknowns: Unknowns) -> _Fit:
        """The fit of some of the parameters, at places (k,), without the others."""
        scale, right = self.scale[kept], self.right(self.unbounded)[kept]
        scaled = self.scaled[np.ix_(kept, kept)]
        factor = cholesky(scaled)
        unbounded = scale * solved(factor, scale * right)
        return _Fit(_within(unbounded, right, (scaled, scale), unknowns), unbounded, factor, scale)


def _within(x: Array, rhs: Array, scaled: tuple[Array, Array], unknowns: Unknowns) -> Array:
    """The minimizer (p,) within the bounds of unknowns, from that without them.

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
