"""Sums of what a robot's logs say, those of a time together: added to log by log, kept in a file.

A file says which logs it sums up. A robot's history has the mean of each time: its logs may scatter
together, so that they are as sure as one.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.input_files import open_regular
from geodrake.boundary.showing import Short
from geodrake.boundary.whole_files import made_folder, write_whole
from geodrake.errors import FleetError
from geodrake.fleet.digest_file import DAMAGED
from geodrake.fleet.history import RobotHistory, joint_history

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_FORMAT = "geodrake history 1"


@dataclass(frozen=True, eq=False)
class JointGrams(Short):
    """Normal matrices of a joint, over the columns that its rows may have.

    Attributes:
        columns: (m,) which of a type's columns these are, ascending.
        grams: (..., m + 1, m + 1) weighted normal matrices [A | b]ᵀ W [A | b].
    """

    columns: Indices
    grams: Array

    def over(self, columns: Indices, times: int) -> JointGrams:
        """Return the same of more times, over more columns.

        Args:
            columns: (M,) which, ascending; all that are here are among them.
            times: Their number of times, at least as many as here.
        """
        grams = np.zeros((times, len(columns) + 1, len(columns) + 1))
        at = np.append(np.searchsorted(columns, self.columns), len(columns))
        grams[np.arange(len(self.grams))[:, None, None], at[:, None], at] = self.grams
        return JointGrams(columns, grams)


@dataclass(frozen=True, eq=False)
class ReducedLog(Short):
    """What statistics need of a log.

    Attributes:
        joints: What it says of each joint: one matrix.
        temperature: Mean temperature of its joints, °C; NaN where it is not known.
        effort_squares: (n,) sums of squares of its efforts, (N·m)² or N².
        samples: (n,) their number.
    """

    joints: tuple[JointGrams, ...]
    temperature: float
    effort_squares: Array
    samples: Array


@dataclass(eq=False)
class HistorySums:
    """What a robot's logs say, in C times.

    Attributes:
        stamps: What says which logs these are of, in their order.
        joints: (C, m + 1, m + 1) sums of each joint's matrices.
        times: (4, C) sums of days and of temperatures, and how many logs these are of.
        efforts: (2, n) sums of squares of efforts, (N·m)² or N², and how many samples these are of.
    """

    stamps: list[str]
    joints: list[JointGrams]
    times: Array
    efforts: Array

    @classmethod
    def none(cls, joints: int) -> HistorySums:
        """Those of no log."""
        nothing = JointGrams(np.zeros(0, np.intp), np.zeros((0, 1, 1)))
        return cls([], [nothing] * joints, np.zeros((4, 0)), np.zeros((2, joints)))

    def add(self, stamp: str, time: int, day: float, log: ReducedLog) -> None:
        """Add a log.

        Args:
            stamp: What says which it is.
            time: Which time it is of.
            day: When it was recorded, days.
            log: What it says.
        """
        self.stamps.append(stamp)
        more = max(time + 1 - self.times.shape[1], 0)
        self.times = np.pad(self.times, ((0, 0), (0, more)))
        for j, (sums, own) in enumerate(zip(self.joints, log.joints, strict=True)):
            columns = np.union1d(sums.columns, own.columns)
            if more or len(columns) > len(sums.columns):
                self.joints[j] = sums.over(columns, self.times.shape[1])
            at = np.append(np.searchsorted(columns, own.columns), len(columns))
            self.joints[j].grams[time, at[:, None], at] += own.grams
        warm = np.isfinite(log.temperature)
        self.times[:, time] += (day, log.temperature if warm else 0.0, 1.0, float(warm))
        self.efforts += (log.effort_squares, log.samples)

    @property
    def _there(self) -> NDArray[np.bool_]:
        """(C,) which times have logs: T of them."""
        return np.asarray(self.times[2] > 0.0)

    @property
    def days(self) -> Array:
        """(T,) mean day of each time that has logs."""
        days, _, logs, _ = self.times[:, self._there]
        return np.asarray(days / logs)

    @property
    def temperature(self) -> Array:
        """(T,) mean temperature of each of them, °C; NaN where it is not known."""
        _, warm, _, known = self.times[:, self._there]
        return np.where(known > 0.0, warm / np.maximum(known, 1.0), np.nan)

    @property
    def effort(self) -> Array:
        """(n,) root of the mean square of efforts, N·m or N."""
        squares, samples = self.efforts
        return np.sqrt(squares / np.maximum(samples, 1.0))

    def history(self, robot: str, columns: int) -> RobotHistory:
        """Return the robot's history in the order of time; there must be a log."""
        logs = self.times[2, self._there]
        joints = tuple(
            joint_history(each.columns, each.grams[self._there] / logs[:, None, None])
            for each in self.joints
        )
        return RobotHistory(robot, self.days, joints, columns, self.temperature)


def write_sums(path: Path, key: str, sums: HistorySums) -> None:
    """Keep sums in a file.

    Raises:
        OutputError: It cannot be written.
    """
    header = json.dumps({"format": _FORMAT, "key": key, "logs": sums.stamps}).encode()
    arrays: dict[str, NDArray[Any]] = {
        "header": np.frombuffer(header, np.uint8),
        "times": sums.times,
        "efforts": sums.efforts,
    }
    for j, joint in enumerate(sums.joints):
        arrays |= {f"{j}.columns": joint.columns, f"{j}.grams": joint.grams}
    with made_folder(path.parent):
        write_whole(path, partial(_save, arrays))


def _save(arrays: dict[str, NDArray[Any]], file: Any) -> None:
    np.savez(file, **arrays)  # type: ignore[arg-type]


def read_sums(path: Path, key: str) -> HistorySums | None:
    """Return the sums of a file; None if there is none, or it is damaged or of something else."""
    try:
        with (
            open_regular(path, "file of sums", FleetError) as file,
            np.load(file, allow_pickle=False) as arrays,
        ):
            header = json.loads(bytes(arrays["header"]).decode())
            if (header["format"], header["key"]) != (_FORMAT, key):
                return None
            joints = range(arrays["efforts"].shape[1])
            return HistorySums(
                list(map(str, header["logs"])),
                [JointGrams(arrays[f"{j}.columns"], arrays[f"{j}.grams"]) for j in joints],
                arrays["times"],
                arrays["efforts"],
            )
    except (FleetError, *DAMAGED):
        return None
