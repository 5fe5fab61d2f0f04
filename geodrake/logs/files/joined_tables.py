"""Tables that are parts of one log: joined by time stamps, or by the joints that cells name."""

from __future__ import annotations

import re
from collections import ChainMap, Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from geodrake.boundary.arguments import Array
from geodrake.errors import LogError
from geodrake.logs.files.base_names import floating_meaning
from geodrake.logs.files.column_mapping import (
    in_seconds,
    likely_clock,
    listed,
    read_column,
    time_source,
    with_own_parts,
)
from geodrake.logs.files.name_rules import (
    PART,
    PLAIN,
    Meaning,
    joint_columns,
    matched,
    meaning_of,
    meanings_of,
    names_joints,
    number_of,
    numbers_joints,
    plain_words,
    tells,
    tells_clock,
    without_unit,
    words_of,
)
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import LogTable, Texts
from geodrake.logs.files.units import find_unit
from geodrake.logs.floating import FLAG, vectors
from geodrake.logs.motion import EFFORT_KINDS
from geodrake.logs.time_stamps import longest_step

_YEARS = 9e8  # s, above which time is since 1970
_ROUNDING = 1e-6  # s, by which stamps of different clocks' forms may differ
_ROWS_APART = 2.0  # by which the ends of parts that begin together may differ
RARE = "is too slow"
"""Why columns were left out that have far fewer rows a second than others."""

_MIXED = 10.0  # times by which the rates of parts may differ
_TURNED, _FEWEST_TURNS = 0.02, 10  # rad, by which an interpolated orientation may be off, and rows
_FEW_BACK = 0.01  # of rows, which may be skipped as their time is back
_ALIKE = 0.9  # of the longest period, from which on parts are as slow, and the first is taken


def joined_tables(log: Path, tables: Sequence[LogTable], reading: Reading) -> LogTable:
    """Join several tables at the time stamps of the first of those with the lowest rate."""
    tables = _of_model(tables, reading)
    order = _order(tables, reading)
    if reading.mapping is not None:
        reading = replace(reading, mapping=reading.mapping.named(order))
    stamps = _times(tables, reading)
    bare = [str(t.path) for t, (time, _) in zip(tables, stamps, strict=True) if time is None]
    if len(bare) >= len(tables) - 1:
        return _of_same_rows(log, tables)
    if bare:
        raise LogError(
            f"Parts of log {str(log)!r} have no time: {', '.join(bare)}.",
            advice="Give all parts time, or only one if all have the same rows.",
        )
    known, origin, clock_notes = _one_clock(
        log, tables, [np.asarray(t) for t, _ in stamps], reading
    )
    clock_notes = (*dict.fromkeys(note for _, said in stamps for note in said), *clock_notes)
    if reading.skip_bad_rows:
        known, skipped = _forwards(tables, known)
        clock_notes += skipped
    steps = [np.diff(time[np.isfinite(time)]) for time in known]
    periods = [float(np.median(step)) if len(step) else np.inf for step in steps]
    for table, period, step in zip(tables, periods, steps, strict=True):
        if (step < 0.0).any() or not period > 0.0:
            what = "stands still in most rows" if (step >= 0.0).all() else "runs backwards"
            raise LogError(
                f"In a part of log {str(log)!r}, {table.path}, time {what}.",
                advice="Write it with more digits, sort rows by it, or cut them where a clock was "
                "set back.",
            )
    quick = [period for period in periods if period <= _MIXED * min(periods)]
    base = next(k for k, p in enumerate(periods) if p in quick and p >= _ALIKE * max(quick))
    tables, slow_notes, rare = _slow_parts(log, tables, periods, reading)
    if not max(map(np.nanmin, known)) < min(map(np.nanmax, known)):
        spans = (f"{np.nanmin(t):.6g} to {np.nanmax(t):.6g} s" for t in known)
        raise LogError(
            f"The parts of log {str(log)!r} do not overlap in time: {', '.join(spans)}.",
            advice="Use one clock for all, or write a log for each joint if they move in turn.",
        )
    instants = known[base][np.isfinite(known[base])] if reading.skip_bad_rows else known[base]
    columns, again = {order[0]: instants}, list[str]()
    for table, time in zip(tables, known, strict=True):
        for column, values in table.columns.items():
            if column in columns:
                again += [column] * (column != order[0])
            elif not _is_time(table, column, reading):
                holds = _what(column, reading)[1] in ("command", FLAG)
                columns[column] = at_instants(instants, time, values, holds=holds)
    rate = 1.0 / periods[base]
    note = f"joined by time at {rate:.4g} Hz, the rate of {tables[base].path}"
    noted = (note for table in tables for note in table.notes)
    notes = (note, *_twice(again), *slow_notes, *clock_notes, *noted)
    units = {column: unit for table in tables for column, unit in table.units.items()}
    silent = {column: why for table in tables for column, why in table.silent.items()}
    zeros = {order[0]: origin}
    return LogTable(log, columns, units, notes, zeros, {**silent, **rare}, order=order)


def _forwards(
    tables: Sequence[LogTable], times: Sequence[Array]
) -> tuple[list[Array], tuple[str, ...]]:
    """Return times (N,) of tables without those of few rows in which it is back, and notes."""
    found, notes = list[Array](), list[str]()
    for table, time in zip(tables, times, strict=True):
        back = time < np.fmax.accumulate(time)
        back &= np.mean(back) <= _FEW_BACK
        found.append(np.where(back, np.nan, time))
        if back.any():
            count = np.count_nonzero(back)
            notes.append(f"rows of {table.path} skipped, as their time is back: {count}")
    return found, tuple(notes)


def _of_same_rows(log: Path, tables: Sequence[LogTable]) -> LogTable:
    """Return the columns of tables of which one at most has time."""
    lengths = sorted({len(table) for table in tables})
    if len(lengths) > 1:
        raise LogError(
            f"The parts of log {str(log)!r} have no time, and different numbers of rows: "
            f"{', '.join(map(str, lengths))}.",
            advice="Log the time in every part.",
        )
    counts = Counter(name for table in tables for name in table.columns)
    again = [name for name in counts for _ in range(counts[name] - 1)]
    every = ChainMap(*(dict(table.columns) for table in tables))
    notes = (note for table in tables for note in table.notes)
    units = {column: unit for table in tables for column, unit in table.units.items()}
    zeros = {column: zero for table in tables for column, zero in table.origins.items()}
    said = next((table.rate for table in tables if table.rate), None)
    columns = {name: every[name] for name in counts}
    return LogTable(log, columns, units, (*_twice(again), *notes), zeros, rate=said)


def _of_model(tables: Sequence[LogTable], reading: Reading) -> Sequence[LogTable]:
    """Drop tables whose joints are all unknown to the model, such as those of a gripper."""
    names = dict.fromkeys(n for t in tables for n in t.columns if floating_meaning(n) is None)
    every = joint_columns(names, reading.joints)
    joint_of = matched(every, reading.joints)[0]
    told = [[m for m in every if m.column in table.columns] for table in tables]
    joints = [{joint_of[m.column] for m in each if m.column in joint_of} for each in told]
    model = {*reading.joints}
    is_own = [not m or not j.isdisjoint(model) for m, j in zip(told, joints, strict=True)]
    if reading.mapping is not None or all(is_own) or model.isdisjoint(set().union(*joints)):
        return tables
    first, *others = [table for table, own in zip(tables, is_own, strict=True) if own]
    lost = [m.column for each, own in zip(told, is_own, strict=True) if not own for m in each]
    return [first.noting(f"not used, as the model has no such joints: {listed(lost)}"), *others]


def _twice(columns: Sequence[str]) -> list[str]:
    """Return a note about columns that occur in several parts."""
    said = f"columns {listed(columns)} occur in several parts; those of the first are used"
    return [said] if columns else []


def _order(tables: Sequence[LogTable], reading: Reading) -> list[str]:
    """Return the names of the columns of several tables together, that of time first."""
    time = reading.mapping.time if reading.mapping else None
    clock = time.among([*tables[0].columns]) if time else ""
    clock = clock if any(clock in table.columns for table in tables) else "time"
    names = dict.fromkeys(n for t in tables for n in t.columns if not t.is_time(n) and n != clock)
    return [clock, *names]


def _is_time(table: LogTable, column: str, reading: Reading) -> bool:
    """Return whether a column is time, by its name, its dates or the mapping."""
    return table.is_time(column) or _what(column, reading)[1] == "time"


def _what(column: str, reading: Reading) -> tuple[str, str]:
    """Return the joint or frame of a column, and its quantity."""
    for name, mapped in reading.mapping or ():
        if mapped.column == column:
            joint, _, quantity = name.rpartition(".")
            return joint, "effort" if quantity in EFFORT_KINDS else quantity
    if (known := floating_meaning(column)) is not None:
        name = known.quantity
        return "", FLAG if name.endswith(FLAG) else name.rpartition(".")[0]
    meaning = meaning_of(column)
    return ("", "") if meaning is None else (meaning.joint, meaning.log_quantity)


def _slow_parts(
    log: Path, tables: Sequence[LogTable], periods: Sequence[float], reading: Reading
) -> tuple[list[LogTable], list[str], dict[str, str]]:
    """Return the tables, slow ones reduced to columns that may be interpolated, and notes.

    Slow ones have less than a tenth as many rows a second as others. Temperatures, flags and the
    orientation of a base with an IMU change slowly. Other slow tables are left out with a note
    where the log can do without them.
    """
    quickest = min(periods)
    parts = [*zip(tables, periods, strict=True)]
    quick = [_what(c, reading) for t, p in parts if p <= _MIXED * quickest for c in t.columns]
    kinds = {what.replace("command", "effort") for _, what in quick}
    has_imu = {"imu.angular_velocity", "imu.linear_acceleration"} <= kinds
    joints = {joint for joint, _ in quick} - {""}
    found, notes, rare, needed = list[LogTable](), list[str](), dict[str, str](), False
    for table, period in parts:
        if period <= _MIXED * quickest:
            found.append(table)
            continue
        may = {"temperature", FLAG, "time", PART}
        may |= {"base.orientation"} if has_imu and _turns_slowly(table.columns) else set()
        told = {column: _what(column, reading) for column in table.columns}
        lost = {column: what for column, what in told.items() if what[1] not in may}
        for joint, what in lost.values():
            if (kind := what.replace("command", "effort")) in ("position", "effort"):
                needed |= (joint in joints and what != "command") or kind not in kinds
            needed |= what.startswith("base.") and not has_imu
            needed |= what.startswith("imu.") and "base.orientation" not in kinds
        kept = {c: values for c, values in table.columns.items() if c not in lost}
        found.append(replace(table, columns=kept))
        used = [column for column in kept if not _is_time(table, column, reading)]
        done = {"interpolated": used, "dropped": [*lost]}
        words = [f"{listed(columns)} {what}" for what, columns in done.items() if columns]
        rates = f"{1 / period:.4g} Hz, but other columns up to {1 / quickest:.4g} Hz"
        notes.append(f"{table.path} has {rates}: {', '.join(words)}")
        rare |= dict.fromkeys(lost, f"{RARE}: {rates}")
    if needed:
        each = (f"{t.path} {1 / p:.4g} Hz" for t, p in zip(tables, periods, strict=True))
        raise LogError(
            f"The parts of log {str(log)!r} have very different rates: {', '.join(each)}.",
            advice=f"Log them at rates that differ at most by a factor of {_MIXED:g}.",
        )
    return found, notes, rare


def _turns_slowly(columns: Mapping[str, Array]) -> bool:
    """Return whether orientations of a base are close to the interpolation of their neighbours."""
    told = {floating_meaning(column): values for column, values in columns.items()}
    named = {meaning.quantity: values for meaning, values in told.items() if meaning}
    q = vectors(named, "base.orientation")
    q = np.zeros((0, 4)) if q is None else q[np.isfinite(q).all(axis=1)]
    if len(q) < _FEWEST_TURNS:
        return False
    before, here, after = q[:-2], q[1:-1], q[2:]
    between = before + np.sign(np.sum(before * after, axis=1))[:, None] * after
    size = np.linalg.norm(between, axis=1) * np.linalg.norm(here, axis=1)
    cosines = np.abs(np.sum(between * here, axis=1)) / np.maximum(size, np.finfo(float).tiny)
    off = 2.0 * np.arccos(np.minimum(cosines, 1.0))
    return bool(np.quantile(off, 0.99) / 4.0 < _TURNED)  # half as far apart, a quarter as far off


def _times(
    tables: Sequence[LogTable], reading: Reading
) -> list[tuple[Array | None, tuple[str, ...]]]:
    """Return time stamps of tables, s, and notes; None where a table has none.

    Where no name says so in any, columns are time by their values.
    """
    sources = [time_source(table, reading) for table in tables]
    if not any(sources) and reading.rate is None and reading.mapping is None:
        clocks = [likely_clock(table) for table in tables]
        sources = [clock if is_sure else None for clock, _, is_sure in clocks]
    found = list[tuple[Array | None, tuple[str, ...]]]()
    for table, source in zip(tables, sources, strict=True):
        own = source and with_own_parts(source, table.columns)
        values = own and read_column(own, dict(table.columns), since_first=False)
        found.append((None, ()) if own is None else in_seconds(own, np.asarray(values)))
    return found


def _one_clock(
    log: Path, tables: Sequence[LogTable], times: Sequence[Array], reading: Reading
) -> tuple[list[Array], int | None, tuple[str, ...]]:
    """Return time stamps of each table on one clock, s, since when they are if known, and notes."""
    for table, time in zip(tables, times, strict=True):
        if not np.isfinite(time).any():
            raise LogError(
                f"A part of log {str(log)!r}, {table.path}, has empty cells of time only.",
                advice="Log the time of each row.",
            )
    zeros = [
        next((o for c, o in t.origins.items() if _is_time(t, c, reading)), None) for t in tables
    ]
    first = min((zero for zero in zeros if zero is not None), default=None)
    if first is None:
        return [*times], None, ()
    zeros = [
        0 if zero is None and np.nanmedian(time) > _YEARS else zero
        for zero, time in zip(zeros, times, strict=True)
    ]
    found = [t + 1e-9 * ((z or 0) - first) for z, t in zip(zeros, times, strict=True)]
    base = next(k for k, zero in enumerate(zeros) if zero is not None)
    notes = list[str]()
    for k in (k for k, zero in enumerate(zeros) if zero is None):
        named = (str(tables[k].path), times[k]), (str(tables[base].path), found[base])
        found[k], words = _begun_together(log, *named)
        notes.append(words)
    return found, first, tuple(notes)


def _begun_together(
    log: Path, part: tuple[str, Array], base: tuple[str, Array]
) -> tuple[Array, str]:
    """Return time of a part on the clock of one with dates that is as long, and a note."""
    (name, time), (other, known) = part, base
    spans = [float(np.nanmax(t) - np.nanmin(t)) for t in (time, known)]
    period = max(float(np.nanmedian(np.diff(t))) if len(t) > 1 else 0.0 for t in (time, known))
    if abs(spans[0] - spans[1]) > _ROWS_APART * period:
        raise LogError(
            f"The parts of log {str(log)!r} have no common clock: time is not since 1970 in "
            f"{name}, but has dates in {other}; they are {spans[0]:.6g} s and {spans[1]:.6g} "
            "s long.",
            advice="Log dates or seconds since 1970 in each part, or cut them to begin and end "
            "at the same instants.",
        )
    words = (
        f"{other} has dates and {name} another clock; as both are {spans[1]:.4g} s long, "
        "they are assumed to begin together"
    )
    return time + float(np.nanmin(known) - np.nanmin(time)), words


def at_instants(instants: Array, time: Array, values: Array, *, holds: bool = False) -> Array:
    """Interpolate values (K,) at instants (N,); NaN outside, in gaps and next to NaN."""
    good = np.isfinite(time)
    time, values = time[good], values[good]
    if len(time) < 2:
        return np.full(len(instants), np.nan)
    inside = np.clip(instants, time.min(), time.max())
    instants = np.where(np.abs(inside - instants) < _ROUNDING, inside, instants)
    after = np.clip(np.searchsorted(time, instants), 1, len(time) - 1)
    steps, since, until = np.diff(time), instants - time[after - 1], time[after] - instants
    gap = steps[after - 1] > longest_step(float(np.median(steps)))
    gap &= (since > _ROUNDING) & (until > _ROUNDING)
    found = np.interp(instants, time, values, left=np.nan, right=np.nan)
    return np.where(gap, values[after - 1] if holds else np.nan, found)


def by_clocks(table: LogTable, reading: Reading) -> LogTable:
    """Return a table with one clock, of one whose groups of columns begin or end with their own.

    Clocks increase where they have numbers, and have columns of joints between them.
    """
    names = [name for name in table.names if name not in table.first_words]
    clocks = [name for name in names if tells_clock(name)]
    if reading.mapping is not None or reading.rate is not None or len(clocks) < 2:
        return table
    is_before = names[0] in clocks
    names = names if is_before else names[::-1]
    starts = [names.index(name) for name in clocks]
    bounds = [*sorted(starts), len(names)]
    groups = [names[first:last] for first, last in pairwise(bounds)]
    measured = {m.column for m in joint_columns(names)} - {*clocks}
    if bounds[0] > 0 or not all(measured & {*group} for group in groups):
        return table
    read, parts = table.loaded(skip=reading.skip_bad_rows), list[LogTable]()
    spans = dict[str, Array]()
    for clock, *group in groups if is_before else [[g[0], *g[:0:-1]] for g in groups[::-1]]:
        rows = np.isfinite(read.columns[clock])
        if not rows.any() or not (np.diff(read.columns[clock][rows]) > 0.0).all():
            return table
        own = {name: read.columns[name][rows] for name in (clock, *group)}
        unit = find_unit(table.units.get(clock, ""), "time") or without_unit(clock, "time")[1]
        spans[clock] = (unit.factor if unit else 1.0) * own[clock][[0, -1]]
        units = {**table.units} | ({"t": unit.name} if unit else {})
        origins = {"t": table.origins[clock]} if clock in table.origins else {}
        part = LogTable(Path(clock), own, units, (), origins)
        parts.append(part.renamed({clock: "t"}))
    if not _are_of_one_time(spans, table):
        return table
    joined = joined_tables(table.path, parts, reading)
    return joined.noting(f"columns have clocks of their own: {listed(clocks)}", *read.notes)


def _are_of_one_time(spans: Mapping[str, Array], table: LogTable) -> bool:
    """Return whether clocks have one name, or begin and end at about the same time, in s.

    Processor times and row counts are not clocks of the columns behind them.
    """
    if len({_AGAIN.sub("", clock) for clock in spans}) == 1:
        return True
    ends = np.array([x - x[0] * (clock in table.origins) for clock, x in spans.items()])
    return bool(np.all(np.ptp(ends, axis=0) <= _APART * np.diff(ends, axis=1).min()))


_NAMES = frozenset(["name", "names"])
_AGAIN = re.compile(r"\.\d+$")  # behind a name that comes again
_APART = 0.25  # of the shortest, by which the ends of clocks may be apart
_ITEM = re.compile(r"[^\s,;'\"\[\]()]+")  # of a list of names
_MOST_CHANGES = 0.05  # of the rows, after which another joint follows in tables of one at a time
_TOGETHER = 0.9  # of the time and the rows of a joint, that others have which are logged with it
_MOST_JOINTS, _MOST_SIGNALS = 200, 2000  # more different words are no names


def reshaped(table: LogTable, reading: Reading) -> LogTable:
    """Return a table with a column for each joint, if cells name the joints."""
    words = {n: w for column, cells in table.words.items() for n, w in _items(column, cells)}
    for name, values in table.columns.items():  # joints that integers number
        if numbers_joints(name) and 1 < len(np.unique(values)) <= _MOST_JOINTS:
            whole = np.all(values == np.rint(values))
            words |= {name: np.array([f"joint_{x:.0f}" for x in values], object)} if whole else {}
    mapped = {each.among(table.counted) for _, each in reading.mapping or ()}
    is_mapped = reading.mapping is not None and mapped.issubset(table.names)
    spread = None if is_mapped else _spread_values(table, words, reading)
    if spread is not None or reading.mapping is not None:
        return table if spread is None else spread
    model = {words_of(joint) for joint in reading.joints}
    naming = {n: w for n, w in words.items() if 0 < len({*w}) <= _MOST_JOINTS}
    naming = {n: w for n, w in naming.items() if names_joints(n) or {*map(words_of, {*w})} <= model}
    numbered = {n: w for n, w in naming.items() if re.search(r"\d", n)}
    named = {n: w for n, w in numbered.items() if _NAMES & plain_words(n) or n.endswith("]")}
    if named:
        return _named(table, named)
    return _pivoted(table, *next(iter(naming.items())), reading) if naming else table


def _spread_values(
    table: LogTable, words: Mapping[str, Texts], reading: Reading
) -> LogTable | None:
    """Return a table with a column for each signal, of one with a row for each of their values."""
    signals = sorted((n for n in words if tells(n, "signals")), key=lambda n: len({*words[n]}) < 2)
    signal = next(iter(signals), None)
    value = [n for n in table.columns if meaning_of(n) is None and "value" in plain_words(n)]
    has_time = any(map(table.is_time, table.columns))
    if signal is None or not value or not has_time or joint_columns(table.columns):
        return None
    of_joints = next((w for n, w in words.items() if n != signal and names_joints(n)), None)
    names = words[signal] if of_joints is None else of_joints + "." + words[signal]
    if len({*names}) > _MOST_SIGNALS:
        return None
    return _brought_together(table, signal, names, {value[0]: ""}, reading)


def _items(column: str, cells: Texts) -> Iterator[tuple[str, Texts]]:
    """Yield a column of texts; of lists of them, such as `['a', 'b']`, one for each place."""
    if len(cells) and (isinstance(cells[0], list) or str(cells[0]).startswith(("[", "("))):
        lists = [each if isinstance(each, list) else _ITEM.findall(each) for each in cells]
        if len({len(names) for names in lists}) == 1:
            for k, names in enumerate(zip(*lists, strict=True)):
                yield f"{column}[{k}]", np.array(names, object)
            return
    yield column, np.array([str(each) for each in cells], object)


def _check_names(table: LogTable, column: str, words: Texts) -> None:
    """Raise for empty cells in a column of joint names."""
    if not all(words):
        row = 1 + next(k for k, word in enumerate(words) if not word)
        raise LogError(
            f"Row {row} of log {str(table.path)!r} has no joint name in column {column!r}.",
            advice="Add the joint's name, or remove the row.",
        )


def _named(table: LogTable, naming: Mapping[str, Texts]) -> LogTable:
    """Return the table with the columns of joints renamed by the names in each row."""
    in_lists = all(name.endswith("]") for name in naming)
    columns = [name for name in table.columns if name not in table.origins]  # no dates
    measured = joint_columns(columns)
    measured = [m for m in measured if m.role <= PLAIN]
    if in_lists:  # whose items are in columns of lists, too, or in numbered ones, from 0 on
        sizes = Counter(m.column.rpartition("[")[0] for m in measured)
        measured = [m for m in measured if sizes[m.column.rpartition("[")[0]] == len(naming)] or [
            m for m in measured if m.number is not None and m.number < len(naming)
        ]
    owner = {name: _named_by(name, naming) for name in naming}
    found = {m.column: (m, n) for n, is_of in owner.items() for m in measured if is_of(m)}
    meanings = {column: m for column, (m, _) in found.items()}
    used = _likeliest(meanings, lambda m: (m.quantity, found[m.column][1]))
    if not used:
        return table
    for name, words in naming.items():
        _check_names(table, name, words)
    kept = {n: values for n, values in table.columns.items() if n not in found}
    units = {n: unit for n, unit in table.units.items() if n not in found}
    for column, meaning in used.items():
        words, unit = naming[found[column][1]], _unit_of(table, meaning)
        for joint in dict.fromkeys(words.tolist()):
            name, here = f"{joint}.{meaning.quantity}", words == joint
            before = kept.get(name, np.full(len(table), np.nan))
            kept[name] = np.where(here, table.columns[column], before)
            units |= {name: unit} if unit else {}
    names = list(dict.fromkeys(joint for words in naming.values() for joint in words.tolist()))
    note = f"joints are named by cells of the log: {listed(names)}"
    return replace(table, columns=kept, units=units, notes=(*table.notes, note))


def _named_by(name: str, naming: Mapping[str, Texts]) -> Callable[[Meaning], bool]:
    """Return a test of whether a column belongs to the joint that a column of names gives.

    It does if it stands beside that column, as `joints[2].angle` beside `joints[2].name`, or ends
    with the same number, in the same group if groups name their joints differently.
    """
    head, number = _head(name), number_of(name)
    if number is None:
        return lambda m: f"{_head(m.column)}.".startswith(f"{head}.")
    alike = (n for n in naming if number_of(n) == number)
    is_alone = len({tuple(dict.fromkeys(naming[n].tolist())) for n in alike}) == 1
    return lambda m: (
        m.words[-1:] == (number,)
        and (is_alone or f"{m.column.replace('/', '.')}.".startswith(f"{head}."))
    )


def _head(name: str) -> str:
    """Return the group that a column is in."""
    return name.replace("/", ".").rpartition(".")[0]


def _likeliest(
    found: Mapping[str, Meaning], place: Callable[[Meaning], object]
) -> dict[str, Meaning]:
    """Return the columns of the least role, one for each place."""
    best = {place(m): n for n, m in sorted(found.items(), key=lambda each: -each[1].role)}
    return {name: found[name] for name in best.values()}


def _unit_of(table: LogTable, meaning: Meaning) -> str | None:
    """Return the unit of a column, from its name or the file."""
    return meaning.unit.name if meaning.unit else table.units.get(meaning.column)


def _pivoted(table: LogTable, naming: str, words: Texts, reading: Reading) -> LogTable:
    """Return a table of a row for each joint and time as one of a row a sample."""
    told = joint_columns(table.columns)
    own = _likeliest({m.column: m for m in told if not m.words}, lambda m: m.quantity)
    of_others = any(m.words and m.quantity == "position" for m in told)
    if not own or of_others or len({*words}) == len(words):
        return table
    _check_names(table, naming, words)
    _check_at_once(table, naming, words)
    ends = {n: f".{m.quantity}" for n, m in own.items()}
    return _brought_together(table, naming, words, ends, reading)


def _brought_together(
    table: LogTable, naming: str, words: Texts, ends: Mapping[str, str], reading: Reading
) -> LogTable:
    """Return a table of a row for each word and instant as one of a row an instant."""
    parts = []
    meanings = [m for m in meanings_of(table.columns) if m.column in ends]
    told = {m.column: unit for m in meanings if (unit := _unit_of(table, m))}
    for word in dict.fromkeys(words.tolist()):
        kept = {n: x[words == word] for n, x in table.columns.items() if table.is_time(n)}
        kept |= {word + end: table.columns[n][words == word] for n, end in ends.items()}
        units = {**table.units} | {word + ends[n]: unit for n, unit in told.items()}
        parts.append(LogTable(Path(word), kept, units, origins=table.origins))
    try:
        joined = joined_tables(table.path, parts, reading)
    except LogError as error:
        raise LogError(
            f"Log {str(table.path)!r} has a row for each name in {naming!r}, which cannot be "
            f"merged: {error.problem}",
            advice=error.advice,
        ) from error
    note = f"rows for each name in {naming!r} are merged to one row for each instant"
    return replace(joined, notes=(note, *table.notes, *joined.notes))


def _check_at_once(table: LogTable, naming: str, words: Texts) -> None:
    """Raise for a table in which joints follow each other in time.

    Tables may also have all rows of a joint together, as many and of the same time as the others'.
    """
    changes = np.count_nonzero(words[1:] != words[:-1])
    time = next((values for name, values in table.columns.items() if table.is_time(name)), None)
    if time is None or changes > _MOST_CHANGES * len(words):
        return
    own = [time[(words == joint) & np.isfinite(time)] for joint in dict.fromkeys(words.tolist())]
    if not all(map(len, own)):
        return
    first, last = ([float(end(each)) for each in own] for end in (np.min, np.max))
    longest = max(np.subtract(last, first))
    counts = [len(each) for each in own]
    if min(last) - max(first) < _TOGETHER * longest or min(counts) < _TOGETHER * max(counts):
        raise LogError(
            f"In log {str(table.path)!r} the joints in {naming!r} follow each other in time "
            "instead of being logged together.",
            advice="Write a log for each joint, with the positions of the others.",
        )
