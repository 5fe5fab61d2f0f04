"""What a robot's logs say, by their digests: each is read once, and what it adds is kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.errors import DigestError, FleetError
from geodrake.fleet.digest import Digest, JointDigest
from geodrake.fleet.digest_file import read_digest_of
from geodrake.fleet.history import RobotHistory
from geodrake.fleet.history_sums import (
    HistorySums,
    JointGrams,
    ReducedLog,
    read_sums,
    write_sums,
)
from geodrake.fleet.log_records import DIGESTS, LogRecord, robot_folder
from geodrake.fleet.model_hash import text_hash
from geodrake.fleet.settings import DigestSettings

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

DAY = 86400.0
"""s."""

MOST_TIMES = 100
"""Most times of a history: neighbouring logs of a robot with more of them count as one."""

_HISTORY = "history.npz"  # beside the records of a robot's logs
_FLAT = 1e-9  # share of information that is none


def reduced_log(digest: Digest, kept: Indices) -> ReducedLog:
    """Return a log as weighted normal matrices over some columns.

    What a row is worth is the share of its samples that are independent, over the variance of what
    the columns leave of the log itself: that of the sensors' noise at least, as a log of few rows
    leaves nothing.

    Args:
        kept: (p,) which of the settings' columns count, ascending.
    """
    samples = digest.samples.astype(float)
    joints = [_kept_grams(joint, kept) for joint in digest.joints]
    weights = [
        share / max(_variance(joint.grams, count), noise**2) if count else 0.0
        for joint, share, count, noise in zip(
            joints, digest.effective_share, samples, digest.noise_floor, strict=True
        )
    ]
    warm = np.concatenate([log.temperature for log in digest.logs])
    warm = warm[np.isfinite(warm)]
    return ReducedLog(
        tuple(JointGrams(j.columns, w * j.grams) for j, w in zip(joints, weights, strict=True)),
        float(warm.mean()) if len(warm) else np.nan,
        np.array([joint.grams[-1, -1] for joint in joints]),
        samples,
    )


def _kept_grams(joint: JointDigest, kept: Indices) -> JointGrams:
    """The normal matrix of a joint over those of its columns that count, by their numbers."""
    own = np.flatnonzero(np.isin(joint.columns, kept))
    at = np.append(own, len(joint.columns))
    gram = joint.normal_matrix()[at[:, None], at]
    return JointGrams(np.searchsorted(kept, joint.columns[own]), gram)


def _variance(gram: Array, samples: float) -> float:
    """Variance of what a fit of all columns leaves of one joint, (N·m)² or N²."""
    A, right, total = gram[:-1, :-1], gram[:-1, -1], float(gram[-1, -1])
    seen = np.diagonal(A) > 0.0
    unit = 1.0 / np.sqrt(np.diagonal(A)[seen])
    values, vectors = np.linalg.eigh(A[np.ix_(seen, seen)] * unit[:, None] * unit)
    told = values > _FLAT * values.max(initial=0.0)
    along = vectors[:, told].T @ (unit * right[seen])
    left = total - float(np.sum(along**2 / values[told]))
    return max(left, 1e-12 * total, 1e-300) / max(samples - told.sum(), 1.0)


@dataclass(frozen=True, eq=False)
class HistoryTask(Short):
    """A robot whose digests are to be read.

    Attributes:
        records: Records of its logs, by date; at least one.
        kept: (p,) which of the settings' columns count, ascending.
    """

    robot: str
    records: Sequence[LogRecord]
    folder: Path
    settings: DigestSettings
    kept: Indices

    @property
    def file(self) -> Path:
        """Return where the sums of its logs are kept."""
        return robot_folder(self.folder, self.robot) / _HISTORY

    @property
    def key(self) -> str:
        """Return what these sums are of, beside logs."""
        return text_hash((self.settings.hash, self.kept.tolist(), MOST_TIMES))


@dataclass(frozen=True, eq=False)
class KeptHistory(Short):
    """A robot's history, which is read from its file by whoever needs it: it is large.

    Attributes:
        stamps: Hash of what says which logs are in it.
        days: (T,) when each log was recorded, days, ascending.
        temperature: (T,) mean temperature of each log, °C; NaN where it is not known.
        effort: (n,) root of the mean square of the robot's efforts, N·m or N.
        logs: How many logs are in it, of which those of a time count as one.
    """

    task: HistoryTask
    stamps: str
    days: Array
    temperature: Array
    effort: Array
    logs: int

    @property
    def robot(self) -> str:
        """Return the robot's name."""
        return self.task.robot

    def read(self) -> RobotHistory:
        """Return the history; its logs are summed up again if another run has replaced the file.

        Raises:
            FleetError: Their digests are not what they were.
            OutputError: The sums cannot be kept.
        """
        sums = read_sums(self.task.file, self.task.key)
        if sums is None or text_hash(sums.stamps) != self.stamps:
            sums, _ = _summed(self.task)
            if not np.array_equal(sums.days, self.days):
                raise FleetError(
                    f"The digests of robot {self.robot} changed while they were looked at.",
                    advice="Run the command again when no other one changes them.",
                )
        return sums.history(self.robot, len(self.task.kept))


@dataclass(frozen=True, eq=False)
class ReadHistory(Short):
    """What came of a robot's digests.

    Attributes:
        history: Its history; None if no digest can be read.
        refused: Records whose digest is damaged, or of other settings, and how.
    """

    history: KeptHistory | None
    refused: tuple[tuple[LogRecord, str], ...]


def read_history(task: HistoryTask) -> ReadHistory:
    """Return a robot's history from its digests, wherever this runs.

    Raises:
        OutputError: It cannot be kept.
    """
    sums, refused = _summed(task)
    if not sums.stamps:
        return ReadHistory(None, refused)
    known = sums.days, sums.temperature, sums.effort, len(sums.stamps)
    return ReadHistory(KeptHistory(task, text_hash(sums.stamps), *known), refused)


def _summed(task: HistoryTask) -> tuple[HistorySums, tuple[tuple[LogRecord, str], ...]]:
    """Sums of a robot's logs, and those that cannot be read, each with its reason.

    Logs that follow what was summed up before are added to it, and the sums are the same as if all
    were read anew.
    """
    dates = np.array([record.date for record in task.records])
    times = time_cells(dates).tolist()
    digests = [task.folder / DIGESTS / record.digest for record in task.records]
    wanted = [_stamp(*each) for each in zip(task.records, digests, times, strict=True)]
    sums = read_sums(task.file, task.key)
    if sums is None or sums.stamps != wanted[: len(sums.stamps)]:
        sums = HistorySums.none(len(task.settings.joints))
    known, refused = len(sums.stamps), list[tuple[LogRecord, str]]()
    for at in range(known, len(wanted)):
        record, path = task.records[at], digests[at]
        try:
            digest = read_digest_of(path, task.settings)
        except DigestError as error:
            refused.append((record, error.problem))
            continue
        sums.add(wanted[at], times[at], record.date / DAY, reduced_log(digest, task.kept))
    if len(sums.stamps) > known:
        write_sums(task.file, task.key, sums)
    return sums, tuple(refused)


def _stamp(record: LogRecord, digest: Path, time: int) -> str:
    """What says which log is in sums: its digest as it is now, its date, and the time it is of."""
    try:
        status = digest.stat()
        now = f"{status.st_size} {status.st_mtime_ns}"
    except OSError:
        now = "gone"
    return f"{record.digest} {now} {record.date!r} {time}"


def time_cells(dates: Array) -> NDArray[np.intp]:
    """(T,) which of at most `MOST_TIMES` times each of some dates counts to.

    Each has its own, unless there are too many: then cells of an hour, or two, four, … of them,
    counted from 1970, so that further logs seldom move the borders.

    Args:
        dates: (T,) s since 1970, ascending.
    """
    if len(dates) <= MOST_TIMES:
        return np.arange(len(dates))
    width = DAY / 24.0
    while len(found := np.unique(np.floor(dates / width), return_inverse=True)[0]) > MOST_TIMES:
        width *= 2.0
    return np.searchsorted(found, np.floor(dates / width))
