"""Logs of LCM: the status messages of Drake's robot drivers."""

from __future__ import annotations

import importlib
import struct
from dataclasses import replace
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

from geodrake.boundary.input_files import open_regular
from geodrake.errors import LogError
from geodrake.logs.files.messages import LCM_TYPES, JointMessages
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import LogTable, readable
from geodrake.logs.files.topics import chosen_topics, topics_table

MAGIC = b"\xed\xa1\xda\x01"
"""Magic number at the start of each event."""

_NEGATIVE = ("lcmt_iiwa_status",)
"""Types whose torques have the opposite sign to Drake's, by definition."""

_EVENT = struct.Struct(">4sQQII")  # begin, number, time, and lengths of a channel and its message
_FINGERPRINT = 8  # bytes of the type at the beginning of a message


def read_lcm(path: Path, reading: Reading) -> LogTable:
    """Return the columns of an LCM log; see `read_bag` for arguments.

    Channels are known by the types of their messages, whatever their names.
    """
    with readable(path, "LCM log"), open_regular(path, "log", LogError) as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise LogError(
                f"Log {str(path)!r} is not an LCM log: its first bytes differ.",
                advice="Record it with lcm-logger.",
            )
        with mmap(file.fileno(), 0, access=ACCESS_READ) as log:
            topics = _topics(log)
    chosen = chosen_topics(path, topics, reading)
    table = topics_table(path, chosen, topics, reading)
    turned = dict.fromkeys(topic.kind for topic in chosen if topic.kind in _NEGATIVE)
    notes = [f"efforts have the opposite sign, as {kind} defines torques" for kind in turned]
    return replace(table, notes=(*table.notes, *notes))


def _topics(log: mmap) -> list[JointMessages]:
    """Return all channels with the content of their messages; one cut off at the end is left."""
    kinds = [getattr(importlib.import_module("drake"), name) for name in LCM_TYPES]
    types = {kind._get_packed_fingerprint(): kind for kind in kinds}
    topics: dict[str, JointMessages] = {}
    at = 0
    while 0 <= at <= len(log) - _EVENT.size:
        _, number, received, of_name, of_message = _EVENT.unpack_from(log, at)
        begin = at + _EVENT.size + of_name
        name = log[at + _EVENT.size : begin].decode(errors="replace")
        kind: Any = types.get(log[begin : begin + _FINGERPRINT])
        if (end := begin + of_message) > len(log):
            break
        at = log.find(MAGIC, end)
        if kind is None:
            topics.setdefault(name, JointMessages(name, "another type"))
            continue
        if name not in topics or not topics[name].made_for_joints:
            topics[name] = JointMessages(name, kind.__name__)
        try:
            message = kind.decode(log[begin:end])
        except (struct.error, ValueError) as error:
            raise LogError(
                f"Message {number} of the log on channel {name} is truncated or damaged: {error}.",
                advice="Record again, or remove that message.",
            ) from error
        for field in kind.__slots__ if kind.__name__ in _NEGATIVE else ():
            if "torque" in field:
                setattr(message, field, [-torque for torque in getattr(message, field)])
        topics[name].add(message, 1000 * received)
    return list(topics.values())
