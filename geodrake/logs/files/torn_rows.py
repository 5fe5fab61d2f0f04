"""Rows of a log that no recorder meant: no numbers, too many cells, time that jumps back."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import LogError
from geodrake.logs.time_stamps import check_time

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST = 0.01
"""Share of the rows that may be left out."""

_NAMED = 8  # rows, or runs of them, that are named
ADVICE = f"--skip-bad-rows leaves such rows out, up to {100 * MOST:g} % of a log."


@dataclass
class TornRows:
    """Bad rows of a file while it is read.

    Attributes:
        skip: Whether they are to be left out.
        rows: Their numbers, from 0 on.
        first: What is wrong with the first.
    """

    path: Path
    lines: int
    skip: bool = False
    rows: list[int] = field(default_factory=list)
    first: LogError | None = None

    def add(self, row: int, error: LogError) -> None:
        """Take a bad row in.

        Args:
            row: Its number, from 0 on.
            error: What is wrong with it.

        Raises:
            LogError: There are so many that nobody needs to know how many.
        """
        self.first = self.first or error
        self.rows.append(row)
        if len(self.rows) > _NAMED + MOST * self.lines:
            raise self._refusal(self.rows, row + 1, f"in the first {row + 1} rows")

    def settle(self, time: Array) -> tuple[Mask | None, tuple[str, ...]]:
        """Which rows are kept, all if None, and what was left out, in words.

        Args:
            time: (N,) time stamps of all rows, s, NaN in bad ones.

        Raises:
            LogError: There are bad rows, and they are not to be left out or are too many.
        """
        bad = np.array(self.rows, int)
        if self.first is not None and not self.skip:
            raise self._refusal(self.rows, len(time), f"of {len(time)}")
        backwards = rows_out_of_order(time)
        if len(backwards):
            self._check_order(time, backwards)
        bad = np.union1d(bad, backwards)
        if not len(bad):
            return None, ()
        if len(bad) > MOST * len(time):
            raise self._refusal(bad.tolist(), len(time), f"of {len(time)}")
        kept = np.ones(len(time), bool)
        kept[bad] = False
        return kept, (f"left out {len(bad)} bad rows of {len(time)}: {_runs(bad.tolist())}",)

    def _check_order(self, time: Array, backwards: NDArray[np.intp]) -> None:
        """Raise what is wrong with the order of time, unless such rows are to be left out."""
        few = len(backwards) <= MOST * len(time)
        if self.skip and few:
            return
        try:
            check_time(self.path.stem, time)
        except LogError as error:
            advice = error.advice
            if few:
                advice = f"Rows out of order: {_runs(backwards.tolist())}. {ADVICE}"
            raise LogError(error.problem, advice=advice, **error.evidence) from None

    def _refusal(self, rows: Sequence[int], count: int, of: str) -> LogError:
        first = self.first
        share = f"{len(rows)} {of}"
        if first is None:
            return LogError(f"Log {str(self.path)!r} has {share} bad rows.", advice=ADVICE)
        advice = first.advice
        if len(rows) > 1:
            advice += f" Bad rows are {_runs(rows)}: {share}."
        if len(rows) <= MOST * count:
            advice += f" {ADVICE}"
        elif self.skip:
            advice += f" At most {100 * MOST:g} % are left out."
        return LogError(first.problem, advice=advice, **first.evidence)


def rows_out_of_order(time: Array) -> NDArray[np.intp]:
    """The fewest rows without which time stamps increase; NaN are in order.

    Args:
        time: (N,) time stamps, s.
    """
    rows = np.flatnonzero(np.isfinite(time))
    stamps = time[rows]
    if np.all(np.diff(stamps) > 0):
        return np.zeros(0, int)
    least: list[float] = []  # end of the sequence of each length that ends earliest
    ends: list[int] = []
    before = np.full(len(stamps), -1)
    for k, stamp in enumerate(stamps.tolist()):
        length = bisect_left(least, stamp)
        if length == len(least):
            least.append(stamp)
            ends.append(k)
        else:
            least[length], ends[length] = stamp, k
        before[k] = ends[length - 1] if length else -1
    kept, k = np.zeros(len(stamps), bool), ends[-1]
    while k >= 0:
        kept[k] = True
        k = int(before[k])
    return rows[~kept]


def _runs(rows: Sequence[int]) -> str:
    """Rows from 0 on as numbers from 1 on, runs of them as such."""
    edges = [k for k, (one, other) in enumerate(pairwise(rows), 1) if other > one + 1]
    runs = [rows[i:j] for i, j in pairwise([0, *edges, len(rows)])]
    words = [
        f"{run[0] + 1}" if len(run) == 1 else f"{run[0] + 1} to {run[-1] + 1}"
        for run in runs[:_NAMED]
    ]
    return ", ".join(words) + (" …" if len(runs) > _NAMED else "")
