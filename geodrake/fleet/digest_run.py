"""The digests of a fleet's logs: each made once, by whoever has time, wherever the log is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from geodrake.boundary.showing import Short
from geodrake.boundary.whole_files import made_folder
from geodrake.errors import ArgumentError, DigestError, FleetError, GeodrakeError, OutputError
from geodrake.fleet.digest_folder import FAILED, Told, check_settings, digest_logs
from geodrake.fleet.fleet_file import Fleet, FleetRobot, FleetType
from geodrake.fleet.log_dates import DATED_BY, date_in_path
from geodrake.fleet.log_places import (
    IN_THIS_PROCESS,
    LogPlace,
    UnreachableLogError,
    find_logs,
    local_log,
)
from geodrake.fleet.log_records import (
    DIGESTS,
    LogRecord,
    changed_logs,
    read_records,
    said_of,
    write_record,
)
from geodrake.fleet.settings import DigestSettings, read_settings
from geodrake.fleet.type_source import own_model, type_source
from geodrake.fleet.workers import Workers
from geodrake.model.carried_payloads import carried_phi
from geodrake.model.robot_model import RobotModel

_KILLED = (
    "The workers that read it died, three one after the other: there may not be memory enough."
)


@dataclass(frozen=True)
class LogTask(Short):
    """A log to be digested."""

    kind: FleetType
    robot: FleetRobot
    place: LogPlace
    folder: Path


@dataclass(frozen=True, eq=False)
class FleetDigests(Short):
    """What is known of the logs of a fleet.

    Attributes:
        records: Robot -> records of its logs that have digests, by date.
        failed: Logs that have none, each with its reason.
        settings: Type -> settings of its digests; None if none of its logs can be used.
        made: How many logs were digested.
        repairs: What of the model files is not believed.
    """

    records: dict[str, tuple[LogRecord, ...]]
    failed: tuple[LogRecord, ...]
    settings: dict[str, DigestSettings | None]
    made: int
    repairs: tuple[str, ...] = ()


def check_places(fleet: Fleet, *, local: bool) -> tuple[str, ...]:
    """Refuse what no worker could do, before any work.

    Returns:
        What of the model files is not believed.

    Raises:
        FleetError: Logs are in the memory of this process, and others are to read them.
        DigestError: There are digests of another model, version or other settings.
        GeodrakeError: A model cannot be read.
    """
    for robot in fleet.robots:
        for pattern in robot.logs:
            if IN_THIS_PROCESS in pattern and not local:
                raise FleetError(
                    f"Logs {pattern} of {robot.name} are in the memory of this process, which no "
                    "other one sees.",
                    advice="Read them in this process: --workers 0.",
                )
    models = list[RobotModel]()
    for kind in fleet.types.values():
        source = type_source(kind)
        model = source.model
        models.append(model)
        settings = read_settings(fleet.folder / kind.name / DIGESTS)
        if settings is not None:
            check_settings(settings, model, source.wanted)
        for robot in fleet.of_type(kind.name):
            _check_payloads(robot, model)
            if robot.model is not None:
                models.append(own_model(kind, robot.model))
                _check_same_robot(robot, models[-1], model)
    found = [f"{model.path.name}: {each}" for model in models for each in model.repairs]
    return tuple(dict.fromkeys(found))


def _check_payloads(robot: FleetRobot, model: RobotModel) -> None:
    """Refuse payloads of bodies that there are not.

    Raises:
        FleetError: There is one.
    """
    try:
        carried_phi(model, robot.payloads)
    except ArgumentError as error:
        raise FleetError(
            f"Robot {robot.name!r} has payloads that cannot be: {error.problem}",
            advice=error.advice,
        ) from error


def _check_same_robot(robot: FleetRobot, own: RobotModel, of_type: RobotModel) -> None:
    """Refuse a robot whose model is of another kind of robot than its type.

    Raises:
        FleetError: It has other joints or bodies.
    """
    for what in ("joints", "bodies"):
        ours, theirs = getattr(own, what), getattr(of_type, what)
        if ours != theirs:
            raise FleetError(
                f"The model of robot {robot.name!r} has the {what} {', '.join(ours)}, and its type "
                f"{robot.type!r} has {', '.join(theirs)}.",
                advice="Robots of a type have the same joints: give it a type of its own.",
            )


def find_tasks(
    fleet: Fleet, failed: Sequence[LogRecord] = ()
) -> tuple[list[LogTask], dict[str, dict[str, LogRecord]]]:
    """Logs that are to be digested, in the order of the fleet file; and what is known of others.

    Args:
        failed: Logs that failed before, which are not tried again until they have changed.

    Raises:
        FleetError: A pattern finds nothing and never did, or two find the same log.
    """
    tasks, known, owners = [], {}, dict[str, str]()
    stuck = {(record.robot, record.address, record.stamp): record for record in failed}
    for robot in fleet.robots:
        folder = fleet.folder / robot.type
        records = read_records(folder, robot)
        places: dict[str, LogPlace] = {}
        for pattern in robot.logs:
            found = find_logs(pattern)
            if not found and not records:
                raise FleetError(
                    f"The pattern {pattern!r} of robot {robot.name!r} matches nothing.",
                    advice="Check the path; paths are beside the fleet file.",
                )
            places.update((place.address, place) for place in found)
        for address in (*places, *records):
            if owners.setdefault(address, robot.name) != robot.name:
                raise FleetError(
                    f"Log {address} is of robot {owners[address]!r} and of {robot.name!r}.",
                    advice="Correct their patterns: a log is of one robot.",
                )
        known[robot.name] = {
            address: record
            for address, record in records.items()
            if (folder / DIGESTS / record.digest).is_file()
        }
        for place in changed_logs(list(places.values()), known[robot.name]):
            known[robot.name].pop(place.address, None)
            if (before := stuck.get((robot.name, place.address, place.stamp))) is not None:
                known[robot.name][place.address] = before
            else:
                tasks.append(LogTask(fleet.types[robot.type], robot, place, folder))
    return tasks, known


def digest_fleet(
    fleet: Fleet,
    tasks: Sequence[LogTask],
    known: dict[str, dict[str, LogRecord]],
    team: Workers,
    told: Told = lambda words, share: None,
) -> FleetDigests:
    """Digest logs; what is there stays.

    Args:
        known: Robot -> address -> record of the others; taken in are those of the tasks.
        told: Called with what is going on.

    Raises:
        DigestError: Digests are there of another model, version or other settings.
        OutputError: Nothing more can be written; what was written stays.
    """
    done = made = 0

    def take(task: LogTask, record: LogRecord) -> None:
        nonlocal done, made
        if record.digest:
            write_record(task.folder, record)
            made += 1
        known[record.robot][record.address] = record
        done += 1

    with ExitStack() as folders:
        for name in fleet.types:
            folders.enter_context(made_folder(fleet.folder / name / DIGESTS))
        rest = _choose_settings(fleet, tasks, take, told)
        for piece in team.each(digest_task, rest):
            task = rest[piece.at]
            take(task, piece.result or _failure(task, _KILLED))
            told(f"Digested {task.place.name} of {task.robot.name}", done / len(tasks))
    by_date = {name: sorted(own.values(), key=_by_date) for name, own in known.items()}
    return FleetDigests(
        {name: tuple(each for each in own if each.digest) for name, own in by_date.items()},
        tuple(each for own in by_date.values() for each in own if not each.digest),
        {name: read_settings(fleet.folder / name / DIGESTS) for name in fleet.types},
        made,
    )


def _choose_settings(
    fleet: Fleet,
    tasks: Sequence[LogTask],
    take: Callable[[LogTask, LogRecord], None],
    told: Told,
) -> list[LogTask]:
    """Digest the first log of each type that can be used, which chooses settings; the others."""
    rest: list[LogTask] = []
    for kind in fleet.types.values():
        folder = fleet.folder / kind.name
        own = [task for task in tasks if task.kind is kind]
        while own and read_settings(folder / DIGESTS) is None:
            told(f"Choosing settings of {kind.name}", None)
            take(own[0], digest_task(own.pop(0)))
        rest += own
    return rest


def digest_task(task: LogTask) -> LogRecord:
    """Digest a log, wherever this runs.

    Raises:
        DigestError: The settings that are there do not fit.
        OutputError: The digest cannot be written.
    """
    source, folder = type_source(task.kind), task.folder / DIGESTS
    if not folder.is_dir():
        raise OutputError(
            f"A worker does not find the folder {folder}.",
            advice="Give a folder that all workers share.",
        )
    try:
        said = task.robot.dates not in DATED_BY
        date = date_in_path(task.place.address, task.robot.dates) if said else None
        with local_log(task.place) as path:
            payloads = {path: task.robot.payloads}
            run = digest_logs(
                source.model, [path], folder, wanted=source.wanted, date=date, payloads=payloads
            )
    except UnreachableLogError as error:  # which may be there when it is looked for next
        return replace(_failure(task, str(error)), stamp="")
    except (OutputError, FleetError, DigestError):  # which are not of this log alone
        raise
    except GeodrakeError as error:
        return _failure(task, str(error))
    (row,) = run.rows
    if row.status == FAILED or row.digest is None or row.about is None:
        return _failure(task, row.reason.replace(str(path), task.place.address))
    if task.robot.dates == "stamps" and row.about.date_from != "stamps":
        return _failure(task, "Its time stamps are no dates, as `dates: stamps` wants them.")
    robot, place = task.robot, task.place
    # What files say of dates may be newer than a digest of the same bytes is.
    when = row.about.date if row.about.date_from == "stamps" or date is None else date
    return LogRecord(robot.name, place.address, place.stamp, said_of(robot), row.digest.name, when)


def _failure(task: LogTask, reason: str) -> LogRecord:
    place, robot = task.place, task.robot
    return LogRecord(robot.name, place.address, place.stamp, said_of(robot), reason=reason)


def _by_date(record: LogRecord) -> tuple[float, str]:
    return record.date, record.address
