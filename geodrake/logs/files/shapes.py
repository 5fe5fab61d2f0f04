"""Tables whose cells name joints, as tables with a row a sample and a column a joint's quantity.

`rostopic echo -p` writes a name beside each number, `field.name0` beside `field.position0`; tidy
tables have a row for each joint and time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import LogError
from geodrake.logs.files.column_names import listed
from geodrake.logs.files.joined_tables import joined_tables
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.recognition import (
    OF_JOINTS,
    PLAIN,
    is_time,
    meaning_of,
    number_of,
    plain_words,
)
from geodrake.logs.files.table import LogTable

Array = NDArray[np.float64]
Texts = NDArray[np.object_]

_NAMING = frozenset(["name", "names", "joint", "joints", "motor", "motors", "axis", "actuator"])
_MOST_JOINTS = 200  # more different words are no names of joints


def names_joints(column: str) -> bool:
    """Return whether a column of words, by its name, has names of joints."""
    words = plain_words(column)
    return bool(_NAMING.intersection(words)) and "frame" not in words


def reshaped(table: LogTable, reading: Reading) -> LogTable:
    """Return a table in which numbers stand under the names of their joints.

    Args:
        table: One whose cells may name joints; other tables are returned as they are.
        reading: What the user said of it; with a mapping nothing is done.

    Raises:
        LogError: Rows of joints have no time, and are not equally many.
    """
    naming = {n: w for n, w in table.words.items() if names_joints(n) and _are_names(w)}
    numbered = {k: w for n, w in naming.items() if (k := number_of(n)) is not None}
    if reading.mapping is not None or not naming:
        return table
    if len(numbered) == len(naming):
        return _named(table, numbered)
    return _pivoted(table, *next(iter(naming.items())), reading)


def _are_names(words: Texts) -> bool:
    return all(words) and len(set(words)) <= _MOST_JOINTS


def _named(table: LogTable, joints: dict[int, Texts]) -> LogTable:
    """Return the table with numbered columns under the names that stand beside them in each row."""
    columns, units, used = dict(table.columns), dict(table.units), set[str]()
    for column, number, quantity in _numbered(table):
        if number not in joints:
            continue
        used.add(column)
        for joint in dict.fromkeys(joints[number].tolist()):
            name, here = f"{joint}.{quantity}", joints[number] == joint
            before = columns.get(name, np.full(len(table), np.nan))
            columns[name] = np.where(here, table.columns[column], before)
            units |= {name: units[column]} if column in units else {}
    kept = {name: values for name, values in columns.items() if name not in used}
    if not used:
        return table
    found = list(dict.fromkeys(joint for words in joints.values() for joint in words.tolist()))
    note = f"joints are named by the cells of the log: {listed(found)}"
    return replace(table, columns=kept, units=units, notes=(*table.notes, note))


def _numbered(table: LogTable) -> Iterator[tuple[str, int, str]]:
    """Yield measured columns that have a number for their joint, with it and their quantity."""
    for column in table.columns:
        meaning = meaning_of(column)
        if meaning is None or meaning.quantity not in OF_JOINTS or meaning.role > PLAIN:
            continue
        if meaning.number is not None:
            yield column, meaning.number, meaning.quantity


def _pivoted(table: LogTable, naming: str, words: Texts, reading: Reading) -> LogTable:
    """Return a table of a row for each joint and time as one of a row a sample."""
    meanings = {name: meaning_of(name) for name in table.columns}
    own = {n: m for n, m in meanings.items() if m is not None and m.quantity in OF_JOINTS}
    joints = list(dict.fromkeys(words.tolist()))
    if not own or any(m.words for m in own.values()) or len(joints) == len(words):
        return table
    parts = []
    for joint in joints:
        here = words == joint
        names = {n: f"{joint}.{own[n].quantity}" if n in own else n for n in table.columns}
        columns = {names[n]: v[here] for n, v in table.columns.items() if n in own or is_time(n)}
        units = {names[n]: unit for n, unit in table.units.items()}
        units |= {names[n]: m.unit.name for n, m in own.items() if m.unit is not None}
        parts.append(LogTable(Path(joint), columns, units, origins=table.origins))
    try:
        joined = joined_tables(table.path, parts, reading)
    except LogError as error:
        raise LogError(
            f"Log {str(table.path)!r} has a row for each joint in {naming!r}, which cannot be "
            f"brought together: {error.problem}",
            advice=error.advice,
        ) from error
    note = f"a row for each joint in {naming!r}: one for each instant is made of them"
    return replace(joined, notes=(note, *table.notes, *joined.notes))
