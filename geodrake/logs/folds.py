"""Validation folds: complete trajectories, or long time blocks with gaps between them.

Residuals of real robots are correlated over many samples, so that cross-validation with folds of
single samples would accept nearly every smooth regressor. Folds are therefore long time blocks.
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
_MOST_BLOCKS = 1000  # per log; each is held out once
_LEAST_OUTPUTS = 10  # filtered samples in a fold
_LARGEST_GAP = 0.05  # relative to a block
_CORRELATION_SECONDS = 0.5  # of residuals of friction and elasticity


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
    """Split trajectories into folds that share no filtered sample and are separated in time.

    Four or more trajectories are one fold each, or two if only one of them has a known payload, or
    has none. Fewer are cut into blocks of equal length: about eight in all, or `blocks` of each.
    Gaps between blocks last half a second longer than the filter's window, but at most 5 %.
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
"""Largest share of a joint's motion in a fold: absolute, or relative to the share of all motion."""


def share_motion(
    folds: tuple[Fold, ...],
    trajectories: Sequence[Trajectory],
    samples: Array,
    instants: Sequence[Sequence[Sequence[Array]]],
) -> tuple[Fold, ...]:
    """Exchange parts of folds so that none contains most of a joint's motion, if possible.

    If joints move one after the other, too little remains to fit a joint's friction without the
    fold that has most of its motion. The `samples` (n, folds) are numbers of samples in which each
    joint moves; `instants` are their stamps, s, by joint, fold and block.
    """
    if len(folds) < 2:
        return folds
    samples, windows, other = samples.astype(float), list[Window](), dict[int, int]()
    shares, totals = samples.sum(axis=0) / max(samples.sum(), 1.0), samples.sum(axis=1)
    for load, total, times in zip(samples, totals, instants, strict=True):
        most = np.maximum(_MOST_MOTION, _MORE_MOTION * shares) * total
        counts = load.copy()
        for fold in np.flatnonzero(counts > most).tolist():
            for block, time in zip(folds[fold].blocks, times[fold], strict=True):
                if len(time):
                    first, last = (time[[0, -1]] - trajectories[block.trajectory].began).tolist()
                    windows.append((block.trajectory, first, last))
            if fold not in other:
                other[fold] = int(np.where(np.arange(len(folds)) == fold, np.inf, load).argmin())
                load[other[fold]] += 0.5 * counts[fold]
    if not windows:
        return folds
    return assign_folds(folds, trajectories, windows, pieces=_PIECES, others=other)


Window = tuple[int, float, float]
"""Index of a log, and start and end of a part of it, s since the log began."""


def assign_folds(
    folds: Sequence[Fold],
    trajectories: Sequence[Trajectory],
    windows: Sequence[Window],
    *,
    pieces: int,
    others: Mapping[int, int] | None = None,
) -> tuple[Fold, ...]:
    """Cut windows of folds into pieces, and move every second piece to another fold.

    Pieces of fold k go to fold `others[k]`, by default the fold half of all folds further on.
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
    """Merge overlapping windows."""
    merged: list[Window] = []
    for log, start, end in sorted(windows):
        if merged and merged[-1][0] == log and start <= merged[-1][2]:
            merged[-1] = (log, merged[-1][1], max(end, merged[-1][2]))
        else:
            merged.append((log, start, end))
    return merged


def _outputs_within(
    block: Block, trajectory: Trajectory, windows: Sequence[Window]
) -> Iterator[tuple[int, int]]:
    """Yield the first and last filtered sample of each window in a block."""
    low_pass, segment = trajectory.filter, trajectory.segments[block.segment]
    began, start = trajectory.began, float(segment[:1].time[0])
    for log, *window in windows:
        if log == block.trajectory:
            samples = (np.array(window) + began - start) / low_pass.period - low_pass.halfwidth
            outputs = np.rint(samples / low_pass.decimation).astype(int)
            first, last = np.clip(outputs, block.start, block.stop).tolist()
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
        parts = (Block(index, k, *bounds) for k, bounds in enumerate(zip(begin, end, strict=True)))
        blocks = tuple(block for block in parts if block.stop > block.start)
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
