"""The numbers of a log while its file is read."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import LogError
from geodrake.logs.files.column_mapping import Columns, Source
from geodrake.logs.files.packed_files import log_name
from geodrake.logs.files.registers import are_whole, signed_register
from geodrake.logs.files.table import TornRows, check_room
from geodrake.logs.motion import PASSIVE, JointLog
from geodrake.logs.time_stamps import evened, repeats, time_unit, with_clock_set_back

Array = NDArray[np.float64]

LEAST_ROWS = 10
TICKS = 4096  # of a turn, of servos with twelve bits
_FIRST = 1000  # rows that mostly tell that numbers are no whole ones
_STILL = 2e-3  # rad or m, by which a joint may move and still stand


class Recording:
    """Arrays of a log while its file is read, block by block or at once.

    Every number is held once: ten million rows of seven joints fill more than a gigabyte.
    """

    def __init__(self, columns: Columns, rows: int) -> None:
        """Room for so many rows."""
        self.columns = columns
        width = len(columns.names)
        check_room(columns.path, rows * width, f"{rows} rows of {width} numbers")
        self.torn = TornRows(columns.path, rows, columns.reading.skip_bad_rows)
        self.time = np.empty(rows)
        self._start: float | None = None
        self._places = {joint: place for place, joint in enumerate(columns.joints)}
        shape = (rows, len(columns.joints))
        self._standing = {joint: np.empty(rows) for joint in columns.standing}
        self._floating = {name: np.empty(rows) for name in columns.floating}
        self.values = {quantity: np.empty(shape) for quantity in columns.quantities}
        for quantity, numbers in self.values.items():
            for place, joint in enumerate(columns.joints):
                if not columns.has(joint, quantity):
                    numbers[:, place] = np.nan

    def put(self, rows: slice, numbers: Mapping[str, Array]) -> None:
        """Put numbers into some rows.

        Args:
            numbers: Column of the file -> (n,) its numbers in these rows; those of
                `Columns.files`, or some of them.
        """
        for name in self.columns.names:
            source = self.columns.sources.get(name)
            if source is not None and numbers.keys() >= set(source.columns):
                self._target(name)[rows] = self._converted(source, numbers)

    def _target(self, name: str) -> Array:
        """(N,) where the numbers of a column go."""
        if name == "time":
            return self.time
        if name in self._floating:
            return self._floating[name]
        joint, quantity = name.rsplit(".", 1)
        if joint in self._standing:
            return self._standing[joint]
        return self.values[quantity][:, self._places[joint]]

    def _converted(self, source: Source, numbers: Mapping[str, Array]) -> Array:
        values = numbers[source.column]
        if source.nanoseconds is not None:  # from the first second on, so that no digits are lost
            if self._start is None:
                self._start = float(values[np.isfinite(values)][:1].sum())
            values = (values - self._start) + 1e-9 * numbers[source.nanoseconds]
        values = values if source.factor == 1.0 else source.factor * values
        return values + source.offset if source.offset else values

    def log(self, rows: int) -> JointLog:
        """Return the log of the first so many rows."""
        path = self.columns.path
        if rows < LEAST_ROWS:
            raise LogError(
                f"Log {str(path)!r} has {rows} rows; at least {LEAST_ROWS} are needed.",
                advice="Record several seconds of motion.",
            )
        if self.columns.rate is not None:
            self.time[:rows] = np.arange(rows) / self.columns.rate
        time, notes = self._seconds(self.time[:rows])
        time, more = with_clock_set_back(time)
        time, even = evened(time, self.values["position"][:rows])
        more += even
        again = repeats(time)
        if again.any():
            time = np.where(again, np.nan, time)
            more += (f"{again.sum()} rows with the time of the row before left out",)
        kept, torn = self.torn.settle(time)
        if again.any():
            kept = ~again if kept is None else kept & ~again
        values = {quantity: numbers[:rows] for quantity, numbers in self.values.items()}
        alone = {joint: numbers[:rows] for joint, numbers in self._standing.items()}
        floating = {name: numbers[:rows] for name, numbers in self._floating.items()}
        values, signed = self._signed(values)
        values, ticks = self._in_radians(values)
        values["effort"], kinds, more_notes = self._without_motors(values["effort"])
        if kept is not None:
            time = time[kept]
            values = {quantity: numbers[kept] for quantity, numbers in values.items()}
            alone = {joint: numbers[kept] for joint, numbers in alone.items()}
            floating = {name: numbers[kept] for name, numbers in floating.items()}
        return JointLog(
            log_name(path),
            self.columns.joints,
            time,
            values["position"],
            values["effort"],
            values.get("velocity"),
            values.get("acceleration"),
            (*self.columns.notes, *notes, *more, *signed, *ticks, *more_notes, *torn),
            effort_uncertainty=self._uncertainty(kinds),
            standing={joint: self._place(joint, rows) for joint in self._standing},
            alone=alone,
            command=values.get("command"),
            effort_kinds=kinds,
            temperature=values.get("temperature"),
            origin=self.columns.origin,
            floating=floating,
            left_out=self.columns.left_out,
        )

    def _signed(self, values: Mapping[str, Array]) -> tuple[dict[str, Array], list[str]]:
        """Return numbers (N, n) with the signs of registers that were read without; and notes."""
        found, notes = dict(values), []
        for quantity, numbers in values.items():
            for at, joint in enumerate(self.columns.joints):
                source = self.columns.sources.get(f"{joint}.{quantity}")
                if source is None or not are_whole(source.written(numbers[:_FIRST, at])):
                    continue
                written = source.written(numbers[:, at])
                signed = signed_register(written, magnitudes=quantity != "position")
                if signed is not None:
                    column = source.factor * signed[0] + source.offset
                    found[quantity] = _with_column(found[quantity], at, column)
                    notes.append(f"{source.column!r} is read as {signed[1]}")
        return found, notes

    def _in_radians(self, values: dict[str, Array]) -> tuple[dict[str, Array], list[str]]:
        """Return positions and commands (N, n) in rad where they are ticks of servos; and notes.

        Whole numbers from 0 to less than 4,096, and beyond 1,024, are taken for ticks if nobody
        says their unit, as geodrake's own names of columns do: in rad no joint goes so far, and in
        degrees hardly one in whole ones.
        """
        told = [n for n in values if n in ("position", "command") and np.isfinite(values[n]).any()]
        if "position" not in told:
            return values, []
        for quantity in told:
            names = (f"{joint}.{quantity}" for joint in self.columns.joints)
            sources = ((name, self.columns.sources.get(name)) for name in names)
            if any(s and (s.unit or s.factor != 1.0 or s.column == n) for n, s in sources):
                return values, []
            numbers, least = values[quantity], TICKS / 4 if quantity == "position" else 0.0
            if not (are_whole(numbers[:_FIRST]) and are_whole(numbers)):
                return values, []
            if not np.nanmin(numbers) >= 0.0 or not least < np.nanmax(numbers) < TICKS:
                return values, []
        turned = {name: values[name] * (2.0 * np.pi / TICKS) for name in told}
        words = (
            f"positions are whole numbers, from {np.nanmin(values['position']):.0f} to "
            f"{np.nanmax(values['position']):.0f}, and so ticks of servos with {TICKS} a turn: "
            "converted (if they are not, give their unit by --units or a mapping)"
        )
        return {**values, **turned}, [words]

    def _without_motors(self, effort: Array) -> tuple[Array, dict[str, str], list[str]]:
        """Return efforts (N, n), zeros at joints without a motor, their kinds, and notes."""
        kinds, notes, command = self.columns.kinds, [], self.values.get("command")
        for at, joint in enumerate(self.columns.joints):
            said, motorless = kinds.get(joint) == PASSIVE, self.columns.reading.motorless
            if not said and joint not in motorless:
                continue
            largest = float(np.abs(np.nan_to_num(effort[:, at])).max(initial=0.0))
            told = command is not None and np.isfinite(command[:, at]).any()
            if said and largest > 0.0:
                raise LogError(
                    f"Joint {joint!r} is said to have no motor, and log {self.columns.path.name!r} "
                    f"has efforts of it, of up to {largest:.4g}.",
                    advice="Leave --passive out; or write `effort: passive` in a mapping, which "
                    "leaves that column out.",
                    joint=joint,
                )
            if joint in motorless and not (largest or told):
                kinds[joint] = PASSIVE
                notes.append(f"{joint} has no motor by the model, and no effort here: passive")
            if kinds.get(joint) == PASSIVE:
                effort = _with_column(effort, at, 0.0)
        return effort, kinds, notes

    def _uncertainty(self, kinds: Mapping[str, str]) -> float | Array:
        """Return how well gains of efforts are known; zeros of passive joints are exact."""
        joints = self.columns.joints
        found = self.columns.reading.effort_uncertainty(joints)
        passive = np.array([kinds.get(joint) == PASSIVE for joint in joints])
        return np.where(passive, 0.0, found) if passive.any() else found

    def _place(self, joint: str, rows: int) -> float:
        """Return where a joint stands whose effort is not there; NaN if it moves."""
        numbers = self._standing[joint][:rows]
        numbers = numbers[np.isfinite(numbers)]
        if not len(numbers) or numbers.max() - _STILL > numbers.min():
            return np.nan
        return float(numbers[0] + (numbers - numbers[0]).mean())

    def _seconds(self, time: Array) -> tuple[Array, tuple[str, ...]]:
        """Return time stamps in s, where nobody said their unit, and a note of it."""
        source = self.columns.sources.get("time")
        if source is None or source.unit is not None or source.nanoseconds is not None:
            return time, ()
        found = time_unit(source.column, time)
        return (time, ()) if found is None else (found[0] * time, (found[1],))


def _with_column(numbers: Array, at: int, column: Array | float) -> Array:
    """Return a copy of numbers (N, n) with another column."""
    found = numbers.copy()
    found[:, at] = column
    return found
