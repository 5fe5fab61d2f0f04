"""Logs in text tables such as CSV: detect their layout, and read their numbers."""

from __future__ import annotations

import csv
import json
import re
from array import array
from ast import literal_eval
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from importlib import import_module
from importlib.util import find_spec
from io import BytesIO, StringIO
from itertools import chain, dropwhile, islice, product, takewhile
from pathlib import Path
from typing import Any, BinaryIO
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import Array
from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import LogError
from geodrake.logs.files.column_mapping import HEADER_ADVICE, check_text, listed, no_header
from geodrake.logs.files.name_rules import (
    is_time,
    meaning_of,
    names_joints,
    numbers_joints,
    quantity_of,
    tells,
)
from geodrake.logs.files.number_marks import ADVICE as MARKS_ADVICE
from geodrake.logs.files.number_marks import may_be_grouped, number_marks, plain
from geodrake.logs.files.packed_files import open_log, unpacked
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import (
    DATE,
    NOTHING,
    Cells,
    LogTable,
    TornRows,
    check_room,
    is_date,
    is_nothing,
    number_in,
    numbered,
    order_of_days,
    readable,
)
from geodrake.logs.files.units import UNITS, WORDS, find_unit

_COMMENTS = ("#", "%", "//")
_RULES = ("---", "===")  # separator lines, if they contain no numbers
_HEADER_LINES = 1000  # most lines of a header with line breaks in names
_PREFACE = 100  # lines searched for names
_KEYED_ROWS = 4  # least rows above the numbers that begin with a keyword
_LINES_AHEAD = 1000  # lines searched for dates, lists and words
_WHITESPACE = None
_KEYED = re.compile(  # a name and its number, or a list of numbers
    r"(?<![\w.\])])([A-Za-z_][^:=\s,;]*)\s*[:=]\s*"
    r"(\[[^\]]*\]|\([^)]*\)|[+-]?(?:\.?\d|nan|inf)[^\s,;]*(?:\s+[+-]?\.?\d[^\s,;:=]*(?!\S))*)"
)
_STAMP = re.compile(r"\[ *(\d+\.\d+) *\]")  # as in ROS console output
_COLOUR = re.compile(r"\x1b\[[\d;]*m")  # terminal escape sequence
_MAY_BE_MARKED = defaultdict(
    lambda: re.compile(r"\d[,'’ \u00a0\u202f]\d|,\d|\d\.\d{3}(?!\d)"),
    {",": re.compile('"'), _WHITESPACE: re.compile("[,'’]")},
)
"""Separator -> pattern of numbers that may differ from Python's notation."""

_UNIT_BEHIND = re.compile(r"\s+(?=[\[(][^\d\W][^\])]*[\])])")  # blanks before `[rad]`
_NUMBER_OF = re.compile(r"[+-]?[\d.,]+\s*([^\W\d]\S*|°\S*|%)")  # a unit
_MEASURED = re.compile(r"[+-]?\d+[.,]\d+([eE][+-]?\d+)?")
_HEADS = [head.split() for head in WORDS["heads"]]
_SEVERAL = re.compile(r"(.*?[^\W\d])[\[({](\d+)[\])}](\s*[\[(][^\d\W].*)?")  # q[6] [rad]
_SPAN = re.compile(r"(.*?)(\d+)(?:-|–|:|\.{2,3}|…|\s+to\s+)(?:\1)?(\d+)(.*)")  # q1-q6, q_0..5
_FIELDS = re.compile(r"\s*\{\s*(['\"]).*?\1\s*:")  # of an object in a cell
_EXCEL = re.compile(r'"?sep=(.)"?')  # first line of files for Excel


@dataclass(frozen=True)
class TextLayout:
    """Layout of a text table."""

    names: tuple[str, ...]
    separator: str | None
    decimal: str
    lines: int
    # Column -> unit, from the line after the header.
    units: Mapping[str, str] = field(default_factory=dict)
    # Cells of the first row of a file without column names; see `LogTable`.
    unnamed: tuple[str, ...] = ()
    is_keyed: bool = False  # whether cells are pairs such as `q=0.1`, perhaps after a date
    # Column -> its first nonempty cell.
    first: Mapping[str, str] = field(default_factory=dict)
    day_first: frozenset[str] = frozenset()  # columns of dates with the day before the month
    # Index of a column -> its thousands separator.
    grouped: Mapping[int, str] = field(default_factory=dict)
    note: str = ""

    @cached_property
    def kinds(self) -> dict[str, Cells | None]:
        """Column -> type of its cells, None for words; without empty columns."""
        cells = self.first.items()
        return {name: Cells.of(cell, day_first=name in self.day_first) for name, cell in cells}

    @cached_property
    def columns(self) -> list[tuple[str, int, int]]:
        """Name, index of the cell, and index in the list of each column; lists are expanded."""
        columns = list[tuple[str, int, int]]()
        for cell, name in enumerate(self.names):
            kind = self.kinds.get(name)
            items = None if kind is None or kind.count is None else range(kind.count)
            columns += [(name, cell, 0)] if items is None else []
            columns += [(f"{name}[{k}]", cell, k) for k in items or ()]
        return columns

    @property
    def words(self) -> list[str]:
        """Names of the columns of words."""
        return [name for name, kind in self.kinds.items() if kind is None]

    def cells(self, lines: Sequence[str]) -> Iterator[tuple[int, list[str]]]:
        """Yield the line number and cells of each line that is not empty, a comment or a rule."""
        if self.is_keyed:
            rows = ((k, [cell for _, cell in _keyed(line)]) for k, line in enumerate(lines, 1))
        elif self.separator is None:
            rows = ((k, line.split()) for k, line in enumerate(lines, 1))
        else:
            reader = csv.reader(lines, delimiter=self.separator)
            rows = ((reader.line_num, cells) for cells in reader)
        names, is_usual = [*self.names], self.decimal == "." and not self.grouped
        for line, cells in rows:
            first = cells[0].lstrip() if cells else "#"
            text = next(filter(None, map(str.strip, cells)), "")
            is_rule = text.startswith(_RULES) and not any(map(is_number, cells))
            if first.startswith(_COMMENTS) or is_rule or cells == names:
                continue
            trailing = len(cells) == len(names) + 1 and not cells[-1].strip()
            kept = cells[:-1] if trailing else cells  # a final separator
            if not is_usual:
                kept = [plain(c, self.decimal, self.grouped.get(k)) for k, c in enumerate(kept)]
            yield line, kept


def text_layout(path: Path, file: Iterator[str], reading: Reading) -> TextLayout:
    """Detect the layout of a table from its first lines."""
    lines = [*islice(file, _HEADER_LINES + _LINES_AHEAD)]
    begin, comment = _first_line(lines)
    lines.append("")
    above, data, mark = _rows_above(lines, begin)
    keyed_names, units = _keyed_names([cells for _, cells in above], lines[data:], mark)
    distinct = (k for k, cells in above if all(cells) and len({*cells}) == len(cells))
    begin = next(distinct, above[0][0] if above else begin)  # the first row of distinct names
    is_aligned = data > begin and len(_cells_of(lines[begin], mark)) == len(
        _cells_of(lines[data], mark)
    )
    separator = mark if is_aligned else _separator(lines[begin])
    cells, after = _header_cells(path, lines, begin, separator)
    names: Sequence[str] = () if reading.columns else _joint_state(cells)
    unnamed = tuple[str, ...]()
    first, second = (_keyed("".join(lines[k : k + 1])) for k in (begin, after))
    keyed, repeated = ([name for name, _ in each] for each in (first, second))
    if is_keyed := len(keyed) > 1 and keyed == repeated:
        names = keyed
    elif keyed_names and not reading.columns:
        names, separator, begin = keyed_names, mark, data
    elif not names and (_are_numbers(cells) or any(map(_MEASURED.fullmatch, cells))):
        given = renamed(path, reading, cells) if reading.columns else ()
        names = given or _names_in_comment(cells, comment)
        unnamed = () if names else tuple(cells)
        names = names or numbered(cells)
    elif not names:
        header = renamed(path, reading, cells) if reading.columns else cells
        check_text(path, header)
        if not any(header):
            raise no_header(path, header)
        header, begin = _whole_header(header, lines, after, separator)
        header = _told_apart(header)
        units = _units(header, lines[begin].split(separator))
        names, begin = _with_units(header, units), begin + bool(units)
        is_above = is_aligned and begin < data
        while _is_remark(_cells_of(lines[begin], separator), names, is_above=is_above):
            begin, is_above = begin + 1, is_above and begin + 1 < data
    layout = TextLayout(tuple(names), separator, ".", begin, units, unnamed, is_keyed)
    below = lines[begin : begin + _LINES_AHEAD]
    if _MAY_BE_MARKED[separator].search("".join(below)):
        with suppress(csv.Error):  # reported when the rows are read
            decimal, grouped, note = number_marks(path, [each for _, each in layout.cells(below)])
            layout = replace(layout, decimal=decimal, grouped=grouped, note=note)
    return replace(layout, first=_first_cells(layout, below))


def _keyed(line: str) -> list[tuple[str, str]]:
    """Return the pairs of names and cells in a line, after its time stamp if there is one."""
    line = _COLOUR.sub("", line)
    if (first := _KEYED.search(line)) is None:
        return []
    stamps = (_STAMP.search(line), DATE.search(line))
    stamp = next((each for each in stamps if each and each.start() <= first.start()), None)
    pairs = [("time", (stamp[1] if stamp.re is _STAMP else stamp[0]).strip())] if stamp else []
    for name, cell in _KEYED.findall(line, stamp.end() if stamp else 0):
        is_row = " " in cell and cell[0] not in "[("  # numbers separated by blanks
        pairs.append((name, f"[{cell}]" if is_row else cell))
    return pairs if len(pairs) > bool(stamp) else []


def _first_line(lines: Sequence[str]) -> tuple[int, str]:
    """Return the index of the first line of content, and the last comment before it."""
    comment = ""
    for k, line in enumerate(lines[:_HEADER_LINES]):
        plain = line.strip()
        if plain.startswith((*_COMMENTS, *_RULES)) and not plain.startswith("%time"):
            comment = plain.lstrip("#%/ \t")
        elif plain and not _EXCEL.fullmatch(plain):
            return k, comment
    return len(lines), comment


def _rows_above(
    lines: Sequence[str], begin: int
) -> tuple[list[tuple[int, list[str]]], int, str | None]:
    """Return the header rows right above the numbers, the first row of numbers, and the separator.

    Header rows have as many cells as the numbers. Two rows of numbers are needed to find them.
    """
    for is_timed, first_row in product((True, False), range(begin, begin + _PREFACE)):
        separator = _separator("".join(lines[first_row : first_row + 1]))
        pair = [_cells_of("".join(lines[k : k + 1]), separator) for k in (first_row, first_row + 1)]
        first = pair[0]
        are_rows = all(2 * sum(map(is_number, cells)) > len(cells) for cells in pair)
        are_rows &= not is_timed or all(_are_numbers(cells[:1]) for cells in pair)
        if len(first) == len(pair[1]) > 1 and are_rows:
            break
    else:
        return [], begin, None
    rows = [(k, _cells_of(lines[k], separator)) for k in range(begin, first_row)]
    rows = [(k, cells) for k, cells in rows if sum(map(bool, cells)) > 1]  # skip titles and rules
    same_width = takewhile(lambda row: len(row[1]) - len(first) in (0, 1), reversed(rows))
    above = dropwhile(lambda row: _are_numbers(row[1][:1]), reversed([*same_width]))
    return [*above], first_row, separator


def _keyed_names(
    above: Sequence[Sequence[str]], lines: Sequence[str], separator: str | None
) -> tuple[Sequence[str], dict[str, str]]:
    """Return names and units from rows that begin with a keyword, or none.

    TwinCAT and LabVIEW write rows such as `Name`, `SampleTime[ms]` and `Unit`. The first column is
    time, as are others of the same name.
    """
    keys = {cells[0] for cells in above if not _are_numbers(cells[:1])} - {""}
    counts = [len({name for name in cells if meaning_of(name) is not None}) for cells in above]
    if not len(above) == len(keys) >= _KEYED_ROWS or not any(counts):  # rows with few numbers
        return (), {}
    header = above[counts.index(max(counts))][: len(_cells_of(lines[0], separator))]
    clock = "Time" if meaning_of(header[0]) is None else header[0]
    names = _told_apart([clock if name == header[0] else name for name in header])
    units = next(filter(None, (_units(names, cells) for cells in above)), {})
    return _with_units(names, units), units


def _cells_of(line: str, separator: str | None) -> list[str]:
    """Split a single line into cells."""
    if separator is None:
        return line.split()
    with suppress(csv.Error):
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
    return []


def _whole_header(
    header: Sequence[str], lines: Sequence[str], after: int, separator: str | None
) -> tuple[Sequence[str], int]:
    """Return the header extended by the lines below it, and the index of the line after it.

    Duplicate names may continue in levels below. Rows may begin with a name or number.
    """
    below, filled = _cells_of(lines[after], separator), list[str]()
    for name in header:  # a merged cell stores its name in the first
        filled.append(name or "".join(filled[-1:]))
    names, next_line = filled, after
    while len(set(names)) < len(header) == len(below):
        if not below[-1] or any(map(is_number, below)):
            break
        names = [_of_levels(*level) for level in zip(names, below, strict=True)]
        next_line += 1
        below = _cells_of(lines[next_line], separator)
    if len(set(names)) == len(header) and next_line > after:
        header, after = names, next_line
        if below[:1] > [""] and not any(below[1:]):  # the index name in files of pandas
            header, after = [below[0], *header[1:]], after + 1
            below = _cells_of(lines[after], separator)
    counts = [filled.count(name) for name in header if name and filled.count(name) > 1]
    is_of_blanks = not all(header) and all(filled) and len(counts) > 1 == len({*counts})
    if is_of_blanks and len(header) == len(below) and all(map(is_number, below)):
        header = filled
    header = _of_several(header, len(below))
    if len(below) == len(header) + 1 and all(below) and any(map(is_number, below)):
        header = ["_row", *header]  # unnamed row index, as R and pandas write it
    return header, after


def _of_several(names: Sequence[str], count: int) -> Sequence[str]:
    """Expand names that stand for several columns, such as `q[6]` or `q1-q6`, to `count` names."""
    expanded = list[str]()
    for name in names if len(names) != count else ():
        several, span = _SEVERAL.fullmatch(name), _SPAN.fullmatch(name)
        if several and int(several[2]) <= count:
            head, number, unit = several.groups("")
            items = [f"{head}[{k}]{unit}" for k in range(int(number))]
            expanded += items if len(items) > 1 else [head + unit]
        elif span and 0 < int(span[3]) - int(span[2]) < count:
            numbers = range(int(span[2]), int(span[3]) + 1)
            expanded += [f"{span[1]}{k}{span[4]}" for k in numbers]
        else:
            expanded.append(name)
    return expanded if len(expanded) == count else names


def _told_apart(header: Sequence[str]) -> list[str]:
    """Number duplicate names as pandas does, except geodrake's own."""
    counts, unique = dict[str, int](), list[str]()
    for name in header:
        k = counts[name] = counts.get(name, -1) + 1
        unique.append(name if not k or "." in name else f"{name}.{k}")
    return unique


def _of_levels(name: str, below: str) -> str:
    """Join two header levels of a column, with the quantity last, or time with its unit."""
    is_unit = is_time(name) and find_unit(below.strip("[]()"), "time") is not None
    if is_unit:
        return f"{name} [{below.strip('[]()')}]"
    is_last = quantity_of(below) is not None and quantity_of(name) is None
    return (f"{name}.{below}" if is_last else f"{below}.{name}").strip(".")


def _joint_state(cells: Sequence[str]) -> tuple[str, ...]:
    """Return column names if the cells are a JointState from ROS's `topic echo`, or none.

    An empty cell stands for an empty list.
    """
    for head in _HEADS:
        rest = cells[len(head) :]
        count = next((k for k, cell in enumerate(rest) if not cell or is_number(cell)), 0)
        columns, at = [*head, *(f"name{k}" for k in range(count))], count
        for name in ("position", "velocity", "effort"):
            block = rest[at : at + (count if "".join(rest[at : at + 1]) else 1)]
            columns += [f"{name}{k}" for k in range(count)] if block != [""] else [f"no {name}"]
            at += len(block) if block == [""] or _are_numbers(block) else 0
        is_stamp = all(cell.isdecimal() for cell in cells[: len(head) - 1])
        if is_stamp and count and len(columns) == len(cells) == len(head) + at:
            return tuple(columns)
    return ()


def _first_cells(layout: TextLayout, lines: Sequence[str]) -> dict[str, str]:
    """Return the first nonempty cell of each column."""
    first: dict[str, str] = {}
    with suppress(csv.Error):  # reported when the rows are read
        for _, cells in layout.cells(lines):
            for name, cell in zip(layout.names, cells, strict=False):
                if name not in first and not is_nothing(cell):
                    first[name] = cell
    return first


def _is_remark(cells: Sequence[str], names: Sequence[str], *, is_above: bool) -> bool:
    """Return whether a row below the header is a title, or words above the numbers."""
    is_title = sum(map(bool, cells)) == 1 < len(names)
    return is_title or (is_above and any(cells) and not any(map(is_number, cells)))


def _units(header: Sequence[str], cells: Sequence[str]) -> dict[str, str]:
    """Return the units in the row below the header, if most of its cells are known units."""
    if len(cells) != len(header):
        return {}
    cells = [cell.strip(' \t\r\n[]()"') for cell in cells]
    units = {cell for cell in set(cells) if any(find_unit(cell, each) for each in UNITS)}
    key = None if is_number(cells[0]) else cells[0] or None  # a keyword such as Unit
    relevant = [cell for cell in cells if cell != key or cell in units]
    if 2 * sum(cell in units for cell in relevant) <= len(relevant):
        return {}
    return {n: c for n, c in zip(header, cells, strict=True) if c and (c != key or c in units)}


def _with_units(names: Sequence[str], units: Mapping[str, str]) -> list[str]:
    """Append units to names that are not recognized without them."""
    return [n if meaning_of(n) or not units.get(n) else f"{n} [{units[n]}]" for n in names]


def _separator(line: str) -> str | None:
    """Return the separator of cells in a line, in which commas may be decimal."""
    counts = {mark: line.count(mark) for mark in (",", ";", "\t", "|")}
    commonest = max(counts, key=lambda mark: counts[mark])
    for mark in ";\t":
        if counts[mark] and _are_numbers([c.replace(",", ".") for c in line.strip().split(mark)]):
            return mark
    if counts[commonest]:
        return commonest
    return _WHITESPACE if len(line.split()) > 1 else ","


def _header_cells(
    path: Path, lines: Sequence[str], begin: int, separator: str | None
) -> tuple[list[str], int]:
    """Return the cells of the header, which may contain line breaks, and the index after it."""
    if separator is None:
        return _UNIT_BEHIND.sub("", lines[begin]).split(), begin + 1
    below = lines[begin : begin + _HEADER_LINES]
    reader = csv.reader(below, strict=True, delimiter=separator)
    try:
        return [name.strip() for name in next(reader, [])], begin + reader.line_num
    except csv.Error as error:
        raise LogError(
            f"The header of log {str(path)!r} cannot be read: {error}.",
            advice=f"Is a closing quote missing? {HEADER_ADVICE}",
        ) from error


def is_number(cell: str) -> bool:
    """Return whether a cell is a number."""
    return number_in(cell.replace(",", ".")) is not None


def _are_numbers(cells: Sequence[str]) -> bool:
    return any(cells) and all(is_number(cell) or is_date(cell) for cell in cells)


def renamed(path: Path, reading: Reading, cells: Sequence[str]) -> Sequence[str]:
    """Return the column names given by the user, after checking their number."""
    names = _of_several(reading.columns, len(cells))
    if len(names) != len(cells):
        raise LogError(
            f"Log {str(path)!r} has {len(cells)} columns, but --columns names {len(names)}.",
            advice="Name every column in order; _ skips one, and q[6] is six.",
        )
    return [f"_{k}" if name == "_" else name for k, name in enumerate(names, 1)]


def _names_in_comment(cells: Sequence[str], comment: str) -> Sequence[str]:
    """Return the names in the comment above the numbers, if their number matches."""
    named = [name.strip() for name in re.split("[,;\t]", comment)]
    for each in (named, _UNIT_BEHIND.sub("", comment).split(), comment.split()):
        names = _of_several(each, len(cells))
        if len(names) == len(cells) and all(names) and not _are_numbers(names):
            return names
    return ()


_MANY = 500_000  # bytes above which importing Arrow pays
_BLOCK = 2_000_000  # bytes read at once
_HEAD, _LARGEST_OTHER = 65_536, 500_000_000  # bytes to detect an encoding; most if not UTF-8
_LONGEST = 8_000_000  # bytes of a line, enough for 400,000 numbers
_LINE_ENDS = re.compile(rb"\r\n?|\n")

Opener = Callable[[], AbstractContextManager[BinaryIO]]
"""Function that opens the bytes of a table."""


class TextTable(LogTable):
    """A table of text, read block by block."""

    def __init__(self, path: Path, layout: TextLayout, opened: Opener) -> None:
        """Store the layout of the table, and the function that opens it."""
        kinds = layout.kinds.items()
        origins = {name: kind.origin for name, kind in kinds if kind and kind.origin is not None}
        super().__init__(path, {}, layout.units, (), origins, unnamed=layout.unnamed)
        self._layout, self._opened = layout, opened

    @property
    def names(self) -> Sequence[str]:
        """Names of the columns."""
        return [name for name, _, _ in self._layout.columns]

    def has_numbers(self, name: str) -> bool:
        """Return whether a column has a value in the first rows."""
        return any(name in (each, f"{each}[0]") for each in self._layout.first)

    @property
    def first_words(self) -> dict[str, str]:
        """Column without numbers -> its first text."""
        return {name: self._layout.first[name] for name in self._layout.words}

    def read(
        self, names: Sequence[str], *, skip: bool = False
    ) -> tuple[dict[str, Array], TornRows]:
        """Return some columns (N,), read block by block; see `LogTable.read`."""
        layout, torn, row = self._layout, TornRows(self.path, skip), 0
        place_of = {name: (cell, item) for name, cell, item in reversed(layout.columns)}
        places = {name: place_of[name] for name in names}
        kinds = {k: layout.kinds.get(layout.names[k]) or Cells() for k, _ in places.values()}
        is_plain = all(kind == Cells() for kind in kinds.values())
        values_of = {name: array("d") for name in places}
        for line, block in _blocks(self.path, self._opened, layout.lines) if places else ():
            columns = [cell for cell, _ in places.values()]
            table = _by_arrow(block, layout, columns) if is_plain and len(block) > _MANY else None
            if table is None:
                rows = self._cells(_lines(block), [*places.values()], kinds, (row, line), torn)
                table = [*np.array(rows, float).reshape(-1, len(places)).T.copy()]
            for values, column in zip(values_of.values(), table, strict=True):
                values.frombytes(column.view(np.uint8).data)
            row += len(table[0])
            check_room(self.path, row * len(places), f"{row} rows of {len(places)} numbers")
        return {name: np.frombuffer(values) for name, values in values_of.items()}, torn

    def texts(self, names: Sequence[str]) -> dict[str, NDArray[np.object_]]:
        """Return the texts (N,) of some columns."""
        places = [self._layout.names.index(name) for name in names]
        blocks = _blocks(self.path, self._opened, self._layout.lines) if names else ()
        rows = (cells for _, block in blocks for _, cells in self._layout.cells(_lines(block)))
        texts = [[c[k].strip() if k < len(c) else "" for k in places] for c in rows]
        return dict(
            zip(names, np.array(texts, object).reshape(len(texts), len(names)).T, strict=True)
        )

    def _cells(
        self,
        lines: Sequence[str],
        places: Sequence[tuple[int, int]],
        kinds: Mapping[int, Cells],
        before: tuple[int, int],
        torn: TornRows,
    ) -> list[list[Any]]:
        """Parse lines cell by cell into K rows, slowly but with errors that name the cell.

        `before` contains the numbers of preceding rows and lines.
        """
        path, names = self.path, self._layout.names
        values: list[list[Any]] = []
        is_plain = all(kind == Cells() for kind in kinds.values())
        is_plain &= not any("_" in line for line in lines)  # `float` accepts 1_000
        try:
            for line, cells in self._layout.cells(lines):
                row = before[0] + len(values) + 1
                try:
                    if len(cells) != len(names):
                        raise LogError(
                            f"Row {row} of log {str(path)!r} (line {before[1] + line}) has "
                            f"{len(cells)} cells, but the header has {len(names)}.",
                            advice="Is the recording truncated? Remove or repair that line.",
                        )
                    if is_plain:
                        with suppress(ValueError):  # missing values or errors
                            values.append([float(cells[k] or "nan") for k, _ in places])
                            continue
                    parsed = dict[int, list[Any]]()
                    for k, kind in kinds.items():
                        numbers = kind.numbers(cells[k])
                        if numbers is None:
                            raise _refusal(path, row, names[k], cells[k], kind)
                        parsed[k] = numbers
                    values.append([parsed[cell][item] for cell, item in places])
                except LogError as error:
                    torn.add(row - 1, error)
                    values.append([np.nan] * len(places))
        except csv.Error as error:
            raise LogError(
                f"Row {before[0] + len(values) + 1} of log {str(path)!r} cannot be read: {error}.",
                advice="Is a closing quote missing? Remove or repair that line.",
            ) from error
        return values

    def loaded(self, *, skip: bool = False) -> LogTable:
        """Return the table with all columns read, including texts."""
        texts = self._layout.words
        columns, torn = self.read([name for name in self.names if name not in texts], skip=skip)
        words = self.texts(texts)
        rows = len(next(iter(columns.values()), ()))
        kept, notes = torn.settle(np.arange(float(rows)))
        if not kept.all():
            columns = {name: values[kept] for name, values in columns.items()}
            words = {name: cells[kept] for name, cells in words.items()}
        silent = {name: f"holds {cells[:1]}" for name, cells in words.items()}
        notes = (*self.notes, *notes)
        return LogTable(self.path, columns, self.units, notes, self.origins, silent, words)


def read_text(path: Path, reading: Reading) -> LogTable:
    """Read a text table, which may be compressed."""
    with readable(path, f"{path.suffix} file"), open_log(path) as file:
        content = file.read(_HEAD)
        for form, (what, advice) in WORDS["no_tables"].items():
            if re.match(form.encode(), content):
                raise LogError(f"Log {str(path)!r} {what}.", advice=advice)
        if encoding := _encoding(content):
            content += file.read(_LARGEST_OTHER)
            if file.read(1):
                raise LogError(
                    f"Log {str(path)!r} has more than {_LARGEST_OTHER / 1e9:g} GB of {encoding}.",
                    advice="Save it as UTF-8, or as .npz.",
                )
            check_room(path, len(content), f"{len(content) / 1e9:.3g} GB of {encoding}")
    if not encoding:
        return _text_table(path, reading, lambda: open_log(path))
    note = f"text is in {encoding}, judging by its words" if encoding in _CODECS else ""
    text = content.decode(encoding, "strict" if encoding.startswith("UTF") else "replace")
    table = _text_table(path, reading, partial(BytesIO, text.encode()))
    return table.noting(note) if note else table


_CODECS = (
    "cp1252",
    "cp1250",
    "cp1254",
    "gb18030",
    "shift_jis",
    "euc_kr",
    "big5",
    "cp1251",
    "mac_roman",
)
"""Encodings recognized by known words."""


# A single letter proves nothing, except for East Asian ones, which have three bytes in UTF-8.
_LETTERS = (word for word in re.findall(r"\w+", str(WORDS)) if not word.isascii())
_FOREIGN = re.compile(
    "|".join(sorted((w for w in _LETTERS if len(w.encode()) > 2), key=len, reverse=True)),
    re.IGNORECASE,
)
_BEGINNING = 10_000  # bytes that contain the column names


def _encoding(head: bytes) -> str:
    """Return the encoding of a text from its first bytes; "" for UTF-8.

    Among several candidates, the one with the most letters in known column words wins.
    """
    if head.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) and head[2:]:
        return "UTF-16"
    zeros = [2 * head[k:_BEGINNING:2].count(0) for k in (0, 1)]
    if len(head) > 1 and max(zeros) > 0.9 * min(len(head), _BEGINNING) and not min(zeros):
        return "UTF-16-LE" if zeros[1] else "UTF-16-BE"
    try:
        head.decode()
    except UnicodeDecodeError as error:
        texts = {each: head[:_BEGINNING].decode(each, "replace") for each in _CODECS}
        scores = {each: sum(map(len, _FOREIGN.findall(texts[each]))) for each in _CODECS}
        best = max(scores, key=lambda each: scores[each])
        if scores[best] and b"\0" not in head and error.end < len(head):
            return best
        for codec in ("Windows-1252", "mac_roman") if error.end < len(head) else ():
            letters = "°²³µ·±äöüÄÖÜßéèêàçñ".encode(codec, "ignore")
            if b"\0" not in head and not head.translate(None, bytes(range(128)) + letters):
                return codec
    return ""


def read_sheet(path: Path, reading: Reading) -> LogTable:
    """Read an Excel sheet like a text table; see `read_text`."""
    pandas = optional_package("pandas", "logs", "sheets of Excel", LogError)
    with readable(path, "sheet of Excel"), open_log(path) as file:
        size = sum(entry.file_size for entry in ZipFile(file).infolist())
        check_room(path, size // 8, f"{size / 1e9:.3g} GB unpacked")
        sheets = pandas.read_excel(file, sheet_name=None, header=None, dtype=object)
    largest = max(sheets, key=lambda name: sheets[name].size)
    name = reading.topics[0] if reading.topics else largest
    if name not in sheets:
        raise LogError(
            f"Log {str(path)!r} has no sheet {name!r}; its sheets are {listed([*sheets])}.",
            advice="Choose one with --topic; by default the largest is read.",
        )
    others = [each for each in sheets if each != name]
    note = [f"sheet {name!r} is read, not {listed(others)} (--topic)"] if others else []
    content = sheets[name].dropna(how="all").to_csv(header=False, index=False).encode()
    return _text_table(path, reading, partial(BytesIO, content)).noting(*note)


def _text_table(path: Path, reading: Reading, opened: Opener) -> LogTable:
    texts = (StringIO(block.decode("utf-8-sig"), newline="") for _, block in _blocks(path, opened))
    layout = text_layout(path, chain.from_iterable(texts), reading)
    first_dates = {name: DATE.fullmatch(cell.strip()) for name, cell in layout.first.items()}
    ambiguous = [name for name, date in first_dates.items() if date and date["mark"] in ("/", "-")]
    orders = dict[str, tuple[bool, str]]()
    with suppress(csv.Error):  # reported when the cells are read
        dates = TextTable(path, layout, opened).texts(ambiguous)
        orders = {name: order_of_days(each) for name, each in dates.items()}
    layout = replace(layout, day_first=frozenset(k for k, (first, _) in orders.items() if first))
    notes = dict.fromkeys(note for note in (layout.note, *(n for _, n in orders.values())) if note)
    table = TextTable(path, layout, opened).noting(*notes)
    names_rows = any(map(names_joints, layout.words)) or any(map(numbers_joints, layout.names))
    names_rows |= any(layout.first[name].lstrip().startswith(("[", "(")) for name in layout.words)
    is_long = names_rows and reading.mapping is None
    is_long |= any(tells(name, "signals") for name in layout.words)
    is_long |= any(tells(name, "robots", "recordings") for name in layout.names)
    fields = [name for name in layout.words if _FIELDS.match(layout.first[name])]
    fields = [name for name in fields if meaning_of(name) is not None]
    loaded = table.loaded(skip=reading.skip_bad_rows) if is_long or fields else table
    return _with_fields(loaded, fields) if fields else loaded


def _with_fields(table: LogTable, names: Sequence[str]) -> LogTable:
    """Give the fields in cells such as `{'elbow': 0.1}` their own columns, `position.elbow`."""
    columns = dict(table.columns)
    for name in names:
        with readable(table.path, f"table, as objects in {name!r} have no numbers by their names"):
            rows = [_object(cell) for cell in table.words[name]]
            for key in dict.fromkeys(key for row in rows for key in row):
                columns[f"{name}.{key}"] = np.array([row.get(key) for row in rows], float)
    silent = {name: why for name, why in table.silent.items() if name not in names}
    words = {name: cells for name, cells in table.words.items() if name not in names}
    return replace(table, columns=columns, silent=silent, words=words)


def _object(text: str) -> dict[str, Any]:
    """Return the object that a text of Python or JSON represents."""
    try:
        return dict(literal_eval(text or "{}"))
    except (SyntaxError, ValueError):  # constants of JSON, such as null
        return dict(json.loads(text))


def _blocks(path: Path, opened: Opener, skip: int = 0) -> Iterator[tuple[int, bytes]]:
    """Yield the number of preceding lines and a block of whole lines, after `skip` lines."""
    remainder, count = b"", 0
    packed = readable(path, f"{path.suffix} file") if unpacked(path) != path else nullcontext()
    with packed, opened() as file:
        for data in chain(iter(lambda: file.read(_BLOCK), b""), [b""]):
            block = remainder + data
            # A final carriage return may be the first half of a line break.
            cut = 1 + max(block.rfind(b"\n"), block.rfind(b"\r", 0, -1)) if data else len(block)
            block, remainder = block[:cut], block[cut:]
            if len(remainder) > _LONGEST:
                raise LogError(
                    f"Log {str(path)!r} has a line of more than {_LONGEST // 10**6} MB.",
                    advice=f"Is it a text table with a row in each line? {HEADER_ADVICE}",
                )
            lines = len(_LINE_ENDS.findall(block)) if b"\r" in block else block.count(b"\n")
            before, count = count, count + lines
            if before < skip and block:
                block = b"".join(block.splitlines(keepends=True)[skip - before :])
            yield max(before, skip), block


def _lines(block: bytes) -> list[str]:
    return StringIO(block.decode().replace("\ufeff", ""), newline="").readlines()


def _by_arrow(block: bytes, layout: TextLayout, columns: Sequence[int]) -> list[Array] | None:
    """Parse some columns (K,) by Arrow; return None if any cell is not a number."""
    if layout.grouped or layout.decimal == layout.separator or find_spec("pyarrow") is None:
        return None
    if not block.isascii():
        block.decode()  # raises if it is not UTF-8
    pyarrow, arrow = map(import_module, ("pyarrow", "pyarrow.csv"))
    if layout.separator is None:  # Arrow needs exactly one blank between cells
        block = block.replace(b"\t", b" ")
        while b"  " in block:
            block = block.replace(b"  ", b" ")
        block = block.strip(b" ").replace(b"\n ", b"\n").replace(b" \n", b"\n")
    names = [str(k) for k in range(len(layout.names))]
    used = [names[k] for k in columns]
    try:
        table = arrow.read_csv(
            pyarrow.BufferReader(block),
            arrow.ReadOptions(use_threads=False, block_size=len(block) + 1, column_names=names),
            arrow.ParseOptions(delimiter=layout.separator or " "),
            arrow.ConvertOptions(
                include_columns=list(dict.fromkeys(used)),
                column_types=dict.fromkeys(used, pyarrow.float64()),
                null_values=sorted(NOTHING.difference(_RULES)),  # rules are not missing values
                decimal_point=layout.decimal,
            ),
        )
    except pyarrow.ArrowInvalid:
        return None
    return [_numbers(table[name]) for name in used]


def _numbers(column: Any) -> Array:
    """Return an Arrow column of numbers; its own `to_numpy` would import pandas for 0.3 s."""
    parts = [np.empty(0)]
    for chunk in column.chunks:
        valid, data = chunk.buffers()
        used = slice(chunk.offset, chunk.offset + len(chunk))
        parts.append(np.frombuffer(data, float)[used])
        if valid is not None:
            known = np.unpackbits(np.frombuffer(valid, np.uint8), bitorder="little")[used]
            parts[-1] = np.where(known, parts[-1], np.nan)
    return np.concatenate(parts)


def _refusal(path: Path, row: int, column: str, text: str, kind: Cells) -> LogError:
    """Return the error for a cell that does not match the type of its column."""
    what = "not a number"
    advice = "Leave a cell empty or write nan where nothing was measured."
    if may_be_grouped(text):
        advice = f"{MARKS_ADVICE} The lines above do not show what its mark means."
    elif (unit := _NUMBER_OF.fullmatch(text.strip())) is not None:
        name = f"{column} [{unit[1]}]"
        advice = f"Write numbers without units, and the unit in the column name: {name}."
    elif is_time(column):
        advice += " A column of dates must have them from its first row on."
    if kind.count is not None:
        what = f"not a list of {kind.count} numbers, as above it"
        advice = "Write lists of equal length in a column, or leave the cell empty."
    elif kind.origin is not None:
        what = "not a date, as above it"
        advice = "Write dates as 2026-05-01T12:00:00.25Z, or leave the cell empty."
    return LogError(
        f"Row {row}, column {column!r} of log {str(path)!r} has {text.strip()[:60]!r}, which "
        f"is {what}.",
        advice=advice,
    )
