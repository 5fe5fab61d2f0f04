"""Residuals of a hypothesis by joint, for proposals of effects."""

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

_SAMPLES = 100_000  # of a segment that are looked at, and of all together that are kept
SLOW = 0.01
"""Below this share of a joint's peak speed its direction of motion is doubtful."""


@dataclass(frozen=True)
class Proposal:
    """An effect proposed by a residual."""

    effects: tuple[Effect, ...]  # the effect with the shapes to try
    share: float  # of the squared error at its joint that it explains
    alarm: float  # probability that noise alone suggests as much


@dataclass(frozen=True, eq=False)
class JointResidual:
    """Residuals of a joint, held out or not, the kept rows of all folds one after another."""

    joint: str
    time: Array  # (K,) instants since the row's log began, s
    log: NDArray[np.int_]  # (K,) index of the row's log
    q: Array  # (K,) position, rad or m
    v: Array  # (K,) velocity, rad/s or m/s
    residual: Array  # (K,) measured less predicted effort, filtered
    effective: float  # how many independent samples these are worth

    def direction(self, v: Array) -> Array:
        """Return the direction of motion at velocities v of the joint, smoothed at the slowest."""
        return np.tanh(v / max(SLOW * float(np.abs(self.v).max()), np.finfo(float).tiny))

    def part(self, rows: NDArray[np.bool_]) -> JointResidual:
        """Return some of its rows."""
        kept = {name: getattr(self, name)[rows] for name in ("time", "log", "q", "v", "residual")}
        share = float(np.mean(rows))
        return replace(self, **kept, effective=max(1.0, share * self.effective))


def joint_residuals(case: Case, hypothesis: Hypothesis) -> list[JointResidual]:
    """Return the residuals of all joints that have rows."""
    dataset, x = hypothesis.dataset, hypothesis.held_out.x
    blocks = residual_blocks(dataset, hypothesis.unknowns.columns, x, delay=hypothesis.delay)
    began = [trajectory.began for trajectory in case.trajectories]
    found = []
    for name, data, residual in zip(dataset.joints, dataset.data, blocks, strict=True):
        if not data.samples.any():
            continue
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


def full_motion(case: Case) -> list[tuple[int, Segment]]:
    """Return the segments of all logs, in memory, each with the index of its log."""
    if case.segments:
        return list(case.segments)
    found = [
        (log, segment[:_SAMPLES])
        for log, trajectory in enumerate(case.trajectories)
        for segment in trajectory.segments
    ]
    if sum(len(segment) for _, segment in found) <= _SAMPLES:
        case.segments.extend(found)
    return found


def filtered_columns(
    case: Case,
    motion: Sequence[tuple[int, Segment]],
    joint: JointResidual,
    columns: Iterable[Array],
) -> Array:
    """Return columns of the motion at its full rate, filtered as the residual is.

    `motion` is `full_motion` of the case, with columns (N, k) of each segment. Returned are (K, k)
    columns at the residual's rows, NaN where the motion was not looked at.
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
    found = np.full((len(joint.time), parts[0][1].shape[1] if parts else 0), np.nan)
    for rows, values in parts:
        found[rows] = values
    return found


def cut_out(
    trajectory: Trajectory,
    segments: Iterable[Segment | Stretch],
    window: tuple[float, float],
    pad: float,
) -> tuple[Segment, Array, Array] | None:
    """Return the samples around a window, with their instants and those of filtered samples.

    Instants are s since the log began, and filtered samples those of the whole segment. None where
    the log has a gap there.
    """
    low_pass, step = trajectory.filter, trajectory.filter.decimation
    for segment in segments:
        time = segment[:].time - trajectory.began
        if time[0] <= window[0] and window[1] <= time[-1]:
            first, last = np.searchsorted(time, [window[0] - pad, window[1] + pad]).tolist()
            near = slice(first // step * step, last)
            at = time[near]
            return segment[near], at, at[low_pass.output_indices(len(at))]
    return None
