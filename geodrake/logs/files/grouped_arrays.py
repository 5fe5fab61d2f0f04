"""Join the groups in a file: demonstrations, recordings, and parts with their own time."""

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

_MOST_PARTS = 200  # more records are samples, not joints
UNIT_OF = re.compile(r"(?:^|[._/])units?(?:[._/]|$)", re.IGNORECASE)
"""Part of the name of a text that is the unit of an array."""

_VALUES = re.compile(r"\.(data|values?)$", re.IGNORECASE)  # values with a unit

_STEPS_BETWEEN, _BETWEEN = 30.0, 1.0  # least steps and s between episodes, to form a gap
_EPISODE = re.compile(
    r"(?:demo|demonstration|episode|ep|traj|trajectory|rollout|trial|run)s?[_ -]?(\d+)", re.I
)


def fields_of(
    record: Mapping[str, Any], prefix: str = "", *, lists: bool = False
) -> Iterator[tuple[str, Any]]:
    """Yield the fields of nested dicts by path; if `lists`, also of dicts in lists."""
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
    """Convert nested arrays, or a list of records, to a table."""
    if (grouped := grouped_table(path, content, reading)) is not None:
        return grouped
    if isinstance(content, Mapping):
        content = _by_names(_with_signals(_inside(content)))
        records = next((x for x in content.values() if are_records(x)), None)
        if records is not None:
            beside = {name: x for name, x in fields_of(content) if describes_columns(name, x)}
            return records_table(path, records, beside)
    if are_records(content):
        return records_table(path, content)
    if not isinstance(content, Mapping):
        raise neither(path, advice)
    arrays = arrays_of(content)
    table = numeric_table(path, arrays, rows_of(arrays))
    # Texts such as `q_units` or `units.q`.
    texts = {UNIT_OF.sub(".", n).strip("."): x for n, x in fields_of(content) if UNIT_OF.search(n)}
    heads = {name: f".{_VALUES.sub('', name.partition('[')[0])}" for name in table.names}
    endings = [(f".{what}", unit) for what, unit in texts.items() if isinstance(unit, str)]
    units = {n: u for n, head in heads.items() for what, u in endings if head.endswith(what)}
    return replace(table, units=units)


def neither(path: Path, advice: str) -> LogError:
    """Return the error for a file without named arrays or records."""
    return LogError(
        f"Log {str(path)!r} is neither a JSON object nor a list of records.", advice=advice
    )


def arrays_of(variables: Mapping[str, Any]) -> dict[str, Any]:
    """Return arrays, lists and scalars by path, without arrays of one number.

    A struct that encloses all else is omitted; Simulink's signals are named by their labels.
    """
    variables, arrays = _with_signals(_inside(variables)), {}
    for name, value in fields_of(variables):
        size = value.size if isinstance(value, np.ndarray) else 2
        size = len(value) if isinstance(value, list) else size
        if isinstance(value, np.ndarray | list | float | int) and size > 1:
            arrays[name] = np.squeeze(value) if isinstance(value, np.ndarray) else value
    return arrays


def _inside(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the content without enclosing structs of one field."""
    while len(content) == 1 and isinstance(inner := next(iter(content.values())), Mapping):
        content = inner
    return content


def are_records(content: Any) -> bool:
    """Return whether the content is a list of dicts."""
    return isinstance(content, list) and {isinstance(row, Mapping) for row in content} == {True}


def _by_names(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """Replace records of arrays for each joint by a dict with the joints' names as keys."""
    by_name = dict[str, Any]()
    for key, value in content.items():
        records = value if are_records(value) and len(value) <= _MOST_PARTS else []
        arrays = (list, np.ndarray)
        lists = [[name for name, x in each.items() if isinstance(x, arrays)] for each in records]
        names = [str(x) for each in records for n, x in each.items() if names_joints(n)]
        is_of_joints = all(lists) and len(set(names)) == len(records) > 0
        by_name |= dict(zip(names, records, strict=True)) if is_of_joints else {key: value}
    return by_name


def _with_signals(variables: Mapping[str, Any], called: str = "signal{}") -> Mapping[str, Any]:
    """Replace Simulink's signals by their values, named by labels or the format `called`."""
    signals = [*np.atleast_1d(variables.get("signals", []))]
    if not all(isinstance(each, Mapping) and "values" in each for each in signals):
        return variables
    values = dict[str, Any]()
    for k, each in enumerate(signals):
        label = np.asarray(each.get("label", ""))
        values[str(label) if label.size == 1 and str(label) else called.format(k)] = each["values"]
    return {name: x for name, x in variables.items() if name != "signals"} | values


def describes_columns(name: str, value: Any) -> bool:
    """Return whether a value beside arrays is their rate or unit, or a list of names."""
    is_list = isinstance(value, list | np.ndarray) and len(np.atleast_1d(value)) > 0
    has_names = is_list and all(isinstance(x, str) for x in np.atleast_1d(value))
    is_unit = isinstance(value, str) and UNIT_OF.search(name) is not None
    return has_names or is_unit or (np.isscalar(value) and rate_in(name, value) is not None)


def records_table(
    path: Path, content: Sequence[Mapping[str, Any]], extras: Mapping[str, Any] | None = None
) -> LogTable:
    """Convert records with any fields to a table, and add the values in `extras`."""
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
    return numeric_table(path, {**(extras or {}), **columns}, len(content))


def grouped_table(path: Path, content: Any, reading: Reading) -> LogTable | None:
    """Join demonstrations, or parts with their own time; return None if there are none."""
    episodes = _episodes_in(content, least=1 if reading.episode is not None else 2)
    if episodes:
        return _joined_episodes(path, episodes, content, reading)
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
    is_unique = len({name[-1:] for name, _ in parts}) == len(parts)
    named = [(".".join(name[-1:] if is_unique else name), each) for name, each in parts]
    table = joined_tables(path, [_part(name, each) for name, each in named], reading)
    scalars = fields_of(content) if isinstance(content, Mapping) else ()
    rates = ((rate, name) for name, x in scalars if (rate := rate_in(name, x)) is not None)
    return replace(table, rate=table.rate or next(rates, None))


def _episodes_in(content: Any, *, least: int) -> dict[int, Mapping[str, Any]]:
    """Return the demonstrations of a file by number, sorted."""
    if not isinstance(content, Mapping):
        return {}
    numbered = ((_EPISODE.fullmatch(name), x) for name, x in content.items())
    episodes = {int(n[1]): x for n, x in numbered if n is not None and isinstance(x, Mapping)}
    if len(episodes) >= least:
        return dict(sorted(episodes.items()))
    inside = (_episodes_in(each, least=least) for each in content.values())
    return next(filter(None, inside), {})


def is_of_episode(path: Sequence[str], reading: Reading) -> bool:
    """Return whether an object, given its path, is in the chosen episode or in none."""
    numbers = (int(found[1]) for name in path if (found := _EPISODE.fullmatch(name)))
    return reading.episode in (None, next(numbers, reading.episode))


def _joined_episodes(
    path: Path,
    episodes: Mapping[int, Mapping[str, Any]],
    content: Mapping[str, Any],
    reading: Reading,
) -> LogTable:
    """Concatenate all demonstrations, or return the chosen one."""
    if reading.episode is not None and reading.episode not in episodes:
        raise LogError(
            f"Log {str(path)!r} has no episode {reading.episode}; it has "
            f"{listed([str(number) for number in episodes])}.",
            advice="Choose one of these, or omit --episode to read all.",
        )
    chosen = [reading.episode] if reading.episode is not None else [*episodes]
    beside = {name: x for name, x in fields_of(content) if describes_columns(name, x)}
    tables = []
    for number in chosen:
        arrays = arrays_of(episodes[number])
        tables.append(numeric_table(path, {**beside, **arrays}, rows_of(arrays)))
    return one_after_another(tables, reading)


def one_after_another(tables: Sequence[LogTable], reading: Reading) -> LogTable:
    """Concatenate the common columns of episodes, with gaps between episodes.

    Time that restarts is continued. Without time, empty rows separate episodes.
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
            values = table.columns[name]
            following = _continued(parts[-1], values) if is_time(name) else values
            parts += [following] if has_time else [empty, following]
        columns[name] = np.concatenate(parts)
    notes = [f"{len(tables)} episodes, concatenated"] if len(tables) > 1 else []
    dropped = dict.fromkeys(n for table in tables for n in table.columns if n not in columns)
    notes += [f"columns missing in some episodes: {listed([*dropped])}"] if dropped else []
    return replace(first, columns=columns, notes=(*notes, *first.notes))


_MOST_ROBOTS = 50  # most distinct values in a column of robots
_LEAST_EDGES = 3  # least changes of value to recognize continuous motion
_MOVING = 0.5  # fraction of the median step that counts as motion, and of such changes
ALL_ROBOTS = "all"
"""Topic that treats the rows of several robots as those of one."""


def regrouped(table: LogTable, reading: Reading) -> LogTable:
    """Select one robot, concatenate recordings, and give each joint its own columns."""
    names = (*table.columns, *table.words)
    robots = [n for n in names if tells(n, "robots")]  # first, as joining recordings drops words
    for name in (*robots, *(n for n in names if tells(n, "recordings") and n not in robots)):
        if name in table.words:
            cells = np.array([*map(str, table.words[name])], object)
        elif name in table.columns:
            cells = np.array([f"{x:g}" for x in table.columns[name]], object)
        else:  # dropped when recordings were joined
            continue
        of_one = _robot_rows if tells(name, "robots") else _recording_rows
        table = of_one(table, name, cells, reading)
    return reshaped(by_clocks(table, reading), reading)


def _robot_rows(table: LogTable, name: str, cells: Texts, reading: Reading) -> LogTable:
    """Return the rows of the requested robot, if a column distinguishes several."""
    robots = [robot for robot in dict.fromkeys(cells.tolist()) if robot not in NOTHING]
    if len(robots) == 1:
        return table.noting(f"all rows are of one robot: {name!r} is {robots[0]!r}")
    if not 1 < len(robots) <= _MOST_ROBOTS or not _are_simultaneous(table, cells, robots):
        return table
    without = replace(table, words={n: words for n, words in table.words.items() if n != name})
    if chosen := [robot for robot in robots if robot in reading.topics]:
        return _rows(without, cells == chosen[0]).noting(
            f"rows with {chosen[0]!r} in {name!r} are read"
        )
    if _is_continuous(table, cells):
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


def _is_continuous(table: LogTable, cells: Texts) -> bool:
    """Return whether joints move smoothly across changes of the cells (N,), as one robot does."""
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
    bends = np.abs(np.diff(position, 2, axis=0))  # rows k − 1 to k + 1 at k − 1
    usual = np.nanmax(np.delete(bends, np.concatenate([edges - 2, edges - 1]), 0), 0, initial=0.0)
    is_smooth = (np.maximum(bends[edges - 2], bends[edges - 1]) <= usual).all()
    moving = (steps[edges - 1] > _MOVING * np.nanmedian(steps, axis=0)).any(axis=1)
    return bool(is_smooth and np.nanmedian(steps) > 0.0 and moving.mean() > _MOVING)


def _are_simultaneous(table: LogTable, cells: Texts, robots: Sequence[str]) -> bool:
    """Return whether robots were logged simultaneously, in alternating rows or in blocks.

    Otherwise, 0 and 1 may be a flag of one robot.
    """
    time = next((x for n, x in table.columns.items() if table.is_time(n)), None)
    if time is None or {*robots} - {"0", "1"}:
        return True
    times = (time[(cells == robot) & np.isfinite(time)] for robot in robots)
    spans = sorted((x.min(initial=np.inf), x.max(initial=-np.inf)) for x in times)
    changes = np.flatnonzero(cells[1:] != cells[:-1])
    restarts = (np.diff(time)[changes] < 0.0).all()
    return bool(spans[1][0] < spans[0][1] and (restarts or 4 * len(changes) > len(cells)))


def _recording_rows(table: LogTable, name: str, cells: Texts, reading: Reading) -> LogTable:
    """Return the rows of the requested recording, or all recordings with gaps between them.

    A column distinguishes recordings if time restarts only where it changes.
    """
    edges = np.flatnonzero(cells[1:] != cells[:-1]) + 1
    time = next((x for n, x in table.columns.items() if table.is_time(n)), None)
    if time is None or not len(edges):
        return table
    restarts = np.flatnonzero(np.diff(time) < 0.0) + 1
    if not {*restarts} <= {*edges}:
        return table
    if reading.episode is not None:
        if not (rows := cells == str(reading.episode)).any():
            raise LogError(
                f"Log {str(table.path)!r} has no {name!r} of {reading.episode}; it has "
                f"{listed(list(dict.fromkeys(cells.tolist())))}.",
                advice="Choose one of these, or omit --episode to read all.",
            )
        return _rows(table, rows)
    if not len(restarts):
        return table
    parts = np.split(np.arange(len(cells)), edges)
    return one_after_another([replace(_rows(table, part), words={}) for part in parts], reading)


def _rows(table: LogTable, rows: Any) -> LogTable:
    """Return some rows of a loaded table."""
    columns = {name: values[rows] for name, values in table.columns.items()}
    words = {name: cells[rows] for name, cells in table.words.items()}
    return replace(table, columns=columns, words=words)


def _continued(previous: Array, time: Array) -> Array:
    """Shift the time (N,) of an episode behind the previous one, unless it already is."""
    earlier, stamps = (each[np.isfinite(each)] for each in (previous, time))
    if not len(stamps) or not len(earlier) or stamps[0] > earlier[-1]:
        return time
    longer = stamps if len(stamps) > 1 else earlier
    period = (longer[-1] - longer[0]) / max(len(longer) - 1, 1)
    return time + (earlier[-1] - stamps[0] + max(_STEPS_BETWEEN * period, _BETWEEN))


def _parts_in(content: Any, name: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the paths and contents of dicts, or lists of records, with their own time."""
    if are_records(content):
        times = [x for n, x in content[0].items() if is_time(n)]
        if times and not any(isinstance(x, list | np.ndarray) for x in times):
            yield name, content
            return
        for k, record in enumerate(content if len(content) <= _MOST_PARTS else ()):
            label = next((str(x) for n, x in record.items() if names_joints(n)), str(k))
            yield from _parts_in(record, (*name, label))
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
