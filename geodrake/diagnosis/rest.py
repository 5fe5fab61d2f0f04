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
_WIDTHS = (1.0, 3.0)  # over which functions vary, in deviations of the signals
_RIDGES = (1e-3, 1e-2, 1e-1, 1.0)  # over the mean square of the features
_FIRST_RIDGE = 1e-2
_PROMISING = 3  # functions, by what they leave with the first ridge, are fitted with all of them
_MOST = 4_000  # samples that are looked at


def share_of_motion(case: Case, hypothesis: Hypothesis) -> Array:
    """Return (nv,) shares of squared errors that a smooth function of the motion could remove.

    Functions of all positions, and of position, velocity and direction of the joint itself and one
    other, are fitted without each fold and predict it: sums of waves of random frequencies with a
    ridge, which approximate a Gaussian process (Rahimi and Recht, 2007). The best one counts,
    chosen by every other fold for the rest, if that is no chance. No function of the motion
    predicts noise, whatever its colour.

    Shares are from 0 to 1, and 0 where only sensor noise is left.
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

    `motion` is `full_motion` of the case, `folds` (K,) has the fold of each row, and `speeds` (nv,)
    are peak speeds, rad/s or m/s; 0 for a joint that does not move.
    """
    own = case.model.joints.index(joint.joint)
    columns = filtered_columns(case, motion, joint, (_signals(s, speeds) for _, s in motion))
    seen = np.flatnonzero(np.isfinite(columns).all(axis=1))
    seen = seen[:: max(1, len(seen) // _MOST)]
    if len(seen) < 2 * len(np.unique(folds)):
        return 0.0
    b, at = joint.residual[seen], folds[seen]
    signals = columns[seen].reshape(len(seen), 3, -1)
    deviations, largest = signals.std(axis=0), np.abs(signals).max(axis=0)
    varying = deviations > np.sqrt(np.finfo(float).eps) * largest  # a direction may be constant
    scaled = signals / np.where(varying, deviations, np.inf)
    moving = np.flatnonzero(speeds)
    groups = [scaled[:, 0, moving], *(scaled[:, :, sorted({own, k})] for k in moving.tolist())]
    offered = [
        _Folds.of(features, b, at)
        for group in groups
        for features in _waves(group.reshape(len(seen), -1))
    ]
    held_out = cache(lambda k, ridge: offered[k].held_out(ridge))
    rough = np.array([held_out(k, _FIRST_RIDGE) for k in range(len(offered))])
    left = np.empty(rough.shape[1])
    even, odd = slice(0, None, 2), slice(1, None, 2)
    for held, judges in ((even, odd), (odd, even)):
        promising = np.argsort(rough[:, judges].sum(axis=1))[:_PROMISING].tolist()
        losses = np.array([held_out(k, ridge) for k in promising for ridge in _RIDGES])
        left[held] = losses[losses[:, judges].sum(axis=1).argmin(), held]
    share = float(1.0 - left.sum() / np.square(b).sum())
    gain = -joint.effective * np.log1p(-max(share, 0.0))
    tried = len(offered) * len(_RIDGES)
    return share if false_alarm_probability(gain, 1, tried) <= ALARM else 0.0


def _signals(segment: Segment, speeds: Array) -> Array:
    """Return (N, 3 n) position, velocity and direction of all joints, with peak speeds (n,)."""
    v, slow = segment.velocity, np.maximum(SLOW * speeds, np.finfo(float).tiny)
    return np.concatenate([segment.position, v, np.tanh(v / slow)], axis=1)


def _waves(signals: Array) -> Iterator[Array]:
    """Yield (N, 2 m + 1) waves of random frequencies over signals (N, k), narrow ones first."""
    rng = np.random.default_rng(0)
    frequencies = rng.normal(size=(signals.shape[1], _FREQUENCIES))
    for width in _WIDTHS:
        angle = signals @ frequencies / width
        yield np.column_stack([np.cos(angle), np.sin(angle), np.ones(len(angle))])


@dataclass(frozen=True, eq=False)
class _Folds:
    """A residual and features of it, with the products of the features and the folds."""

    features: Array  # (N, k)
    residual: Array  # (N,)
    parts: list[Indices]  # samples of each fold
    gram: Array  # (k, k) products of the features

    @classmethod
    def of(cls, features: Array, b: Array, folds: Indices) -> _Folds:
        """From features (N, k), a residual (N,) and the fold (N,) of each sample."""
        parts = [np.flatnonzero(folds == fold) for fold in np.unique(folds)]
        return cls(features, b, parts, features.T @ features)

    def held_out(self, ridge: float) -> Array:
        """Return (F,) squared errors in each fold by a ridge regression on all others.

        With the smoother WᵀW of all folds, that of a fold is (I − W_fᵀW_f)⁻¹ times the residual.
        """
        factor = cholesky(self.gram, ridge * len(self.residual))
        W = solve_triangular(factor, self.features.T, lower=True)
        left, found = self.residual - (W @ self.residual) @ W, list[float]()
        for part in self.parts:
            own, e = W[:, part], left[part]
            if len(part) <= len(own):
                e = np.linalg.solve(np.eye(len(part)) - own.T @ own, e)
            else:
                e = e + np.linalg.solve(np.eye(len(own)) - own @ own.T, own @ e) @ own
            found.append(float(e @ e))
        return np.array(found)
