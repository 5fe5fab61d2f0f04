"""Residuals of a hypothesis by joint, as a source of proposals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.effects.base import Effect
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.evidence import effective_samples
from geodrake.identification.logs.hypothesis import Hypothesis, residual_blocks
from geodrake.logs.motion import Trajectory
from geodrake.logs.smoothing import Segment, Stretch

Array = NDArray[np.float64]

_SAMPLES = 100_000  # most samples of a segment, and of all segments that are cached
SLOW = 0.01
"""Share of a joint's peak speed below which its direction of motion is doubtful."""


@dataclass(frozen=True)
class Proposal:
    """Effect proposed by a residual."""

    effects: tuple[Effect, ...]  # the effect with the shapes to try
    share: float  # of the squared error at its joint that it explains
    alarm: float  # false alarm probability


@dataclass(frozen=True, eq=False)
class JointResidual:
    """Residuals of a joint, with the stored rows of all folds in order."""

    joint: str
    time: Array  # (K,) instants since the row's log began, s
    log: NDArray[np.int_]  # (K,) index of the row's log
    q: Array  # (K,) position, rad or m
    v: Array  # (K,) velocity, rad/s or m/s
    residual: Array  # (K,) measured minus predicted effort, filtered
    effective: float  # effective sample size

    def direction(self, v: Array) -> Array:
        """Return the direction of motion at velocities v, smoothed at low speeds."""
        return np.tanh(v / max(SLOW * float(np.abs(self.v).max()), np.finfo(float).tiny))

    def part(self, rows: NDArray[np.bool_]) -> JointResidual:
        """Return the residuals of some rows."""
        kept = {name: getattr(self, name)[rows] for name in ("time", "log", "q", "v", "residual")}
        share = float(np.mean(rows))
        return replace(self, **kept, effective=max(1.0, share * self.effective))


def joint_residuals(case: Case, hypothesis: Hypothesis) -> list[JointResidual]:
    """Return the residuals of all joints with rows."""
    dataset, x = hypothesis.dataset, hypothesis.held_out.x
    blocks = residual_blocks(dataset, hypothesis.unknowns.columns, x, delay=hypothesis.delay)
    began = [trajectory.began for trajectory in case.trajectories]
    residuals = []
    for name, data, residual in zip(dataset.joints, dataset.data, blocks, strict=True):
        if not data.samples.any():
            continue
        rows = data.logged_rows(case.folds)
        q, v, _ = np.concatenate([part.motion for _, part in rows]).T
        residuals.append(
            JointResidual(
                name,
                np.concatenate([part.time - began[log] for log, part in rows]),
                np.concatenate([np.full(len(part.time), log) for log, part in rows]),
                q,
                v,
                np.concatenate(residual),
                effective_samples(residual),
            )
        )
    return residuals


def full_motion(case: Case) -> list[tuple[int, Segment]]:
    """Return the segments of all logs in memory, each with the index of its log."""
    if case.segments:
        return list(case.segments)
    segments = [
        (log, segment[:_SAMPLES])
        for log, trajectory in enumerate(case.trajectories)
        for segment in trajectory.segments
    ]
    if sum(len(segment) for _, segment in segments) <= _SAMPLES:
        case.segments.extend(segments)
    return segments


def filtered_columns(
    case: Case,
    motion: Sequence[tuple[int, Segment]],
    joint: JointResidual,
    columns: Iterable[Array],
) -> Array:
    """Return columns of the full-rate motion, filtered like the residual, at its rows (K, k).

    `motion` is `full_motion` of the case, and `columns` has (N, k) columns of each segment. Rows
    outside of the motion are NaN.
    """
    began = [trajectory.began for trajectory in case.trajectories]
    parts: list[tuple[NDArray[np.bool_], Array]] = []
    for (log, segment), unfiltered in zip(motion, columns, strict=True):
        low_pass = case.trajectories[log].filter
        values = low_pass.apply(unfiltered)
        if len(values):
            time = segment.time[low_pass.output_indices(len(segment))] - began[log]
            slack = 0.5 * segment.period
            rows = joint.log == log
            rows &= (joint.time >= time[0] - slack) & (joint.time <= time[-1] + slack)
            at = np.rint((joint.time[rows] - time[0]) / low_pass.output_period).astype(int)
            parts.append((rows, values[np.clip(at, 0, len(values) - 1)]))
    columns_at_rows = np.full((len(joint.time), parts[0][1].shape[1] if parts else 0), np.nan)
    for rows, values in parts:
        columns_at_rows[rows] = values
    return columns_at_rows


def cut_out(
    trajectory: Trajectory,
    segments: Iterable[Segment | Stretch],
    window: tuple[float, float],
    pad: float,
) -> tuple[Segment, Array, Array] | None:
    """Return the samples around a window, their instants, and the instants of filtered samples.

    Instants are in s since the log began. The filtered samples are aligned with those of the whole
    segment. Return None if the log has a gap in the window.
    """
    low_pass, step = trajectory.filter, trajectory.filter.decimation
    for segment in segments:
        time = segment[:].time - trajectory.began
        if time[0] <= window[0] and window[1] <= time[-1]:
            first, last = np.searchsorted(time, [window[0] - pad, window[1] + pad]).tolist()
            padded = slice(first // step * step, last)
            instants = time[padded]
            return segment[padded], instants, instants[low_pass.output_indices(len(instants))]
    return None
