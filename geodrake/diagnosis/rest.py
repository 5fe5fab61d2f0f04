"""The remaining error, and the share of it that the motion predicts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from geodrake.diagnosis.residuals import (
    SLOW,
    JointResidual,
    filtered_columns,
    full_motion,
    joint_residuals,
)
from geodrake.identification.logs.case import Case, error_table
from geodrake.identification.logs.criteria import ALARM, NOISE_MARGIN
from geodrake.identification.logs.evidence import false_alarm_probability
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.identification.logs.reduce import peak_speeds
from geodrake.identification.normal_equations import cholesky
from geodrake.logs.smoothing import Segment

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_FREQUENCIES = 60  # of random features
_WIDTHS = (1.0, 3.0)  # length scales of functions, in deviations of the signals
_RIDGES = (1e-3, 1e-2, 1e-1, 1.0)  # relative to the mean square of the features
_FIRST_RIDGE = 1e-2
_PROMISING = 3  # functions that are fitted with all ridges, the best by the first one
_MOST = 4_000  # samples


def share_of_motion(case: Case, hypothesis: Hypothesis) -> Array:
    """Return (nv,) shares of squared errors that a smooth function of the motion could remove.

    Candidates are functions of all positions, and functions of position, velocity and direction of
    the joint and one other joint. They are sums of waves of random frequencies, fitted with a
    ridge, which approximate a Gaussian process (Rahimi and Recht, 2007), and predict held-out
    folds. Even folds choose the best candidate for odd ones, and the reverse. Noise is not
    predictable, whatever its spectrum.

    Shares are 0 if only sensor noise is left, or if the prediction may be by chance.
    """
    motion, speeds = full_motion(case), peak_speeds(case.trajectories)
    with_rows = np.flatnonzero(case.dataset.has_rows).tolist()
    joints = zip(
        with_rows,
        joint_residuals(case, hypothesis),
        error_table(case.dataset, hypothesis.held_out).joints,
        [case.dataset.data[j] for j in with_rows],
        strict=True,
    )
    shares = np.zeros(len(case.dataset.joints))
    for j, residual, error, data in joints:
        if error.rms > NOISE_MARGIN * error.floor:
            folds = np.repeat(
                np.arange(len(data.rows)), [sum(len(r.time) for r in fold) for fold in data.rows]
            )
            shares[j] = _predictable(case, motion, residual, folds, speeds)
    return shares


def _predictable(
    case: Case,
    motion: Sequence[tuple[int, Segment]],
    joint: JointResidual,
    folds: Indices,
    speeds: Array,
) -> float:
    """Return the share of a joint's squared residual that the best function of motion predicts.

    `motion` is `full_motion` of the case, `folds` (K,) is the fold of each row, and `speeds` (nv,)
    are peak speeds, rad/s or m/s; 0 for a joint at rest.
    """
    index = case.model.joints.index(joint.joint)
    columns = filtered_columns(case, motion, joint, (_signals(s, speeds) for _, s in motion))
    valid = np.flatnonzero(np.isfinite(columns).all(axis=1))
    valid = valid[:: max(1, len(valid) // _MOST)]
    if len(valid) < 2 * len(np.unique(folds)):
        return 0.0
    b, row_folds = joint.residual[valid], folds[valid]
    signals = columns[valid].reshape(len(valid), 3, -1)
    deviations, largest = signals.std(axis=0), np.abs(signals).max(axis=0)
    varying = deviations > np.sqrt(np.finfo(float).eps) * largest  # a direction may be constant
    scaled = signals / np.where(varying, deviations, np.inf)
    moving = np.flatnonzero(speeds)
    groups = [scaled[:, 0, moving], *(scaled[:, :, sorted({index, k})] for k in moving.tolist())]
    candidates = [
        _Folds.of(features, b, row_folds)
        for group in groups
        for features in _waves(group.reshape(len(valid), -1))
    ]
    held_out = cache(lambda k, ridge: candidates[k].held_out(ridge))
    first_losses = np.array([held_out(k, _FIRST_RIDGE) for k in range(len(candidates))])
    remainder = np.empty(first_losses.shape[1])
    even, odd = slice(0, None, 2), slice(1, None, 2)
    for judged, judges in ((even, odd), (odd, even)):
        promising = np.argsort(first_losses[:, judges].sum(axis=1))[:_PROMISING].tolist()
        losses = np.array([held_out(k, ridge) for k in promising for ridge in _RIDGES])
        remainder[judged] = losses[losses[:, judges].sum(axis=1).argmin(), judged]
    share = float(1.0 - remainder.sum() / np.square(b).sum())
    gain = -joint.effective * np.log1p(-max(share, 0.0))
    count = len(candidates) * len(_RIDGES)
    return share if false_alarm_probability(gain, 1, count) <= ALARM else 0.0


def _signals(segment: Segment, speeds: Array) -> Array:
    """Return (N, 3 n) positions, velocities and directions of joints with peak speeds (n,)."""
    v, slow = segment.velocity, np.maximum(SLOW * speeds, np.finfo(float).tiny)
    return np.concatenate([segment.position, v, np.tanh(v / slow)], axis=1)


def _waves(signals: Array) -> Iterator[Array]:
    """Yield (N, 2 m + 1) waves of random frequencies over signals (N, k), short ones first."""
    rng = np.random.default_rng(0)
    frequencies = rng.normal(size=(signals.shape[1], _FREQUENCIES))
    for width in _WIDTHS:
        angle = signals @ frequencies / width
        yield np.column_stack([np.cos(angle), np.sin(angle), np.ones(len(angle))])


@dataclass(frozen=True, eq=False)
class _Folds:
    """Ridge regression of a residual on features, with folds for cross-validation."""

    features: Array  # (N, k)
    residual: Array  # (N,)
    parts: list[Indices]  # samples of each fold
    gram: Array  # (k, k) products of the features

    @classmethod
    def of(cls, features: Array, b: Array, folds: Indices) -> _Folds:
        """Return the regression of features (N, k), a residual (N,) and folds (N,)."""
        parts = [np.flatnonzero(folds == fold) for fold in np.unique(folds)]
        return cls(features, b, parts, features.T @ features)

    def held_out(self, ridge: float) -> Array:
        """Return (F,) squared errors in each fold of a ridge regression on all other folds.

        With the smoother WᵀW of all folds, they are those of (I − W_fᵀW_f)⁻¹ times the residual.
        """
        factor = cholesky(self.gram, ridge * len(self.residual))
        W = solve_triangular(factor, self.features.T, lower=True)
        residual, errors = self.residual - (W @ self.residual) @ W, list[float]()
        for part in self.parts:
            W_f, e = W[:, part], residual[part]
            if len(part) <= len(W_f):
                e = np.linalg.solve(np.eye(len(part)) - W_f.T @ W_f, e)
            else:
                e = e + np.linalg.solve(np.eye(len(W_f)) - W_f @ W_f.T, W_f @ e) @ W_f
            errors.append(float(e @ e))
        return np.array(errors)
