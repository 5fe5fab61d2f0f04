"""The columns of a log file: which joints and quantities its names stand for."""

from __future__ import annotations

import difflib
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import LogError
from geodrake.logs.motion import JointLog, check_joints

Array = NDArray[np.float64]

LEAST_ROWS = 10
QUANTITIES = ("position", "velocity", "acceleration", "effort")
_STILL = 2e-3  # rad or m, by which a joint may move and still stand
_LARGEST_SHARE = 0.5  # of the memory that the numbers of a log may take; the rest is for the work
HEADER = "time,<joint>.position,<joint>.velocity,<joint>.effort"
HEADER_ADVICE = f"The first line names the columns: {HEADER}; velocity may be left out."


@dataclass(frozen=True)
class Columns:
    """What is read from a file.

    Attributes:
        path: The file.
        joints: Names of the n joints, in the order of the log to be.
        quantities: Quantities that every joint has.
        notes: What was left out, in words.
        standing: Further joints, of which there is the position alone.
    """

    path: Path
    joints: tuple[str, ...]
    quantities: tuple[str, ...]
    notes: tuple[str, ...]
    standing: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        path: Path,
        names: Sequence[str],
        joints: Sequence[str] | None,
        *,
        partial: bool = False,
    ) -> Columns:
        """The columns of a file with these names, joints in the order given if any is.

        Args:
            path: The file, for messages.
            names: All columns of the file, in its order.
            joints: Names of the model's joints, which the log must have, in the order that it shall
                have them in; None for the order of the file.
            partial: Whether the log may lack some of them, or their efforts.

        Raises:
            LogError: Time, or a joint's position or effort, is missing, or the joints are others.
        """
        _check_names(path, names)
        if "time" not in names:
            close = difflib.get_close_matches("time", [n.lower() for n in names[:100]], cutoff=0.4)
            raise LogError(
                f"Log {str(path)!r} has no column 'time'; it has {_listed(names)}.",
                advice=(f"Is it {close[0]!r}? " if close else "") + HEADER_ADVICE,
            )
        having = {
            quantity: [n.rsplit(".", 1)[0] for n in names if n.endswith(f".{quantity}")]
            for quantity in QUANTITIES
        }
        own, standing = _joints(path, having, partial=partial)
        if joints is not None:
            check_joints(path.stem, [*own, *standing], joints, partial=partial)
        quantities, notes = [], []
        for quantity in QUANTITIES:
            there = set(having[quantity])
            missing = [f"{joint}.{quantity}" for joint in own if joint not in there]
            if not missing:
                quantities.append(quantity)
            elif len(missing) < len(own):
                notes.append(f"{quantity} is not used: there is no {_listed(missing)}")
        known = {"time", *(f"{joint}.{quantity}" for joint in own for quantity in QUANTITIES)}
        known |= {f"{joint}.{quantity}" for joint in standing for quantity in QUANTITIES}
        others = [name for name in names if name not in known]
        if others:
            notes.append(f"columns ignored: {_listed(others)}")
        order = own if joints is None else [joint for joint in joints if joint in own]
        return cls(path, tuple(order), tuple(quantities), tuple(notes), tuple(standing))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns to read, time first."""
        return (
            "time",
            *(f"{joint}.{quantity}" for quantity in self.quantities for joint in self.joints),
            *(f"{joint}.position" for joint in self.standing),
        )


class Recording:
    """Arrays of a log while its file is read, column by column or stretch by stretch.

    Every number is held once: ten million rows of seven joints fill more than a gigabyte.
    """

    def __init__(self, columns: Columns, rows: int) -> None:
        """Room for so many rows.

        Raises:
            LogError: There is none: with what is made of them they would fill the memory.
        """
        self.columns = columns
        needed, there = 8 * rows * len(columns.names), _memory()
        if needed > _LARGEST_SHARE * there:
            raise LogError(
                f"Log {str(columns.path)!r} has {rows} rows of {len(columns.names)} numbers, "
                f"{needed / 1e9:.3g} GB; this machine has {there / 1e9:.3g} GB of memory.",
                advice="Give excerpts of it, or fewer columns.",
                rows=rows,
            )
        self.time = np.empty(rows)
        self._places = {joint: place for place, joint in enumerate(columns.joints)}
        shape = (rows, len(columns.joints))
        self._standing = {joint: np.empty(rows) for joint in columns.standing}
        self.values = {quantity: np.empty(shape) for quantity in columns.quantities}

    def put(self, name: str, rows: slice, numbers: Array) -> None:
        """Put numbers into some rows of the column of that name.

        Args:
            name: `time`, or `<joint>.<quantity>`; one of `Columns.names`.
            rows: Samples that the numbers are of.
            numbers: (n,) values of the column in these rows, SI.
        """
        if name == "time":
            self.time[rows] = numbers
        else:
            joint, quantity = name.rsplit(".", 1)
            if joint in self._standing:
                self._standing[joint][rows] = numbers
                return
            self.values[quantity][rows, self._places[joint]] = numbers

    def log(self, rows: int) -> JointLog:
        """The log of the first so many rows.

        Raises:
            LogError: They are too few.
        """
        path = self.columns.path
        if rows < LEAST_ROWS:
            names = ", ".join(self.columns.standing)
            more = f", without effort of {names}" if names else ""
            raise LogError(
                f"Log {str(path)!r} has {rows} rows{more}; at least {LEAST_ROWS} are needed.",
                advice="Record several seconds of motion.",
            )
        values = {quantity: numbers[:rows] for quantity, numbers in self.values.items()}
        return JointLog(
            path.stem,
            self.columns.joints,
            self.time[:rows],
            values["position"],
            values["effort"],
            values.get("velocity"),
            values.get("acceleration"),
            self.columns.notes,
            standing={joint: self._place(joint, rows) for joint in self._standing},
        )

    def _place(self, joint: str, rows: int) -> float:
        """Where a joint stands whose effort is not there; NaN if it moves."""
        numbers = self._standing[joint][:rows]
        numbers = numbers[np.isfinite(numbers)]
        still = len(numbers) and np.ptp(numbers) <= _STILL
        return float(numbers.mean()) if still else np.nan


def is_used(name: str) -> bool:
    """Whether a column is one of the format's."""
    return name == "time" or ("." in name and name.rsplit(".", 1)[1] in QUANTITIES)


def _joints(
    path: Path, having: Mapping[str, Sequence[str]], *, partial: bool
) -> tuple[Sequence[str], Sequence[str]]:
    """Joints with position and effort, and those without effort, an error unless partial."""
    joints, heard = having["position"], set(having["effort"])
    silent = [joint for joint in joints if joint not in heard]
    if not joints or len(silent) == len(joints):
        raise LogError(
            f"Log {str(path)!r} has no joint with both position and effort; positions: "
            f"{_listed(joints)}; efforts: {_listed(having['effort'])}.",
            advice=f"A log without effort says nothing about dynamics. {HEADER_ADVICE}",
        )
    if silent and not partial:
        raise LogError(
            f"Log {str(path)!r} is a log without effort of {', '.join(silent)}: the position is "
            "there, the effort is not.",
            advice="Log that joint's effort too, or leave its columns out.",
            joints=silent,
        )
    return [joint for joint in joints if joint in heard], silent


def _check_names(path: Path, names: Sequence[str]) -> None:
    """Refuse names that a column of the format has twice, and those that no text has."""
    if any("\0" in name for name in names):
        raise LogError(
            f"The first line of log {str(path)!r} has null characters: it is no text in UTF-8.",
            advice="Is it UTF-16, or binary? Save it as CSV in UTF-8, or as .npz.",
        )
    twice = sorted(name for name, count in Counter(names).items() if count > 1 and is_used(name))
    if twice:
        raise LogError(
            f"Log {str(path)!r} has these columns more than once: {', '.join(twice)}.",
            advice="Remove or rename one of each.",
            columns=twice,
        )


def _listed(names: Sequence[str]) -> str:
    """The first few names."""
    return f"{', '.join(names[:8]) or 'none'}{' …' if len(names) > 8 else ''}"


def _memory() -> int:
    """Bytes of memory of this machine, where its system tells; else more than any log needs."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return 1 << 62
