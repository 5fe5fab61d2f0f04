"""Residuals of a hypothesis, joint by joint, as something to look into."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.case import Case
from geodrake.diagnosis.evidence import effective_samples
from geodrake.diagnosis.hypothesis import Hypothesis, residual_blocks

Array = NDArray[np.float64]

_SLOW = 0.01  # share of its peak speed below which a joint's direction of motion is doubtful


@dataclass(frozen=True, eq=False)
class JointResidual:
    """Held-out residuals of a joint, the kept rows of all folds one after another.

    Attributes:
        joint: Name of the joint.
        time: (K,) instants since the row's log began, s.
        log: (K,) index of the row's log.
        q: (K,) position, rad or m.
        v: (K,) velocity, rad/s or m/s.
        residual: (K,) measured less predicted effort, filtered.
        effective: How many independent samples these are worth.
    """

    joint: str
    time: Array
    log: NDArray[np.int_]
    q: Array
    v: Array
    residual: Array
    effective: float

    @property
    def sign_v(self) -> Array:
        """(K,) direction of motion, smoothed at the slowest."""
        return np.tanh(self.v / max(_SLOW * float(np.abs(self.v).max()), np.finfo(float).tiny))

    def improvement(self, base: Sequence[Array], columns: Sequence[Array]) -> tuple[float, float]:
        """What columns explain of the residual beyond others, in sample.

        Args:
            base: Columns (K,) that may be there anyway.
            columns: Further columns (K,).

        Returns:
            Share of the squared residual that they take away, and about χ² of as many degrees of
            freedom as they are where they are irrelevant.
        """
        first = _left(self.residual, np.stack(base, 1))
        second = _left(self.residual, np.stack([*base, *columns], 1))
        share = 1.0 - second / first if first > 0.0 else 0.0
        return share, float(-self.effective * np.log1p(-min(share, 1.0 - 1e-9)))


def joint_residuals(case: Case, hypothesis: Hypothesis) -> list[JointResidual]:
    """Residuals of all joints."""
    dataset = hypothesis.dataset
    blocks = residual_blocks(
        dataset, hypothesis.unknowns.columns, hypothesis.held_out.x, delay=hypothesis.delay
    )
    began = [float(trajectory.segments[0][:1].time[0]) for trajectory in case.trajectories]
    found = []
    for name, data, residual in zip(dataset.joints, dataset.data, blocks, strict=True):
        rows = [
            (rows, block.trajectory)
            for fold, kept in zip(case.folds, data.rows, strict=True)
            for block, rows in zip(fold.blocks, kept, strict=False)
        ]
        q, v, _ = np.concatenate([part.motion for part, _ in rows]).T
        found.append(
            JointResidual(
                name,
                np.concatenate([part.time - began[log] for part, log in rows]),
                np.concatenate([np.full(len(part.time), log) for part, log in rows]),
                q,
                v,
                np.concatenate(residual),
                effective_samples(residual),
            )
        )
    return found


def _left(residual: Array, columns: Array) -> float:
    """Sum of squares that least squares leaves."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    found = np.linalg.lstsq(scaled, residual, rcond=1e-9)[0]
    return float(np.square(residual - scaled @ found).sum())
