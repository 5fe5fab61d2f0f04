"""Columns of a log file under the names that the file gives them, before they are understood."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.logs.files.torn_rows import TornRows

Array = NDArray[np.float64]
Groups = Sequence[tuple[str, ...]]
Part = tuple[slice, Mapping[str, Array]]


@dataclass(eq=False)
class LogTable:
    """What a file of any format holds, as columns of numbers.

    Readers of formats make it; which joint and quantity a column is of is found out afterwards.
    Large files are tables that are read in parts, of which subclasses know how.

    Attributes:
        columns: (N,) numbers of each column, by its name in the file; NaN where nothing was
            measured. `time`, if the format has stamps of its own: s from the first sample.
        units: Units of columns, where the file states them.
        notes: What was noticed while reading, in words.
        origins: Columns of time that are in seconds, whatever their names say -> when they are
            zero, ns since 1970.
        silent: Columns that were left out -> why, in words.
        words: (N,) texts of columns without numbers.
        in_seconds: Whether the column `time` is in seconds, whatever the user says of the file's.
    """

    path: Path
    columns: Mapping[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    origins: Mapping[str, int] = field(default_factory=dict)
    silent: Mapping[str, str] = field(default_factory=dict)
    words: Mapping[str, NDArray[np.object_]] = field(default_factory=dict)
    in_seconds: bool = False

    def __len__(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values()), ()))

    @property
    def names(self) -> Sequence[str]:
        """Names of the columns."""
        return list(self.columns)

    def rows(self, names: Sequence[str]) -> int:
        """Return how many rows some columns have at most, before they are read."""
        return len(self)

    def parts(self, groups: Groups, torn: TornRows) -> Iterator[Part]:
        """Yield rows, and the numbers of some columns in them; those of a group come together.

        Rows that cannot be read are `torn`, and NaN.
        """
        yield slice(0, len(self)), self.columns

    def loaded(self) -> LogTable:
        """Return the table with all its columns read."""
        return self

    def noting(self, *notes: str) -> LogTable:
        """Return the table with further notes, first."""
        noted = copy(self)
        noted.notes = (*notes, *self.notes)
        return noted
