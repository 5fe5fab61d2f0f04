"""Samples of logs that columns are judged by: filtered, decimated, and few enough to be quick.

Motion and efforts pass the same filter. Unlike in a fit, the regressor is that of the filtered
motion, so that another assignment of the columns needs no filter: all that it may do to a motion is
linear. Samples in whose window a joint reverses are left out, as only the filtered effort knows of
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.identification.logs.evidence import effective_samples_of_each
from geodrake.identification.logs.reduce import STILL_SPEED, peak_speeds, sign_widths
from geodrake.logs.folds import Block, Fold
from geodrake.logs.motion import Trajectory
from geodrake.logs.smoothing import CHUNK
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_MOST = 1500  # samples
_ONE_WAY = 0.9  # mean direction, from −1 to 1, of a joint that does not reverse
_FEWEST = 0.3  # of the samples that a joint keeps


@dataclass(frozen=True, eq=False)
class ColumnSamples:
    """Filtered samples of the columns of logs, as they are assigned to the model's joints.

    Attributes:
        model: The model.
        q: (N, n) positions.
        v: (N, n) their derivatives.
        vd: (N, n) second derivatives.
        effort: (N, n) efforts.
        rate: (N, n) measured velocities; None where a log has none.
        used: (N, n) whether the joint of a position's column moves one way.
        width: (n,) speed below which the direction of motion is not known.
        block: (N,) block of time without gaps that it is in.
        log: (N,) index of its trajectory.
        trajectories: The prepared logs.
        keeps_sign: (n,) whether a column of efforts is never of one of the signs.
    """

    model: RobotModel
    q: Array
    v: Array
    vd: Array
    effort: Array
    rate: Array | None
    used: NDArray[np.bool_]
    width: Array
    block: NDArray[np.intp]
    log: NDArray[np.intp]
    trajectories: tuple[Trajectory, ...]
    keeps_sign: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.q)

    @cached_property
    def gain_deviations(self) -> Array:
        """(n,) how well the gains of the efforts are known."""
        n = self.q.shape[1]
        return np.asarray(
            np.max([np.broadcast_to(t.gain_deviations, n) for t in self.trajectories], axis=0)
        )

    def effective(self, residuals: Sequence[Array], rows: Sequence[NDArray[np.intp]]) -> Array:
        """Return (J,) how many independent samples residuals are worth."""
        series = []
        for left, at in zip(residuals, rows, strict=True):
            cuts = np.flatnonzero(np.diff(self.block[at])) + 1
            series.append([part for part in np.split(left, cuts) if len(part)])
        return effective_samples_of_each(series)


def column_samples(
    model: RobotModel, trajectories: tuple[Trajectory, ...], folds: Sequence[Fold]
) -> ColumnSamples:
    """Return the samples of prepared logs."""
    width = sign_widths(model, trajectories)
    still = STILL_SPEED * peak_speeds(trajectories)
    blocks = [block for fold in folds for block in fold.blocks]
    stride = max(1, -(-sum(len(block) for block in blocks) // _MOST))
    speed = np.maximum(width, still)
    parts = [_block(trajectories[b.trajectory], b, speed, stride) for b in blocks]
    counts = [len(part[0]) for part in parts]
    q, v, vd, effort, direction = (np.concatenate([part[i] for part in parts]) for i in range(5))
    one_way = np.abs(direction)
    least = np.minimum(_ONE_WAY, np.quantile(one_way, 1.0 - _FEWEST, axis=0))
    return ColumnSamples(
        model,
        q,
        v,
        vd,
        effort,
        _joined([part[5] for part in parts]),
        one_way >= least,
        width,
        np.repeat(np.arange(len(blocks)), counts),
        np.repeat([b.trajectory for b in blocks], counts),
        trajectories,
        _keeps_sign(trajectories),
    )


def _keeps_sign(trajectories: Sequence[Trajectory]) -> NDArray[np.bool_]:
    """(n,) whether efforts, as they were logged, are never of one of the signs."""
    pieces = [segment.piece.piece.effort for t in trajectories for segment in t.segments]
    least = np.min([np.nanmin(own, axis=0) for own in pieces], axis=0)
    most = np.max([np.nanmax(own, axis=0) for own in pieces], axis=0)
    return np.asarray((least >= 0.0) | (most <= 0.0))


def _block(
    trajectory: Trajectory, block: Block, speed: Array, stride: int
) -> tuple[Array, Array, Array, Array, Array, Array | None]:
    """Filtered motion, efforts, direction and measured velocities of a block, thinned out."""
    low_pass, stretch = trajectory.filter, trajectory.segments[block.segment]
    first = block.start * low_pass.decimation
    window = slice(first, first + (len(block) - 1) * low_pass.decimation + len(low_pass.kernel))
    found: list[list[Array]] = [[] for _ in range(6)]
    for inside, _ in low_pass.chunks(window.stop - window.start, CHUNK):
        here = slice(first + inside.start, first + inside.stop)
        segment, raw = stretch[here], stretch.piece.piece
        raw = raw[stretch.first + here.start : stretch.first + here.stop]
        n = segment.position.shape[1]
        direction = np.tanh(segment.velocity / np.maximum(speed, 1e-300))
        columns = [segment.position, segment.velocity, segment.acceleration, raw.effort, direction]
        columns += [] if raw.velocity is None else [raw.velocity]
        filtered = low_pass.apply(np.hstack(columns))
        for k, part in enumerate(np.split(filtered, filtered.shape[1] // n, axis=1)):
            found[k].append(part)
    q, v, vd, effort, direction, *rate = (
        np.concatenate(parts)[::stride] for parts in found if parts
    )
    return q, v, vd, effort, direction, rate[0] if rate else None


def _joined(parts: Sequence[Array | None]) -> Array | None:
    """Parts (·, n) one after another; None if one is missing."""
    known = [part for part in parts if part is not None]
    return np.concatenate(known) if len(known) == len(parts) else None
