"""Validation folds: complete trajectories, or long time blocks with gaps between them.

Residuals of real robots are correlated over many samples, so that folds of single samples call
nearly every smooth regressor real. Folds here are long stretches of time.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from operator import attrgetter

import numpy as np

from geodrake.boundary.arguments import Array
from geodrake.errors import ArgumentError, LogError
from geodrake.logs.motion import Trajectory

_ENOUGH_TRAJECTORIES = 4
_FOLDS = 8
_MOST_BLOCKS = 1000  # of a log; each is held out of a fit once
_LEAST_OUTPUTS = 10  # filtered samples in a fold
_LARGEST_GAP = 0.05  # of a block
_CORRELATION_SECONDS = 0.5  # of what friction and elasticity leave in a residual


@dataclass(frozen=True)
class Block:
    """A stretch of the filtered samples of one segment."""

    trajectory: int
    segment: int
    start: int  # first of the segment's filtered samples that is in the block
    stop: int

    def __len__(self) -> int:
        return self.stop - self.start


@dataclass(frozen=True)
class Fold:
    """Blocks that are held out together."""

    name: str
    blocks: tuple[Block, ...]

    def __len__(self) -> int:
        return sum(map(len, self.blocks))


def validation_blocks(
    trajectories: Sequence[Trajectory], *, blocks: int | None = None
) -> tuple[Fold, ...]:
    """Split trajectories into folds that share no filtered sample and are apart in time.

    Four trajectories or more are one fold each, or two if one alone has a known payload or has
    none; fewer are cut into blocks of equal length, about eight in all, or as many `blocks` each.
    Gaps between blocks are as long as the filter's window and half a second, and at most 5 %.
    """
    if not trajectories:
        raise ArgumentError("There are no trajectories to split into folds.")
    least = 2 if len(trajectories) == 1 else 1
    if blocks is not None and not least <= blocks <= _MOST_BLOCKS:
        why = "at least one must be held out" if blocks < least else "each is held out once"
        raise ArgumentError(
            f"{blocks} blocks are not possible for {len(trajectories)} log(s): {why}.",
            advice=f"Use {least} to {_MOST_BLOCKS} blocks.",
        )
    wanted = blocks or max(1, _FOLDS // len(trajectories))
    if blocks is None and len(trajectories) >= _ENOUGH_TRAJECTORIES:
        alone = 1 in Counter(trajectory.payloads for trajectory in trajectories).values()
        wanted = 2 if alone else 1
    cut = (_cut(trajectory, index, wanted) for index, trajectory in enumerate(trajectories))
    folds = tuple(chain.from_iterable(cut))
    if len(folds) < 2:
        outputs = sum(trajectories[0].output_counts)
        raise LogError(
            f"Log {trajectories[0].name!r} is too short for validation: it has {outputs} "
            "filtered samples, but two blocks with a gap need more than "
            f"{2 * _LEAST_OUTPUTS}.",
            advice="Use a longer log, a second one, or a larger bandwidth.",
        )
    return folds


_PIECES = 4
_MOST_MOTION, _MORE_MOTION = 0.4, 1.5
"""A fold has at most this share of a joint's motion, or so many times its share of all motion."""


def share_motion(
    folds: tuple[Fold, ...],
    trajectories: Sequence[Trajectory],
    samples: Array,
    instants: Sequence[Sequence[Sequence[Array]]],
) -> tuple[Fold, ...]:
    """Return folds of which none has much of a joint's motion, if possible; else these.

    Joints may move one after the other, in one log or in one log each: without the fold that has
    most of its motion, little is left to fit a joint's friction. The `samples` (n, folds) count
    motion of each joint in each fold; `instants` are their stamps, s, by joint, fold and block.
    """
    if len(folds) < 2:
        return folds
    samples, windows, others = samples.astype(float), list[Window](), dict[int, int]()
    usual, whole = samples.sum(axis=0) / max(samples.sum(), 1.0), samples.sum(axis=1)
    for here, total, times in zip(samples, whole, instants, strict=True):
        most = np.maximum(_MOST_MOTION, _MORE_MOTION * usual) * total
        counts = here.copy()
        for fold in np.flatnonzero(counts > most).tolist():
            for block, time in zip(folds[fold].blocks, times[fold], strict=True):
                if len(time):
                    first, last = (time[[0, -1]] - trajectories[block.trajectory].began).tolist()
                    windows.append((block.trajectory, first, last))
            if fold not in others:
                others[fold] = int(np.where(np.arange(len(folds)) == fold, np.inf, here).argmin())
                here[others[fold]] += 0.5 * counts[fold]
    if not windows:
        return folds
    return assign_folds(folds, trajectories, windows, pieces=_PIECES, others=others)


Window = tuple[int, float, float]
"""Index of a log, start and end of a part of it, s since the log began."""


def assign_folds(
    folds: Sequence[Fold],
    trajectories: Sequence[Trajectory],
    windows: Sequence[Window],
    *,
    pieces: int,
    others: Mapping[int, int] | None = None,
) -> tuple[Fold, ...]:
    """Return folds of which windows are cut into pieces, every other one given to another fold.

    Which other one it is, `others` says by numbers; by default it is half of all folds further on.
    """
    dealt: dict[int, list[Block]] = defaultdict(list)
    windows = _merged(windows)
    for number, fold in enumerate(folds):
        other = (others or {}).get(number, (number + len(folds) // 2) % len(folds))
        for block in fold.blocks:
            cuts = {block.start: number}
            for start, stop in _outputs_within(block, trajectories[block.trajectory], windows):
                edges = np.linspace(start, stop, pieces + 1).round().astype(int).tolist()
                cuts |= {edge: (number, other)[k % 2] for k, edge in enumerate(edges[:-1])}
                cuts[stop] = number
            edges = sorted(cuts)
            for start, stop in zip(edges, [*edges[1:], block.stop], strict=True):
                if start < stop:
                    dealt[cuts[start]].append(replace(block, start=start, stop=stop))
    order = attrgetter("trajectory", "segment", "start")
    parts = enumerate(folds)
    return tuple(replace(f, blocks=tuple(sorted(dealt[number], key=order))) for number, f in parts)


def _merged(windows: Sequence[Window]) -> list[Window]:
    """Merge windows that overlap."""
    found: list[Window] = []
    for log, start, end in sorted(windows):
        if found and found[-1][0] == log and start <= found[-1][2]:
            found[-1] = (log, found[-1][1], max(end, found[-1][2]))
        else:
            found.append((log, start, end))
    return found


def _outputs_within(
    block: Block, trajectory: Trajectory, windows: Sequence[Window]
) -> Iterator[tuple[int, int]]:
    """Yield the first and last filtered sample of each window in a block."""
    low_pass, segment = trajectory.filter, trajectory.segments[block.segment]
    began, here = trajectory.began, float(segment[:1].time[0])
    for log, *window in windows:
        if log == block.trajectory:
            since = (np.array(window) + began - here) / low_pass.period - low_pass.halfwidth
            places = np.rint(since / low_pass.decimation).astype(int)
            first, last = np.clip(places, block.start, block.stop).tolist()
            if first < last:
                yield first, last


def _cut(trajectory: Trajectory, index: int, wanted: int) -> list[Fold]:
    counts = np.array(trajectory.output_counts)
    ends = np.cumsum(counts)
    total, period = int(ends[-1]), trajectory.filter.output_period
    window = 2 * trajectory.filter.halfwidth * trajectory.filter.period
    for pieces in range(max(1, min(wanted, total // _LEAST_OUTPUTS)), 0, -1):
        gap = int(np.ceil((window + _CORRELATION_SECONDS) / period))
        gap = min(gap, max(1, int(_LARGEST_GAP * total / pieces)))
        length = (total - gap * (pieces - 1)) // pieces
        if length >= _LEAST_OUTPUTS:
            break
    if pieces == 1:
        gap = 0
    cuts = np.linspace(0, total + gap, pieces + 1).round().astype(int)
    folds = []
    for start, stop in zip(cuts[:-1], cuts[1:] - gap, strict=True):
        begin = np.maximum(start - (ends - counts), 0).tolist()
        end = np.minimum(stop - (ends - counts), counts).tolist()
        whole = (Block(index, k, *both) for k, both in enumerate(zip(begin, end, strict=True)))
        blocks = tuple(block for block in whole if block.stop > block.start)
        folds.append(Fold(_name(trajectory, blocks, pieces), blocks))
    return folds


def _name(trajectory: Trajectory, blocks: Sequence[Block], pieces: int) -> str:
    if pieces == 1:
        return trajectory.name
    low_pass, ends = trajectory.filter, list[float]()
    for block, sample in ((blocks[0], blocks[0].start), (blocks[-1], blocks[-1].stop - 1)):
        center = low_pass.halfwidth + low_pass.decimation * sample
        ends.append(float(trajectory.segments[block.segment][center : center + 1].time[0]))
    return f"{trajectory.name} {ends[0]:.2f}–{ends[1]:.2f} s"
