"""Parts of a log that were recorded apart, as columns in several tables: joined by time stamps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import LogError
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.recognition import Meaning, is_time, meaning_of
from geodrake.logs.files.table import LogTable
from geodrake.logs.files.units import unit_of
from geodrake.logs.time_stamps import time_unit

Array = NDArray[np.float64]

_YEARS = 9e8  # s, above which time is since 1970
_ROUNDING = 1e-6  # s, by which stamps of different clocks' forms may differ
_MIXED = 10.0  # times by which the rates of parts may differ
_ALIKE = 0.9  # of the longest period, from which on parts are as slow, and the first is taken
_GAP_STEPS, _GAP_SECONDS = 5.0, 0.02  # a longer time step is a gap, as in logs


def joined_tables(log: Path, tables: Sequence[LogTable], reading: Reading) -> LogTable:
    """The columns of several tables, at the time stamps of the first with the fewest a second.

    Args:
        log: What messages call the log.
        tables: Its parts; messages call each by its path.

    Raises:
        LogError: Parts without time are not equally long, their times do not meet, or one has more
            than ten times the rows a second of another.
    """
    units = {column: unit for table in tables for column, unit in table.units.items()}
    noted = tuple(note for table in tables for note in table.notes)
    times, origins, unit_notes = _one_clock(log, tables, reading)
    stamped = [k for k, time in enumerate(times) if time is not None]
    if len(stamped) < 2:
        columns = _side_by_side(log, tables)
        origins = {column: zero for table in tables for column, zero in table.origins.items()}
        return LogTable(log, columns, units, noted, origins)
    if len(stamped) < len(tables):
        bare = [str(table.path) for table, time in zip(tables, times, strict=True) if time is None]
        raise LogError(
            f"Log {str(log)!r} has parts with time and without: {', '.join(bare)} has none.",
            advice="Give time in each part, or in one if all have the same rows.",
        )
    known = [time for time in times if time is not None]
    periods = [float(np.nanmedian(np.diff(time))) if len(time) > 1 else np.nan for time in known]
    slowest = _ALIKE * np.nanmax(periods)
    base = next(k for k, period in enumerate(periods) if period >= slowest)
    _check_rates(log, tables, periods)
    _check_meet(log, known)
    columns = {"time": known[base]}
    for table, time in zip(tables, known, strict=True):
        for column, values in table.columns.items():
            if not is_time(column):
                meaning = meaning_of(column)
                holds = meaning is not None and meaning.quantity == "command"
                columns[column] = _at(known[base], time, values, holds=holds)
    rate = 1.0 / periods[base]
    note = f"joined by time, at the {rate:.4g} rows a second of {tables[base].path}"
    notes = (note, *unit_notes, *noted)
    return LogTable(log, columns, units, notes, origins, in_seconds=True)


def meanings_of(table: LogTable) -> list[Meaning]:
    """What columns of a table are, of those whose names say it."""
    return [meaning for name in table.columns if (meaning := meaning_of(name)) is not None]


def _time(table: LogTable, reading: Reading) -> tuple[Array | None, str]:
    """Time stamps of a table, s, and a note of a unit that nobody said."""
    times = [m for m in meanings_of(table) if m.quantity == "time"]
    if not times:
        return None, ""
    best = min(times, key=lambda meaning: meaning.role)
    if best.column in table.origins or table.in_seconds:
        return table.columns[best.column], ""
    unit = unit_of(reading.units["time"], "time") if "time" in reading.units else best.unit
    time = table.columns[best.column]
    factor, note = (unit.factor, "") if unit else time_unit(best.column, time) or (1.0, "")
    return factor * time, note


def _one_clock(
    log: Path, tables: Sequence[LogTable], reading: Reading
) -> tuple[list[Array | None], dict[str, int], tuple[str, ...]]:
    """Time stamps of each table, s, since when they are, if any says it, and notes of their units.

    Raises:
        LogError: Some are since a date, and others since nobody knows when.
    """
    stamps = [_time(table, reading) for table in tables]
    times = [time for time, _ in stamps]
    notes = tuple(dict.fromkeys(note for _, note in stamps if note))
    zeros = [next((o for c, o in t.origins.items() if is_time(c)), None) for t in tables]
    known = [zero for zero in zeros if zero is not None]
    if not known or sum(time is not None for time in times) < 2:
        return times, {}, notes
    first = min(known)
    moved: list[Array | None] = []
    for table, time, zero in zip(tables, times, zeros, strict=True):
        if time is None or zero is not None:
            moved.append(None if time is None or zero is None else time + 1e-9 * (zero - first))
            continue
        if not np.nanmedian(time) > _YEARS:
            raise LogError(
                f"The parts of log {str(log)!r} have no common clock: time in {table.path} "
                "is not since 1970, and in another part it is of dates.",
                advice="Log dates, or seconds since 1970, in each part.",
            )
        moved.append(time - 1e-9 * first)
    return moved, {"time": first}, notes


def _side_by_side(log: Path, tables: Sequence[LogTable]) -> dict[str, Array]:
    lengths = {len(table) for table in tables}
    if len(lengths) > 1:
        raise LogError(
            f"The parts of log {str(log)!r} have {', '.join(map(str, sorted(lengths)))} rows, and "
            "no time in each to join them by.",
            advice="Log the time in every part.",
        )
    columns: dict[str, Array] = {}
    for table in tables:
        columns |= table.columns
    return columns


def _check_rates(log: Path, tables: Sequence[LogTable], periods: Sequence[float]) -> None:
    if max(periods) > _MIXED * min(periods):
        rates = (f"{t.path} {1 / p:.4g} Hz" for t, p in zip(tables, periods, strict=True))
        raise LogError(
            f"The parts of log {str(log)!r} are of mixed rates: {', '.join(rates)}.",
            advice=f"Log them at rates that differ by a factor of {_MIXED:g} at most.",
        )


def _check_meet(log: Path, times: Sequence[Array]) -> None:
    first, last = max(np.nanmin(t) for t in times), min(np.nanmax(t) for t in times)
    if not first < last:
        spans = (f"{np.nanmin(t):.6g} to {np.nanmax(t):.6g} s" for t in times)
        raise LogError(
            f"The parts of log {str(log)!r} are of times that do not meet: {', '.join(spans)}.",
            advice="Use one clock for both.",
        )


def _at(instants: Array, time: Array, values: Array, *, holds: bool) -> Array:
    """Values at other instants: between the neighbours; NaN outside, in gaps, and beside NaN.

    Args:
        instants: (N,) the instants, s.
        time: (K,) those of the values, s.
        values: (K,) the values.
        holds: Whether the last one holds in gaps, as a command does.
    """
    good = np.isfinite(time)
    time, values = time[good], values[good]
    if len(time) < 2:
        return np.full(len(instants), np.nan)
    inside = np.clip(instants, time.min(), time.max())
    instants = np.where(np.abs(inside - instants) < _ROUNDING, inside, instants)
    after = np.clip(np.searchsorted(time, instants), 1, len(time) - 1)
    steps, since, until = np.diff(time), instants - time[after - 1], time[after] - instants
    gap = steps[after - 1] > max(_GAP_STEPS * np.median(steps), _GAP_SECONDS)
    gap &= (since > _ROUNDING) & (until > _ROUNDING)
    found = np.interp(instants, time, values, left=np.nan, right=np.nan)
    return np.where(gap, values[after - 1] if holds else np.nan, found)
