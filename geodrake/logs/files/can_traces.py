"""Traces of a CAN bus, whose frames a DBC decodes: candump, Vector's .asc and .blf, PCAN's .trc."""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from geodrake.boundary.input_files import open_regular
from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import LogError
from geodrake.logs.files.joined_tables import YEARS, joined_tables
from geodrake.logs.files.packed_files import open_log
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import LogTable, readable

_ASC = rb"date .*\s+base +(hex|dec)"
BEGINNING = re.compile(
    rb"\s*(\([\d.: -]+\)\s+)?[\w-]+\s+[\dA-F]{3,8}(#|\s+\[\d+\] )|;\$FILEVERSION|" + _ASC
)
"""First bytes of traces in text."""

FIRST = 200
"""Bytes that show the format of a text."""

TRACES = (".blf", ".trc")
"""Suffixes of traces; those of text may also have others."""

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
    unknown, unfit, others = Counter[Key](), Counter[Key](), list[str]()
    with readable(path, "trace of a CAN bus", "Is it cut off? Remove the last frame."):
        decoding = optional_package("cantools.database", "logs", "traces of a CAN bus", LogError)
        for time, channel, key, data in _frames(path, others):
            if key not in messages:
                unknown[key] += 1
                continue
            try:
                signals = messages[key].decode(data, decode_choices=False)
            except (decoding.DecodeError, ValueError):
                unfit[key] += 1
                continue
            part = channel, key, tuple(signals)  # multiplexed frames have several
            rows.setdefault(part, []).append(tuple(map(float, signals.values())))
            times.setdefault(part, []).append(time)
    counts = f"{_listed(unknown)}, which {reading.dbc.name} lacks" if unknown else ""
    if not (rows or unknown or unfit):
        raise LogError(
            f"Log {str(path)!r} is a trace of a CAN bus without data frames"
            f"{f'; its first line is {others[0][:80]!r}' if others else ''}.",
            advice="Record it again, as with candump -l can0.",
        )
    if not rows:
        known = ", ".join(_hex(key) for key in [*messages][:_MOST_LISTED])
        raise LogError(
            f"No frame of log {str(path)!r} can be decoded: it has "
            f"{counts or f'{_listed(unfit)}, which do not fit'}; "
            f"the DBC has {known or 'no messages'}.",
            advice="Give the DBC of this robot and bus.",
        )
    notes = [f"there are frames with {counts}"] if counts else []
    if unfit:
        notes.append(
            f"frames with {_listed(unfit)} are not used: they are shorter than in the DBC, or of a "
            "page that it lacks"
        )
    if others:
        notes.append(
            f"lines without data frames are not used: {len(others)}, such as {others[0][:80]!r}"
        )
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
    with open_regular(path, "DBC", LogError) as file:
        encoding = "utf-8" if _is_utf8(file.read()) else None  # cantools expects cp1252 in a DBC
    try:
        return cantools.database.load_file(path, encoding=encoding, strict=False)
    except Exception as error:  # its parsers raise many types
        reason = " ".join(str(error).split())[:200]
        raise LogError(
            f"DBC {str(path)!r} cannot be read: {reason}.",
            advice="Give a DBC, KCD, SYM or ARXML file.",
        ) from error


def _is_utf8(content: bytes) -> bool:
    try:
        content.decode()
    except UnicodeDecodeError:
        return False
    return True


def _frames(path: Path, others: list[str]) -> Iterator[tuple[float, str, Key, bytes]]:
    """Yield time (s), channel, key and data of the data frames; append other lines to `others`."""
    if path.suffix.lower() == ".blf":
        can = optional_package("can", "logs", "traces of a CAN bus", LogError)
        with can.BLFReader(path) as frames:
            yield from _messages(frames)
        return
    with open_log(path) as file:
        is_asc = re.match(_ASC, file.read(FIRST))
    with open_log(path) as file, io.TextIOWrapper(file, errors="replace") as text:
        if is_asc:
            can = optional_package("can", "logs", "traces of a CAN bus", LogError)
            yield from _messages(can.ASCReader(text))
            return
        logreader = optional_package("cantools.logreader", "logs", "traces of a CAN bus", LogError)
        for line, frame in logreader.Parser(text).iterlines(keep_unknowns=True):
            if frame is None:
                others += [line] * (line.strip() != "" and not line.startswith(";"))
                continue
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


def _messages(frames: Any) -> Iterator[tuple[float, str, Key, bytes]]:
    """Yield time (s), channel, key and data of the data frames of a reader of python-can."""
    for frame in frames:
        if not (frame.is_error_frame or frame.is_remote_frame):
            key = frame.arbitration_id, bool(frame.is_extended_id)
            yield frame.timestamp, str(frame.channel), key, bytes(frame.data)


def _hex(key: Key) -> str:
    return f"0x{key[0]:X}"


def _listed(counts: Counter[Key]) -> str:
    """Return numbers of frames by id, the most frequent ones first."""
    each = [f"{_hex(key)} ({count})" for key, count in counts.most_common(_MOST_LISTED)]
    more = [f"{len(counts) - _MOST_LISTED} more"] if len(counts) > _MOST_LISTED else []
    return f"the ids {', '.join([*each, *more])}" if each else ""
