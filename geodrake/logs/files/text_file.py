"""Logs in tables of text: CSV and its kin."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.input_files import open_regular, open_text, regular_file
from geodrake.errors import LogError
from geodrake.logs.files.column_names import HEADER_ADVICE
from geodrake.logs.files.dates import date_of
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.recognition import is_time, names_joints
from geodrake.logs.files.table import Groups, LogTable, Part
from geodrake.logs.files.text_layout import TextLayout, list_of, text_layout
from geodrake.logs.files.torn_rows import TornRows

Array = NDArray[np.float64]

_LINES = 50_000  # that are read at once
_MANY = 100_000  # lines, from which on pandas is quicker
_BLOCK = 1 << 20  # bytes in which line ends are looked for
_LONGEST_LINE = 8  # blocks, which hold 400,000 numbers


class TextTable(LogTable):
    """A table of text, read block by block."""

    def __init__(self, path: Path, layout: TextLayout, lines: int, reading: Reading) -> None:
        super().__init__(path, {}, layout.units, (), layout.origins)
        self._read = layout, lines, reading

    @property
    def names(self) -> Sequence[str]:
        """Names of the columns."""
        return self._read[0].columns

    def rows(self, names: Sequence[str]) -> int:
        """Return how many rows there are at most."""
        return self._read[1]

    def parts(self, groups: Groups, torn: TornRows) -> Iterator[Part]:
        """Yield rows, and the numbers of some columns in them; see `LogTable`."""
        names = list(dict.fromkeys(name for group in groups for name in group))
        layout, row = self._read[0], 0
        if self._read[1] > _MANY and find_spec("pandas"):
            with suppress(ValueError):  # of something else than numbers: told cell by cell
                yield from self._quickly(names)
                return
        with open_text(self.path, "log", LogError, newline="") as file:
            lines = islice(file, layout.lines, None)
            for table in _blocks(self.path, layout, lines, names, torn):
                yield slice(row, row + len(table)), dict(zip(names, table.T, strict=True))
                row += len(table)

    def _quickly(self, names: Sequence[str]) -> Iterator[Part]:
        """Yield the parts of a table that has nothing but numbers; else raise a ValueError."""
        import pandas

        layout, row = self._read[0], 0
        places = [layout.places[name] for name in names]
        cells = [cell for cell, item in places if item is None]
        if layout.separator is None or len(cells) < len(names) or layout.origins:
            raise ValueError("not of numbers alone")
        exact: dict[str, Any] = (
            {} if pandas.__version__ >= "3" else {"float_precision": "round_trip"}
        )
        last = len(layout.names) - 1
        kinds = {k: float if k in {*cells, last} else str for k in range(last + 1)}
        with open_text(self.path, "log", LogError, newline="") as file:
            for _ in range(layout.lines):
                file.readline()
            frames = pandas.read_csv(
                file,
                sep=layout.separator,
                decimal=layout.decimal,
                header=None,
                dtype=kinds,
                keep_default_na=False,
                na_values=["", "nan", "NaN"],
                chunksize=_MANY,
                **exact,
            )
            for frame in frames:
                if frame.shape[1] != last + 1 or frame[last].isna().any():
                    raise ValueError("a row may be cut off")
                numbers = frame[cells].to_numpy()
                part = slice(row, row + len(numbers))
                yield part, dict(zip(names, numbers.T, strict=True))
                row = part.stop

    def loaded(self) -> LogTable:
        """Return the table with all its columns read, those of words as texts."""
        layout, most, reading = self._read
        torn = TornRows(self.path, most, reading.skip_bad_rows)
        names = [name for name in layout.columns if name not in layout.texts]
        blocks = list[Part]()
        for part in self.parts([tuple(names)], torn):
            if part[0].start == 0:
                blocks.clear()  # of a quick reading that did not come to the end
            blocks.append(part)
        rows = blocks[-1][0].stop if blocks else 0
        kept, notes = torn.settle(np.arange(float(rows)))
        columns = {
            name: np.concatenate([numbers[name] for _, numbers in blocks])[_all(kept)]
            for name in (names if blocks else ())
        }
        words = {name: texts[_all(kept)] for name, texts in self._texts(rows)}
        silent = {name: f"holds {texts[:1]}" for name, texts in words.items()}
        return LogTable(self.path, columns, layout.units, notes, layout.origins, silent, words)

    def _texts(self, rows: int) -> Iterator[tuple[str, NDArray[np.object_]]]:
        """Yield columns of words, if every row has them."""
        layout = self._read[0]
        with open_text(self.path, "log", LogError, newline="") as file, suppress(csv.Error):
            cells = [row for _, row in layout.cells(list(islice(file, layout.lines, None)))]
            places = [(name, layout.names.index(name)) for name in layout.texts]
            if len(cells) == rows:
                for name, k in places:
                    texts = [row[k].strip() if k < len(row) else "" for row in cells]
                    yield name, np.array(texts, object)


def _all(kept: NDArray[np.bool_] | None) -> NDArray[np.bool_] | slice:
    return slice(None) if kept is None else kept


def read_text(
    path: Path, reading: Reading, joints: Sequence[str] | None = None, *, numbered: bool = False
) -> LogTable:
    """Return the columns of a table of text.

    Args:
        joints: Names of the model's joints, if there is a model, for a proposed mapping.
        numbered: Whether columns without names may be called by their numbers.
    """
    most = 1 + _count_lines(regular_file(path, "log", LogError))
    with open_text(path, "log", LogError, newline="") as file:
        layout, _ = text_layout(path, file, reading, joints, numbered=numbered)
    table = TextTable(path, layout, most, reading)
    return table.loaded() if any(map(names_joints, layout.texts)) else table


def _blocks(
    path: Path, layout: TextLayout, lines: Iterator[str], used: Sequence[str], torn: TornRows
) -> Iterator[Array]:
    """(K, used) numbers of some columns, block by block; NaN in the rows that are `torn`."""
    places = [layout.places[name] for name in used]
    rows, line = 0, layout.lines
    while block := list(islice(lines, _LINES)):
        table = _numbers(layout, block, places)
        if table is None:
            table = _cells(path, layout, used, block, before=(rows, line), torn=torn)
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


def _numbers(
    layout: TextLayout, lines: Sequence[str], places: Sequence[tuple[int, int | None]]
) -> Array | None:
    """(K, places) of lines whose cells there are nothing but numbers; None for others."""
    if not any(line.strip() for line in lines):
        return np.empty((0, len(places)))
    mark, columns = layout.separator, [cell for cell, _ in places]
    if {*columns} & {layout.names.index(name) for name in (*layout.lists, *layout.origins)}:
        return None
    plain = [line.replace(",", ".") for line in lines] if layout.decimal == "," else lines
    cells = len(layout.names) - 1
    if mark and any('"' in line or (line.count(mark) != cells and line.strip()) for line in plain):
        return None
    try:
        table = np.loadtxt(
            plain, delimiter=mark, comments=None, ndmin=2, usecols=columns if mark else None
        )
    except ValueError:
        return None  # empty cells, text or ragged rows: distinguished cell by cell
    return table if mark else table[:, columns] if table.shape[1] == cells + 1 else None


def _cells(
    path: Path,
    layout: TextLayout,
    used: Sequence[str],
    lines: Sequence[str],
    *,
    before: tuple[int, int],
    torn: TornRows,
) -> Array:
    """(K, used columns) of lines read cell by cell: slower, but exact about what is wrong where.

    `before` counts the rows and the lines of the file that come before them.
    """
    values: list[list[float]] = []
    places = [(name, *layout.places[name]) for name in used]
    try:
        for line, cells in layout.cells(lines):
            row = before[0] + len(values)
            try:
                _check_count(path, layout, cells, row + 1, before[1] + line)
                lists = {
                    k: _list(cells[k], path, row + 1, layout, k)
                    for k in {cell for _, cell, item in places if item is not None}
                }
                values.append(
                    [
                        _value(cells[cell], path, row + 1, layout, cell)
                        if item is None
                        else lists[cell][item]
                        for _, cell, item in places
                    ]
                )
            except LogError as error:
                torn.add(row, error)
                values.append([np.nan] * len(places))
    except csv.Error as error:
        raise LogError(
            f"Row {before[0] + len(values) + 1} of log {str(path)!r} cannot be read: {error}.",
            advice="Is there a quote that never closes? Remove or repair that line.",
        ) from error
    return np.array(values, float).reshape(-1, len(places))


def _list(cell: str, path: Path, row: int, layout: TextLayout, place: int) -> list[float]:
    """Return the numbers of a list in a cell; NaN where the cell is empty."""
    column = layout.names[place]
    is_empty = cell.strip() in ("", "[]", "()")
    count, found = layout.lists[column], None if is_empty else list_of(cell)
    if is_empty:
        return [np.nan] * count
    if found is None or len(found) != count:
        raise LogError(
            f"Row {row}, column {column!r} of log {str(path)!r} holds {cell.strip()[:60]!r}, which "
            f"is no list of {count} numbers as above it.",
            advice="Write all lists of a column equally long, or leave the cell empty.",
            row=row,
            column=column,
        )
    return found


def _check_count(path: Path, layout: TextLayout, cells: Sequence[str], row: int, line: int) -> None:
    if len(cells) != len(layout.names):
        raise LogError(
            f"Row {row} of log {str(path)!r} (line {line}) has {len(cells)} cells; the header has "
            f"{len(layout.names)}.",
            advice="Was the recording cut off? Remove or repair that line.",
            row=row,
        )


def _value(cell: str, path: Path, row: int, layout: TextLayout, place: int) -> float:
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
