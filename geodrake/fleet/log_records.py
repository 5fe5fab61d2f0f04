"""What a fleet remembers of each log: one small file, so that nothing is read a second time.

A record holds where the log was, its stamp, and which digest is of it. It stays when the log is
deleted, as its digest does: a fleet's history is that of its digests.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

from geodrake.boundary.input_files import read_regular
from geodrake.boundary.whole_files import made_folder, write_whole
from geodrake.errors import FleetError
from geodrake.fleet.fleet_file import FleetRobot
from geodrake.fleet.log_places import LogPlace, fits
from geodrake.fleet.model_hash import text_hash

DIGESTS = "digests"
"""Name of the folder of a type's digests."""

_FOLDER = "logs"
_LETTERS = 24  # of a file's name
_NAME = 40  # letters of a robot's name in that of its folder


@dataclass(frozen=True)
class LogRecord:
    """What became of a log of a robot.

    Attributes:
        stamp: Its size and when it was changed; empty if it is to be digested again.
        said: Hash of what the fleet file says of it: how it is dated, and what the robot carried.
        digest: Name of its digest's file; empty if there is none.
        date: When it began, s since 1970; 0 if nobody knows.
        reason: Why there is no digest.
    """

    robot: str
    address: str
    stamp: str
    said: str
    digest: str = ""
    date: float = 0.0
    reason: str = ""


def record_file(folder: Path, robot: str, address: str) -> Path:
    """Return where the record of a log is."""
    return robot_folder(folder, robot) / f"{text_hash(address)[:_LETTERS]}.json"


def robot_folder(folder: Path, robot: str) -> Path:
    """Return where the records of a robot's logs are: a name that any file system takes."""
    plain = re.sub(r"[^\w-]", "_", robot, flags=re.ASCII)[:_NAME]
    return folder / _FOLDER / f"{plain}-{text_hash(robot)[:8]}"


def said_of(robot: FleetRobot) -> str:
    """Hash of what the fleet file says of a robot's logs."""
    return text_hash((robot.dates, robot.payloads))[:_LETTERS]


def write_record(folder: Path, record: LogRecord) -> None:
    """Write a record.

    Raises:
        OutputError: It cannot be written.
    """
    path = record_file(folder, record.robot, record.address)
    with made_folder(path.parent):
        write_whole(path, json.dumps(asdict(record), indent=1) + "\n")


def look_again(folder: Path, record: LogRecord) -> None:
    """Have a log digested again when it is looked for next, if it is there: its digest is damaged.

    Raises:
        OutputError: That cannot be written.
    """
    write_record(folder, replace(record, stamp=""))


def read_records(folder: Path, robot: FleetRobot) -> dict[str, LogRecord]:
    """Address -> record of a robot's logs that have a digest, of those that its patterns fit.

    One that is damaged, or was said otherwise, is none: its log is looked at again.
    """
    try:
        files = sorted(robot_folder(folder, robot.name).glob("*.json"))
    except OSError:
        return {}
    found = (_read(file) for file in files)
    said = said_of(robot)
    return {
        record.address: record
        for record in found
        if record is not None
        and record.robot == robot.name
        and record.said == said
        and any(fits(record.address, pattern) for pattern in robot.logs)
    }


def _read(path: Path) -> LogRecord | None:
    try:
        said = json.loads(read_regular(path, "record", FleetError))
        types = {f.name: float if f.name == "date" else str for f in fields(LogRecord)}
        values = {name: said[name] for name in types}
    except (FleetError, ValueError, KeyError, TypeError):
        return None
    if not all(isinstance(value, types[name]) for name, value in values.items()):
        return None
    return LogRecord(**values)


def changed_logs(places: Sequence[LogPlace], known: Mapping[str, LogRecord]) -> list[LogPlace]:
    """Logs that are not as they were when their digests were made, and those that are new."""
    return [
        place
        for place in places
        if place.address not in known or known[place.address].stamp != place.stamp
    ]
