"""Readings of sources that are slower than the rows of a log, held until the next ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import Array

_FEWEST, _FIRST = 20, 0.05  # least number of runs of equal values, and quantile of their lengths
_REGULAR = 0.9  # share of runs whose length is a multiple of that one
_MOSTLY, _LONGER = 0.8, 2.0  # share of runs that are held if rows are lost, and longest of them
_ONE_STEP = 1.5  # largest change by one step, relative to the smallest change


def held_readings(values: Array) -> tuple[int, NDArray[np.bool_]] | None:
    """Return every how many rows values (N, k) are new, and the rows (N,) with new values.

    The result is None if they may be new in any row. If rows are lost, runs of equal values have
    different lengths, as they have if a slow signal is coarse: its changes are single steps, and
    its values not held. Runs that are much longer than usual are then standstills.
    """
    steps = np.abs(np.diff(values, axis=0))
    starts = np.flatnonzero(np.append(True, (steps != 0.0).any(axis=1)))
    lengths = np.diff(np.append(starts, len(values)))
    if len(lengths) < _FEWEST or not (steps > 0.0).any():
        return None
    every = int(np.quantile(lengths, _FIRST))
    if every > 1 and np.mean(lengths % every == 0) >= _REGULAR:
        return every, (np.arange(len(values)) - np.repeat(starts, lengths)) % every == 0
    every = int(np.median(lengths))
    is_short = lengths <= _LONGER * every
    smallest = np.min(steps, axis=0, initial=np.inf, where=steps > 0.0)
    is_coarse = np.mean((steps < _ONE_STEP * smallest)[steps > 0.0]) > 0.5
    if np.mean(is_short & (lengths > 1)) < _MOSTLY or is_coarse:
        return None
    is_new = ~np.repeat(is_short, lengths)
    is_new[starts] = True
    return every, is_new
