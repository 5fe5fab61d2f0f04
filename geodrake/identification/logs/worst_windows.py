"""The stretches of time in which a joint's error is largest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from geodrake.identification.logs.model_errors import Series

Array = NDArray[np.float64]

_SHARE = 0.03
"""Errors are averaged over this share of a joint's samples."""
_LEAST_SAMPLES = 5
_NOTABLE = 2.0
"""A window is bad if its mean square is so many times that of the joint."""


@dataclass(frozen=True)
class WorstWindow:
    """A stretch of time in which a joint errs much more than usual.

    Attributes:
        block: Name of the fold it is in.
        start: First instant in the log's own time, s.
        end: Last instant in the log's own time, s.
        rms: RMS of measured − predicted effort there, N·m or N.
        share: Share of the joint's squared error that is made there.
    """

    joint: str
    block: str
    start: float
    end: float
    rms: float
    share: float


def worst_windows(series: Sequence[Series], *, most: int = 3) -> tuple[WorstWindow, ...]:
    """The worst stretches of one joint, those of largest share of its squared error first.

    Returns:
        None where the error is about the same throughout.
    """
    squares = [np.square(s.residual) for s in series]
    count, total = sum(map(len, squares)), float(sum(each.sum() for each in squares))
    if total == 0.0 or not np.isfinite(total):
        return ()
    width = max(_LEAST_SAMPLES, round(_SHARE * count))
    limit = _NOTABLE * total / count
    found = [
        WorstWindow(
            s.joint, s.block, float(s.time[first]), float(s.time[last - 1]),
            float(np.sqrt(own[first:last].mean())), float(own[first:last].sum() / total),
        )
        for s, own in zip(series, squares, strict=True)
        for first, last in _bad(own, width, limit)
    ]  # fmt: skip
    return tuple(sorted(found, key=lambda window: -window.share)[:most])


def _bad(squares: Array, width: int, limit: float) -> Iterator[tuple[int, int]]:
    """First and past-the-last samples of stretches whose moving mean is above a limit."""
    if len(squares) < 2:
        return
    above = uniform_filter1d(squares, min(width, len(squares))) > limit
    edges = np.flatnonzero(np.diff(np.concatenate([[False], above, [False]])))
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if last - first >= 2:
            yield first, last
