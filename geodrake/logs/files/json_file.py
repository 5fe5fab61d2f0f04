"""Logs in JSON: an object of arrays, an array of records, or a record a line."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from geodrake.boundary.input_files import open_text
from geodrake.errors import LogError
from geodrake.logs.files.damage import readable
from geodrake.logs.files.numeric_columns import numeric_table, rows_of
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.room import check_room
from geodrake.logs.files.table import LogTable

_LINES = (".jsonl", ".ndjson")
_ADVICE = 'Write {"time": [...], "joint.position": [...], ...}, or a record of these in each line.'


def read_json(path: Path, reading: Reading) -> LogTable:
    """Return the columns of a JSON file: fields of records by their paths, as in `state.q[0]`."""
    with readable(path, "JSON file", _ADVICE), open_text(path, "log", LogError) as file:
        if path.suffix.lower() in _LINES:
            content: Any = [json.loads(line) for line in file if line.strip()]
        else:
            content = json.load(file)
    if isinstance(content, Mapping):
        found = {name: values for name, values in _arrays(content) if len(values) > 1}
        return numeric_table(path, found, rows_of(found))
    if not isinstance(content, list) or not all(isinstance(row, Mapping) for row in content):
        raise LogError(f"Log {str(path)!r} is neither an object nor records.", advice=_ADVICE)
    columns = dict[str, list[Any]]()
    for k, record in enumerate(content):
        for name, value in _fields(record):
            columns.setdefault(name, [None] * k).append(value)
            check_room(path, len(content) * len(columns), f"{len(columns)} fields")
        for values in columns.values():
            values.extend([None] * (k + 1 - len(values)))
    arrays = {name: np.array(values, object) for name, values in columns.items()}
    return numeric_table(path, arrays, len(content))


def _arrays(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, list[Any]]]:
    """Yield the arrays of an object, and of those in it, by their paths."""
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from _arrays(value, f"{prefix}{name}.")
        elif isinstance(value, list):
            yield f"{prefix}{name}", value


def _fields(record: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the numbers and words of a record by their paths."""
    for name, value in record.items():
        if isinstance(value, Mapping):
            yield from _fields(value, f"{prefix}{name}.")
        elif isinstance(value, list):
            inner = {f"{name}[{k}]": each for k, each in enumerate(value)}
            yield from _fields(inner, prefix)
        else:
            yield f"{prefix}{name}", value
