"""The logs of a fleet: their paths, their digests, and a record of each.

A record is a small file with the address and stamp of a log, and the name of its digest, so that
logs are read only once. Records and digests are kept when a log is deleted: a fleet's history is
that of its digests.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from operator import attrgetter
from pathlib import Path

import msgspec

from geodrake.boundary.input_files import read_regular
from geodrake.boundary.showing import Short
from geodrake.boundary.whole_files import made_folder, write_whole
from geodrake.errors import ArgumentError, DigestError, FleetError, GeodrakeError, OutputError
from geodrake.fleet.digest_folder import FAILED, Progress, check_settings, digest_logs
from geodrake.fleet.fleet_file import Fleet, FleetRobot, FleetType
from geodrake.fleet.hashes import text_hash
from geodrake.fleet.log_places import (
    DATED_BY,
    IN_THIS_PROCESS,
    LogPlace,
    UnreachableLogError,
    date_in_path,
    find_logs,
    fits,
    local_log,
)
from geodrake.fleet.settings import DigestSettings, read_settings
from geodrake.fleet.type_layout import own_model, type_source
from geodrake.fleet.workers import Workers
from geodrake.model.carried_payloads import carried_phi
from geodrake.model.robot_model import RobotModel

DIGESTS = "digests"
"""Name of the folder of a type's digests."""

_FOLDER = "logs"
_LETTERS = 24  # of a file's name
_NAME = 40  # letters of a robot's name in the name of its folder


@dataclass(frozen=True)
class LogRecord:
    """Result for a log of a robot."""

    robot: str
    address: str
    stamp: str  # size and time of change; empty if it has to be digested again
    said: str  # hash of its entry in the fleet file: dates and payloads
    digest: str = ""  # name of its digest file; empty without one
    date: float = 0.0  # start of the log, s since 1970; 0 if unknown
    reason: str = ""


def robot_folder(folder: Path, robot: str) -> Path:
    """Return the folder of a robot's records, with a name valid on any file system."""
    plain = re.sub(r"[^\w-]", "_", robot, flags=re.ASCII)[:_NAME]
    return folder / _FOLDER / f"{plain}-{text_hash(robot)[:8]}"


def entry_hash(robot: FleetRobot) -> str:
    """Return the hash of the fleet file's entries that affect the digests of a robot."""
    return text_hash((robot.dates, robot.payloads))[:_LETTERS]


def write_record(folder: Path, record: LogRecord) -> None:
    """Write a record."""
    name = f"{text_hash(record.address)[:_LETTERS]}.json"
    path = robot_folder(folder, record.robot) / name
    with made_folder(path.parent):
        write_whole(path, json.dumps(asdict(record), indent=1) + "\n")


def read_records(folder: Path, robot: FleetRobot) -> dict[str, LogRecord]:
    """Return address -> record of a robot's logs that match its patterns.

    Damaged records, and those of changed entries in the fleet file, are skipped.
    """
    try:
        files = sorted(robot_folder(folder, robot.name).glob("*.json"))
    except OSError:
        return {}
    records = (_read_record(file) for file in files)
    entry = entry_hash(robot)
    return {
        record.address: record
        for record in records
        if record is not None
        and record.robot == robot.name
        and record.said == entry
        and any(fits(record.address, pattern) for pattern in robot.logs)
    }


def _read_record(path: Path) -> LogRecord | None:
    try:
        return msgspec.json.decode(read_regular(path, "record", FleetError), type=LogRecord)
    except (FleetError, msgspec.MsgspecError, UnicodeDecodeError):
        return None


_KILLED = "The workers that read it died three times: memory may be too small."


@dataclass(frozen=True)
class LogTask(Short):
    """A log to digest."""

    kind: FleetType
    robot: FleetRobot
    place: LogPlace
    folder: Path


@dataclass(frozen=True, eq=False)
class FleetDigests(Short):
    """The digests of a fleet's logs."""

    records: dict[str, tuple[LogRecord, ...]]  # robot -> its logs with digests, by date
    failed: tuple[LogRecord, ...]
    settings: dict[str, DigestSettings | None]  # type -> settings; None without valid logs
    made: int  # number of newly digested logs
    repairs: tuple[str, ...] = ()  # of the model files


def check_places(fleet: Fleet, *, local: bool) -> tuple[str, ...]:
    """Raise if logs, settings or models are invalid; return the repairs of the model files."""
    for robot in fleet.robots:
        for pattern in robot.logs:
            if IN_THIS_PROCESS in pattern and not local:
                raise FleetError(
                    f"Logs {pattern} of {robot.name} are in the memory of this process, "
                    "which others cannot read.",
                    advice="Read them in this process: --workers 0.",
                )
    models = list[RobotModel]()
    for kind in fleet.types.values():
        model, wanted = type_source(kind)
        models.append(model)
        settings = read_settings(fleet.folder / kind.name / DIGESTS)
        if settings is not None:
            check_settings(settings, model, wanted)
        for robot in fleet.of_type(kind.name):
            models += _check_robot(kind, robot, model)
    repairs = [f"{model.path.name}: {repair}" for model in models for repair in model.repairs]
    return tuple(dict.fromkeys(repairs))


def _check_robot(kind: FleetType, robot: FleetRobot, type_model: RobotModel) -> list[RobotModel]:
    """Return a robot's own model, if any; raise if it or the payloads do not fit the type."""
    try:
        carried_phi(type_model, robot.payloads)
    except ArgumentError as error:
        raise FleetError(
            f"Robot {robot.name!r} has invalid payloads: {error.problem}",
            advice=error.advice,
        ) from error
    if robot.model is None:
        return []
    model = own_model(kind, robot.model)
    for field in ("joints", "bodies"):
        names, expected = getattr(model, field), getattr(type_model, field)
        if names != expected:
            raise FleetError(
                f"The model of robot {robot.name!r} has the {field} {', '.join(names)}, but "
                f"its type {robot.type!r} {', '.join(expected)}.",
                advice="Robots of a type must have the same joints: define another type.",
            )
    return [model]


def find_tasks(
    fleet: Fleet, failed: Sequence[LogRecord] = ()
) -> tuple[list[LogTask], dict[str, dict[str, LogRecord]]]:
    """Return the logs to digest, in the order of the fleet file, and the records of the others.

    Logs that failed before are skipped until they change.
    """
    tasks, known, owners = [], {}, dict[str, str]()
    failures = {(record.robot, record.address, record.stamp): record for record in failed}
    for robot in fleet.robots:
        folder = fleet.folder / robot.type
        records = read_records(folder, robot)
        places: dict[str, LogPlace] = {}
        for pattern in robot.logs:
            matches = find_logs(pattern)
            if not matches and not records:
                raise FleetError(
                    f"The pattern {pattern!r} of robot {robot.name!r} matches no log.",
                    advice="Check the path, which is relative to the fleet file.",
                )
            places.update((place.address, place) for place in matches)
        for address in (*places, *records):
            if owners.setdefault(address, robot.name) != robot.name:
                raise FleetError(
                    f"Log {address} belongs to both robots {owners[address]!r} and {robot.name!r}.",
                    advice="Correct their patterns.",
                )
        known[robot.name] = {
            address: record
            for address, record in records.items()
            if (folder / DIGESTS / record.digest).is_file()
        }
        for place in places.values():
            record = known[robot.name].get(place.address)
            if record is not None and record.stamp == place.stamp:
                continue
            known[robot.name].pop(place.address, None)
            if (failure := failures.get((robot.name, place.address, place.stamp))) is not None:
                known[robot.name][place.address] = failure
            else:
                tasks.append(LogTask(fleet.types[robot.type], robot, place, folder))
    return tasks, known


def digest_fleet(
    fleet: Fleet,
    tasks: Sequence[LogTask],
    known: dict[str, dict[str, LogRecord]],
    team: Workers,
    progress: Progress = lambda words, share: None,
) -> FleetDigests:
    """Digest logs, and add their records to the known ones, robot -> address -> record."""
    done = made = 0

    def add_record(task: LogTask, record: LogRecord) -> None:
        nonlocal done, made
        if record.digest:
            write_record(task.folder, record)
            made += 1
        known[record.robot][record.address] = record
        done += 1

    with ExitStack() as folders:
        for name in fleet.types:
            folders.enter_context(made_folder(fleet.folder / name / DIGESTS))
        remaining = _choose_settings(fleet, tasks, add_record, progress)
        for k, record in team.each(digest_task, remaining):
            task = remaining[k]
            add_record(task, record or _failure(task, _KILLED))
            progress(f"Digested {task.place.name} of {task.robot.name}", done / len(tasks))
    by_date = {
        name: sorted(records.values(), key=attrgetter("date", "address"))
        for name, records in known.items()
    }
    return FleetDigests(
        {name: tuple(r for r in records if r.digest) for name, records in by_date.items()},
        tuple(r for records in by_date.values() for r in records if not r.digest),
        {name: read_settings(fleet.folder / name / DIGESTS) for name in fleet.types},
        made,
    )


def _choose_settings(
    fleet: Fleet,
    tasks: Sequence[LogTask],
    add_record: Callable[[LogTask, LogRecord], None],
    progress: Progress,
) -> list[LogTask]:
    """Digest the first valid log of each type, which chooses settings; return remaining tasks."""
    remaining: list[LogTask] = []
    for kind in fleet.types.values():
        folder = fleet.folder / kind.name
        of_kind = [task for task in tasks if task.kind is kind]
        while of_kind and read_settings(folder / DIGESTS) is None:
            progress(f"Choosing settings of {kind.name}", None)
            add_record(of_kind[0], digest_task(of_kind.pop(0)))
        remaining += of_kind
    return remaining


def digest_task(task: LogTask) -> LogRecord:
    """Digest a log; runs in a worker."""
    if any("\ud800" <= letter <= "\udfff" for letter in task.place.address):
        return _failure(task, "Its path is not UTF-8, which files of fleets require. Rename it.")
    (model, wanted), folder = type_source(task.kind), task.folder / DIGESTS
    if not folder.is_dir():
        raise OutputError(
            f"A worker cannot find folder {folder}.",
            advice="Use a folder that all workers share.",
        )
    try:
        has_pattern = task.robot.dates not in DATED_BY
        date = date_in_path(task.place.address, task.robot.dates) if has_pattern else None
        with local_log(task.place) as path:
            payloads = {path: task.robot.payloads}
            run = digest_logs(model, [path], folder, wanted=wanted, date=date, payloads=payloads)
    except UnreachableLogError as error:  # try again next time
        return replace(_failure(task, str(error)), stamp="")
    except (OutputError, FleetError, DigestError):  # these concern all logs
        raise
    except GeodrakeError as error:
        return _failure(task, str(error))
    (row,) = run.rows
    if row.status == FAILED or row.digest is None or row.about is None:
        return _failure(task, row.reason.replace(str(path), task.place.address))
    if task.robot.dates == "stamps" and row.about.date_from != "stamps":
        return _failure(task, "Its time stamps are not dates, which `dates: stamps` needs.")
    robot, place = task.robot, task.place
    # The date from the path may be newer than that of an existing digest with the same content.
    start = row.about.date if row.about.date_from == "stamps" or date is None else date
    return LogRecord(
        robot.name, place.address, place.stamp, entry_hash(robot), row.digest.name, start
    )


def _failure(task: LogTask, reason: str) -> LogRecord:
    place, robot = task.place, task.robot
    return LogRecord(robot.name, place.address, place.stamp, entry_hash(robot), reason=reason)
