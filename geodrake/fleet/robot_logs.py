"""Digests of one robot's logs as its history: read one at a time, and of each a matrix is kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.errors import DigestError
from geodrake.fleet.digest import Digest, check_same
from geodrake.fleet.digest_file import read_digest
from geodrake.fleet.history import RobotHistory, joint_history
from geodrake.fleet.log_records import LogRecord
from geodrake.fleet.settings import DigestSettings

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

DAY = 86400.0
"""s."""

MOST_TIMES = 100
"""Most times of a history: neighbouring logs of a robot with more of them count as one."""

_FLAT = 1e-9  # share of information that is none


@dataclass(frozen=True, eq=False)
class ReducedLog(Short):
    """What statistics need of a log.

    Attributes:
        grams: (n, p + 1, p + 1) weighted normal matrices [A | b]ᵀ W [A | b] of its joints.
        temperature: Mean temperature of its joints, °C; NaN where it is not known.
        effort_squares: (n,) sums of squares of its efforts, (N·m)² or N².
        samples: (n,) their number.
    """

    grams: Array
    temperature: float
    effort_squares: Array
    samples: Array


def reduced_log(digest: Digest, kept: Indices) -> ReducedLog:
    """A log as weighted normal matrices over some columns.

    What a row is worth is the share of its samples that are independent, over the variance of what
    the columns leave of the log itself: that of the sensors' noise at least, as a log of few rows
    leaves nothing.

    Args:
        digest: Its digest.
        kept: (p,) which of the settings' columns count.
    """
    every = digest.normal_matrices()
    at = np.append(kept, every.shape[1] - 1)
    grams = every[:, at[:, None], at]
    samples = digest.samples.astype(float)
    weights = [
        share / max(_variance(gram, count), noise**2) if count else 0.0
        for share, gram, count, noise in zip(
            digest.effective_share, grams, samples, digest.noise_floor, strict=True
        )
    ]
    warm = np.concatenate([log.temperature for log in digest.logs])
    warm = warm[np.isfinite(warm)]
    return ReducedLog(
        np.array(weights)[:, None, None] * grams,
        float(warm.mean()) if len(warm) else np.nan,
        grams[:, -1, -1],
        samples,
    )


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
class RobotLogs(Short):
    """A robot's history, and how large its efforts are.

    Attributes:
        history: Its history.
        effort: (n,) root of the mean square of its efforts, N·m or N.
        logs: How many logs it is of.
    """

    history: RobotHistory
    effort: Array
    logs: int


@dataclass(frozen=True, eq=False)
class HistoryTask(Short):
    """A robot whose digests are to be read.

    Attributes:
        robot: Its name.
        records: Records of its logs, by date; at least one.
        folder: Folder of the digests.
        settings: Their settings.
        kept: (p,) which of the settings' columns count.
    """

    robot: str
    records: Sequence[LogRecord]
    folder: Path
    settings: DigestSettings
    kept: Indices


@dataclass(frozen=True, eq=False)
class ReadHistory(Short):
    """What came of it.

    Attributes:
        logs: The history in the order of time; None if no digest can be read.
        refused: Records whose digest is damaged, or of other settings, and how.
    """

    logs: RobotLogs | None
    refused: tuple[tuple[LogRecord, str], ...]


def robot_logs(task: HistoryTask) -> ReadHistory:
    """The history of a robot from its digests, wherever this runs.

    Args:
        task: The robot.
    """
    records, settings, kept, refused = task.records, task.settings, task.kept, []
    dates = np.array([record.date for record in records])
    cells = time_cells(dates)
    count, size = int(cells[-1]) + 1, len(kept) + 1
    n = len(settings.joints)
    grams = np.zeros((count, n, size, size))
    days, logs, warm, known = (np.zeros(count) for _ in range(4))
    squares, samples = np.zeros(n), np.zeros(n)
    for record, cell in zip(records, cells.tolist(), strict=True):
        try:
            path = task.folder / record.digest
            digest = read_digest(path)
            check_same(digest.settings, settings, str(path))
        except DigestError as error:
            refused.append((record, error.problem))
            continue
        own = reduced_log(digest, kept)
        grams[cell] += own.grams
        days[cell] += record.date / DAY
        logs[cell] += 1
        if np.isfinite(own.temperature):
            warm[cell] += own.temperature
            known[cell] += 1
        squares, samples = squares + own.effort_squares, samples + own.samples
    if not (there := logs > 0).any():
        return ReadHistory(None, tuple(refused))
    temperature = np.where(known > 0, warm / np.maximum(known, 1), np.nan)[there]
    # Logs of one time may scatter together, so that it is as sure as one log, by their mean.
    each = grams[there] / logs[there, None, None, None]
    joints = tuple(joint_history(each[:, j]) for j in range(n))
    history = RobotHistory(task.robot, days[there] / logs[there], joints, len(kept), temperature)
    effort = np.sqrt(squares / np.maximum(samples, 1.0))
    return ReadHistory(RobotLogs(history, effort, int(logs.sum())), tuple(refused))


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
