"""Topics of a bag that are parts of one log, as positions and commands are: joined by time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.logs.files.joined_tables import joined_tables
from geodrake.logs.files.joint_messages import NUMBERS, MessageRows
from geodrake.logs.files.joint_series import joint_columns
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.recognition import meaning_of
from geodrake.logs.files.table import LogTable
from geodrake.logs.files.topics import Topic

Array = NDArray[np.float64]

_CLOSER = 2.0  # times as close to its joint as to any other a command is that has no name


def joined_topics(path: Path, topics: Sequence[Topic], reading: Reading) -> LogTable:
    """The columns of several topics, at the instants of the one with the fewest messages a second.

    Of a column that two have, that of the first is taken. Messages without stamps are put on the
    clock of those with: on average they take no time from there to the recorder.

    Raises:
        LogError: Messages of a topic do not go together, or topics do not meet in time, or one has
            more than ten times the messages a second of another.
    """
    spoken = [(topic, topic.rows) for topic in topics if topic.rows is not None]
    clock = next((rows for _, rows in spoken if rows.all_stamped), None)
    tables: list[LogTable] = []
    for topic, rows in spoken:
        table = _table(topic, rows)
        if clock is not None and not rows.all_stamped:
            table = _on_clock(table, clock)
        known = {name for each in tables for name in each.columns} - {"time"}
        new = {name: column for name, column in table.columns.items() if name not in known}
        tables.append(replace(table, columns=new))
    read = ", ".join(f"{topic.name} ({topic.kind})" for topic, _ in spoken)
    table = joined_tables(path, tables, reading)
    columns, notes = _named_by_motion(table.columns)
    return replace(table, columns=columns, notes=(f"read from {read}", *table.notes, *notes))


def _table(topic: Topic, rows: MessageRows) -> LogTable:
    """The columns of one topic, and what was noticed."""
    columns, notes, origin = joint_columns(rows.series(), topic.name, part=True)
    if "command" in topic.part and topic.is_wanted:
        columns = _commands(columns)
    columns = {f"{topic.name}/{n}" if n.startswith(NUMBERS) else n: c for n, c in columns.items()}
    if not rows.all_stamped:
        notes = (*notes, f"messages of {topic.name} have no stamps: their time is that of receipt")
    return LogTable(Path(topic.name), columns, notes=notes, origins={"time": origin})


def _commands(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Positions that are wanted, as commands, and no more; all columns where there are none."""
    found = {}
    for name, column in columns.items():
        joint, dot, _ = name.rpartition(".position")
        if dot or name.startswith("position["):
            found[f"{joint}.command" if dot else name.replace("position", "command")] = column
    return {"time": columns["time"], **found} if found else dict(columns)


def _on_clock(table: LogTable, clock: MessageRows) -> LogTable:
    """A table of times of receipt, at stamps that others had when they were received."""
    stamps, received = clock.clock
    if len(stamps) < 2:
        return table
    since = 1e-9 * (received - received[0])
    line = np.polyfit(since, 1e-9 * (stamps - stamps[0]), 1)
    time = table.columns["time"] + 1e-9 * (table.origins["time"] - int(received[0]))
    columns = {**table.columns, "time": np.asarray(np.polyval(line, time), float)}
    return replace(table, columns=columns, origins={"time": int(stamps[0])})


def _named_by_motion(columns: Mapping[str, Array]) -> tuple[dict[str, Array], list[str]]:
    """Commands without names get that of the joint which follows them, if that is clear."""
    joints = [name.removesuffix(".position") for name in columns if name.endswith(".position")]
    told = {name: meaning_of(name) for name in columns}
    bare = [n for n, m in told.items() if m is not None and m.quantity == "command" and not m.joint]
    kept = dict(columns)
    if not bare or not joints:
        return kept, []
    q, c = (
        np.stack([columns[n] for n in names]) for names in ([f"{j}.position" for j in joints], bare)
    )
    q, c = (each[:, np.isfinite(q).all(axis=0) & np.isfinite(c).all(axis=0)] for each in (q, c))
    apart = np.array([np.sum((q - each) ** 2, axis=1) for each in c])
    nearest, ordered = np.argmin(apart, axis=1), np.sort(apart, axis=1)
    clear = len(joints) == 1 or bool((ordered[:, 1] > _CLOSER**2 * ordered[:, 0]).all())
    if len(set(nearest.tolist())) < len(bare) or not clear:
        return kept, []
    names = {name: f"{joints[k]}.command" for name, k in zip(bare, nearest.tolist(), strict=True)}
    words = ", ".join(f"{old} of {new.removesuffix('.command')}" for old, new in names.items())
    found = {names.get(name, name): column for name, column in columns.items()}
    return found, [f"commands without names are of the joints that follow them: {words}"]
