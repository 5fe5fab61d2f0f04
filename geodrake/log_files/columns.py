"""The columns of a log file: which joints and quantities its names stand for."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import LogError
from geodrake.motion import JointLog, check_joints

Array = NDArray[np.float64]

LEAST_ROWS = 10
QUANTITIES = ("position", "velocity", "acceleration", "effort")
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
    """

    path: Path
    joints: tuple[str, ...]
    quantities: tuple[str, ...]
    notes: tuple[str, ...]

    @classmethod
    def of(cls, path: Path, names: Sequence[str], joints: Sequence[str] | None) -> Columns:
        """The columns of a file with these names, joints in the order given if any is.

        Raises:
            LogError: Time, or a joint's position or effort, is missing, or the joints are others.
        """
        if "time" not in names:
            close = difflib.get_close_matches("time", [name.lower() for name in names], cutoff=0.4)
            raise LogError(
                f"Log {str(path)!r} has no column 'time'; it has {', '.join(names[:8]) or 'none'}"
                f"{' …' if len(names) > 8 else ''}.",
                advice=(f"Is it {close[0]!r}? " if close else "") + HEADER_ADVICE,
            )
        having = {
            quantity: [n.rsplit(".", 1)[0] for n in names if n.endswith(f".{quantity}")]
            for quantity in QUANTITIES
        }
        own = _joints(path, having)
        if joints is not None:
            check_joints(path.stem, own, joints)
        quantities, notes = [], []
        for quantity in QUANTITIES:
            missing = [f"{joint}.{quantity}" for joint in own if joint not in having[quantity]]
            if not missing:
                quantities.append(quantity)
            elif len(missing) < len(own):
                notes.append(f"{quantity} is not used: there is no {', '.join(missing)}")
        known = {"time", *(f"{joint}.{quantity}" for joint in own for quantity in QUANTITIES)}
        others = [name for name in names if name not in known]
        if others:
            more = " …" if len(others) > 8 else ""
            notes.append(f"columns ignored: {', '.join(others[:8])}{more}")
        return cls(path, tuple(own if joints is None else joints), tuple(quantities), tuple(notes))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns to read, time first."""
        return (
            "time",
            *(f"{joint}.{quantity}" for quantity in self.quantities for joint in self.joints),
        )


class Recording:
    """Arrays of a log while its file is read, column by column or stretch by stretch.

    Every number is held once: ten million rows of seven joints fill more than a gigabyte.
    """

    def __init__(self, columns: Columns, rows: int) -> None:
        """Room for so many rows."""
        self.columns = columns
        self.time = np.empty(rows)
        shape = (rows, len(columns.joints))
        self.values = {quantity: np.empty(shape) for quantity in columns.quantities}

    def put(self, name: str, rows: slice, numbers: Array) -> None:
        """Put numbers into some rows of the column of that name."""
        if name == "time":
            self.time[rows] = numbers
        else:
            joint, quantity = name.rsplit(".", 1)
            self.values[quantity][rows, self.columns.joints.index(joint)] = numbers

    def log(self, rows: int) -> JointLog:
        """The log of the first so many rows.

        Raises:
            LogError: They are too few.
        """
        path = self.columns.path
        if rows < LEAST_ROWS:
            raise LogError(
                f"Log {str(path)!r} has {rows} rows; at least {LEAST_ROWS} are needed.",
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
        )


def is_used(name: str) -> bool:
    """Whether a column is one of the format's."""
    return name == "time" or ("." in name and name.rsplit(".", 1)[1] in QUANTITIES)


def _joints(path: Path, having: Mapping[str, Sequence[str]]) -> Sequence[str]:
    """Joints with position and effort; an error if a position has no effort."""
    joints = having["position"]
    silent = [joint for joint in joints if joint not in having["effort"]]
    if not joints or len(silent) == len(joints):
        raise LogError(
            f"Log {str(path)!r} has no joint with both position and effort; positions: "
            f"{', '.join(joints) or 'none'}; efforts: {', '.join(having['effort']) or 'none'}.",
            advice=f"A log without effort says nothing about dynamics. {HEADER_ADVICE}",
        )
    if silent:
        raise LogError(
            f"Log {str(path)!r} is a log without effort of {', '.join(silent)}: the position is "
            "there, the effort is not.",
            advice="Log that joint's effort too, or leave its columns out.",
            joints=silent,
        )
    return joints
