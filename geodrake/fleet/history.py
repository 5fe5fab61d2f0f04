"""The logs of one robot as weighted normal matrices, over the same columns in all logs.

Digests are read once. What they add is summed up, those of a time together, in a file that says
which logs are in it. A history has the mean of each time: its logs may scatter together, so that
they are as sure as one.
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
"""s."""

MOST_TIMES = 100
"""Most times of a history: neighbouring logs of a robot with more of them count as one."""

_FILE = "history.sums"  # beside the records of a robot's logs
_LARGEST = 8 * 10**9  # bytes that sums of many logs of a robot of many joints unpack to at most
_FORMAT = "geodrake history 2"


@dataclass(frozen=True, eq=False)
class JointGrams(Short):
    """Weighted normal matrices of a joint, over the columns that its rows may have.

    These are the same in all logs of the same settings.
    """

    columns: Indices  # (m,) which of a type's columns these are, ascending
    grams: Array  # (T, m + 1, m + 1) matrices [A | b]ᵀ W [A | b] of each log or time


@dataclass(frozen=True, eq=False)
class LogEquations(Short):
    """Normal equations of a robot's logs."""

    days: Array
    information: Array  # (T, p, p) weighted normal matrices Aᵀ W A
    right: Array  # (T, p) right sides Aᵀ W b
    temperature: Array  # (T,) mean temperature of each log, °C; NaN where it is not known


@dataclass(frozen=True, eq=False)
class HistoryTask(Short):
    """A robot whose digests are to be read."""

    robot: str
    records: Sequence[LogRecord]
    folder: Path
    settings: DigestSettings
    kept: Indices  # (p,) which of the settings' columns count, ascending

    @property
    def file(self) -> Path:
        """Return where the sums of its logs are kept."""
        return robot_folder(self.folder, self.robot) / _FILE

    @property
    def key(self) -> str:
        """Return the key of these sums: all that they depend on besides logs."""
        return text_hash((self.settings.hash, self.kept.tolist(), MOST_TIMES))


@dataclass(frozen=True, eq=False)
class RobotHistory(Short):
    """A robot's logs as sums, in the order of time: in memory or, if large, in its file."""

    robot: str
    days: Array  # (T,) when each log was recorded, days, ascending
    temperature: Array  # (T,) mean temperature of each log, °C; NaN where it is not known
    columns: int
    # (n,) what they say of each joint, over some of the p columns; None as long as it is in a file.
    joints: tuple[JointGrams, ...] | None
    # (p,) or (T, p) parameters of the robot, as far as they are known, that gains of its joints
    # refer to; None without gains.
    reference: Array | None = None
    task: HistoryTask | None = None  # what a history in a file was made for
    # (n,) root of the mean square of the robot's efforts, N·m or N
    effort: Array = field(default_factory=lambda: np.zeros(0))
    logs: int = 0  # number of logs, of which several may be of one time; 0 for one at each

    def read(self) -> RobotHistory:
        """Return it in memory; logs are summed up again if another run has replaced the file."""
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
        """Return normal equations; with a reference, of a further column for each joint's gain.

        The column of joint j is the effort there by the reference, and zero at the other joints,
        so that its parameter is ε where the logged effort is 1 + ε times that.
        """
        joints = self.read().joints or ()
        T, p, reference = len(self.days), self.columns, self.reference
        size = p if reference is None else p + len(joints)
        information, right = np.zeros((T, size, size)), np.zeros((T, size))
        for gain, joint in enumerate(joints, start=p):
            at = joint.columns
            own, side = joint.grams[:, :-1, :-1], joint.grams[:, :-1, -1]
            information[:, at[:, None], at] += own
            right[:, at] += side
            if reference is not None and joint.grams[:, -1, -1].any():  # there is effort
                x = np.broadcast_to(reference[..., :p], (T, p))[:, at]
                along = np.einsum("tab,tb->ta", own, x)
                information[:, gain, at] = information[:, at, gain] = along
                information[:, gain, gain] = np.einsum("ta,ta->t", along, x)
                right[:, gain] = np.einsum("ta,ta->t", side, x)
        return LogEquations(self.days, information, right, self.temperature)


def read_history(task: HistoryTask) -> tuple[RobotHistory | None, list[tuple[LogRecord, str]]]:
    """Return a robot's history, and records whose digest cannot be read, each with its reason."""
    sums, refused = _summed(task)
    if refused:
        damaged = [record for record, _ in refused]
        task = replace(task, records=[each for each in task.records if each not in damaged])
        sums, _ = _summed(task)
    return (sums.history(task) if sums.stamps else None), refused


@dataclass(eq=False)
class _HistorySums:
    """Sums over a robot's logs, at C times."""

    stamps: list[str]  # what says which logs these are of, in their order
    joints: list[JointGrams]  # (C, m + 1, m + 1) sums of each joint's matrices
    times: Array  # (4, C) sums of days and of temperatures, and how many logs these are of
    # (2, n) sums of squares of efforts, (N·m)² or N², and how many samples these are of.
    efforts: Array

    def add(self, stamp: str, time: int, day: float, digest: Digest, kept: Indices) -> None:
        """Add a log that was recorded on a day, and is of one of the times."""
        self.stamps.append(stamp)
        joints, squares = weighted_grams(digest, kept)
        if more := max(time + 1 - self.times.shape[1], 0):
            self.times = np.pad(self.times, ((0, 0), (0, more)))
            before = self.joints or [JointGrams(j.columns, j.grams[:0]) for j in joints]
            none = (0, more), (0, 0), (0, 0)  # information at further times
            self.joints = [JointGrams(j.columns, np.pad(j.grams, none)) for j in before]
        for sums, own in zip(self.joints, joints, strict=True):
            sums.grams[time] += own.grams[0]
        warm = np.concatenate([log.temperature for log in digest.logs])
        warm = warm[np.isfinite(warm)]
        mean = float(warm.mean()) if len(warm) else 0.0
        self.times[:, time] += (day, mean, 1.0, float(len(warm) > 0))
        self.efforts += (squares, digest.samples)

    def history(self, task: HistoryTask) -> RobotHistory:
        """Return the history that these sums are of, without its matrices."""
        days, warm, logs, known = self.times[:, self.times[2] > 0.0]
        squares, samples = self.efforts
        return RobotHistory(
            task.robot,
            days / logs,
            np.where(known > 0.0, warm / np.maximum(known, 1.0), np.nan),
            len(task.kept),
            None,
            task=task,
            effort=np.sqrt(squares / np.maximum(samples, 1.0)),
            logs=len(self.stamps),
        )

    def means(self) -> tuple[JointGrams, ...]:
        """Return the means of each joint at each time, in order of time; there must be a log."""
        there = self.times[2] > 0.0
        counts = self.times[2, there, None, None]
        return tuple(JointGrams(each.columns, each.grams[there] / counts) for each in self.joints)


def _summed(task: HistoryTask) -> tuple[_HistorySums, list[tuple[LogRecord, str]]]:
    """Sum up a robot's logs; also return those that cannot be read, each with its reason.

    Logs that follow what was summed up before are added to it, and the sums are the same as if all
    were read anew.
    """
    times = time_cells(np.array([record.date for record in task.records])).tolist()
    digests = [task.folder / DIGESTS / record.digest for record in task.records]
    wanted = [_stamp(*each) for each in zip(task.records, digests, times, strict=True)]
    sums, refused = _read_sums(task), list[tuple[LogRecord, str]]()
    if sums is None or sums.stamps != wanted[: len(sums.stamps)]:
        sums = _HistorySums([], [], np.zeros((4, 0)), np.zeros((2, len(task.settings.joints))))
    known = len(sums.stamps)
    for at in range(known, len(wanted)):
        record = task.records[at]
        try:
            digest = read_digest_of(digests[at], task.settings)
        except DigestError as error:
            refused.append((record, error.problem))
        else:
            sums.add(wanted[at], times[at], record.date / DAY, digest, task.kept)
    if len(sums.stamps) > known:
        with made_folder(task.file.parent):
            write_whole(task.file, sealed((task.key, sums), _FORMAT))
    return sums, refused


def weighted_grams(digest: Digest, kept: Indices) -> tuple[list[JointGrams], Array]:
    """Return weighted normal matrices of a log, one a joint, and (n,) sums of squared efforts.

    They are over the columns that are kept (p,). What a row is worth is the share of its samples
    that are independent, over the variance of what the refitted model leaves: that of the sensors'
    noise at least. The likelihood of the inertia m that a joint without a motor feels, over that of
    the model, is in them to second order: n (m − 2)², as in `LogFits`.
    """
    settings, found, squares = digest.settings, [], []
    shares = np.zeros((len(digest.joints), len(settings.columns)))
    if (inertia := digest.passive_inertia) is not None:
        shares[:, : inertia.shape[1]] = inertia
    power = np.sum([log.residual_power for log in digest.logs], axis=0)
    power = np.maximum(power, digest.samples * digest.noise_floor**2)
    counts = zip(digest.joints, digest.effective.tolist(), power.tolist(), strict=True)
    for j, (joint, effective, left) in enumerate(counts):
        local = joint.local(kept)
        columns, at = np.flatnonzero(local >= 0), np.append(local[local >= 0], len(joint.columns))
        gram, own = joint.gram[np.ix_(at, at)], np.append(shares[j, kept[columns]], 0.0)
        squares.append(gram[-1, -1])
        gram = effective / max(left, 1e-300) * gram + effective * own[:, None] * own
        gram[:-1, -1] += 2.0 * effective * own[:-1]
        gram[-1, :-1] = gram[:-1, -1]
        found.append(JointGrams(columns, gram[None]))
    scales = digest.samples * np.square(digest.effort_scale)
    return found, np.where(np.isin(settings.joints, settings.passive), scales, squares)


def _stamp(record: LogRecord, digest: Path, time: int) -> str:
    """Return the identity of a log in sums: its present digest, its date, and its time."""
    try:
        status = digest.stat()
        now = f"{status.st_size} {status.st_mtime_ns}"
    except OSError:
        now = "gone"
    return f"{record.digest} {now} {record.date!r} {time}"


def time_cells(dates: Array) -> NDArray[np.intp]:
    """Return (T,) which of at most `MOST_TIMES` times each of ascending dates (T,) counts to.

    Each has its own, unless there are too many: then cells of an hour, or two, four, … of them,
    counted from 1970, so that further logs seldom move the borders.
    """
    if len(dates) <= MOST_TIMES:
        return np.arange(len(dates))
    width = DAY / 24.0
    while len(found := np.unique(np.floor(dates / width), return_inverse=True)[0]) > MOST_TIMES:
        width *= 2.0
    return np.searchsorted(found, np.floor(dates / width))


def _read_sums(task: HistoryTask) -> _HistorySums | None:
    """Read the sums of a file; None if it is missing, damaged or of something else."""
    try:
        data = read_regular(task.file, "file of sums", FleetError)
        key, sums = unsealed(data, _FORMAT, tuple[str, _HistorySums], largest=_LARGEST)
    except (FleetError, DamagedFileError):
        return None
    return sums if key == task.key else None
