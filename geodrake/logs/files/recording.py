"""The numbers of a log while its file is read."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import LogError
from geodrake.logs.files.column_mapping import Columns
from geodrake.logs.files.joined_tables import at_instants
from geodrake.logs.files.packed_files import log_name
from geodrake.logs.files.registers import are_whole, signed_register
from geodrake.logs.files.table import TornRows
from geodrake.logs.motion import PASSIVE, JointLog
from geodrake.logs.time_stamps import evened, order_of_time, repeats, with_clock_set_back

Array = NDArray[np.float64]

LEAST_ROWS = 10
TICKS = 4096  # of a turn, of servos with twelve bits
_FIRST = 1000  # rows that mostly tell that numbers are no whole ones
_RUN, _ENOUGH_ROWS = 20, 100  # rows without an empty cell that are of use, and of a column
_STILL = 2e-3  # rad or m, by which a joint may move and still stand


class Recording:
    """Numbers of a log's file on their way to a log.

    Every number is held once, but for those of a quantity: ten million rows of seven joints fill
    more than a gigabyte.
    """

    def __init__(self, columns: Columns, numbers: dict[str, Array], torn: TornRows) -> None:
        """Take numbers (N,) by the columns of the file, which are taken out, and bad rows."""
        rows = len(next(iter(numbers.values())))
        if rows < LEAST_ROWS:
            raise LogError(
                f"Log {str(columns.path)!r} has {rows} rows; at least {LEAST_ROWS} are needed.",
                advice="Record several seconds of motion.",
            )
        self.columns, self.torn = columns, torn

        def column(name: str) -> Array:
            source = columns.sources.get(name)
            return np.full(rows, np.nan) if source is None else source.read(numbers)

        rate = columns.rate
        self.time = np.arange(rows) / rate if rate is not None else column("time")
        self._standing = {joint: column(f"{joint}.position") for joint in columns.standing}
        self._floating = {name: column(name) for name in columns.floating}
        self.values = {name: np.empty((rows, len(columns.joints))) for name in columns.quantities}
        for quantity, values in self.values.items():
            for place, joint in enumerate(columns.joints):
                values[:, place] = column(f"{joint}.{quantity}")

    def log(self) -> JointLog:
        """Return the log."""
        source = self.columns.sources.get("time")
        time, notes = (self.time, ()) if source is None else source.seconds(self.time)
        time, more = with_clock_set_back(time)
        order = None if self.torn.rows else order_of_time(time, self.values["position"])
        if order is not None:  # rows that are torn are known by their place in the file
            time, more = time[order], (*more, "rows were not in the order of time: sorted by it")
            self.values = {quantity: numbers[order] for quantity, numbers in self.values.items()}
            self._standing = {joint: numbers[order] for joint, numbers in self._standing.items()}
            self._floating = {name: numbers[order] for name, numbers in self._floating.items()}
        time, even = evened(time, self.values["position"])
        more += even
        again = repeats(time)
        if again.any():
            time = np.where(again, np.nan, time)
            more += (f"{again.sum()} rows with the time of the row before left out",)
        kept, torn = self.torn.settle(time)
        if again.any():
            kept = ~again if kept is None else kept & ~again
        alone, floating = self._standing, self._floating
        values, signed = self._signed(self.values)
        values, ticks = self._in_radians(values)
        values["effort"], kinds, more_notes = self._without_motors(values["effort"])
        if kept is not None:
            time = time[kept]
            values = {quantity: numbers[kept] for quantity, numbers in values.items()}
            alone = {joint: numbers[kept] for joint, numbers in alone.items()}
            floating = {name: numbers[kept] for name, numbers in floating.items()}
        if (rows := _rows_of_the_rarest(time, values)) is not None:

            def known(quantity: str, numbers: Array) -> Array:
                there, holds = np.isfinite(numbers) & np.isfinite(time), quantity == "command"
                return at_instants(time[rows], time[there], numbers[there], holds=holds)

            values = {q: np.stack([known(q, c) for c in x.T], 1) for q, x in values.items()}
            alone = {joint: known("position", numbers) for joint, numbers in alone.items()}
            floating = {name: known("command", numbers) for name, numbers in floating.items()}
            count, time = len(time), time[rows]
            words = "rows have some columns each: all are brought to the instants of the rarest"
            more += (f"{words}, {len(time)} of {count} rows",)
        return JointLog(
            log_name(self.columns.path),
            self.columns.joints,
            time,
            values["position"],
            values["effort"],
            values.get("velocity"),
            values.get("acceleration"),
            (*self.columns.notes, *notes, *more, *signed, *ticks, *more_notes, *torn),
            effort_uncertainty=self._uncertainty(kinds),
            standing={joint: self._place(joint) for joint in self._standing},
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

    def _place(self, joint: str) -> float:
        """Return where a joint stands whose effort is not there; NaN if it moves."""
        numbers = self._standing[joint]
        numbers = numbers[np.isfinite(numbers)]
        if not len(numbers) or numbers.max() - _STILL > numbers.min():
            return np.nan
        return float(numbers[0] + (numbers - numbers[0]).mean())


def _rows_of_the_rarest(time: Array, values: Mapping[str, Array]) -> NDArray[np.bool_] | None:
    """Return rows (N,) that have the column which fewest have; None of a log with whole rows.

    It has whole rows if half of them come in runs that are long enough to be of use.
    """
    quantities = [values[q] for q in ("position", "effort", "command") if q in values]
    if all(np.isfinite(numbers).all() for numbers in quantities):
        return None
    known = [np.isfinite(column) for numbers in quantities for column in numbers.T]
    known = [each for each in known if each.any()]
    rarest = min(known, key=np.count_nonzero, default=np.zeros(0, bool))
    if np.count_nonzero(rarest) < _ENOUGH_ROWS:
        return None
    whole = np.logical_and.reduce(known)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], whole, [False]]).astype(np.int8)))
    lengths = edges[1::2] - edges[::2]
    has_whole = 2 * lengths[lengths >= _RUN].sum() >= np.count_nonzero(rarest)
    return None if has_whole else rarest & np.isfinite(time)


def _with_column(numbers: Array, at: int, column: Array | float) -> Array:
    """Return a copy of numbers (N, n) with another column."""
    found = numbers.copy()
    found[:, at] = column
    return found
