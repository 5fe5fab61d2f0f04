"""Columns of a log file under the names that the file gives them, before they are understood."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LogTable:
    """What a file of any format holds, as columns of numbers.

    Readers of formats make it; which joint and quantity a column is of is found out afterwards.

    Attributes:
        path: The file or folder.
        columns: (N,) numbers of each column, by its name in the file; NaN where nothing was
            measured. `time`, if the format has stamps of its own: s from the first sample.
        units: Units of columns, where the file states them.
        notes: What was noticed while reading, in words.
        origins: Columns of time that are in seconds, whatever their names say -> when they are
            zero, ns since 1970.
        silent: Columns that were left out -> why, in words.
    """

    path: Path
    columns: Mapping[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    origins: Mapping[str, int] = field(default_factory=dict)
    silent: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values()), ()))
