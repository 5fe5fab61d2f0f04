"""Choose the topics of a recording that form the log."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from geodrake.boundary.arguments import Array
from geodrake.errors import LogError, nearest
from geodrake.logs.files.grouped_arrays import are_records
from geodrake.logs.files.joined_tables import joined_tables
from geodrake.logs.files.messages import (
    NUMBERS,
    BaseMessages,
    JointMessages,
    Messages,
    is_complete,
    on_clock,
    stamp_of,
)
from geodrake.logs.files.name_rules import is_time, meaning_of, names_joints, plain_words
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import LogTable, date_of, number_in
from geodrake.logs.files.units import WORDS
from geodrake.logs.time_stamps import time_unit

_MOST_LISTED = 8
Received = tuple[str, str, Any, int]
"""Topic, type, message, and time of receipt (ns)."""


def topics_of(messages: Iterable[Received]) -> list[JointMessages]:
    """Group messages by topic."""
    topics = dict[str, JointMessages]()
    for name, kind, message, received in messages:
        topics.setdefault(name, JointMessages(name, kind)).add(message, received)
    return list(topics.values())


_TOPIC, _INSIDE = WORDS["topic"].split(), WORDS["inside"].split()


def messages_table(path: Path, records: Any, reading: Reading) -> LogTable | None:
    """Return a table if records are messages of several topics or joints, else None."""
    if not are_records(records):
        return None
    messages = [*map(_topic_and_message, records)]
    names = (x for _, each in messages for n, x in each.items() if names_joints(n))
    lists = (x for x in names if isinstance(x, list) and all(isinstance(n, str) for n in x))
    name_lists = {tuple(sorted(x)) for x in lists}
    if len({topic for topic, _ in messages}) < 2 and len(name_lists) < 2:
        return None
    clock = next((n for n, x in records[0].items() if is_time(n) and not isinstance(x, dict)), "")
    times = np.array([_seconds(each.get(clock)) for each in records])
    unit = time_unit("", times)
    stamps = np.rint(times * 1e9 * (unit[0] if unit else 1.0)).astype(np.int64).tolist()
    received = stamps if clock else [stamp_of(message) for _, message in messages]
    pairs = zip(messages, received, strict=True)
    topics = topics_of((name or "records", "messages", x, time) for (name, x), time in pairs)
    if not any(topic.quantities for topic in topics):
        return None
    return topics_table(path, chosen_topics(path, topics, reading), topics, reading)


def _seconds(value: Any) -> float:
    """Return a number, or a date in s since 1970; 0 for other values."""
    date = date_of(value) if isinstance(value, str) else None
    return (number_in(value) or 0.0) if date is None else 1e-9 * date


def _topic_and_message(record: Mapping[str, Any]) -> tuple[str, Mapping[str, Any]]:
    """Split a record into its topic, or "", and the message."""
    topic = next((x for name in _TOPIC if isinstance(x := record.get(name), str)), "")
    inside = next((x for name in _INSIDE if isinstance(x := record.get(name), Mapping)), None)
    return (topic, record) if inside is None or not topic else (topic, inside)


def chosen_topics(
    path: Path, topics: Sequence[JointMessages], reading: Reading
) -> tuple[JointMessages, ...]:
    """Return the topics that form the log."""
    if not topics:
        raise LogError(f"Log {str(path)!r} has no messages.", advice="Check how it was recorded.")
    names = {topic.topic.strip("/") for topic in topics}
    joint_words = [plain_words(str(joint)) for topic in topics for joint in topic.joints]
    requested = [
        name  # without words of joint names, which select one of two robots
        for name in reading.topics
        if name.strip("/") in names
        or not any(set() < plain_words(name) <= words for words in joint_words)
    ]
    if requested:
        return tuple(_named(path, topics, name, alone=len(requested) == 1) for name in requested)
    best = _best([topic for topic in topics if topic.fits])
    if len(best) == 1:
        return (best[0],)
    if best:
        raise LogError(
            f"Log {str(path)!r} has {len(best)} topics with joint positions and efforts: "
            f"{_listed(best)}.",
            advice=f"Choose one, as in --topic {best[0].topic}, or several of different arms.",
        )
    return _parts(path, topics)


def _best(topics: Sequence[JointMessages]) -> Sequence[JointMessages]:
    """Return the topics with efforts, if any, and among them those only for joint states."""
    driven = [topic for topic in topics if topic.has_efforts] or topics
    return [topic for topic in driven if topic.made_for_joints] or driven


def _parts(path: Path, topics: Sequence[JointMessages]) -> tuple[JointMessages, JointMessages]:
    """Return a topic of positions and one of efforts or commands, if no topic has both."""
    named = [t for t in topics if any(isinstance(joint, str) for joint in t.joints)]
    moved = _best([topic for topic in named or topics if "position" in topic.part])
    driven = _best([t for t in topics if is_complete(("position", *t.part)) and t not in moved])
    if len(moved) == len(driven) == 1:
        return moved[0], driven[0]
    advice = (
        "Record joint states with efforts, such as sensor_msgs/JointState, a controller state with "
        "positions and commands, or commands in addition to joint states."
    )
    if moved and driven:
        advice = (
            "Choose one of positions and one of efforts or commands, to join them by time, as in "
            f"--topic {moved[0].topic} --topic {driven[0].topic}."
        )
    raise LogError(
        f"Log {str(path)!r} has no topic with both joint positions and efforts; it has "
        f"{_listed(topics)}.",
        advice=advice,
    )


def _named(path: Path, topics: Sequence[JointMessages], name: str, *, alone: bool) -> JointMessages:
    """Return a topic by its name; if `alone`, it must have positions and efforts."""
    matching = [topic for topic in topics if topic.topic.strip("/") == name.strip("/")]
    if matching and (matching[0].fits if alone else matching[0].part):
        return matching[0]
    if matching:
        lacks = "lacks positions or efforts of" if alone else "has no"
        fitting = [topic for topic in topics if (topic.fits if alone else topic.part)]
        raise LogError(
            f"Topic {matching[0]} of log {str(path)!r} {lacks} joints.",
            advice=f"Topics with them: {_listed(fitting)}." if fitting else "No topic has them.",
        )
    raise LogError(
        f"Log {str(path)!r} has no topic {name!r}; it has {_listed(topics)}.",
        advice=f"{nearest(name, [topic.topic for topic in topics], 1)}Use names from the bag or "
        "LCM log; by default the best match is read.",
    )


def _listed(topics: Sequence[JointMessages]) -> str:
    ordered = sorted(topics, key=lambda topic: (not topic.fits, not topic.part))
    more = f" … ({len(topics)} in total)" if len(topics) > _MOST_LISTED else ""
    return ", ".join(map(str, ordered[:_MOST_LISTED])) + more


_CLOSER = 2.0  # least ratio of distances of an unnamed command to other joints and its own


def topics_table(
    path: Path,
    chosen: Sequence[JointMessages],
    topics: Sequence[JointMessages],
    reading: Reading,
    base: Sequence[BaseMessages] = (),
) -> LogTable:
    """Join topics at the time stamps of the slowest; the first one of duplicate columns is used.

    Messages without stamps are moved to the clock of those with stamps, assuming no mean delay to
    the recorder. `base` contains the data of a floating base and its feet.
    """
    is_alone, sources = len(chosen) == 1, ", ".join(f"{t.topic} ({t.kind})" for t in chosen)
    if is_alone and not chosen[0].fits:  # possible if only the first messages fit
        raise LogError(f"Topic {chosen[0]} of log {str(path)!r} has no positions with efforts.")
    alternatives = [
        other.topic
        for other in topics
        if is_alone and other.topic != chosen[0].topic
        if other.fits and other.has_efforts >= chosen[0].has_efforts
    ]
    hint = f"; {', '.join(alternatives)} would also match (--topic)" if alternatives else ""
    remarks = [f"read from {sources}{hint}"]
    if any(topic.from_controller for topic in chosen):
        remarks.append("there are no measured efforts: the controller's output is used")
    made: list[tuple[Messages, list[LogTable]]] = [
        (topic, _part_tables(topic, part=not is_alone)) for topic in chosen
    ]
    made += [(each, each.tables()) for each in base]
    clock = next(filter(None, (messages.clock for messages, _ in made)), None)
    names = [{n for t in tables for n in t.columns} - {"time"} for _, tables in made]
    if len(names) > 1 and names[0] and all(each == names[0] for each in names):  # such as two arms
        made = [(messages, [t.under(f"{messages.topic}/") for t in own]) for messages, own in made]
    tables = list[LogTable]()
    for messages, own in made:
        remarks += messages.clock_notes
        is_bare = len(made) > 1 and not messages.clock
        tables += [on_clock(table, clock) for table in own] if is_bare else own
    table = joined_tables(path, tables, reading)
    columns, notes = _named_by_motion(table.columns) if not is_alone else (table.columns, [])
    return replace(table, columns=columns, notes=(*remarks, *table.notes, *notes))


def _part_tables(topic: JointMessages, *, part: bool) -> list[LogTable]:
    """Return the tables of a topic, with unique names if it is a part of a log."""
    tables = topic.tables(part=part)
    if not part:
        return tables
    parts = []
    for table in tables:
        columns = table.columns
        if "command" in topic.part and topic.is_wanted:
            columns = _commands(columns)
        named = {
            f"{topic.topic}/{n}" if n.startswith(NUMBERS) else n: c for n, c in columns.items()
        }
        path = Path(topic.topic) if len(tables) == 1 else table.path
        parts.append(replace(table, path=path, columns=named))
    return parts


def _commands(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Rename the positions of command messages to commands; return all columns if none."""
    commands = {}
    for name, column in columns.items():
        joint, dot, _ = name.rpartition(".position")
        if dot or name.startswith("position["):
            commands[f"{joint}.command" if dot else name.replace("position", "command")] = column
    return {"time": columns["time"], **commands} if commands else dict(columns)


def _named_by_motion(columns: Mapping[str, Array]) -> tuple[dict[str, Array], list[str]]:
    """Assign unnamed commands to the joints that follow them, if unambiguous."""
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
    squares = np.array([np.sum((q - each) ** 2, axis=1) for each in c])
    nearest, ordered = np.argmin(squares, axis=1), np.sort(squares, axis=1)
    is_clear = len(joints) == 1 or bool((ordered[:, 1] > _CLOSER**2 * ordered[:, 0]).all())
    if len(set(nearest.tolist())) < len(bare) or not is_clear:
        return kept, []
    names = {name: f"{joints[k]}.command" for name, k in zip(bare, nearest.tolist(), strict=True)}
    words = ", ".join(f"{old} of {new.removesuffix('.command')}" for old, new in names.items())
    renamed = {names.get(name, name): column for name, column in columns.items()}
    return renamed, [f"unnamed commands are assigned to the joints that follow them: {words}"]
