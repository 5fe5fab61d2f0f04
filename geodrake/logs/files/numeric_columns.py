"""Columns of numbers from arrays of any type: nested, nullable, dated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sized
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.logs.files.dates import NO_DATE, date_of, dates, since_first
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
    origins, silent, words = {}, {}, {}
    for name, values in arrays.items():
        found, origin = numbers(values)
        if found is None or found.ndim not in (1, 2) or len(found) != rows:
            silent[name] = _what_else(values, rows)
            if rows and np.shape(values) == (rows,) and isinstance(values[0], str):
                words[name] = np.array([str(value) for value in values], object)
            continue
        columns.update(spread(name, found))
        if origin is not None:
            origins[name] = origin
    more = " …" if len(silent) > _MOST_NAMES else ""
    note = f"columns without numbers: {', '.join([*silent][:_MOST_NAMES])}{more}"
    notes = (note,) if silent else ()
    return LogTable(path, columns, notes=notes, origins=origins, silent=silent, words=words)


def _what_else(values: Any, rows: int) -> str:
    """Return what is in an array that has no numbers, in words."""
    if np.ndim(values) == 0:
        return f"is {str(values)[:_LONGEST_TEXT]!r} alone"
    if len(values) != rows:
        return f"has {len(values)} rows, and others have {rows}"
    bad = next((value for value in values if isinstance(value, str) and not _is_number(value)), "")
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
        array = np.asarray(values)
        if array.dtype.kind == "M":
            return dates(array)
        if array.dtype.kind == "m":
            return np.asarray(array / _SECOND), None
        if array.dtype.kind in "OUT":
            return _of_objects(array.astype(object))
    except (TypeError, ValueError, ArithmeticError):  # texts, rows of different lengths, 10**400
        return None, None
    return (np.asarray(array, float) if array.dtype.kind in "fiub" else None), None


def _of_objects(array: NDArray[Any]) -> tuple[Array | None, int | None]:
    """Numbers of lists, or of objects that are numbers, dates or nothing."""
    first = next((value for value in array.flat if not _is_nothing(value)), None)
    if not array.size:
        return None, None
    if isinstance(first, Sized) and not isinstance(first, str):
        return np.stack([np.asarray(row, float) for row in array]), None
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
