"""Columns of numbers from arrays of any type: nested, nullable, dated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sized
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SECOND = np.timedelta64(1, "s")
_MOST_NAMES = 8


def numeric_columns(
    arrays: Mapping[str, Any], rows: int
) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Columns of numbers, those of wider arrays as `name[0]`, `name[1]` and so on.

    Args:
        arrays: Name -> (N,) or (N, n) values, in whatever can be made an array. Dates and times
            become seconds: dates from the first row on.
        rows: N; arrays of another length are left out.

    Returns:
        The columns, and notes of what was left out.
    """
    columns: dict[str, Array] = {}
    silent = []
    for name, values in arrays.items():
        found = numbers(values)
        if found is None or found.ndim not in (1, 2) or len(found) != rows:
            silent.append(name)
        else:
            columns.update(spread(name, found))
    if not silent:
        return columns, ()
    more = " …" if len(silent) > _MOST_NAMES else ""
    return columns, (f"columns without numbers: {', '.join(silent[:_MOST_NAMES])}{more}",)


def spread(name: str, values: Array) -> Iterator[tuple[str, Array]]:
    """The columns of an array.

    Args:
        name: Its name.
        values: (N,) or (N, n).
    """
    if values.ndim == 1:
        yield name, values
    elif values.shape[1] == 1:
        yield name, values[:, 0]
    else:
        yield from ((f"{name}[{k}]", column) for k, column in enumerate(values.T))


def numbers(values: Any) -> Array | None:
    """An array of floats, NaN where nothing is; None for what has no numbers."""
    try:
        array = np.asarray(values)
        if array.dtype.kind in "mM":
            return _seconds(array)
        if array.dtype.kind == "O":
            return _of_objects(array)
    except (TypeError, ValueError):  # texts, and rows of different lengths
        return None
    return np.asarray(array, float) if array.dtype.kind in "fiub" else None


def _seconds(array: NDArray[Any]) -> Array:
    """Durations, or dates from the first one on, in seconds."""
    if array.dtype.kind == "M":
        known = array[~np.isnat(array)]
        array = array - (known[0] if len(known) else array[:1])
    return np.asarray(array / _SECOND)


def _of_objects(array: NDArray[Any]) -> Array | None:
    """Numbers of lists, or of objects that are numbers or nothing."""
    if not array.size:
        return None
    if isinstance(array.flat[0], Sized) and not isinstance(array.flat[0], str):
        return np.stack([np.asarray(row, float) for row in array])
    return np.array([_number(value) for value in array.flat]).reshape(array.shape)


def _number(value: Any) -> float:
    """A number, NaN for None and other words for nothing."""
    try:
        return float(value)
    except TypeError:
        return np.nan
