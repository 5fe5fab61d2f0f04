"""Tables whose cells name joints, as tables with a row a sample and a column a joint's quantity.

`rostopic echo -p` writes a name beside each number, `field.name0` beside `field.position0`; tidy
tables have a row for each joint and time.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
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
    Meaning,
    is_time,
    meaning_of,
    names_joints,
    number_of,
    plain_words,
)
from geodrake.logs.files.table import LogTable

Array = NDArray[np.float64]
Texts = NDArray[np.object_]

_NAMES = frozenset(["name", "names"])
_ITEM = re.compile(r"[^\s,;'\"\[\]()]+")  # of a list of names
_MOST_JOINTS = 200  # more different words are no names of joints


def reshaped(table: LogTable, reading: Reading) -> LogTable:
    """Return a table in which numbers stand under the names of their joints.

    Args:
        table: One whose cells may name joints; other tables are returned as they are.
        reading: What the user said of it; with a mapping nothing is done.

    Raises:
        LogError: Rows of joints have no time, and are not equally many.
    """
    words = {n: w for column, cells in table.words.items() for n, w in _items(column, cells)}
    naming = {n: w for n, w in words.items() if names_joints(n) and _are_names(w)}
    numbered = {n: w for n, w in naming.items() if number_of(n) is not None}
    if reading.mapping is not None or not naming:
        return table
    if numbered and all(_NAMES & plain_words(name) or name.endswith("]") for name in numbered):
        return _named(table, numbered)
    return _pivoted(table, *next(iter(naming.items())), reading)


def _items(column: str, cells: Texts) -> Iterator[tuple[str, Texts]]:
    """Yield a column of texts; of lists of them, such as `['a', 'b']`, one for each place."""
    if len(cells) and str(cells[0]).startswith(("[", "(")):
        lists = [_ITEM.findall(str(cell)) for cell in cells]
        if len({len(names) for names in lists}) == 1:
            for k, names in enumerate(zip(*lists, strict=True)):
                yield f"{column}[{k}]", np.array(names, object)
            return
    yield column, cells


def _are_names(words: Texts) -> bool:
    return all(words) and len(set(words)) <= _MOST_JOINTS


def _named(table: LogTable, naming: Mapping[str, Texts]) -> LogTable:
    """Return the table with numbered columns under the names that stand beside them in each row."""
    in_lists = all(name.endswith("]") for name in naming)
    joints = {number_of(name): words for name, words in naming.items()}
    found = {n: m for n in table.columns if (m := _measured(n)) and m.number in joints}
    found = {n: m for n, m in found.items() if n.endswith("]") or not in_lists}
    used = _likeliest(found, lambda m: (m.quantity, m.number))
    if not used:
        return table
    columns = {n: values for n, values in table.columns.items() if n not in found}
    units = {n: unit for n, unit in table.units.items() if n not in found}
    for column, meaning in used.items():
        words, unit = joints[meaning.number], _unit(table, meaning)
        for joint in dict.fromkeys(words.tolist()):
            name, here = f"{joint}.{meaning.quantity}", words == joint
            before = columns.get(name, np.full(len(table), np.nan))
            columns[name] = np.where(here, table.columns[column], before)
            units |= {name: unit} if unit else {}
    names = list(dict.fromkeys(joint for words in joints.values() for joint in words.tolist()))
    note = f"joints are named by the cells of the log: {listed(names)}"
    return replace(table, columns=columns, units=units, notes=(*table.notes, note))


def _measured(column: str) -> Meaning | None:
    """Return what a column of joints is, by its name; None for others, and for what is wanted."""
    meaning = meaning_of(column)
    is_measured = meaning is not None and meaning.quantity in OF_JOINTS and meaning.role <= PLAIN
    return meaning if is_measured else None


def _likeliest(
    found: Mapping[str, Meaning], place: Callable[[Meaning], object]
) -> dict[str, Meaning]:
    """Return the columns of the least role, one for each place."""
    best = {place(m): n for n, m in sorted(found.items(), key=lambda each: -each[1].role)}
    return {name: found[name] for name in best.values()}


def _unit(table: LogTable, meaning: Meaning) -> str | None:
    """Return the unit of a column, as its name or the file says."""
    return meaning.unit.name if meaning.unit else table.units.get(meaning.column)


def _pivoted(table: LogTable, naming: str, words: Texts, reading: Reading) -> LogTable:
    """Return a table of a row for each joint and time as one of a row a sample."""
    meanings = {name: meaning_of(name) for name in table.columns}
    own = {n: m for n, m in meanings.items() if m is not None and m.quantity in OF_JOINTS}
    own = _likeliest(own, lambda m: m.quantity)
    joints = list(dict.fromkeys(words.tolist()))
    if not own or any(m.words for m in own.values()) or len(joints) == len(words):
        return table
    parts = []
    for joint in joints:
        here = words == joint
        names = {n: f"{joint}.{own[n].quantity}" if n in own else n for n in table.columns}
        columns = {names[n]: v[here] for n, v in table.columns.items() if n in own or is_time(n)}
        units = {n: unit for n, unit in table.units.items() if n not in own}
        units |= {names[n]: unit for n, m in own.items() if (unit := _unit(table, m))}
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
