"""Logs in CSV files."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import LogError
from geodrake.logs.files.column_names import HEADER_ADVICE, Columns, Recording
from geodrake.logs.motion import JointLog

Array = NDArray[np.float64]

_LINES = 50_000  # that are read at once
_BLOCK = 1 << 20  # bytes in which line ends are looked for
_HEADER_LINES = 1000  # of a header whose names have line ends
_LONGEST_LINE = 8  # blocks, which hold 400,000 numbers


def read_csv(path: Path, joints: Sequence[str] | None, *, partial: bool = False) -> JointLog:
    """Read a log from a CSV file; see `read_log`."""
    most = 1 + _count_lines(path)
    with path.open(encoding="utf-8-sig", newline="") as file:
        header, line = _read_header(path, file)
        columns = Columns.of(path, header, joints, partial=partial)
        recording = Recording(columns, most)
        places = [header.index(name) for name in columns.names]
        rows = 0
        while lines := list(islice(file, _LINES)):
            table = _numbers(path, header, lines)
            if table is None:
                table = _cells(path, header, places, lines, (rows, line))
            else:
                table = table[:, places]
            for name, numbers in zip(columns.names, table.T, strict=True):
                recording.put(name, slice(rows, rows + len(table)), numbers)
            rows, line = rows + len(table), line + len(lines)
    return recording.log(rows)


def _count_lines(path: Path) -> int:
    """Line ends of any system; one more where a block ends between the two of a pair."""
    count = without = 0
    with path.open("rb") as binary:
        while block := binary.read(_BLOCK):
            ends = block.count(b"\n") + block.count(b"\r") - block.count(b"\r\n")
            count, without = count + ends, 0 if ends else without + 1
            if without >= _LONGEST_LINE:
                raise LogError(
                    f"Log {str(path)!r} has a line of more than {_LONGEST_LINE} MB.",
                    advice=f"Is it a text table, a row in each line? {HEADER_ADVICE}",
                )
    return count


def _read_header(path: Path, file: TextIO) -> tuple[list[str], int]:
    """Names of all columns, and how many lines they fill: a name in quotes may have line ends."""
    reader = csv.reader(islice(file, _HEADER_LINES), strict=True)
    try:
        header = [name.strip() for name in next(reader, [])]
    except csv.Error as error:
        raise LogError(
            f"The header of log {str(path)!r} cannot be read: {error}.",
            advice=f"Is there a quote that never closes? {HEADER_ADVICE}",
        ) from error
    _check_header(path, header)
    return header, reader.line_num


def _numbers(path: Path, header: Sequence[str], lines: Sequence[str]) -> Array | None:
    """(K, columns) of lines with nothing but numbers; None for others."""
    if not any(line.strip() for line in lines):
        return np.empty((0, len(header)))
    try:
        table = np.loadtxt(lines, delimiter=",", comments=None, ndmin=2)
    except ValueError:
        return None  # empty cells, text or ragged rows: distinguished cell by cell
    return table if table.shape[1] == len(header) else None


def _cells(
    path: Path,
    header: Sequence[str],
    places: Sequence[int],
    lines: Sequence[str],
    before: tuple[int, int],
) -> Array:
    """(K, used columns) of lines read cell by cell: slower, but exact about what is wrong where.

    `before` counts the rows and the lines of the file that come before them.
    """
    values: list[list[float]] = []
    reader = csv.reader(lines)
    try:
        for cells in filter(None, reader):
            row = before[0] + len(values) + 1
            if len(cells) != len(header):
                raise LogError(
                    f"Row {row} of log {str(path)!r} (line {before[1] + reader.line_num}) has "
                    f"{len(cells)} cells; the header has {len(header)}.",
                    advice="Was the recording cut off? Remove or repair that line.",
                    row=row,
                )
            values.append([_number(cells[k], path, row, header[k]) for k in places])
    except csv.Error as error:
        raise LogError(
            f"Row {before[0] + len(values) + 1} of log {str(path)!r} cannot be read: {error}.",
            advice="Is there a quote that never closes? Remove or repair that line.",
        ) from error
    return np.array(values, float).reshape(-1, len(places))


def _number(cell: str, path: Path, row: int, column: str) -> float:
    try:
        if "_" in cell:  # which Python takes in its own numbers
            raise ValueError(cell)
        return float(cell) if cell and not cell.isspace() else np.nan
    except ValueError:
        raise LogError(
            f"Row {row}, column {column!r} of log {str(path)!r} holds {cell.strip()[:60]!r}, which "
            "is not a number.",
            advice="Leave a cell empty, or write nan, where nothing was measured.",
            row=row,
            column=column,
        ) from None


def _check_header(path: Path, header: Sequence[str]) -> None:
    def is_number(cell: str) -> bool:
        try:
            float(cell)
        except ValueError:
            return False
        return True

    if not any(header) or all(map(is_number, header)):
        first = ",".join(header)
        raise LogError(
            f"Log {str(path)!r} has no header: its first line is {first[:60]!r}.",
            advice=HEADER_ADVICE,
        )
    separator = next((c for c in ";\t|" if c in header[0]), None)
    if len(header) == 1 and separator is not None:
        raise LogError(
            f"Log {str(path)!r} separates its columns by {separator!r}: its first line is "
            f"{header[0][:60]!r}.",
            advice="Separate them by commas, with a point in decimal numbers.",
        )
