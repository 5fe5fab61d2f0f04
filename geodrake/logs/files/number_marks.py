"""Detect decimal and thousands separators in text tables, as in `1.234,5`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path

from geodrake.errors import LogError

_BLANKS = "'’ \u00a0\u202f"  # thousands separators only
_NUMBER = re.compile(rf"[+-]?[\d.,{_BLANKS}]*\d[.,]?([eE][+-]?\d+)?")
_MARKS, _DIGITS = re.compile(f"[.,{_BLANKS}]"), 3
_GROUPED = {
    mark: re.compile(
        rf"[+-]?[1-9]\d{{0,2}}({re.escape(mark)}\d{{3}})+([{''.join({*'.,'} - {mark})}]\d*)?"
        r"([eE][+-]?\d+)?"
    )
    for mark in f".,{_BLANKS}"
}
"""Separator -> pattern of numbers with it between thousands."""

ADVICE = "Write numbers without thousands separators."
GROUPS, MAYBE, DECIMAL = range(3)


def number_marks(path: Path, rows: Sequence[Sequence[str]]) -> tuple[str, dict[int, str], str]:
    """Return the decimal mark, column index -> thousands separator, and a note.

    A mark separates thousands if all cells with it allow that, and either a cell contains it twice
    or before decimals, or numbers without it end at three digits, where those with it begin.
    Ambiguous columns follow the others.
    """
    marks = [*_marks_of(rows)]
    marks_of = {kind: {mark for _, mark, own, _ in marks if own == kind} for kind in range(3)}
    grouped = {k: mark for k, mark, kind, _ in marks if kind == GROUPS}
    for k, mark, kind, cell in marks:
        if kind != MAYBE or (mark in marks_of[DECIMAL] and mark not in marks_of[GROUPS]):
            continue
        other = "," if mark == "." else "."
        is_clear = mark in marks_of[GROUPS] or other in marks_of[DECIMAL]
        if is_clear and mark not in marks_of[DECIMAL]:
            grouped[k] = mark
        elif is_clear or (other in marks_of[MAYBE] and other not in marks_of[GROUPS]):
            examples = (c for _, each, own, c in marks if each == other or own == DECIMAL)
            raise LogError(
                f"Log {str(path)!r} has numbers such as {cell!r} and {next(examples)!r}, whose "
                "decimal and thousands separators are ambiguous.",
                advice=ADVICE,
            )
    is_comma = any(mark == "," and grouped.get(k) != mark for k, mark, _, _ in marks)
    decimal, note = "," if is_comma else ".", ""
    if grouped:
        cell, mark = next((c, m) for k, m, _, c in marks if grouped.get(k) == m)
        number = plain(cell, decimal, mark)
        note = f"{mark!r} is a thousands separator in numbers such as {cell!r}: read as {number}"
    return decimal, grouped, note


def _marks_of(rows: Sequence[Sequence[str]]) -> Iterator[tuple[int, str, int, str]]:
    """Yield (column index, separator, meaning, example)."""
    for k, column in enumerate(zip_longest(*rows, fillvalue="")):
        cells = [cell for each in column if _NUMBER.fullmatch(cell := each.strip())]
        for mark, grouped in _GROUPED.items():
            marked = [cell for cell in cells if mark in cell]
            if not marked or not all(map(grouped.fullmatch, marked)):
                yield from [(k, mark, DECIMAL, marked[0])] if marked and mark in ".," else ()
                continue
            clear = [cell for cell in marked if len(_MARKS.findall(cell)) > 1 or mark in _BLANKS]
            digits = {len(re.sub("[.,].*|[+-]", "", cell)) for cell in cells if mark not in cell}
            heads = {len(cell.lstrip("+-").partition(mark)[0]) for cell in marked}
            is_clear = clear or (max(digits, default=0) == _DIGITS and min(heads) == 1)
            yield k, mark, GROUPS if is_clear else MAYBE, (clear or marked)[0]


def may_be_grouped(cell: str) -> bool:
    """Return whether a cell may be a number with thousands separators."""
    return any(grouped.fullmatch(cell.strip()) for grouped in _GROUPED.values())


def plain(cell: str, decimal: str, mark: str | None) -> str:
    """Convert a number to Python's notation; leave other cells unchanged."""
    if mark is not None and _GROUPED[mark].fullmatch(cell.strip()):
        cell = cell.replace(mark, "")
    is_list = cell.lstrip().startswith(("[", "(", "{"))
    return cell.replace(",", ".") if decimal == "," and not is_list else cell
