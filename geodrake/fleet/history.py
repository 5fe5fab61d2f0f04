"""The logs of one robot as weighted normal matrices, over the same columns in all logs.

Each digest is read once. The sums over digests of the same time are kept in a file, together with
the identities of their logs. A history contains the mean of each time, as its logs may scatter
together, and then count as one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.input_files import read_regular
from geodrake.boundary.showing import Short
from geodrake.boundary.whole_files import made_folder, write_whole
from geodrake.errors import DigestError, FleetError
from geodrake.fleet.digest import Digest, read_digest_of
from geodrake.fleet.fleet_logs import DIGESTS, LogRecord, robot_folder
from geodrake.fleet.hashes import text_hash
from geodrake.fleet.sealed_file import DamagedFileError, sealed, unsealed
from geodrake.fleet.settings import DigestSettings
from geodrake.identification.logs.dataset import Indices
from geodrake.inertia import Array

DAY = 86400.0
"""Seconds of a day."""

MOST_TIMES = 100
"""Maximum number of times of a history; with more logs, neighbouring ones are combined."""

_FILE = "history.sums"  # in the folder of a robot's records
_LARGEST = 8 * 10**9  # bytes, limit of unpacked sums
_FORMAT = "geodrake history 2"


@dataclass(frozen=True, eq=False)
class JointGrams(Short):
    """Weighted normal matrices of a joint, over the columns of its rows.

    The columns are the same in all logs with the same settings.
    """

    columns: Indices  # (m,) indices among the type's columns, ascending
    grams: Array  # (T, m + 1, m + 1) matrices [A | b]ᵀ W [A | b] of each log or time


@dataclass(frozen=True, eq=False)
class LogEquations(Short):
    """Normal equations of a robot's logs."""

    days: Array
    information: Array  # (T, p, p) weighted normal matrices Aᵀ W A
    right: Array  # (T, p) right sides Aᵀ W b
    temperature: Array  # (T,) mean temperature of each log, °C; NaN where unknown


@dataclass(frozen=True, eq=False)
class HistoryTask(Short):
    """A robot whose digests to read."""

    robot: str
    records: Sequence[LogRecord]
    folder: Path
    settings: DigestSettings
    kept: Indices  # (p,) indices of the settings' columns to use, ascending

    @property
    def file(self) -> Path:
        """File of the sums of its logs."""
        return robot_folder(self.folder, self.robot) / _FILE

    @property
    def key(self) -> str:
        """Hash of everything that the sums depend on besides the logs."""
        return text_hash((self.settings.hash, self.kept.tolist(), MOST_TIMES))


@dataclass(frozen=True, eq=False)
class RobotHistory(Short):
    """A robot's logs as sums, in order of time, in memory or in a file."""

    robot: str
    days: Array  # (T,) date of each log, days, ascending
    temperature: Array  # (T,) mean temperature of each log, °C; NaN where unknown
    columns: int
    joints: tuple[JointGrams, ...] | None  # (n,) over some of the p columns; None if in a file
    # (p,) or (T, p) reference parameters for the gains of the joints; None without gains.
    reference: Array | None = None
    task: HistoryTask | None = None  # of a history in a file
    effort: Array = field(default_factory=lambda: np.zeros(0))  # (n,) RMS efforts, N·m or N
    logs: int = 0  # number of logs; 0 for one per time

    def read(self) -> RobotHistory:
        """Return the history in memory; recompute the sums if another run has replaced the file."""
        if self.task is None or self.joints is not None:
            return self
        sums, _ = _summed(self.task)
        if not np.array_equal(sums.history(self.task).days, self.days):
            raise FleetError(
                f"The digests of robot {self.robot} changed while they were read.",
                advice="Run the command again when no other one changes them.",
            )
        return replace(self, joints=sums.means())

    def equations(self) -> LogEquations:
        """Return the normal equations; with a reference, including a gain column for each joint.

        The column of joint j is its effort by the reference, and zero at other joints, so that its
        parameter is ε if the logged effort is 1 + ε times that effort.
        """
        joints = self.read().joints or ()
        T, p, reference = len(self.days), self.columns, self.reference
        size = p if reference is None else p + len(joints)
        information, right = np.zeros((T, size, size)), np.zeros((T, size))
        for gain, joint in enumerate(joints, start=p):
            columns = joint.columns
            normal, side = joint.grams[:, :-1, :-1], joint.grams[:, :-1, -1]
            information[:, columns[:, None], columns] += normal
            right[:, columns] += side
            if reference is not None and joint.grams[:, -1, -1].any():  # nonzero effort
                x = np.broadcast_to(reference[..., :p], (T, p))[:, columns]
                cross = np.einsum("tab,tb->ta", normal, x)
                information[:, gain, columns] = information[:, columns, gain] = cross
                information[:, gain, gain] = np.einsum("ta,ta->t", cross, x)
                right[:, gain] = np.einsum("ta,ta->t", side, x)
        return LogEquations(self.days, information, right, self.temperature)


def read_history(task: HistoryTask) -> tuple[RobotHistory | None, list[tuple[LogRecord, str]]]:
    """Return a robot's history, and records with invalid digests, each with the reason."""
    sums, refused = _summed(task)
    if refused:
        damaged = [record for record, _ in refused]
        task = replace(task, records=[record for record in task.records if record not in damaged])
        sums, _ = _summed(task)
    return (sums.history(task) if sums.stamps else None), refused


@dataclass(eq=False)
class _HistorySums:
    """Sums over a robot's logs, at C times."""

    stamps: list[str]  # identities of the logs, in order
    joints: list[JointGrams]  # (C, m + 1, m + 1) sums of each joint's matrices
    times: Array  # (4, C) sums of days and temperatures, numbers of logs, and with temperatures
    efforts: Array  # (2, n) sums of squares of efforts, (N·m)² or N², and numbers of samples

    def add(self, stamp: str, time: int, day: float, digest: Digest, kept: Indices) -> None:
        """Add a log of a day to the sums of a time, given by index."""
        self.stamps.append(stamp)
        joints, squares = weighted_grams(digest, kept)
        if missing := max(time + 1 - self.times.shape[1], 0):
            self.times = np.pad(self.times, ((0, 0), (0, missing)))
            previous = self.joints or [JointGrams(j.columns, j.grams[:0]) for j in joints]
            padding = (0, missing), (0, 0), (0, 0)
            self.joints = [JointGrams(j.columns, np.pad(j.grams, padding)) for j in previous]
        for sums, joint in zip(self.joints, joints, strict=True):
            sums.grams[time] += joint.grams[0]
        temperature = np.concatenate([log.temperature for log in digest.logs])
        temperature = temperature[np.isfinite(temperature)]
        mean = float(temperature.mean()) if len(temperature) else 0.0
        self.times[:, time] += (day, mean, 1.0, float(len(temperature) > 0))
        self.efforts += (squares, digest.samples)

    def history(self, task: HistoryTask) -> RobotHistory:
        """Return the history of these sums, without its matrices."""
        days, temperatures, logs, with_temperature = self.times[:, self.times[2] > 0.0]
        squares, samples = self.efforts
        return RobotHistory(
            task.robot,
            days / logs,
            np.where(
                with_temperature > 0.0, temperatures / np.maximum(with_temperature, 1.0), np.nan
            ),
            len(task.kept),
            None,
            task=task,
            effort=np.sqrt(squares / np.maximum(samples, 1.0)),
            logs=len(self.stamps),
        )

    def means(self) -> tuple[JointGrams, ...]:
        """Return the means of each joint's matrices at all times with logs."""
        has_logs = self.times[2] > 0.0
        counts = self.times[2, has_logs, None, None]
        return tuple(JointGrams(j.columns, j.grams[has_logs] / counts) for j in self.joints)


def _summed(task: HistoryTask) -> tuple[_HistorySums, list[tuple[LogRecord, str]]]:
    """Return the sums over a robot's logs, and those that cannot be read, with the reason.

    New logs are added to the sums in the file, with the same result as reading all logs.
    """
    times = time_cells(np.array([record.date for record in task.records])).tolist()
    digests = [task.folder / DIGESTS / record.digest for record in task.records]
    stamps = [_stamp(*row) for row in zip(task.records, digests, times, strict=True)]
    sums, refused = _read_sums(task), list[tuple[LogRecord, str]]()
    if sums is None or sums.stamps != stamps[: len(sums.stamps)]:
        sums = _HistorySums([], [], np.zeros((4, 0)), np.zeros((2, len(task.settings.joints))))
    count = len(sums.stamps)
    for k in range(count, len(stamps)):
        record = task.records[k]
        try:
            digest = read_digest_of(digests[k], task.settings)
        except DigestError as error:
            refused.append((record, error.problem))
        else:
            sums.add(stamps[k], times[k], record.date / DAY, digest, task.kept)
    if len(sums.stamps) > count:
        with made_folder(task.file.parent):
            write_whole(task.file, sealed((task.key, sums), _FORMAT))
    return sums, refused


def weighted_grams(digest: Digest, kept: Indices) -> tuple[list[JointGrams], Array]:
    """Return weighted normal matrices of a log, one per joint, and (n,) sums of squared efforts.

    They are over the columns `kept` (p,). The weight of a row is the fraction of independent
    samples over the variance of the refitted model's residuals, which is at least that of the
    sensor noise. For joints without a motor they include the likelihood of the inertia m relative
    to the model, to second order: n (m − 2)², as in `LogFits`.
    """
    settings, grams, squares = digest.settings, [], []
    shares = np.zeros((len(digest.joints), len(settings.columns)))
    if (inertia := digest.passive_inertia) is not None:
        shares[:, : inertia.shape[1]] = inertia
    power = np.sum([log.residual_power for log in digest.logs], axis=0)
    power = np.maximum(power, digest.samples * digest.noise_floor**2)
    counts = zip(digest.joints, digest.effective.tolist(), power.tolist(), strict=True)
    for j, (joint, effective, residual_power) in enumerate(counts):
        local = joint.local(kept)
        columns = np.flatnonzero(local >= 0)
        indices = np.append(local[local >= 0], len(joint.columns))
        gram, row = joint.gram[np.ix_(indices, indices)], np.append(shares[j, kept[columns]], 0.0)
        squares.append(gram[-1, -1])
        gram = effective / max(residual_power, 1e-300) * gram + effective * row[:, None] * row
        gram[:-1, -1] += 2.0 * effective * row[:-1]
        gram[-1, :-1] = gram[:-1, -1]
        grams.append(JointGrams(columns, gram[None]))
    scales = digest.samples * np.square(digest.effort_scale)
    return grams, np.where(np.isin(settings.joints, settings.passive), scales, squares)


def _stamp(record: LogRecord, digest: Path, time: int) -> str:
    """Return the identity of a log in sums: its present digest, its date, and its time."""
    try:
        status = digest.stat()
        version = f"{status.st_size} {status.st_mtime_ns}"
    except OSError:
        version = "gone"
    return f"{record.digest} {version} {record.date!r} {time}"


def time_cells(dates: Array) -> NDArray[np.intp]:
    """Return (T,) the index of the time of each of ascending dates (T,), below `MOST_TIMES`.

    With more dates, times are cells of 1, 2, 4, … hours since 1970, so that further logs seldom
    change the cells.
    """
    if len(dates) <= MOST_TIMES:
        return np.arange(len(dates))
    width = DAY / 24.0
    while len(cells := np.unique(np.floor(dates / width))) > MOST_TIMES:
        width *= 2.0
    return np.searchsorted(cells, np.floor(dates / width))


def _read_sums(task: HistoryTask) -> _HistorySums | None:
    """Read the sums of a file; None if it is missing, damaged or has another key."""
    try:
        data = read_regular(task.file, "file of sums", FleetError)
        key, sums = unsealed(data, _FORMAT, tuple[str, _HistorySums], largest=_LARGEST)
    except (FleetError, DamagedFileError):
        return None
    return sums if key == task.key else None
