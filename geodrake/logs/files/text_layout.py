"""How a text table is laid out: comments, header, separator, decimal point."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path

from geodrake.errors import LogError
from geodrake.logs.files.column_names import HEADER_ADVICE, check_text
from geodrake.logs.files.dates import date_of
from geodrake.logs.files.mapping_file import proposed_mapping, with_proposal
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.units import UNITS, find_unit

COMMENTS = ("#", "%", "//")
_HEADER_LINES = 1000  # of a header whose names have line ends
_LINES_AHEAD = 1000  # in which dates, lists and words are looked for
_WHITESPACE = None
_LIST = re.compile(r"[\[(]([^\[\]()]*)[\])]")
_BETWEEN = re.compile(r"\s*[,;]\s*|\s+")


@dataclass(frozen=True)
class TextLayout:
    """How a table is laid out.

    Attributes:
        separator: What is between cells; None for any white space.
        decimal: The decimal point, or comma.
        lines: Lines that come before the rows.
        units: Units of columns, where the line after the header has them.
        origins: Columns of dates -> the first, ns since 1970.
        lists: Columns whose cells are lists of numbers -> how many each has.
        texts: Columns whose cells are words.
    """

    names: tuple[str, ...]
    separator: str | None
    decimal: str
    lines: int
    units: Mapping[str, str] = field(default_factory=dict)
    origins: Mapping[str, int] = field(default_factory=dict)
    lists: Mapping[str, int] = field(default_factory=dict)
    texts: tuple[str, ...] = ()

    @property
    def places(self) -> dict[str, tuple[int, int | None]]:
        """Name of each column -> its cell in a row, and the place in the list in that."""
        found = dict[str, tuple[int, int | None]]()
        for cell, name in enumerate(self.names):
            if name in self.lists:
                found |= {f"{name}[{k}]": (cell, k) for k in range(self.lists[name])}
            else:
                found.setdefault(name, (cell, None))
        return found

    @property
    def columns(self) -> list[str]:
        """Names of the columns, those of a list one by one."""
        return [
            each
            for name in self.names
            for each in (
                [f"{name}[{k}]" for k in range(self.lists[name])] if name in self.lists else [name]
            )
        ]

    def cells(self, lines: Sequence[str]) -> Iterator[tuple[int, list[str]]]:
        """Cells of every line that has some and is no comment, with the number of its line.

        Raises:
            csv.Error: A quote never closes.
        """
        if self.separator is None:
            rows = ((k, line.split()) for k, line in enumerate(lines, 1))
        else:
            reader = csv.reader(lines, delimiter=self.separator)
            rows = ((reader.line_num, cells) for cells in reader)
        for line, cells in rows:
            if not cells or cells[0].lstrip().startswith(COMMENTS):
                continue
            trailing = len(cells) == len(self.names) + 1 and not cells[-1].strip()
            kept = cells[:-1] if trailing else cells  # a separator behind the last cell
            yield line, [_pointed(c) for c in kept] if self.decimal == "," else kept


def text_layout(
    path: Path,
    file: Iterator[str],
    reading: Reading,
    joints: Sequence[str] | None,
    *,
    numbered: bool = False,
) -> tuple[TextLayout, Iterator[str]]:
    """The layout of a table, and its lines from the first row on.

    Args:
        numbered: Whether columns without names may be called by their numbers.

    Raises:
        LogError: It has no header and nobody named its columns, or the header cannot be read.
    """
    comment, first, count = "", "", 0
    for first in islice(file, _HEADER_LINES):
        plain = first.strip()
        if plain.startswith(COMMENTS) and not plain.startswith("%time"):
            comment = plain.lstrip("#%/ \t")
        elif plain:
            break
        count += 1
    else:
        first = ""
    separator = _separator(first)
    cells, used, rest = _header_cells(path, first, file, separator)
    if not _are_numbers(cells):
        header = _renamed(path, reading, cells) if reading.columns else cells
        _check_names(path, header)
        following = next(rest, "")
        units = _units(header, following, separator)
        if units:
            following, used = next(rest, ""), used + 1
        decimal = _decimal(separator, following)
        layout = TextLayout(tuple(header), separator, decimal, count + used, units)
        return _with_contents(layout, chain([following], rest))
    decimal = _decimal(separator, first)
    names = _renamed(path, reading, cells) if reading.columns else None
    names = names or _names_in_comment(cells, comment)
    if names is None and not (numbered or reading.mapping):
        proposal = proposed_mapping(path, cells, joints, headed=False, motorless=reading.motorless)
        raise with_proposal(_no_header(path, cells), path, proposal)
    names = names or [str(k) for k in range(1, len(cells) + 1)]
    return _with_contents(TextLayout(tuple(names), separator, decimal, count), chain([first], rest))


def _decimal(separator: str | None, line: str) -> str:
    """Return the decimal mark of a line: commas within lists are none."""
    return "," if separator == ";" and "," in _LIST.sub("", line) else "."


def _pointed(cell: str) -> str:
    """Return a cell with a point for a decimal comma; lists as they are."""
    return cell if cell.lstrip().startswith(("[", "(")) else cell.replace(",", ".")


def list_of(cell: str) -> list[float] | None:
    """The numbers of a cell such as `[0.1, 0.2]` or `(0.1 0.2)`; None if it is no list of some."""
    found = _LIST.fullmatch(cell.strip())
    try:
        return [float(number) for number in _BETWEEN.split(found[1].strip())] if found else None
    except ValueError:
        return None


def _with_contents(layout: TextLayout, lines: Iterator[str]) -> tuple[TextLayout, Iterator[str]]:
    """The layout with columns of dates, lists and words, by the first cell that is not empty."""
    ahead = list(islice(lines, _LINES_AHEAD))
    first: dict[str, str] = {}
    with suppress(csv.Error):  # said when the rows are read
        for _, cells in layout.cells(ahead):
            for name, cell in zip(layout.names, cells, strict=False):
                if cell.strip() not in ("", "[]", "()"):
                    first.setdefault(name, cell)
    dates = {name: date_of(cell) for name, cell in first.items()}
    origins = {name: date for name, date in dates.items() if date is not None}
    found = {name: list_of(cell) for name, cell in first.items()}
    lists = {name: len(numbers) for name, numbers in found.items() if numbers is not None}
    texts = tuple(n for n, c in first.items() if n not in {*origins, *lists} and not is_number(c))
    whole = replace(layout, origins=origins, lists=lists, texts=texts)
    return whole, chain(ahead, lines)


def _units(header: Sequence[str], line: str, separator: str | None) -> dict[str, str]:
    """Units in a line below the header: as many as names, most of them known ones."""
    cells = [cell.strip(' \t\r\n[]()"') for cell in line.split(separator)]
    if len(cells) != len(header):
        return {}
    known = {cell for cell in set(cells) if any(find_unit(cell, each) for each in UNITS)}
    if 2 * sum(cell in known for cell in cells) <= len(cells):
        return {}
    return dict(zip(header, cells, strict=True))


def _separator(line: str) -> str | None:
    """What is between the cells of a line; commas may be decimal ones."""
    counts = {mark: line.count(mark) for mark in (",", ";", "\t", "|")}
    most = max(counts, key=lambda mark: counts[mark])
    if counts[";"] and _are_numbers([c.replace(",", ".") for c in line.strip().split(";")]):
        return ";"
    if counts[most]:
        return most
    return _WHITESPACE if len(line.split()) > 1 else ","


def _header_cells(
    path: Path, first: str, file: Iterator[str], separator: str | None
) -> tuple[list[str], int, Iterator[str]]:
    """Cells of the first line, how many lines they fill, and the lines after it."""
    if separator is None:
        return first.split(), 1, file
    reader = csv.reader(
        chain([first], islice(file, _HEADER_LINES)), strict=True, delimiter=separator
    )
    try:
        cells = [name.strip() for name in next(reader, [])]
    except csv.Error as error:
        raise LogError(
            f"The header of log {str(path)!r} cannot be read: {error}.",
            advice=f"Is there a quote that never closes? {HEADER_ADVICE}",
        ) from error
    return cells, reader.line_num, file


def is_number(cell: str) -> bool:
    """Whether a cell is a number."""
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _are_numbers(cells: Sequence[str]) -> bool:
    return any(cells) and all(is_number(cell) or date_of(cell) is not None for cell in cells)


def _check_names(path: Path, names: Sequence[str]) -> None:
    check_text(path, names)
    if not any(names):
        raise _no_header(path, names)


def _no_header(path: Path, cells: Sequence[str]) -> LogError:
    return LogError(
        f"Log {str(path)!r} has no header: its first line is {','.join(cells)[:60]!r}.",
        advice=f"{HEADER_ADVICE} Or name its columns by --columns, or by --mapping.",
    )


def _renamed(path: Path, reading: Reading, cells: Sequence[str]) -> Sequence[str]:
    """The names that the user gave, as many as there are columns."""
    if len(reading.columns) != len(cells):
        raise LogError(
            f"Log {str(path)!r} has {len(cells)} columns, and {len(reading.columns)} are named.",
            advice="Name every column, in order; _ for those that are not used.",
        )
    return [f"_{k}" if name == "_" else name for k, name in enumerate(reading.columns, 1)]


def _names_in_comment(cells: Sequence[str], comment: str) -> Sequence[str] | None:
    """Names in the comment before a first line of numbers, if they are as many."""
    named = [name.strip() for name in comment.replace(";", ",").replace("\t", ",").split(",")]
    for names in (named, comment.split()):
        if len(names) == len(cells) and all(names) and not _are_numbers(names):
            return names
    return None
