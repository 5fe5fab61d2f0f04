"""Logs in CSV files and other tables of text."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.input_files import open_regular, open_text, regular_file
from geodrake.errors import LogError
from geodrake.logs.files.column_names import HEADER_ADVICE, Columns
from geodrake.logs.files.csv_layout import CsvLayout, csv_layout
from geodrake.logs.files.dates import date_of
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.recognition import is_time
from geodrake.logs.files.recording import Recording
from geodrake.logs.files.table import LogTable
from geodrake.logs.files.torn_rows import TornRows
from geodrake.logs.files.understanding import columns_of
from geodrake.logs.motion import JointLog

Array = NDArray[np.float64]

_LINES = 50_000  # that are read at once
_BLOCK = 1 << 20  # bytes in which line ends are looked for
_LONGEST_LINE = 8  # blocks, which hold 400,000 numbers


def read_csv(
    path: Path, joints: Sequence[str] | None, reading: Reading, *, partial: bool = False
) -> tuple[JointLog, Columns]:
    """Read a log from a table of text, and what its columns are; see `read_log`.

    Args:
        path: The file.
        joints: Names of the model's joints, if the log must have them.
        reading: What the user said of the file.
        partial: Whether the log may lack some of the joints.
    """
    most = 1 + _count_lines(path)
    with open_text(path, "log", LogError, newline="") as file:
        layout, lines = csv_layout(path, file, reading, joints)
        columns = columns_of(
            path,
            layout.names,
            joints,
            reading,
            layout.units,
            origins=layout.origins,
            partial=partial,
        )
        recording = Recording(columns, most)
        rows = 0
        for table in csv_blocks(path, layout, lines, columns.files, recording.torn):
            numbers = dict(zip(columns.files, table.T, strict=True))
            recording.put(slice(rows, rows + len(table)), numbers)
            rows += len(table)
    return recording.log(rows), columns


def csv_table(path: Path, reading: Reading) -> LogTable:
    """Return the columns of a table of text as they are, those of text left out.

    Args:
        path: The file.
        reading: What the user said of it.
    """
    most = 1 + _count_lines(regular_file(path, "log", LogError))
    with open_text(path, "log", LogError, newline="") as file:
        layout, lines = csv_layout(path, file, reading, None, numbered=True)
        torn = TornRows(path, most, reading.skip_bad_rows)
        blocks = list(csv_blocks(path, layout, lines, layout.names, torn))
    numbers = np.concatenate(blocks) if blocks else np.empty((0, len(layout.names)))
    kept, notes = torn.settle(np.arange(float(len(numbers))))
    columns = dict(zip(layout.names, (numbers if kept is None else numbers[kept]).T, strict=True))
    return LogTable(path, columns, layout.units, notes, layout.origins)


def csv_blocks(
    path: Path, layout: CsvLayout, lines: Iterator[str], used: Sequence[str], torn: TornRows
) -> Iterator[Array]:
    """(K, used) numbers of some columns, block by block; NaN in the rows that are `torn`.

    Args:
        path: The file, for messages.
        layout: How it is laid out.
        lines: Its lines from the first row on.
        used: Names of the columns.
        torn: Takes bad rows in.
    """
    places = [layout.names.index(name) for name in used]
    rows, line = 0, layout.lines
    while block := list(islice(lines, _LINES)):
        table = _numbers(layout, block)
        if table is None:
            table = _cells(path, layout, places, block, before=(rows, line), torn=torn)
        else:
            table = table[:, places]
        yield table
        rows, line = rows + len(table), line + len(block)


def _count_lines(path: Path) -> int:
    """Line ends of any system; one more where a block ends between the two of a pair."""
    count = without = 0
    with open_regular(path, "log", LogError) as binary:
        while block := binary.read(_BLOCK):
            ends = block.count(b"\n") + block.count(b"\r") - block.count(b"\r\n")
            count, without = count + ends, 0 if ends else without + 1
            if without >= _LONGEST_LINE:
                raise LogError(
                    f"Log {str(path)!r} has a line of more than {_LONGEST_LINE} MB.",
                    advice=f"Is it a text table, a row in each line? {HEADER_ADVICE}",
                )
    return count


def _numbers(layout: CsvLayout, lines: Sequence[str]) -> Array | None:
    """(K, columns) of lines with nothing but numbers; None for others."""
    if not any(line.strip() for line in lines):
        return np.empty((0, len(layout.names)))
    plain = [line.replace(",", ".") for line in lines] if layout.decimal == "," else lines
    try:
        table = np.loadtxt(plain, delimiter=layout.separator, comments=None, ndmin=2)
    except ValueError:
        return None  # empty cells, text or ragged rows: distinguished cell by cell
    return table if table.shape[1] == len(layout.names) else None


def _cells(
    path: Path,
    layout: CsvLayout,
    places: Sequence[int],
    lines: Sequence[str],
    *,
    before: tuple[int, int],
    torn: TornRows,
) -> Array:
    """(K, used columns) of lines read cell by cell: slower, but exact about what is wrong where.

    `before` counts the rows and the lines of the file that come before them.
    """
    values: list[list[float]] = []
    try:
        for line, cells in layout.cells(lines):
            row = before[0] + len(values)
            try:
                _check_count(path, layout, cells, row + 1, before[1] + line)
                values.append([_value(cells[k], path, row + 1, layout, k) for k in places])
            except LogError as error:
                torn.add(row, error)
                values.append([np.nan] * len(places))
    except csv.Error as error:
        raise LogError(
            f"Row {before[0] + len(values) + 1} of log {str(path)!r} cannot be read: {error}.",
            advice="Is there a quote that never closes? Remove or repair that line.",
        ) from error
    return np.array(values, float).reshape(-1, len(places))


def _check_count(path: Path, layout: CsvLayout, cells: Sequence[str], row: int, line: int) -> None:
    if len(cells) != len(layout.names):
        raise LogError(
            f"Row {row} of log {str(path)!r} (line {line}) has {len(cells)} cells; the header has "
            f"{len(layout.names)}.",
            advice="Was the recording cut off? Remove or repair that line.",
            row=row,
        )


def _value(cell: str, path: Path, row: int, layout: CsvLayout, place: int) -> float:
    """Return the number in a cell, or the seconds since the first date in its column."""
    column = layout.names[place]
    origin = layout.origins.get(column)
    if origin is None or not cell.strip():
        return _number(cell, path, row, column)
    date = date_of(cell)
    if date is None:
        raise LogError(
            f"Row {row}, column {column!r} of log {str(path)!r} holds {cell.strip()[:60]!r}, which "
            "is no date as above it.",
            advice="Write dates as 2026-05-01T12:00:00.25Z, or leave the cell empty.",
            row=row,
            column=column,
        )
    return (date - origin) / 1e9


def _number(cell: str, path: Path, row: int, column: str) -> float:
    try:
        if "_" in cell:  # which Python takes in its own numbers
            raise ValueError(cell)
        return float(cell) if cell and not cell.isspace() else np.nan
    except ValueError:
        dates = " A column of dates has them from its first row on." if is_time(column) else ""
        raise LogError(
            f"Row {row}, column {column!r} of log {str(path)!r} holds {cell.strip()[:60]!r}, which "
            "is not a number.",
            advice=f"Leave a cell empty, or write nan, where nothing was measured.{dates}",
            row=row,
            column=column,
        ) from None
