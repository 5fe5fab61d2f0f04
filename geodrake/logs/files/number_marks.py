"""Marks of decimals and of thousands in numbers of a table of text, as in `1.234,5`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path

from geodrake.errors import LogError

_BLANKS = "'’ \u00a0\u202f"  # that stand between thousands, and nowhere else in a number
_NUMBER = re.compile(rf"[+-]?[\d.,{_BLANKS}]*\d[.,]?([eE][+-]?\d+)?")
_MARKS, _DIGITS = re.compile(f"[.,{_BLANKS}]"), 3
_GROUPED = {
    mark: re.compile(
        rf"[+-]?[1-9]\d{{0,2}}({re.escape(mark)}\d{{3}})+([{''.join({*'.,'} - {mark})}]\d*)?"
        r"([eE][+-]?\d+)?"
    )
    for mark in f".,{_BLANKS}"
}
"""Mark -> numbers that have it between thousands."""

ADVICE = "Write numbers without thousands separators."
GROUPS, MAYBE, DECIMAL = range(3)


def number_marks(path: Path, rows: Sequence[Sequence[str]]) -> tuple[str, dict[int, str], str]:
    """Return the mark of decimals, of columns by their place that between thousands, and a note.

    In a column it is of thousands where every cell that has it may be so written, and one has it
    twice or with decimals behind it, or numbers without it end below a thousand where those with it
    begin. Columns that do not say it go by others.
    """
    told = [*_marks_of(rows)]
    sure = {kind: {mark for _, mark, own, _ in told if own == kind} for kind in range(3)}
    grouped = {k: mark for k, mark, kind, _ in told if kind == GROUPS}
    for k, mark, kind, cell in told:
        if kind != MAYBE or (mark in sure[DECIMAL] and mark not in sure[GROUPS]):
            continue
        other = "," if mark == "." else "."
        is_clear = mark in sure[GROUPS] or other in sure[DECIMAL]
        if is_clear and mark not in sure[DECIMAL]:
            grouped[k] = mark
        elif is_clear or (other in sure[MAYBE] and other not in sure[GROUPS]):
            known = (c for _, each, own, c in told if each == other or own == DECIMAL)
            raise LogError(
                f"Log {str(path)!r} has numbers such as {cell!r} and {next(known)!r}, whose "
                "decimal and thousands separators are ambiguous.",
                advice=ADVICE,
            )
    is_comma = any(mark == "," and grouped.get(k) != mark for k, mark, _, _ in told)
    decimal, note = "," if is_comma else ".", ""
    if grouped:
        cell, mark = next((c, m) for k, m, _, c in told if grouped.get(k) == m)
        number = plain(cell, decimal, mark)
        note = f"{mark!r} is a thousands separator in numbers such as {cell!r}: read as {number}"
    return decimal, grouped, note


def _marks_of(rows: Sequence[Sequence[str]]) -> Iterator[tuple[int, str, int, str]]:
    """Yield columns, separators in their numbers, their meaning, and an example."""
    for k, column in enumerate(zip_longest(*rows, fillvalue="")):
        cells = [cell for each in column if _NUMBER.fullmatch(cell := each.strip())]
        for mark, grouped in _GROUPED.items():
            having = [cell for cell in cells if mark in cell]
            if not having or not all(map(grouped.fullmatch, having)):
                yield from [(k, mark, DECIMAL, having[0])] if having and mark in ".," else ()
                continue
            clear = [cell for cell in having if len(_MARKS.findall(cell)) > 1 or mark in _BLANKS]
            digits = {len(re.sub("[.,].*|[+-]", "", cell)) for cell in cells if mark not in cell}
            heads = {len(cell.lstrip("+-").partition(mark)[0]) for cell in having}
            is_clear = clear or (max(digits, default=0) == _DIGITS and min(heads) == 1)
            yield k, mark, GROUPS if is_clear else MAYBE, (clear or having)[0]


def may_be_grouped(cell: str) -> bool:
    """Return whether a cell may be a number with marks between thousands."""
    return any(grouped.fullmatch(cell.strip()) for grouped in _GROUPED.values())


def plain(cell: str, decimal: str, mark: str | None) -> str:
    """Return a number in Python's notation; other cells, such as dates, are unchanged."""
    if mark is not None and _GROUPED[mark].fullmatch(cell.strip()):
        cell = cell.replace(mark, "")
    is_list = cell.lstrip().startswith(("[", "(", "{"))
    return cell.replace(",", ".") if decimal == "," and not is_list else cell
