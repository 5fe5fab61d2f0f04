"""Groups in one file: concatenated demonstrations, and parts with their own time."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from geodrake.boundary.arguments import Array
from geodrake.errors import LogError
from geodrake.logs.files.column_mapping import listed
from geodrake.logs.files.joined_tables import by_clocks, joined_tables, reshaped
from geodrake.logs.files.name_rules import (
    is_time,
    joint_columns,
    meanings_of,
    names_joints,
    tells,
)
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import (
    NOTHING,
    LogTable,
    Texts,
    check_room,
    numeric_table,
    rate_in,
    rows_of,
)
from geodrake.logs.time_stamps import longest_step

_MOST_PARTS = 200  # more records are samples, and no joints
UNIT_OF = re.compile(r"(?:^|[._/])units?(?:[._/]|$)", re.IGNORECASE)
"""The part of a name by which a text is the unit of an array."""

_VALUES = re.compile(r"\.(data|values?)$", re.IGNORECASE)  # beside a unit

_STEPS_BETWEEN, _BETWEEN = 30.0, 1.0  # steps and s between episodes at least, which are a gap
_EPISODE = re.compile(
    r"(?:demo|demonstration|episode|ep|traj|trajectory|rollout|trial|run)s?[_ -]?(\d+)", re.I
)


def fields_of(
    record: Mapping[str, Any], prefix: str = "", *, lists: bool = False
) -> Iterator[tuple[str, Any]]:
    """Yield the fields of nested tables by path; if `lists`, those of tables in lists, too."""
    for name, value in record.items():
        if isinstance(value, dict):
            yield from fields_of(value, f"{prefix}{name}.", lists=lists)
        elif lists and isinstance(value, list) and any(isinstance(x, dict | list) for x in value):
            items = {f"{name}[{k}]": each for k, each in enumerate(value)}
            yield from fields_of(items, prefix, lists=lists)
        else:
            yield f"{prefix}{name}", value


def content_table(
    path: Path, content: Any, reading: Reading, advice: str = "Save arrays by their names."
) -> LogTable:
    """Return the columns of nested arrays, or of records for each sample."""
    if (grouped := grouped_table(path, content, reading)) is not None:
        return grouped
    if isinstance(content, Mapping):
        content = _by_names(_with_signals(_inside(content)))
        records = next((x for x in content.values() if are_records(x)), None)
        if records is not None:
            said = {name: x for name, x in fields_of(content) if describes_columns(name, x)}
            return records_table(path, records, said)
    if are_records(content):
        return records_table(path, content)
    if not isinstance(content, Mapping):
        raise neither(path, advice)
    arrays = arrays_of(content)
    table = numeric_table(path, arrays, rows_of(arrays))
    # Texts beside the arrays, such as `q_units` or `units.q`.
    told = {UNIT_OF.sub(".", n).strip("."): x for n, x in fields_of(content) if UNIT_OF.search(n)}
    heads = {name: f".{_VALUES.sub('', name.partition('[')[0])}" for name in table.names}
    of_what = [(f".{what}", unit) for what, unit in told.items() if isinstance(unit, str)]
    units = {n: u for n, head in heads.items() for what, u in of_what if head.endswith(what)}
    return replace(table, units=units)


def neither(path: Path, advice: str) -> LogError:
    """Return the error for a file of neither arrays by name nor records."""
    return LogError(
        f"Log {str(path)!r} is neither a JSON object nor a list of records.", advice=advice
    )


def arrays_of(variables: Mapping[str, Any]) -> dict[str, Any]:
    """Return arrays, lists and scalars by path, without arrays of one number.

    A single struct around everything else is omitted, and Simulink's signals have their labels.
    """
    variables, found = _with_signals(_inside(variables)), {}
    for name, value in fields_of(variables):
        size = value.size if isinstance(value, np.ndarray) else 2
        size = len(value) if isinstance(value, list) else size
        if isinstance(value, np.ndarray | list | float | int) and size > 1:
            found[name] = np.squeeze(value) if isinstance(value, np.ndarray) else value
    return found


def _inside(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the content of a struct that is alone, however many are around it."""
    while len(content) == 1 and isinstance(inner := next(iter(content.values())), Mapping):
        content = inner
    return content


def are_records(content: Any) -> bool:
    """Return whether something is a list of tables, a record for each sample."""
    return isinstance(content, list) and {isinstance(row, Mapping) for row in content} == {True}


def _by_names(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the arrays of records of joints by the joints' names."""
    found = dict[str, Any]()
    for key, value in content.items():
        records = value if are_records(value) and len(value) <= _MOST_PARTS else []
        arrays = (list, np.ndarray)
        lists = [[name for name, x in each.items() if isinstance(x, arrays)] for each in records]
        called = [str(x) for each in records for n, x in each.items() if names_joints(n)]
        is_of_joints = all(lists) and len(set(called)) == len(records) > 0
        found |= dict(zip(called, records, strict=True)) if is_of_joints else {key: value}
    return found


def _with_signals(variables: Mapping[str, Any], called: str = "signal{}") -> Mapping[str, Any]:
    """Return variables with Simulink's structs of values, by their labels or else as `called`."""
    signals = [*np.atleast_1d(variables.get("signals", []))]
    if not all(isinstance(each, Mapping) and "values" in each for each in signals):
        return variables
    named = dict[str, Any]()
    for k, each in enumerate(signals):
        label = np.asarray(each.get("label", ""))
        named[str(label) if label.size == 1 and str(label) else called.format(k)] = each["values"]
    return {name: x for name, x in variables.items() if name != "signals"} | named


def describes_columns(name: str, value: Any) -> bool:
    """Return whether a value beside arrays is their rate or unit, or may name their joints."""
    is_list = isinstance(value, list | np.ndarray) and len(np.atleast_1d(value)) > 0
    named = is_list and all(isinstance(x, str) for x in np.atleast_1d(value))
    is_unit = isinstance(value, str) and UNIT_OF.search(name) is not None
    return named or is_unit or (np.isscalar(value) and rate_in(name, value) is not None)


def records_table(
    path: Path, content: Sequence[Mapping[str, Any]], said: Mapping[str, Any] | None = None
) -> LogTable:
    """Return the columns of records of any fields, and of what is `said` beside them."""
    columns, width = dict[str, list[Any]](), 0
    for k, record in enumerate(content):
        for name, value in fields_of(record, lists=True):
            if name not in columns:
                columns[name] = []
                width += len(value) if isinstance(value, list) else 1
                check_room(path, len(content) * width, f"{width} fields")
            if len(columns[name]) < k:
                columns[name] += [None] * (k - len(columns[name]))
            columns[name].append(value)
    for values in columns.values():
        values.extend([None] * (len(content) - len(values)))
    return numeric_table(path, {**(said or {}), **columns}, len(content))


def grouped_table(path: Path, content: Any, reading: Reading) -> LogTable | None:
    """Return the columns of demonstrations or of parts with their own time; None otherwise."""
    found = _episodes_in(content, least=1 if reading.episode is not None else 2)
    if found:
        return _in_turn(path, found, content, reading)
    if reading.episode is not None:
        raise LogError(
            f"Log {str(path)!r} has no episodes, such as groups demo_0, demo_1.",
            advice="Omit --episode.",
        )
    parts = list[tuple[tuple[str, ...], Any]]()
    for name, part in _parts_in(content):
        fields = part if isinstance(part, Mapping) else part[0]
        if joint_columns(".".join((*name, field)) for field in fields):
            parts.append((name, part))
    if len(parts) < 2:
        return None
    is_told = len({name[-1:] for name, _ in parts}) == len(parts)
    named = [(".".join(name[-1:] if is_told else name), each) for name, each in parts]
    return joined_tables(path, [_part(name, each) for name, each in named], reading)


def _episodes_in(content: Any, *, least: int) -> dict[int, Mapping[str, Any]]:
    """Return the demonstrations of a file by their numbers, in the order of these."""
    if not isinstance(content, Mapping):
        return {}
    told = ((_EPISODE.fullmatch(name), x) for name, x in content.items())
    found = {int(n[1]): x for n, x in told if n is not None and isinstance(x, Mapping)}
    if len(found) >= least:
        return dict(sorted(found.items()))
    inside = (_episodes_in(each, least=least) for each in content.values())
    return next(filter(None, inside), {})


def is_of_episode(path: Sequence[str], reading: Reading) -> bool:
    """Return whether an object is in the chosen episode, if in one, by the groups it is in."""
    numbers = (int(found[1]) for name in path if (found := _EPISODE.fullmatch(name)))
    return reading.episode in (None, next(numbers, reading.episode))


def _in_turn(
    path: Path,
    episodes: Mapping[int, Mapping[str, Any]],
    content: Mapping[str, Any],
    reading: Reading,
) -> LogTable:
    """Return the columns of all demonstrations, or of the chosen one."""
    if reading.episode is not None and reading.episode not in episodes:
        raise LogError(
            f"Log {str(path)!r} has no episode {reading.episode}; it has "
            f"{listed([str(number) for number in episodes])}.",
            advice="Choose one of these, or omit --episode to read all.",
        )
    chosen = [reading.episode] if reading.episode is not None else [*episodes]
    said = {name: x for name, x in fields_of(content) if describes_columns(name, x)}
    tables = []
    for number in chosen:
        arrays = arrays_of(episodes[number])
        tables.append(numeric_table(path, {**said, **arrays}, rows_of(arrays)))
    return one_after_another(tables, reading)


def one_after_another(tables: Sequence[LogTable], reading: Reading) -> LogTable:
    """Return the columns that all episodes have, with gaps between episodes.

    Without time stamps, empty rows separate two of them; time that begins anew is continued.
    """
    first = tables[0]
    names = [n for n in first.columns if all(n in table.columns for table in tables)]
    has_time = any(map(is_time, names))
    rate = reading.rate or (first.rate[0] if first.rate else 1.0)
    empty = np.full(1 + math.ceil(rate * longest_step(1.0 / rate)), np.nan)
    columns = {}
    for name in names:
        parts = [first.columns[name]]
        for table in tables[1:]:
            own = table.columns[name]
            following = _going_on(parts[-1], own) if is_time(name) else own
            parts += [following] if has_time else [empty, following]
        columns[name] = np.concatenate(parts)
    notes = [f"{len(tables)} episodes, concatenated"] if len(tables) > 1 else []
    lost = dict.fromkeys(n for table in tables for n in table.columns if n not in columns)
    notes += [f"columns missing in some episodes: {listed([*lost])}"] if lost else []
    return replace(first, columns=columns, notes=(*notes, *first.notes))


_MOST_ROBOTS = 50  # different words or numbers in a column that tells them
_LEAST_EDGES = 3  # changes at which a robot is seen to move on
_MOVING = 0.5  # of the usual step of a joint that moves, and of such changes
ALL_ROBOTS = "all"
"""Topic by which rows of several robots are those of one."""


def regrouped(table: LogTable, reading: Reading) -> LogTable:
    """Return a table of one robot, recordings one after the other, with a column for each joint."""
    names = (*table.columns, *table.words)
    robots = [n for n in names if tells(n, "robots")]  # first, as joining recordings drops words
    for name in (*robots, *(n for n in names if tells(n, "recordings") and n not in robots)):
        if name in table.words:
            cells = np.array([*map(str, table.words[name])], object)
        elif name in table.columns:
            cells = np.array([f"{x:g}" for x in table.columns[name]], object)
        else:  # dropped when recordings were joined
            continue
        of_one = _of_one_robot if tells(name, "robots") else _of_recordings
        table = of_one(table, name, cells, reading)
    return reshaped(by_clocks(table, reading), reading)


def _of_one_robot(table: LogTable, name: str, cells: Texts, reading: Reading) -> LogTable:
    """Return the rows of the robot that is asked for, if a column tells several."""
    robots = [robot for robot in dict.fromkeys(cells.tolist()) if robot not in NOTHING]
    if len(robots) == 1:
        return table.noting(f"all rows are of one robot: {name!r} is {robots[0]!r}")
    if not 1 < len(robots) <= _MOST_ROBOTS or not _are_together(table, cells, robots):
        return table
    without = replace(table, words={n: words for n, words in table.words.items() if n != name})
    if asked := [robot for robot in robots if robot in reading.topics]:
        return _rows(without, cells == asked[0]).noting(
            f"rows with {asked[0]!r} in {name!r} are read"
        )
    if _moves_on(table, cells):
        words = "joints move on where it changes, so all rows are of one robot"
        return without.noting(f"{name!r} is {listed(robots)}: {words}")
    if ALL_ROBOTS in reading.topics:
        return without.noting(f"rows with {listed(robots)} in {name!r} are of one robot, as asked")
    raise LogError(
        f"Log {str(table.path)!r} has rows of {len(robots)} robots, by column {name!r}: "
        f"{listed(robots)}.",
        advice=f"Choose one: --topic {robots[0]}; or, if all rows are of one robot, --topic "
        f"{ALL_ROBOTS}.",
    )


def _moves_on(table: LogTable, cells: Texts) -> bool:
    """Return whether joints go on as they moved where cells (N,) change, as no other robot does."""
    places = [
        table.columns[m.column] for m in meanings_of(table.columns) if m.quantity == "position"
    ]
    places = [place for place in places if np.isfinite(np.diff(place)).any()]
    time = next((x for n, x in table.columns.items() if table.is_time(n)), None)
    edges = np.flatnonzero(cells[1:] != cells[:-1]) + 1
    edges = edges[(edges > 1) & (edges < len(cells) - 1)]
    if time is None or not places or len(edges) < _LEAST_EDGES or not (np.diff(time) > 0.0).all():
        return False
    position = np.stack(places, 1)
    steps = np.abs(np.diff(position, axis=0))
    bends = np.abs(np.diff(position, 2, axis=0))  # from rows k − 1, k to k + 1, at k − 1
    usual = np.nanmax(np.delete(bends, np.concatenate([edges - 2, edges - 1]), 0), 0, initial=0.0)
    is_smooth = (np.maximum(bends[edges - 2], bends[edges - 1]) <= usual).all()
    moving = (steps[edges - 1] > _MOVING * np.nanmedian(steps, axis=0)).any(axis=1)
    return bool(is_smooth and np.nanmedian(steps) > 0.0 and moving.mean() > _MOVING)


def _are_together(table: LogTable, cells: Texts, robots: Sequence[str]) -> bool:
    """Return whether robots are logged at the same time, one row each or one after the other.

    Otherwise, 0 and 1 may be a flag of one robot.
    """
    time = next((x for n, x in table.columns.items() if table.is_time(n)), None)
    if time is None or {*robots} - {"0", "1"}:
        return True
    known = (time[(cells == robot) & np.isfinite(time)] for robot in robots)
    spans = sorted((x.min(initial=np.inf), x.max(initial=-np.inf)) for x in known)
    changes = np.flatnonzero(cells[1:] != cells[:-1])
    begins_anew = (np.diff(time)[changes] < 0.0).all()
    return bool(spans[1][0] < spans[0][1] and (begins_anew or 4 * len(changes) > len(cells)))


def _of_recordings(table: LogTable, name: str, cells: Texts, reading: Reading) -> LogTable:
    """Return the rows of the recording that is asked for, or of all with gaps between them.

    A column that tells recordings does so if time begins anew where it changes.
    """
    edges = np.flatnonzero(cells[1:] != cells[:-1]) + 1
    time = next((x for n, x in table.columns.items() if table.is_time(n)), None)
    if time is None or not len(edges):
        return table
    back = np.flatnonzero(np.diff(time) < 0.0) + 1
    if not {*back} <= {*edges}:
        return table
    if reading.episode is not None:
        if not (here := cells == str(reading.episode)).any():
            raise LogError(
                f"Log {str(table.path)!r} has no {name!r} of {reading.episode}; it has "
                f"{listed(list(dict.fromkeys(cells.tolist())))}.",
                advice="Choose one of these, or omit --episode to read all.",
            )
        return _rows(table, here)
    if not len(back):
        return table
    parts = np.split(np.arange(len(cells)), edges)
    return one_after_another([replace(_rows(table, part), words={}) for part in parts], reading)


def _rows(table: LogTable, rows: Any) -> LogTable:
    """Return some rows of a table in memory."""
    columns = {name: values[rows] for name, values in table.columns.items()}
    words = {name: cells[rows] for name, cells in table.words.items()}
    return replace(table, columns=columns, words=words)


def _going_on(before: Array, time: Array) -> Array:
    """Return time (N,) of an episode after that of others, behind which it is to be."""
    known, own = (each[np.isfinite(each)] for each in (before, time))
    if not len(own) or not len(known) or own[0] > known[-1]:
        return time
    longer = own if len(own) > 1 else known
    period = (longer[-1] - longer[0]) / max(len(longer) - 1, 1)
    return time + (known[-1] - own[0] + max(_STEPS_BETWEEN * period, _BETWEEN))


def _parts_in(content: Any, name: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield names and tables or lists of records that have their own time."""
    if are_records(content):
        times = [x for n, x in content[0].items() if is_time(n)]
        if times and not any(isinstance(x, list | np.ndarray) for x in times):
            yield name, content
            return
        for k, record in enumerate(content if len(content) <= _MOST_PARTS else ()):
            called = next((str(x) for n, x in record.items() if names_joints(n)), str(k))
            yield from _parts_in(record, (*name, called))
    elif isinstance(content, Mapping):
        content = _with_signals(content, "value")
        for own, each in content.items():
            if isinstance(each, Mapping) or are_records(each):
                yield from _parts_in(each, (*name, own))
        fields = {n: x for n, x in content.items() if isinstance(x, list | np.ndarray)}
        fields = {n: x for n, x in fields.items() if not are_records(x)}
        if any(map(is_time, fields)):
            yield name, fields


def _part(name: str, part: Any) -> LogTable:
    """Return the columns of a part, but for time with its name before their own."""
    if isinstance(part, Mapping):
        arrays = arrays_of(part)
        table = numeric_table(Path(name), arrays, rows_of(arrays))
    else:
        table = records_table(Path(name), part)
    return table.under(f"{name}.")
