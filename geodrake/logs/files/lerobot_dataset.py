"""Logs in LeRobot datasets, of versions 2 and 3: episodes in Parquet files, described by JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from geodrake.boundary.input_files import read_regular, regular_files
from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import LogError
from geodrake.logs.files.array_files import arrow_table
from geodrake.logs.files.grouped_arrays import one_after_another
from geodrake.logs.files.name_rules import PREVIOUS, meaning_of, quantity_of
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import LogTable, readable

INFO = "meta/info.json"
"""Files that identify a folder as a dataset."""

_LARGEST_INFO = 100_000_000  # bytes
_ACTION = "action"  # what a policy or a person told the joints


def read_lerobot(path: Path, reading: Reading) -> LogTable:
    """Return the columns of a LeRobot dataset; see `read_bag` for arguments.

    Without a chosen episode all are read, one after the other, with a gap between two.
    """
    parquet = optional_package("pyarrow.parquet", "logs", "LeRobot datasets", LogError)
    with readable(path, "LeRobot dataset"):
        told = read_regular(path / INFO, "description", LogError, largest=_LARGEST_INFO)
        features = json.loads(told)["features"]
        meaning = dict(_meaning(features))
        wanted = ["timestamp", "episode_index", *dict.fromkeys(f for f, _ in meaning)]
        episode = reading.episode
        only = None if episode is None else [("episode_index", "==", episode)]
        files = [*map(str, regular_files(path.glob("data/**/*.parquet"), "log", LogError))]
        found = parquet.read_table(files, columns=wanted, filters=only)
        columns = {**arrow_table(path, found).columns}
    if not len(found):
        of, advice = ("", "") if only is None else (f" of episode {episode}", "Count them from 0.")
        raise LogError(f"LeRobot dataset {str(path)!r} has no samples{of}.", advice=advice)
    edges = np.flatnonzero(np.diff(columns.pop("episode_index"))) + 1
    named = {name: columns[column] for (_, column), name in meaning.items() if column in columns}
    named = {"time": columns["timestamp"], **named}
    parts = zip(*(np.split(values, edges) for values in named.values()), strict=True)
    episodes = [LogTable(path, dict(zip(named, part, strict=True))) for part in parts]
    return one_after_another(episodes, reading)


def _meaning(features: Mapping[str, Any]) -> Iterator[tuple[tuple[str, str], str]]:
    """Yield feature and column -> `<joint>.<quantity>`, for observations of joints and actions."""
    for feature, description in features.items():
        told, is_action = meaning_of(f"{feature}[0]"), feature == _ACTION
        is_read = is_action or feature.startswith("observation")
        if not is_read or told is None or told.role >= PREVIOUS:
            continue
        (size,) = description["shape"]
        names = _names(description.get("names"), size) or [""] * size
        for k, name in enumerate(names):
            joint, _, word = name.rpartition(".")
            own = quantity_of(word) if joint else None
            if is_action and own not in (None, "position"):
                continue  # no position that a servo goes to
            joint = joint if own else name
            quantity = "command" if is_action else own or told.quantity
            column = feature if size == 1 else f"{feature}[{k}]"
            yield (feature, column), f"{joint}.{quantity}" if joint else f"{quantity}[{k}]"


def _names(names: Any, size: int) -> list[str] | None:
    """Return the names of a feature's numbers, however nested; None if there are none."""
    if isinstance(names, Mapping):
        names = [name for each in names.values() if isinstance(each, list) for name in each]
    if isinstance(names, list) and len(names) == 1 and isinstance(names[0], list):
        names = names[0]
    if isinstance(names, list) and len(names) == size:
        return [str(name) for name in names]
    return None
