"""Readers of joint logs and of data frames, and their writer, as CSV and NPZ.

The columns are `time` and, for each joint, `<joint>.position`, `<joint>.effort` and, if measured,
`<joint>.velocity` and `<joint>.acceleration`: the terms of ROS JointState, in SI units. Efforts
may be replaced by `<joint>.current`, `.voltage`, `.pwm` (a fraction of the supply voltage or
another maximum) or `.command`, the commanded position of a servo. The quantity follows the last
dot, so joint names may contain dots. Other column names are parsed by `name_rules`, or assigned by
the user with a `Reading`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from geodrake.boundary.arguments import Array, file_path, instance, instances
from geodrake.boundary.whole_files import Content, write_whole
from geodrake.errors import ArgumentError, LogError, OutputError
from geodrake.logs.files.column_mapping import (
    Columns,
    check_once,
    columns_of,
    is_used,
    listed,
    without_use,
)
from geodrake.logs.files.formats import (
    check_log,
    file_names,
    joined_table,
    parts_of,
    table_of,
)
from geodrake.logs.files.grouped_arrays import regrouped
from geodrake.logs.files.joined_tables import RARE
from geodrake.logs.files.name_rules import is_time, meanings_of
from geodrake.logs.files.reading import Reading, read_mapping
from geodrake.logs.files.recording import recorded
from geodrake.logs.files.table import LogTable, numeric_table, readable
from geodrake.logs.motion import JointLog

__all__ = [
    "Reading",
    "check_log",
    "file_names",
    "log_content",
    "log_of_frame",
    "parts_of",
    "read_log",
    "read_mapping",
    "understand",
    "write_log",
]


def read_log(
    path: str | Path,
    *,
    joints: Sequence[str] | None = None,
    partial: bool = False,
    reading: Reading | None = None,
) -> JointLog:
    """Read a log.

    Args:
        path: A file or folder of any of the `formats`; several files with `+` between them, as in
            `positions.csv+efforts.csv`, are joined by time. Columns are identified by their
            names, in any order, and unknown ones are noted. Empty cells become NaN.
        joints: Joints of a model, if the log must have the same ones; sets their order.
        partial: Whether the log may lack some of these joints, or only their efforts: joints at
            rest are then in `JointLog.standing`.
        reading: Options where column names are not sufficient.

    Raises:
        LogError: The file cannot be read or interpreted, or its time does not increase. If names
            are not recognized, `evidence["proposal"]` is the text of a mapping to edit.
    """
    return understand(path, joints=joints, partial=partial, reading=reading)[0]


def understand(
    path: str | Path,
    *,
    joints: Sequence[str] | None = None,
    partial: bool = False,
    reading: Reading | None = None,
) -> tuple[JointLog, Columns]:
    """Return a log and its columns; see `read_log`."""
    path = file_path(path)
    joints = None if joints is None else instances(joints, "joints", str)
    reading = Reading() if reading is None else instance(reading, "reading", Reading)
    reading = replace(reading, joints=joints or ())
    parts = parts_of(path)
    for part in parts:
        check_log(part)

    try:
        joined = len(parts) > 1
        table = joined_table(parts, reading) if joined else table_of(path, reading)
        return log_of(table, joints, reading, partial=partial)
    except UnicodeDecodeError as error:
        raise LogError(
            f"Log {str(path)!r} is not {error.encoding.upper()} text: {error.reason} at byte "
            f"{error.start}.",
            advice="Save it as CSV in UTF-8, or as .npz.",
        ) from error
    except (OSError, MemoryError) as error:
        raise LogError(
            f"Log {str(path)!r} cannot be read: {error}.",
            advice="Check the file's permissions and the available memory.",
        ) from error


def log_of(
    table: LogTable, joints: Sequence[str] | None, reading: Reading, *, partial: bool = False
) -> tuple[JointLog, Columns]:
    """Return the log in a table and its columns; see `read_log`."""
    table, original = regrouped(table, reading), reading
    _check_silent(table, reading, joints)
    while True:
        columns = columns_of(table, joints, reading, partial=partial)
        log = recorded(columns, *table.read(columns.files, skip=reading.skip_bad_rows))
        if not (useless := without_use(log, columns)):
            break
        reading = replace(reading, ignored=reading.ignored | useless)
    notes = [*table.notes, *log.notes]
    if unused := reading.ignored - original.ignored:
        notes.append(f"columns {listed(sorted(unused))} do not describe efforts, and are not used")
    return replace(log, notes=tuple(notes), motors=reading.motors_of(log.joints)), columns


_ADVICE = {
    RARE: "Log that joint as often as the others, or fix it: --lock JOINT=POSITION.",
    "has the shape": "Save a row a sample, as of one of several environments: array[:, 0].",
    "has lists": "Write lists of equal length, or null in rows that lack some.",
    "": "Use numbers, or for time dates such as 2026-05-01T12:00:00.25Z.",
}
"""Beginning of the reason why a column has no numbers -> advice."""


def _check_silent(table: LogTable, reading: Reading, joints: Sequence[str] | None) -> None:
    """Raise if needed columns have no numbers, rather than report them as missing."""
    needed = {mapped.among(table.counted) for _, mapped in reading.mapping or ()}
    if reading.mapping is None:
        rare = {name for name, words in table.silent.items() if words.startswith(RARE)}
        rare = {name for name in rare if name.rpartition(".")[0] not in (joints or ())}
        needed = {n for n in table.silent if is_used(n) and n != "time"} - rare
        if reading.rate is None and not any(map(table.is_time, table.names)):
            needed |= {name for name in table.silent if is_time(name)}
        present = {m.log_quantity.replace("command", "effort") for m in meanings_of(table.columns)}
        missing = {"position", "effort"}.difference(present)
        needed |= {m.column for m in meanings_of(table.silent) if m.log_quantity in missing}
    for name, words in table.silent.items():
        if name in needed:
            advice = (each for begin, each in _ADVICE.items() if words.startswith(begin))
            raise LogError(
                f"Column {name!r} of log {str(table.path)!r} {words}.", advice=next(advice)
            )


def log_of_frame(
    frame: Any,
    *,
    joints: Sequence[str] | None = None,
    name: str = "frame",
    reading: Reading | None = None,
) -> JointLog:
    """Return the log in a data frame, or in arrays by name.

    Args:
        frame: A DataFrame of pandas or polars, a table of Arrow, a structured array, or a mapping
            of names to arrays. Columns are `time` (numbers, durations or dates),
            `<joint>.position`, `<joint>.effort` (or `.current`, `.voltage`, `.pwm`, `.command`) and
            perhaps `<joint>.velocity` and `<joint>.temperature`; or `position`, `effort` … (N, n),
            with the joints in order. Without `time`, a pandas index of dates, durations or seconds
            is used.
        joints: Joints of a model, if the log must have the same ones; sets their order.
        name: Name of the log in messages.
        reading: Options where column names are not sufficient.

    """
    instance(name, "name", str)
    joints = None if joints is None else instances(joints, "joints", str)
    reading = Reading() if reading is None else instance(reading, "reading", Reading)
    reading = replace(reading, joints=joints or ())
    with readable(Path(name), "frame of numbers", "Use numeric columns, such as float64."):
        arrays = _frame_arrays(frame, name)
    rows = max((len(values) for values in arrays.values() if np.ndim(values)), default=0)
    index: Any = getattr(frame, "index", None)
    if getattr(getattr(index, "dtype", None), "kind", "") in ("M", "m", "f"):  # not row numbers
        arrays.setdefault("time", index.to_numpy())
    table = numeric_table(Path(name), arrays, rows)
    return log_of(table, joints, reading)[0]


def _frame_arrays(frame: Any, title: str) -> dict[str, Any]:
    """Return name -> column of any container; a lazy polars frame is collected."""
    if hasattr(frame, "collect_schema") and hasattr(frame, "collect"):
        frame = frame.collect()
    kinds = (frame, "column_names"), (frame, "columns"), (getattr(frame, "dtype", None), "names")
    listed_names = (x for each, name in kinds if (x := getattr(each, name, None)) is not None)
    names: Any = frame if isinstance(frame, Mapping) else next(listed_names, None)
    if names is None or isinstance(frame, str):
        raise ArgumentError(
            f"A frame must have named columns; got {type(frame).__name__}.",
            advice="Pass a DataFrame, or a dict of arrays with time, position and effort.",
        )
    check_once(Path(title), [str(name) for name in names])
    columns = {str(name): frame[name] for name in names}
    return {  # keeps masks of missing values
        name: column.to_numpy() if hasattr(column, "to_numpy") else np.asanyarray(column)
        for name, column in columns.items()
    }


_ROWS = 50_000  # rows written at once


def write_log(log: JointLog, path: str | Path) -> None:
    """Write a log so that `read_log` returns the same numbers.

    The file appears whole or not at all: arrays in `.npz`, text in `.csv` and `.txt`.
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
    if any("\r" in name for name in columns):  # an unquoted one is read as a line break
        csv.writer(text, lineterminator="\n", quoting=csv.QUOTE_ALL).writerow(columns)
    else:
        writer.writerow(columns)
    count = len(columns["time"])
    for first in range(0, count, _ROWS):
        rows = [numbers[first : first + _ROWS] for numbers in columns.values()]
        writer.writerows(np.column_stack(rows).tolist())
    text.detach()  # flushes the text and leaves the file open
