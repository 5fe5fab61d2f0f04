"""Writer of joint logs, as CSV and NPZ."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from geodrake.arguments import file_path, instance
from geodrake.errors import OutputError
from geodrake.log_files.columns import QUANTITIES
from geodrake.motion import JointLog

_ROWS = 50_000  # that are written at once


def write_log(log: JointLog, path: str | Path) -> None:
    """Write a log so that `read_log` returns the same numbers.

    The file appears whole or not at all: it is written beside `path` and then renamed.

    Args:
        log: The log.
        path: Target; `.npz` writes arrays, `.csv` and `.txt` write text.

    Raises:
        OutputError: If the suffix is another, or the file cannot be written.
    """
    path = file_path(path)
    instance(log, "log", JointLog)
    if path.suffix.lower() not in (".csv", ".txt", ".npz"):
        raise OutputError(f"Cannot write a log to {str(path)!r}.", advice="Use .csv or .npz.")
    columns: dict[str, Any] = {"time": log.time}
    for quantity in QUANTITIES:
        values = getattr(log, quantity)
        if values is not None:
            names = (f"{joint}.{quantity}" for joint in log.joints)
            columns.update(zip(names, values.T, strict=True))
    partial = path.with_name(f".{path.name}.partial")
    try:
        if path.suffix.lower() == ".npz":
            with partial.open("wb") as file:
                np.savez_compressed(file, **columns)
        else:
            with partial.open("w", encoding="utf-8", newline="") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(columns)
                for first in range(0, len(log), _ROWS):
                    rows = [numbers[first : first + _ROWS] for numbers in columns.values()]
                    writer.writerows(np.column_stack(rows).tolist())
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise OutputError(
            f"Log {str(path)!r} cannot be written: {error.strerror or error}.",
            advice="Choose a folder that exists and can be written to.",
        ) from error
