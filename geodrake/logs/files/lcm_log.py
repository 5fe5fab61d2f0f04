"""Logs of LCM: the status messages of Drake's robot drivers."""

from __future__ import annotations

import importlib
import os
import struct
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

from geodrake.boundary.input_files import open_regular
from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import LogError
from geodrake.logs.files.messages import JointMessages
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import LogTable, readable
from geodrake.logs.files.topics import Topic, chosen_topics, topics_table

MAGIC = b"\xed\xa1\xda\x01"
"""Magic number at the start of each event."""

_TYPES = ("lcmt_iiwa_status", "lcmt_jaco_status", "lcmt_panda_status")
_NEGATIVE = ("lcmt_iiwa_status",)
"""Types whose torques have the opposite sign to Drake's, by definition."""

_EVENT = struct.Struct(">4sQQII")  # begin, number, time, and lengths of a channel and its message
_LARGEST = 100_000_000  # bytes of a message, which the package lcm would take into memory
_FINGERPRINT = 8  # bytes of the type at the beginning of a message


def read_lcm(path: Path, reading: Reading) -> LogTable:
    """Return the columns of an LCM log; see `read_bag` for arguments.

    Channels are known by the types of their messages, whatever their names.
    """
    lcm = optional_package("lcm", "logs", "LCM logs", LogError)
    with open_regular(path, "log", LogError) as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise LogError(
                f"Log {str(path)!r} is not an LCM log: its first bytes differ.",
                advice="Record it with lcm-logger.",
            )
        file.seek(0)
        _check_sizes(path, file)
    with readable(path, "LCM log"):
        topics = _topics(lcm.EventLog(str(path), "r"), _types())
    topic, *others = chosen_topics(path, topics, reading)
    if others:
        raise LogError(
            f"Log {str(path)!r} has several requested channels, {', '.join(reading.topics)}, "
            "but only one can be read.",
            advice="Choose one.",
        )
    table = topics_table(path, [topic], topics, reading)
    if topic.kind not in _NEGATIVE:
        return table
    turned = {
        name: -numbers if name.startswith("effort[") else numbers
        for name, numbers in table.columns.items()
    }
    note = f"efforts have the opposite sign, as {topic.kind} defines torques"
    return replace(table, columns=turned, notes=(*table.notes, note))


def _check_sizes(path: Path, file: BinaryIO) -> None:
    """Raise a LogError if a message is too large."""
    while len(head := file.read(_EVENT.size)) == _EVENT.size:
        begin, number, _, channel, message = _EVENT.unpack(head)
        if begin != MAGIC:  # the package lcm looks for the next
            return
        if channel + message > _LARGEST:
            raise LogError(
                f"Message {number} of the log {str(path)!r} has {message / 1e6:.0f} MB; geodrake "
                f"reads up to {_LARGEST / 1e6:.0f} MB.",
                advice="Record again without such channels.",
            )
        file.seek(channel + message, os.SEEK_CUR)


def _types() -> Mapping[bytes, type]:
    """Return types of messages about joints, by their fingerprints."""
    drake = importlib.import_module("drake")
    found = [getattr(drake, name) for name in _TYPES]
    return {kind._get_packed_fingerprint(): kind for kind in found}


def _topics(events: Any, types: Mapping[bytes, type]) -> list[Topic]:
    """Return all channels with the content of their messages."""
    topics: dict[str, Topic] = {}
    for event in events:
        name, kind = event.channel, types.get(event.data[:_FINGERPRINT])
        if kind is None:
            topics.setdefault(name, Topic(name, "another type", JointMessages(name)))
            continue
        if name not in topics or not topics[name].made_for_joints:
            topics[name] = Topic(name, kind.__name__, JointMessages(name), True)
        topics[name].messages.add(_decoded(kind, event), 1000 * event.timestamp)
    return list(topics.values())


def _decoded(kind: Any, event: Any) -> Any:
    """Return the message of an event, or raise if it is not of its type."""
    try:
        return kind.decode(event.data)
    except (struct.error, ValueError) as error:
        raise LogError(
            f"Message {event.eventnum} of the log on channel {event.channel} is truncated or "
            f"damaged: {error}.",
            advice="Record again, or remove that message.",
        ) from error
