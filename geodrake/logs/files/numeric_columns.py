"""Columns of numbers from arrays of any type: nested, nullable, dated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sized
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.logs.files.dates import NO_DATE, date_of, dates, since_first
from geodrake.logs.files.recognition import is_time, names_joints
from geodrake.logs.files.table import LogTable

Array = NDArray[np.float64]

_SECOND = np.timedelta64(1, "s")
_MOST_NAMES = 8
_LONGEST_TEXT = 60
_NOTHING = ("", "NaT", "nan", "None", "null", "<NA>")


def numeric_table(path: Path, arrays: Mapping[str, Any], rows: int) -> LogTable:
    """Return a table of numbers, wider arrays as columns `name[0]`, `name[1]` and so on.

    Args:
        arrays: Name -> (N,) or (N, n) values, in whatever can be made an array. Dates and times
            become seconds: dates from the first row on.
        rows: N; arrays of another length are left out.

    Returns:
        The table, with a note of what was left out.
    """
    columns: dict[str, Array] = {}
    origins, silent, words = {}, {}, dict[str, NDArray[np.object_]]()
    for name, given in arrays.items():
        values = _array(given) if isinstance(given, list) else given
        found, origin = numbers(values)
        if found is None or found.ndim not in (1, 2) or len(found) != rows:
            silent[name] = _what_else(values, rows)
            words |= _texts(name, values, rows)
            continue
        columns.update(spread(name, found))
        if origin is not None:
            origins[name] = origin
    more = " …" if len(silent) > _MOST_NAMES else ""
    note = f"columns without numbers: {', '.join([*silent][:_MOST_NAMES])}{more}"
    notes = (note,) if silent else ()
    return LogTable(path, columns, notes=notes, origins=origins, silent=silent, words=words)


def _texts(name: str, values: Any, rows: int) -> dict[str, NDArray[np.object_]]:
    """Return the texts of an array, as (N,) for each column `name`, or `name[k]` of lists.

    A list of names of joints alone is that of each row.
    """
    cells = [] if np.ndim(values) == 0 else [_text(value) for value in values]
    is_flat = all(isinstance(cell, str) for cell in cells)
    if is_flat and len(cells) == rows:
        return {name: np.array(cells, object)} if rows else {}
    if is_flat and names_joints(name) and rows:
        return {f"{name}[{k}]": np.full(rows, cell, object) for k, cell in enumerate(cells)}
    if len(cells) != rows or is_flat or len({cell and len(cell) for cell in cells}) > 1:
        return {}
    lists = zip(*(cell or () for cell in cells), strict=True)
    return {f"{name}[{k}]": np.array(each, object) for k, each in enumerate(lists)}


def _text(value: Any) -> str | list[str] | None:
    """Return a text, or the texts of a list; None of others."""
    if isinstance(value, bytes | str):
        return value.decode(errors="replace") if isinstance(value, bytes) else str(value)
    if not isinstance(value, Sized):
        return None
    items = [_text(each) for each in value]  # type: ignore[attr-defined]
    return items if all(isinstance(item, str) for item in items) else None  # type: ignore[return-value]


def rows_of(arrays: Mapping[str, Any]) -> int:
    """Return how many rows a log of some arrays has: those of its time, or of most arrays."""
    times = [len(values) for name, values in arrays.items() if is_time(name)]
    lengths = times or [len(values) for values in arrays.values()]
    return max(set(lengths), key=lambda length: (lengths.count(length), length), default=0)


def _what_else(values: Any, rows: int) -> str:
    """Return what is in an array that has no numbers, in words."""
    if np.ndim(values) == 0:
        return f"is {str(values)[:_LONGEST_TEXT]!r} alone"
    if len(values) != rows:
        return f"has {len(values)} rows, and others have {rows}"
    bad = next((value for value in values if isinstance(value, str) and not _is_number(value)), "")
    lists = {
        k: len(value)
        for k, value in enumerate(values, 1)
        if isinstance(value, Sized) and not isinstance(value, str) and len(value)
    }
    first = next(iter(lists.values()), 0)
    row = next((k for k, length in lists.items() if length != first), None)
    if row is not None:
        return f"has lists of {first} numbers, and one of {lists[row]} in row {row}"
    if bad:
        return f"holds {bad[:_LONGEST_TEXT]!r}, which is neither a number nor a date"
    return "holds no numbers"


def spread(name: str, values: Array) -> Iterator[tuple[str, Array]]:
    """The columns of an array.

    Args:
        values: (N,) or (N, n).
    """
    if values.ndim == 1:
        yield name, values
    elif values.shape[1] == 1:
        yield name, values[:, 0]
    else:
        yield from ((f"{name}[{k}]", column) for k, column in enumerate(values.T))


def numbers(values: Any) -> tuple[Array | None, int | None]:
    """Return an array of floats, NaN where nothing is; None for what has no numbers.

    Of dates, the seconds from the first on, and the first, ns since 1970.
    """
    if isinstance(values, np.ma.MaskedArray):
        missing, values = np.ma.getmaskarray(values), np.array(values.data, object)
        values[missing] = None
    try:
        array = _array(values)
        if array.dtype.kind == "M":
            return dates(array)
        if array.dtype.kind == "m":
            return np.asarray(array / _SECOND), None
        if array.dtype.kind in "OUT":
            return _of_objects(array.astype(object))
    except (TypeError, ValueError, ArithmeticError):  # texts, rows of different lengths, 10**400
        return None, None
    return (np.asarray(array, float) if array.dtype.kind in "fiub" else None), None


def _array(values: Any) -> NDArray[Any]:
    """Return an array; of lists of several lengths, or of lists and nothing, one of objects."""
    try:
        return np.asarray(values)
    except ValueError:
        array = np.empty(len(values), object)
        array[:] = values
        return array


def _of_objects(array: NDArray[Any]) -> tuple[Array | None, int | None]:
    """Numbers of lists, or of objects that are numbers, dates or nothing."""
    first = next((value for value in array.flat if not _is_nothing(value)), None)
    if not array.size:
        return None, None
    if isinstance(first, Sized) and not isinstance(first, str):
        empty = np.full(len(first), np.nan)
        rows = [empty if _is_nothing(row) or not len(row) else row for row in array]
        return np.stack([np.asarray(row, float) for row in rows]), None
    if array.ndim == 1 and _date(first) is not None:
        stamps = [NO_DATE if _is_nothing(value) else _date(value) for value in array]
        return (None, None) if None in stamps else since_first(np.array(stamps, np.int64))
    return np.array([_number(value) for value in array.flat]).reshape(array.shape), None


def _is_nothing(value: Any) -> bool:
    if isinstance(value, Sized) and not isinstance(value, str):
        return False
    return str(value) in _NOTHING


def _date(value: Any) -> int | None:
    """Nanoseconds since 1970 of a date, as an object or a text."""
    text = value.isoformat() if isinstance(value, datetime) else value
    return date_of(text) if isinstance(text, str) else None


def _number(value: Any) -> float:
    """Return a number, NaN for None and other words for nothing."""
    if _is_nothing(value):
        return np.nan
    if isinstance(value, str) and "_" in value:  # which Python takes in its own numbers
        raise ValueError(value)
    return float(value)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text in _NOTHING
    return True
