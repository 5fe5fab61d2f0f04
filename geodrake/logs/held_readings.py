"""Readings of sources that are slower than the rows of a log, held until the next ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import Array

_LONGER = 2.0  # longest held run of equal values, relative to the median
_MOSTLY, _FEWEST = 0.8, 20  # least share of held runs, and least number of runs
_ONE_STEP = 1.5  # largest change by one step, relative to the smallest change


def held_readings(values: Array) -> tuple[int, NDArray[np.bool_]] | None:
    """Return every how many rows values (N, k) are new, and the rows (N,) that are no repetitions.

    Longer runs than usual are standstills, and not held. The result is None if values are not held:
    if most runs have one row, or most values change by one step of their resolution.
    """
    steps = np.abs(np.diff(values, axis=0))
    starts = np.flatnonzero(np.append(True, (steps != 0.0).any(axis=1)))
    lengths = np.diff(np.append(starts, len(values)))
    every = int(np.median(lengths))
    is_short = lengths <= _LONGER * every
    if len(lengths) < _FEWEST or np.mean(is_short & (lengths > 1)) < _MOSTLY:
        return None
    changes = np.where(steps > 0.0, steps, np.nan)[starts[1:] - 1]
    if np.nanmedian(changes / np.nanmin(changes, axis=0)) < _ONE_STEP:
        return None
    is_new = ~np.repeat(is_short, lengths)
    is_new[starts] = True
    return every, is_new
