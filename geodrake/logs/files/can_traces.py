"""Traces of a CAN bus, whose frames a DBC decodes: candump, Vector's .asc and .blf, PCAN's .trc."""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from geodrake.boundary.input_files import regular_file
from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import LogError
from geodrake.logs.files.joined_tables import YEARS, joined_tables
from geodrake.logs.files.packed_files import open_log, unpacked
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import LogTable, readable

BEGINNING = re.compile(
    rb"\s*(\([\d.: -]+\)\s+)?\w+\s+[\dA-F]{3,8}(#|\s+\[\d+\] )"
    rb"|date .*\s+base +(hex|dec)|;\$FILEVERSION"
)
"""First bytes of traces in text."""

TRACES = (".blf", ".trc")
"""Suffixes of traces; those of text may also have others."""

_OF_VECTOR = (".asc", ".blf")
_MOST_LISTED = 8  # ids in messages

Key = tuple[int, bool]
"""Id of a frame, and whether it has 29 bits."""


def read_trace(path: Path, reading: Reading) -> LogTable:
    """Read the signals of a trace, joined by time, with the names and units of a DBC."""
    if reading.dbc is None:
        raise LogError(
            f"Log {str(path)!r} is a trace of a CAN bus, in whose frames numbers are packed.",
            advice="Give the file that says how, the robot's DBC: --dbc robot.dbc.",
        )
    messages = {(m.frame_id, m.is_extended_frame): m for m in _database(reading.dbc).messages}
    rows, times = dict[Any, list[tuple[float, ...]]](), dict[Any, list[float]]()
    unknown, short = Counter[Key](), Counter[Key]()
    with readable(path, "trace of a CAN bus", "Is it cut off? Remove the last frame."):
        decoding = optional_package("cantools.database", "logs", "traces of a CAN bus", LogError)
        for time, channel, key, data in _frames(path):
            if key not in messages:
                unknown[key] += 1
                continue
            try:
                signals = messages[key].decode(data, decode_choices=False)
            except (decoding.DecodeError, ValueError):
                short[key] += 1
                continue
            part = channel, key, tuple(signals)  # multiplexed frames have several
            rows.setdefault(part, []).append(tuple(map(float, signals.values())))
            times.setdefault(part, []).append(time)
    counts = f"{_listed(unknown)}, which {reading.dbc.name} lacks" if unknown else ""
    if not rows:
        known = ", ".join(_hex(key) for key in [*messages][:_MOST_LISTED])
        raise LogError(
            f"No frame of log {str(path)!r} can be decoded: it has "
            f"{counts or _listed(short) or 'none'}; the DBC has {known or 'no messages'}.",
            advice="Give the DBC of this robot and bus.",
        )
    notes = [f"there are frames with {counts}"] if counts else []
    if short:
        notes.append(f"frames with {_listed(short)} are shorter than in the DBC, and not used")
    channels = Counter(key for _, key in {(channel, key) for channel, key, _ in rows})
    decoded = {key: messages[key] for _, key, _ in rows}
    owners = Counter(name for m in decoded.values() for name in {s.name for s in m.signals})
    tables, first = list[LogTable](), min(each[0] for each in times.values())
    date = round(1e9 * first) if first > YEARS else None  # stamps of traces may begin at 0
    for (channel, key, names), values in rows.items():
        message = decoded[key]
        units = {signal.name: signal.unit or "" for signal in message.signals}
        full = {name: name if owners[name] == 1 else f"{message.name}.{name}" for name in names}
        columns = dict(zip(full.values(), np.array(values).T, strict=True))
        stated = {full[name]: units[name] for name in names if units[name]}
        columns = {"time": np.array(times[channel, key, names]) - first, **columns}
        table = LogTable(Path(message.name), columns, stated, origins={"time": date})
        tables.append(table.under(f"{channel}/") if channels[key] > 1 else table)
    return joined_tables(path, tables, reading).noting(*notes)


def _database(path: Path) -> Any:
    """Return the messages of a DBC, or of another format that cantools reads."""
    cantools = optional_package("cantools", "logs", "traces of a CAN bus", LogError)
    try:
        return cantools.database.load_file(regular_file(path, "DBC", LogError), strict=False)
    except LogError:
        raise
    except Exception as error:  # its parsers raise many types
        reason = " ".join(str(error).split())[:200]
        raise LogError(
            f"DBC {str(path)!r} cannot be read: {reason}.",
            advice="Give a DBC, KCD, SYM or ARXML file.",
        ) from error


def _frames(path: Path) -> Iterator[tuple[float, str, Key, bytes]]:
    """Yield time (s), channel, key and data of the data frames."""
    if unpacked(path).suffix.lower() in _OF_VECTOR:
        can = optional_package("can", "logs", "traces of a CAN bus", LogError)
        with can.LogReader(path) as frames:
            for frame in frames:
                if not (frame.is_error_frame or frame.is_remote_frame):
                    key = frame.arbitration_id, bool(frame.is_extended_id)
                    yield frame.timestamp, str(frame.channel), key, bytes(frame.data)
        return
    logreader = optional_package("cantools.logreader", "logs", "traces of a CAN bus", LogError)
    with open_log(path) as file, io.TextIOWrapper(file, errors="replace") as text:
        for frame in logreader.Parser(text):
            stamp = frame.timestamp
            if stamp is None:
                raise LogError(
                    f"Log {str(path)!r} has frames without time.",
                    advice="Record with time stamps: candump -l can0.",
                )
            if not frame.is_remote_frame:
                time = stamp.timestamp() if hasattr(stamp, "timestamp") else stamp.total_seconds()
                key = frame.frame_id, bool(frame.is_extended_frame)
                yield time, frame.channel, key, frame.data


def _hex(key: Key) -> str:
    return f"0x{key[0]:X}"


def _listed(counts: Counter[Key]) -> str:
    """Return numbers of frames by id, the most frequent ones first."""
    each = [f"{_hex(key)} ({count})" for key, count in counts.most_common(_MOST_LISTED)]
    more = [f"{len(counts) - _MOST_LISTED} more"] if len(counts) > _MOST_LISTED else []
    return f"the ids {', '.join([*each, *more])}" if each else ""
