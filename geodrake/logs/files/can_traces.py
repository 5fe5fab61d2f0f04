"""Traces of a CAN bus, whose frames a DBC decodes: candump, Vector's .asc and .blf, PCAN's .trc."""

from __future__ import annotations

import io
import logging
import re
from array import array
from collections import Counter
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from geodrake.boundary.input_files import open_regular
from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import LogError
from geodrake.logs.files.joined_tables import YEARS, joined_tables
from geodrake.logs.files.packed_files import open_log
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import LogTable, readable

_READERS = {"ASCReader": rb"date .*\s+base +(hex|dec)", "CSVReader": b"timestamp,arbitration_id,"}
"""Reader of python-can -> the beginning of its text."""

BEGINNING = re.compile(
    rb"\s*(\([\d.: -]+\)\s+)?[\w-]+\s+[\dA-F]{3,8}(#|\s+\[\d+\] )|;\$FILEVERSION|"
    + b"|".join(_READERS.values())
)
"""First bytes of traces in text."""

FIRST = 200
"""Bytes that show the format of a text."""

TRACES = (".blf", ".trc")
"""Suffixes of traces; those of text may also have others."""

_MOST_LISTED = 8  # ids in messages
_MOST_BACK = 0.01  # share of frames that are earlier than the one before
_LONGEST_PAUSE = 1.0  # s, between frames
_SOURCE, _LEAST_BROADCAST = 0xFF, 240  # in ids of SAE J1939
_FRAME = re.compile(r"\s*\d+\.\d+\s+\S+\s+[\dA-Fa-f]+x?\b")  # beginning of a frame in .asc

Key = tuple[int, bool]
"""Id of a frame, and whether it has 29 bits."""


def read_trace(path: Path, reading: Reading) -> LogTable:
    """Read the signals of a trace, joined by time, with the names and units of a DBC."""
    if reading.dbc is None:
        raise LogError(
            f"Log {str(path)!r} is a trace of a CAN bus, in whose frames numbers are packed.",
            advice="Give the file that says how, the robot's DBC: --dbc robot.dbc.",
        )
    dbc, clock = _Messages(reading.dbc), array("d")
    rows, times = dict[Any, list[tuple[float, ...]]](), dict[Any, list[int]]()
    unknown, unfit, others = Counter[Key](), Counter[Key](), list[str]()
    with readable(path, "trace of a CAN bus", "Is it cut off? Remove the last frame."):
        decoding = optional_package("cantools.database", "logs", "traces of a CAN bus", LogError)
        for time, channel, key, data in _frames(path, others):
            clock.append(time)
            if (message := dbc.message(key)) is None:
                unknown[key] += 1
                continue
            try:
                signals = message.decode(data, decode_choices=False)
            except (decoding.DecodeError, ValueError):
                unfit[key] += 1
                continue
            sender = channel if key in dbc.ids else f"{channel}/{key[0] & _SOURCE:02X}"
            part = sender, message, tuple(signals)  # multiplexed frames have several
            rows.setdefault(part, []).append(tuple(map(float, signals.values())))
            times.setdefault(part, []).append(len(clock) - 1)
    counts = f"{_listed(unknown)}, which {reading.dbc.name} lacks" if unknown else ""
    if not (rows or unknown or unfit):
        raise LogError(
            f"Log {str(path)!r} is a trace of a CAN bus without data frames"
            f"{f'; its first line is {others[0][:80]!r}' if others else ''}.",
            advice="Record it again, as with candump -l can0.",
        )
    if not rows:
        known = ", ".join(_hex(key) for key in [*dbc.ids][:_MOST_LISTED])
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
    stamps = np.array(clock)
    if np.mean(np.diff(stamps) < 0.0) > _MOST_BACK and stamps.max() < _LONGEST_PAUSE:
        stamps = np.cumsum(stamps)
        notes.append("time stamps are times since the frame before: added up")
    senders = Counter(message for _, message in {(sender, message) for sender, message, _ in rows})
    owners = Counter(name for message in senders for name in {s.name for s in message.signals})
    tables, first = list[LogTable](), min(float(stamps[each[0]]) for each in times.values())
    date = round(1e9 * first) if first > YEARS else None  # stamps of traces may begin at 0
    for (sender, message, names), values in rows.items():
        units = {signal.name: signal.unit or "" for signal in message.signals}
        full = {name: name if owners[name] == 1 else f"{message.name}.{name}" for name in names}
        columns = dict(zip(full.values(), np.array(values).T, strict=True))
        stated = {full[name]: units[name] for name in names if units[name]}
        columns = {"time": stamps[times[sender, message, names]] - first, **columns}
        table = LogTable(Path(message.name), columns, stated, origins={"time": date})
        tables.append(table.under(f"{sender}/") if senders[message] > 1 else table)
    return joined_tables(path, tables, reading).noting(*notes)


def _database(path: Path) -> Any:
    """Return the messages of a DBC, or of another format that cantools reads."""
    cantools = optional_package("cantools", "logs", "traces of a CAN bus", LogError)
    with open_regular(path, "DBC", LogError) as file:
        encoding = "utf-8" if _is_utf8(file.read()) else None  # cantools expects cp1252 in a DBC
    logger = logging.getLogger("cantools")
    level = logger.level
    logger.setLevel(logging.ERROR)  # it warns of messages with the same id
    try:
        return cantools.database.load_file(path, encoding=encoding, strict=False)
    except Exception as error:  # its parsers raise many types
        reason = " ".join(str(error).split())[:200]
        raise LogError(
            f"DBC {str(path)!r} cannot be read: {reason}.",
            advice="Give a DBC, KCD, SYM or ARXML file.",
        ) from error
    finally:
        logger.setLevel(level)


class _Messages:
    """Messages of a DBC by their ids, and by their groups of parameters in SAE J1939."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.ids, self.groups = dict[Key, list[Any]](), dict[int, Any]()
        for message in _database(path).messages:
            self.ids.setdefault((message.frame_id, message.is_extended_frame), []).append(message)
            if message.protocol == "j1939":
                self.groups[_group_of(message.frame_id)] = message

    def message(self, key: Key) -> Any:
        """Return the message of a frame; None if the DBC lacks it."""
        found = self.ids.get(key, ())
        if len(found) > 1:
            names = " and ".join(message.name for message in found)
            raise LogError(
                f"DBC {str(self.path)!r} has several messages with the id {_hex(key)}: {names}.",
                advice="Remove those that this robot does not send.",
            )
        return found[0] if found else self.groups.get(_group_of(key[0])) if key[1] else None


def _group_of(number: int) -> int:
    """Return the group of parameters in an id of SAE J1939, without priority and addresses."""
    is_addressed = number >> 16 & 0xFF < _LEAST_BROADCAST
    return number & (0x3FF0000 if is_addressed else 0x3FFFF00)


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
        head = file.read(FIRST)
    if reader := next((name for name, form in _READERS.items() if re.match(form, head)), ""):
        can = optional_package("can", "logs", "traces of a CAN bus", LogError)
        with open_log(path) as file, _PassedLines(file) as lines:
            for each in chain(_messages(getattr(can, reader)(lines)), [None]):
                skipped, lines.passed = lines.passed[: -1 if each else None], []
                others += [line.strip() for line in skipped if _FRAME.match(line)]
                if each:
                    yield each
        return
    with open_log(path) as file, io.TextIOWrapper(file, errors="replace") as text:
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


class _PassedLines(io.TextIOWrapper):
    """Lines of a text, with those that were read since `passed` was emptied."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file, errors="replace")
        self.passed = list[str]()

    def __iter__(self) -> Iterator[str]:  # type: ignore[override]
        for line in iter(self.readline, ""):
            self.passed.append(line)
            yield line


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
