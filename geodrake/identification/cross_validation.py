"""Held-out errors: every fold predicted by a fit to the others.

The normal matrices are assembled from the per-fold, per-joint factors of a `Dataset`, so that a
fit costs one Cholesky factorization and a candidate effect one small Schur complement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import nnls

from geodrake.identification.dataset import Dataset, JointData
from geodrake.identification.unknowns import Unknowns

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


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


def normal_matrix(
    data: JointData, fold: int, left: Indices, right: Indices, delay: int
) -> tuple[Array, Array]:
    """AᵀA between two sets of columns, and Aᵀb of the first, for one joint and fold."""
    gram = data.grams[fold]
    loc_left, loc_right = data.local(left), data.local(right)
    on_left, on_right = loc_left >= 0, loc_right >= 0
    block = np.zeros((len(left), len(right)))
    block[np.ix_(on_left, on_right)] = gram[np.ix_(loc_left[on_left], loc_right[on_right])]
    rhs = np.zeros(len(left))
    rhs[on_left] = gram[loc_left[on_left], len(data.columns) + delay]
    return block, rhs


def residual_norms(dataset: Dataset, fold: int, columns: Indices, x: Array, delay: int) -> Array:
    """(nv,) squared norms of b − A x in one fold, through the triangular factors."""
    out = np.empty(len(dataset.joints))
    for j, data in enumerate(dataset.data):
        local = data.local(columns)
        used = local >= 0
        factor = data.factors[fold]
        r = factor[:, len(data.columns) + delay] - factor[:, local[used]] @ x[used]
        out[j] = r @ r
    return out


class CrossValidation:
    """Fits to all folds but one, of given unknowns, and of unknowns with one candidate more.

    Args:
        dataset: The reduced logs.
        unknowns: What the fit may move.
        weights: (nv,) weight of a squared residual of each joint, 1 / (N·m)².
        delay: Index of the effort column to fit.
    """

    def __init__(
        self, dataset: Dataset, unknowns: Unknowns, weights: Array, *, delay: int = 0
    ) -> None:
        self.dataset, self.unknowns, self.weights, self.delay = dataset, unknowns, weights, delay
        columns = unknowns.columns
        blocks = [self._assemble(f, columns, columns) for f in range(len(dataset.folds))]
        self._gram = np.array([gram for gram, _ in blocks])
        self._rhs = np.array([rhs for _, rhs in blocks])
        self._solutions = [self._solve_fold(f) for f in range(len(dataset.folds))]
        self.held_out = self._evaluate(columns, np.array([x for x, _, _ in self._solutions]))

    def _assemble(self, fold: int, left: Indices, right: Indices) -> tuple[Array, Array]:
        gram, rhs = np.zeros((len(left), len(right))), np.zeros(len(left))
        for data, weight in zip(self.dataset.data, self.weights, strict=True):
            block, b = normal_matrix(data, fold, left, right, self.delay)
            gram += weight * block
            rhs += weight * b
        return gram, rhs

    def training(self, fold: int | None) -> tuple[Array, Array]:
        """Normal matrix and right-hand side without a fold, prior included."""
        gram, rhs = self._gram.sum(0), self._rhs.sum(0)
        if fold is not None:
            gram, rhs = gram - self._gram[fold], rhs - self._rhs[fold]
        information = self.unknowns.information
        return gram + information, rhs + information @ self.unknowns.mean

    def _solve_fold(self, fold: int | None) -> tuple[Array, tuple[Array, bool], Array]:
        gram, rhs = self.training(fold)
        scale = 1.0 / np.sqrt(np.diag(gram))
        factor = cho_factor(gram * scale[:, None] * scale + _ridge(len(gram)), lower=True)
        x = scale * cho_solve(factor, scale * rhs)
        free = np.ones(len(x), bool)
        lower, upper = self.unknowns.lower, self.unknowns.upper
        for _ in range(len(x)):
            outside = (x < lower - 1e-12) | (x > upper + 1e-12)
            if not outside.any():
                break
            free &= ~outside
            x = np.clip(x, lower, upper)
            fixed = ~free
            sub = gram[np.ix_(free, free)] * scale[free, None] * scale[free]
            right = scale[free] * (rhs[free] - gram[np.ix_(free, fixed)] @ x[fixed])
            x[free] = scale[free] * cho_solve(cho_factor(sub + _ridge(len(sub)), lower=True), right)
        return x, factor, scale

    def _evaluate(self, columns: Indices, x: Array) -> HeldOut:
        folds = range(len(self.dataset.folds))
        sse = [residual_norms(self.dataset, f, columns, x[f], self.delay) for f in folds]
        samples = np.stack([data.samples for data in self.dataset.data], 1)
        return HeldOut(np.array(sse), samples, x)

    def fit_all(self) -> Array:
        """(p,) parameters fitted to all folds."""
        return self._solve_fold(None)[0]

    def with_candidate(self, columns: Indices, information: Array, lower: Array) -> HeldOut:
        """Held-out errors with candidate columns beside the unknowns.

        Args:
            columns: (k,) the candidate's columns.
            information: (k, k) its prior information about zero.
            lower: (k,) lower bounds, 0 or −inf.
        """
        base = self.unknowns.columns
        folds = range(len(self.dataset.folds))
        both = [self._assemble(f, base, columns) for f in folds]
        own = [self._assemble(f, columns, columns) for f in folds]
        cross, gram = np.array([b for b, _ in both]), np.array([g for g, _ in own])
        rhs = np.array([r for _, r in own])
        x = np.empty((len(base) + len(columns),))
        out = []
        for f in folds:
            c, d = cross.sum(0) - cross[f], gram.sum(0) - gram[f] + information
            r = rhs.sum(0) - rhs[f]
            x_base, factor, scale = self._solutions[f]
            solved = scale[:, None] * cho_solve(factor, scale[:, None] * c)
            y = _bounded_solve(d - c.T @ solved, r - c.T @ x_base, lower)
            x = np.concatenate([x_base - solved @ y, y])
            out.append(x)
        return self._evaluate(np.concatenate([base, columns]), np.array(out))


def _ridge(size: int) -> Array:
    """Keeps columns that say the same (a friction and its asymmetric form) from being singular."""
    return 1e-9 * np.eye(size)


def _bounded_solve(schur: Array, rhs: Array, lower: Array) -> Array:
    """Minimizer of ½ yᵀ S y − rᵀ y with y ≥ 0 where a lower bound is given."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(schur), 1e-300))
    matrix = schur * scale[:, None] * scale + _ridge(len(rhs))
    y = np.linalg.solve(matrix, scale * rhs)
    bounded = np.isfinite(lower)
    if np.any(y[bounded] < 0):
        root = np.linalg.cholesky(matrix)
        target = np.linalg.solve(root, scale * rhs)
        mirrored = np.concatenate([root.T, -root.T[:, ~bounded]], axis=1)
        z, _ = nnls(mirrored, target)
        y = z[: len(rhs)]
        y[~bounded] -= z[len(rhs) :]
    return scale * y
