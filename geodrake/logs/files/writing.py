"""Writer of joint logs, as CSV and NPZ."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import file_path, instance
from geodrake.boundary.whole_files import Content, write_whole
from geodrake.errors import OutputError
from geodrake.logs.motion import JointLog

Array = NDArray[np.float64]

_ROWS = 50_000  # that are written at once


def write_log(log: JointLog, path: str | Path) -> None:
    """Write a log so that `read_log` returns the same numbers.

    The file appears whole or not at all: it is written beside `path` and then renamed.

    Args:
        path: Target; `.npz` writes arrays, `.csv` and `.txt` write text.

    Raises:
        OutputError: If the suffix is another, or the file cannot be written.
    """
    path = file_path(path)
    write_whole(path, log_content(log, path))


def log_content(log: JointLog, path: str | Path) -> Content:
    """Return the content of the file; see `write_log` for arguments and errors."""
    path = file_path(path)
    instance(log, "log", JointLog)
    if path.suffix.lower() not in (".csv", ".txt", ".npz"):
        raise OutputError(f"Cannot write a log to {str(path)!r}.", advice="Use .csv or .npz.")
    columns = log.columns()
    if path.suffix.lower() == ".npz":
        arrays: dict[str, Any] = {**columns}
        return lambda file: np.savez_compressed(file, **arrays)
    return lambda file: _write_csv(file, columns)


def _write_csv(file: BinaryIO, columns: Mapping[str, Array]) -> None:
    text = io.TextIOWrapper(file, encoding="utf-8", errors="backslashreplace", newline="")
    writer = csv.writer(text, lineterminator="\n")
    if any("\r" in name for name in columns):  # readers take it for a line end if it is bare
        csv.writer(text, lineterminator="\n", quoting=csv.QUOTE_ALL).writerow(columns)
    else:
        writer.writerow(columns)
    count = len(columns["time"])
    for first in range(0, count, _ROWS):
        rows = [numbers[first : first + _ROWS] for numbers in columns.values()]
        writer.writerows(np.column_stack(rows).tolist())
    text.detach()  # which flushes it, and leaves the file open
