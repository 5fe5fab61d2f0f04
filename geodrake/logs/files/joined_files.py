"""Logs whose columns are in several files: read one by one, and joined by their time stamps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import LogError
from geodrake.logs.files.csv_file import csv_table
from geodrake.logs.files.formats import read_table
from geodrake.logs.files.npz_file import npz_table
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.recognition import OF_JOINTS, Meaning, meaning_of, quantity_of
from geodrake.logs.files.table import LogTable
from geodrake.logs.files.units import unit_of

Array = NDArray[np.float64]

_YEARS = 9e8  # s, above which time is since 1970
_ROUNDING = 1e-6  # s, by which stamps of different clocks' forms may differ
_MIXED = 10.0  # times by which the rates of files may differ
_TEXT = (".csv", ".txt", ".dat", ".tsv", ".log")


def parts_of(path: Path) -> tuple[Path, ...]:
    """The files of a log: itself, or those that `+` joins, as in `positions.csv+efforts.csv`."""
    if "+" not in str(path) or path.exists():
        return (path,)
    return tuple(Path(part) for part in str(path).split("+") if part)


def joined_table(paths: Sequence[Path], reading: Reading) -> LogTable:
    """The columns of several files, at the time stamps of the one with the fewest a second.

    Args:
        paths: Files of any format. The name of a file may say the quantity of its columns, as
            that of `efforts.csv` does.
        reading: What the user said of the log.

    Raises:
        LogError: One cannot be read, files without time are not equally long, their times do not
            meet, or one has more than ten times the rows a second of another.
    """
    tables = [_table(path, reading) for path in paths]
    name = Path("+".join(path.name for path in paths))
    units = {column: unit for table in tables for column, unit in table.units.items()}
    noted = tuple(note for table in tables for note in table.notes)
    times, origins = _one_clock(name, tables, reading)
    stamped = [k for k, time in enumerate(times) if time is not None]
    if len(stamped) < 2:
        columns = _side_by_side(name, tables)
        origins = {column: zero for table in tables for column, zero in table.origins.items()}
        return LogTable(name, columns, units, noted, origins)
    if len(stamped) < len(tables):
        bare = [table.path.name for table, time in zip(tables, times, strict=True) if time is None]
        raise LogError(
            f"Log {str(name)!r} has files with time and without: {', '.join(bare)} has none.",
            advice="Give time in each file, or in one if all have the same rows.",
        )
    known = [time for time in times if time is not None]
    periods = [float(np.nanmedian(np.diff(time))) if len(time) > 1 else np.nan for time in known]
    base = int(np.nanargmax(periods))
    _check_rates(name, tables, periods)
    _check_meet(name, known)
    columns = {"time": known[base]}
    for table, time in zip(tables, known, strict=True):
        for column, values in table.columns.items():
            if not _is_time(column):
                columns[column] = _at(known[base], time, values)
    rate = 1.0 / periods[base]
    note = f"joined by time, at the {rate:.4g} rows a second of {tables[base].path.name}"
    return LogTable(name, columns, units, (note, *noted), origins)


def _table(path: Path, reading: Reading) -> LogTable:
    """The columns of one file; bare names of joints get the quantity of the file's name."""
    kind = path.suffix.lower()
    read = csv_table if kind in _TEXT else npz_table if kind == ".npz" else read_table
    table = read(path, reading)
    quantity = quantity_of(path.stem)
    if quantity is None or any(m.quantity == quantity for m in _meanings(table)):
        return table
    if quantity == "command" and any(m.quantity in OF_JOINTS for m in _meanings(table)):
        quantity = None  # positions by their names: of commands, as that of the file says

    def named(column: str) -> str:
        meaning = meaning_of(column)
        if _is_time(column):
            return column
        if quantity is None:
            is_position = meaning is not None and meaning.quantity == "position"
            own = column.removesuffix(".position")
            named = f"{own}.command" if own != column else f"command_{column}"
            return named if is_position else column
        return f"{quantity}_{column}" if column.isdecimal() else f"{column}.{quantity}"

    columns = {named(name): values for name, values in table.columns.items()}
    units = {named(name): unit for name, unit in table.units.items()}
    origins = {named(name): zero for name, zero in table.origins.items()}
    return LogTable(path, columns, units, table.notes, origins)


def _meanings(table: LogTable) -> list[Meaning]:
    return [meaning for name in table.columns if (meaning := meaning_of(name)) is not None]


def _is_time(name: str) -> bool:
    meaning = meaning_of(name)
    return meaning is not None and meaning.quantity in ("time", "nanoseconds")


def _time(table: LogTable, reading: Reading) -> Array | None:
    """Time stamps of a table, s."""
    times = [m for m in _meanings(table) if m.quantity == "time"]
    if not times:
        return None
    best = min(times, key=lambda meaning: meaning.role)
    if best.column in table.origins:
        return table.columns[best.column]
    unit = unit_of(reading.units["time"], "time") if "time" in reading.units else best.unit
    return table.columns[best.column] * (unit.factor if unit else 1.0)


def _one_clock(
    name: Path, tables: Sequence[LogTable], reading: Reading
) -> tuple[list[Array | None], dict[str, int]]:
    """Time stamps of each table, s, and since when they are, if any says it.

    Raises:
        LogError: Some are since a date, and others since nobody knows when.
    """
    times = [_time(table, reading) for table in tables]
    zeros = [next((o for c, o in t.origins.items() if _is_time(c)), None) for t in tables]
    known = [zero for zero in zeros if zero is not None]
    if not known or sum(time is not None for time in times) < 2:
        return times, {}
    first = min(known)
    moved: list[Array | None] = []
    for table, time, zero in zip(tables, times, zeros, strict=True):
        if time is None or zero is not None:
            moved.append(None if time is None or zero is None else time + 1e-9 * (zero - first))
            continue
        if not np.nanmedian(time) > _YEARS:
            raise LogError(
                f"The files of log {str(name)!r} have no common clock: time in {table.path.name} "
                "is not since 1970, and in another file it is of dates.",
                advice="Log dates, or seconds since 1970, in each file.",
            )
        moved.append(time - 1e-9 * first)
    return moved, {"time": first}


def _side_by_side(name: Path, tables: Sequence[LogTable]) -> dict[str, Array]:
    lengths = {len(table) for table in tables}
    if len(lengths) > 1:
        raise LogError(
            f"The files of log {str(name)!r} have {', '.join(map(str, sorted(lengths)))} rows, and "
            "no time in each to join them by.",
            advice="Log the time in every file.",
        )
    columns: dict[str, Array] = {}
    for table in tables:
        columns |= table.columns
    return columns


def _check_rates(name: Path, tables: Sequence[LogTable], periods: Sequence[float]) -> None:
    if max(periods) > _MIXED * min(periods):
        rates = (f"{t.path.name} {1 / p:.4g} Hz" for t, p in zip(tables, periods, strict=True))
        raise LogError(
            f"The files of log {str(name)!r} are of mixed rates: {', '.join(rates)}.",
            advice=f"Log them at rates that differ by a factor of {_MIXED:g} at most.",
        )


def _check_meet(name: Path, times: Sequence[Array]) -> None:
    first, last = max(np.nanmin(t) for t in times), min(np.nanmax(t) for t in times)
    if not first < last:
        spans = (f"{np.nanmin(t):.6g} to {np.nanmax(t):.6g} s" for t in times)
        raise LogError(
            f"The files of log {str(name)!r} are of times that do not meet: {', '.join(spans)}.",
            advice="Use one clock for both.",
        )


def _at(instants: Array, time: Array, values: Array) -> Array:
    """Values at other instants: between the neighbours; NaN outside, and beside empty cells."""
    good = np.isfinite(time)
    inside = np.clip(instants, time[good].min(), time[good].max())
    instants = np.where(np.abs(inside - instants) < _ROUNDING, inside, instants)
    return np.interp(instants, time[good], values[good], left=np.nan, right=np.nan)
