"""Few filtered samples of logs, for quick fits of many column assignments.

Motion and efforts pass the same filter. Unlike in a full fit, the regressor is evaluated at the
filtered motion: another assignment only scales, swaps and shifts that motion, so that nothing is
filtered again. The regressor is wrong near reversals, whose samples are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.identification.logs.evidence import effective_samples_of_each
from geodrake.identification.logs.reduce import sign_widths, still_speeds
from geodrake.logs.folds import Block, Fold
from geodrake.logs.motion import Trajectory
from geodrake.logs.smoothing import CHUNK
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_MOST = 1500  # samples
_ONE_WAY = 0.9  # magnitude of the mean direction of a joint that does not reverse
_FEWEST = 0.3  # least share of samples that a joint keeps


@dataclass(frozen=True, eq=False)
class ColumnSamples:
    """N filtered samples of the columns of logs, in order of the logs."""

    model: RobotModel
    q: Array  # (N, n) positions
    v: Array  # (N, n) their derivatives
    vd: Array  # (N, n) second derivatives
    effort: Array  # (N, n) efforts
    rate: Array | None  # (N, n) measured velocities; None where a log has none
    used: NDArray[np.bool_]  # (N, n) whether the joint of a position column does not reverse
    block: Indices  # (N,) index of the block without gaps
    log: Indices  # (N,) index of the trajectory
    trajectories: tuple[Trajectory, ...]  # the prepared logs
    width: Array  # (n,) speed below which the direction of motion is unknown
    keeps_sign: NDArray[np.bool_]  # (n,) whether an effort column never changes sign
    fitted: NDArray[np.bool_]  # (n,) whether the gain of an effort column was fitted to these logs

    def __len__(self) -> int:
        return len(self.q)

    @cached_property
    def gain_deviations(self) -> Array:
        """(n,) relative standard deviations of the gains of the efforts."""
        n = self.q.shape[1]
        deviations = [np.broadcast_to(t.gain_deviations, n) for t in self.trajectories]
        return np.asarray(np.max(deviations, axis=0))

    def motion(
        self, assignment: Assignment, rows: Indices | slice = slice(None)
    ) -> tuple[Array, Array, Array]:
        """Return (K, n) positions, velocities and accelerations of the joints in some rows."""
        source, scale, time = assignment.position, assignment.scale, assignment.time
        q, v, vd = (values[rows][:, source] * scale for values in (self.q, self.v, self.vd))
        return q + assignment.zero, v / time, vd / time**2

    def effective(self, residuals: Sequence[Array], rows: Sequence[Indices]) -> Array:
        """Return (J,) effective sample sizes of residuals."""
        cuts = [np.flatnonzero(np.diff(self.block[indices])) + 1 for indices in rows]
        pairs = zip(residuals, cuts, strict=True)
        return effective_samples_of_each(
            [[part for part in np.split(left, at) if len(part)] for left, at in pairs]
        )


def column_samples(
    model: RobotModel,
    trajectories: tuple[Trajectory, ...],
    folds: Sequence[Fold],
    fitted: frozenset[str] = frozenset(),
) -> ColumnSamples:
    """Return the samples of prepared logs; the `fitted` joints have estimated effort gains."""
    width = sign_widths(model, trajectories)
    blocks = [block for fold in folds for block in fold.blocks]
    blocks.sort(key=lambda block: block.trajectory)
    stride = max(1, -(-sum(len(block) for block in blocks) // _MOST))
    speed = np.maximum(width, still_speeds(trajectories))
    parts = [_block(trajectories[b.trajectory], b, speed, stride) for b in blocks]
    counts = [len(part[0]) for part in parts]
    quantities = min(map(len, parts))  # measured velocities only if all logs have them
    q, v, vd, effort, direction, *rate = (
        np.concatenate([p[i] for p in parts]) for i in range(quantities)
    )
    one_way = np.abs(direction)
    least = np.minimum(_ONE_WAY, np.quantile(one_way, 1.0 - _FEWEST, axis=0))
    pieces = [segment.piece.effort for t in trajectories for segment in t.segments]
    lowest = np.min([np.nanmin(values, axis=0) for values in pieces], axis=0)
    highest = np.max([np.nanmax(values, axis=0) for values in pieces], axis=0)
    return ColumnSamples(
        model,
        q,
        v,
        vd,
        effort,
        rate[0] if rate else None,
        one_way >= least,
        np.repeat(np.arange(len(blocks)), counts),
        np.repeat([b.trajectory for b in blocks], counts),
        trajectories,
        width,
        (lowest >= 0.0) | (highest <= 0.0),
        np.array([joint in fitted for joint in model.joints]),
    )


def _block(trajectory: Trajectory, block: Block, speed: Array, stride: int) -> list[Array]:
    """Return the filtered motion, efforts, directions and measured velocities of a block."""
    low_pass, stretch = trajectory.filter, trajectory.segments[block.segment]
    first = block.start * low_pass.decimation
    length = (len(block) - 1) * low_pass.decimation + len(low_pass.kernel)
    filtered_parts = []
    for inside, _ in low_pass.chunks(length, CHUNK):
        window = slice(first + inside.start, first + inside.stop)
        segment = stretch[window]
        raw = stretch.piece[stretch.first + window.start : stretch.first + window.stop]
        direction = np.tanh(segment.velocity / np.maximum(speed, 1e-300))
        columns = [segment.position, segment.velocity, segment.acceleration, raw.effort, direction]
        columns += [] if raw.velocity is None else [raw.velocity]
        filtered_parts.append(low_pass.apply(np.hstack(columns)))
    filtered = np.concatenate(filtered_parts)[::stride]
    return np.split(filtered, filtered.shape[1] // len(speed), axis=1)
