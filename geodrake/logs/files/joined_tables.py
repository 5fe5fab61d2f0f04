"""Join tables that are parts of one log, by time stamps or by joint names in cells."""

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
    quantity_of,
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

YEARS = 9e8
"""Time stamps above this, s, count from 1970."""

_ROUNDING = 1e-6  # s, rounding of stamps in different formats
_ROWS_APART = 2.0  # rows by which durations may differ if parts begin together
RARE = "is too slow"
"""Beginning of the reason why columns with a far lower rate were left out."""

_MIXED = 10.0  # largest ratio of the rates of parts
_TURNED, _FEWEST_TURNS = 0.02, 10  # rad, error of an interpolated orientation; least rows
_FEW_BACK = 0.01  # largest fraction of rows skipped for time that runs backwards
_ALIKE = 0.9  # fraction of the longest period above which parts count as equally slow


def joined_tables(log: Path, tables: Sequence[LogTable], reading: Reading) -> LogTable:
    """Join tables at the time stamps of the slowest, or of the first of several slow ones."""
    tables = _parts_of_model(tables, reading)
    order = _order(tables, reading)
    if reading.mapping is not None:
        reading = replace(reading, mapping=reading.mapping.named(order))
    stamps = _times(tables, reading)
    untimed = [str(t.path) for t, (time, _) in zip(tables, stamps, strict=True) if time is None]
    if len(untimed) >= len(tables) - 1:
        return _same_rows(log, tables)
    if untimed:
        raise LogError(
            f"Parts of log {str(log)!r} have no time: {', '.join(untimed)}.",
            advice="Give all parts time, or only one if all have the same rows.",
        )
    times, origin, clock_notes = _one_clock(
        log, tables, [np.asarray(t) for t, _ in stamps], reading
    )
    clock_notes = (*dict.fromkeys(note for _, texts in stamps for note in texts), *clock_notes)
    if reading.skip_bad_rows:
        times, skipped = _forward_times(tables, times)
        clock_notes += skipped
    steps = [np.diff(time[np.isfinite(time)]) for time in times]
    periods = [float(np.median(step)) if len(step) else np.inf for step in steps]
    for table, period, step in zip(tables, periods, steps, strict=True):
        if (step < 0.0).any() or not period > 0.0:
            what = "stands still in most rows" if (step >= 0.0).all() else "runs backwards"
            raise LogError(
                f"In a part of log {str(log)!r}, {table.path}, time {what}.",
                advice="Write it with more digits, sort rows by it, or cut them where a clock was "
                "set back.",
            )
    beside = _beside_efforts(tables, reading)
    fast = [k for k, period in enumerate(periods) if period <= _MIXED * min(periods)]
    decide = [k for k in fast if not beside[k]] or fast
    slowest = max(periods[k] for k in decide)
    base = next(k for k in decide if periods[k] >= _ALIKE * slowest)
    tables, slow_notes, rare = _slow_parts(log, tables, periods, reading)
    if not max(map(np.nanmin, times)) < min(map(np.nanmax, times)):
        spans = (f"{np.nanmin(t):.6g} to {np.nanmax(t):.6g} s" for t in times)
        raise LogError(
            f"The parts of log {str(log)!r} do not overlap in time: {', '.join(spans)}.",
            advice="Use one clock for all, or write a log for each joint if they move in turn.",
        )
    instants = times[base][np.isfinite(times[base])] if reading.skip_bad_rows else times[base]
    columns, repeated = {order[0]: instants}, list[str]()
    for table, time in zip(tables, times, strict=True):
        for column, values in table.columns.items():
            if column in columns:
                repeated += [column] * (column != order[0])
            elif not _is_time(table, column, reading):
                holds = _meaning(column, reading)[1] in ("command", FLAG)
                columns[column] = at_instants(instants, time, values, holds=holds)
    rate = 1.0 / periods[base]
    note = f"joined by time at {rate:.4g} Hz, the rate of {tables[base].path}"
    table_notes = (note for table in tables for note in table.notes)
    notes = (note, *_repeated(repeated), *slow_notes, *clock_notes, *table_notes)
    units = {column: unit for table in tables for column, unit in table.units.items()}
    silent = {column: why for table in tables for column, why in table.silent.items()}
    zeros = {order[0]: origin}
    return LogTable(log, columns, units, notes, zeros, {**silent, **rare}, order=order)


def _forward_times(
    tables: Sequence[LogTable], times: Sequence[Array]
) -> tuple[list[Array], tuple[str, ...]]:
    """Replace the times (N,) of a few rows that run backwards by NaN, and note it."""
    masked, notes = list[Array](), list[str]()
    for table, time in zip(tables, times, strict=True):
        is_back = time < np.fmax.accumulate(time)
        is_back &= np.mean(is_back) <= _FEW_BACK
        masked.append(np.where(is_back, np.nan, time))
        if is_back.any():
            count = np.count_nonzero(is_back)
            notes.append(f"rows of {table.path} skipped, as their time is back: {count}")
    return masked, tuple(notes)


def _same_rows(log: Path, tables: Sequence[LogTable]) -> LogTable:
    """Join tables of equal length, of which at most one has time."""
    lengths = sorted({len(table) for table in tables})
    if len(lengths) > 1:
        raise LogError(
            f"The parts of log {str(log)!r} have no time, and different numbers of rows: "
            f"{', '.join(map(str, lengths))}.",
            advice="Log the time in every part.",
        )
    counts = Counter(name for table in tables for name in table.columns)
    repeated = [name for name in counts for _ in range(counts[name] - 1)]
    merged = ChainMap(*(dict(table.columns) for table in tables))
    notes = (note for table in tables for note in table.notes)
    units = {column: unit for table in tables for column, unit in table.units.items()}
    zeros = {column: zero for table in tables for column, zero in table.origins.items()}
    rate = next((table.rate for table in tables if table.rate), None)
    columns = {name: merged[name] for name in counts}
    return LogTable(log, columns, units, (*_repeated(repeated), *notes), zeros, rate=rate)


def _parts_of_model(tables: Sequence[LogTable], reading: Reading) -> Sequence[LogTable]:
    """Drop tables whose joints are all unknown to the model, such as those of a gripper."""
    names = dict.fromkeys(n for t in tables for n in t.columns if floating_meaning(n) is None)
    meanings = joint_columns(names, reading.joints)
    joint_of = matched(meanings, reading.joints)[0]
    parts = [[m for m in meanings if m.column in table.columns] for table in tables]
    joints = [{joint_of[m.column] for m in each if m.column in joint_of} for each in parts]
    model = {*reading.joints}
    known = [not m or not j.isdisjoint(model) for m, j in zip(parts, joints, strict=True)]
    if reading.mapping is not None or all(known) or model.isdisjoint(set().union(*joints)):
        return tables
    first, *others = [table for table, used in zip(tables, known, strict=True) if used]
    extra = [m.column for each, used in zip(parts, known, strict=True) if not used for m in each]
    return [first.noting(f"not used, as the model has no such joints: {listed(extra)}"), *others]


def _beside_efforts(tables: Sequence[LogTable], reading: Reading) -> list[bool]:
    """Return whether each table has commands only, of joints whose efforts others have."""
    parts = [joint_columns(table.columns, reading.joints) for table in tables]
    told = [[m.quantity == "command" or m.is_wanted for m in each] for each in parts]
    joint_of = matched([m for each in parts for m in each], reading.joints)[0]
    joints = [{joint_of.get(m.column) for m in each} for each in parts]
    driven = {
        joint_of.get(m.column)
        for each, are_told in zip(parts, told, strict=True)
        for m, is_told in zip(each, are_told, strict=True)
        if m.log_quantity == "effort" and not is_told
    }
    is_used = reading.mapping is not None or "command" in reading.kinds.values()
    return [
        not is_used and each != [] and all(each) and own <= driven
        for each, own in zip(told, joints, strict=True)
    ]


def _repeated(columns: Sequence[str]) -> list[str]:
    """Return a note on columns that occur in several parts."""
    said = f"columns {listed(columns)} occur in several parts; those of the first are used"
    return [said] if columns else []


def _order(tables: Sequence[LogTable], reading: Reading) -> list[str]:
    """Return the column names of all tables, time first."""
    time = reading.mapping.time if reading.mapping else None
    clock = time.among([*tables[0].columns]) if time else ""
    clock = clock if any(clock in table.columns for table in tables) else "time"
    names = dict.fromkeys(n for t in tables for n in t.columns if not t.is_time(n) and n != clock)
    return [clock, *names]


def _is_time(table: LogTable, column: str, reading: Reading) -> bool:
    """Return whether a column is time, by its name, its dates or the mapping."""
    return table.is_time(column) or _meaning(column, reading)[1] == "time"


def _meaning(column: str, reading: Reading) -> tuple[str, str]:
    """Return the joint of a column and its quantity, both "" if unknown."""
    for name, mapped in reading.mapping or ():
        if mapped.column == column:
            joint, _, quantity = name.rpartition(".")
            return joint, "effort" if quantity in EFFORT_KINDS else quantity
    if (floating := floating_meaning(column)) is not None:
        name = floating.quantity
        return "", FLAG if name.endswith(FLAG) else name.rpartition(".")[0]
    meaning = meaning_of(column)
    return ("", "") if meaning is None else (meaning.joint, meaning.log_quantity)


def _slow_parts(
    log: Path, tables: Sequence[LogTable], periods: Sequence[float], reading: Reading
) -> tuple[list[LogTable], list[str], dict[str, str]]:
    """Reduce tables at less than a tenth of the highest rate to what may be interpolated.

    Temperatures, flags and the orientation of a base with an IMU change slowly. Other columns are
    dropped if the log does not need them. Returns notes and the reasons for dropped columns too.
    """
    shortest = min(periods)
    parts = [*zip(tables, periods, strict=True)]
    fast = [_meaning(c, reading) for t, p in parts if p <= _MIXED * shortest for c in t.columns]
    kinds = {what.replace("command", "effort") for _, what in fast}
    has_imu = {"imu.angular_velocity", "imu.linear_acceleration"} <= kinds
    joints = {joint for joint, _ in fast} - {""}
    reduced, notes, rare, is_needed = list[LogTable](), list[str](), dict[str, str](), False
    for table, period in parts:
        if period <= _MIXED * shortest:
            reduced.append(table)
            continue
        allowed = {"temperature", FLAG, "time", PART}
        allowed |= {"base.orientation"} if has_imu and _turns_slowly(table.columns) else set()
        meanings = {column: _meaning(column, reading) for column in table.columns}
        dropped = {column: what for column, what in meanings.items() if what[1] not in allowed}
        for joint, what in dropped.values():
            if (kind := what.replace("command", "effort")) in ("position", "effort"):
                is_needed |= (joint in joints and what != "command") or kind not in kinds
            is_needed |= what.startswith("base.") and not has_imu
            is_needed |= what.startswith("imu.") and "base.orientation" not in kinds
        kept = {c: values for c, values in table.columns.items() if c not in dropped}
        reduced.append(replace(table, columns=kept))
        used = [column for column in kept if not _is_time(table, column, reading)]
        actions = {"interpolated": used, "dropped": [*dropped]}
        words = [f"{listed(columns)} {what}" for what, columns in actions.items() if columns]
        rates = f"{1 / period:.4g} Hz, but other columns up to {1 / shortest:.4g} Hz"
        notes.append(f"{table.path} has {rates}: {', '.join(words)}")
        rare |= dict.fromkeys(dropped, f"{RARE}: {rates}")
    if is_needed:
        each = (f"{t.path} {1 / p:.4g} Hz" for t, p in zip(tables, periods, strict=True))
        raise LogError(
            f"The parts of log {str(log)!r} have very different rates: {', '.join(each)}.",
            advice=f"Log them at rates that differ at most by a factor of {_MIXED:g}.",
        )
    return reduced, notes, rare


def _turns_slowly(columns: Mapping[str, Array]) -> bool:
    """Return whether the orientations of a base are close to interpolated neighbours."""
    meanings = {floating_meaning(column): values for column, values in columns.items()}
    components = {meaning.quantity: values for meaning, values in meanings.items() if meaning}
    q = vectors(components, "base.orientation")
    q = np.zeros((0, 4)) if q is None else q[np.isfinite(q).all(axis=1)]
    if len(q) < _FEWEST_TURNS:
        return False
    before, middle, after = q[:-2], q[1:-1], q[2:]
    between = before + np.sign(np.sum(before * after, axis=1))[:, None] * after
    size = np.linalg.norm(between, axis=1) * np.linalg.norm(middle, axis=1)
    cosines = np.abs(np.sum(between * middle, axis=1)) / np.maximum(size, np.finfo(float).tiny)
    angles = 2.0 * np.arccos(np.minimum(cosines, 1.0))
    return bool(np.quantile(angles, 0.99) / 4.0 < _TURNED)  # halving the step quarters the error


def _times(
    tables: Sequence[LogTable], reading: Reading
) -> list[tuple[Array | None, tuple[str, ...]]]:
    """Return the time stamps (s) of each table, or None, and notes.

    If no column is named as time, it is recognized by its values.
    """
    sources = [time_source(table, reading) for table in tables]
    if not any(sources) and reading.rate is None and reading.mapping is None:
        clocks = [likely_clock(table) for table in tables]
        sources = [clock if is_sure else None for clock, _, is_sure in clocks]
    times = list[tuple[Array | None, tuple[str, ...]]]()
    for table, source in zip(tables, sources, strict=True):
        clock = source and with_own_parts(source, table.columns)
        values = clock and read_column(clock, dict(table.columns), since_first=False)
        times.append((None, ()) if clock is None else in_seconds(clock, np.asarray(values)))
    return times


def _one_clock(
    log: Path, tables: Sequence[LogTable], times: Sequence[Array], reading: Reading
) -> tuple[list[Array], int | None, tuple[str, ...]]:
    """Return the time stamps (s) of all tables on one clock, its zero if known, and notes."""
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
        0 if zero is None and np.nanmedian(time) > YEARS else zero
        for zero, time in zip(zeros, times, strict=True)
    ]
    shifted = [t + 1e-9 * ((z or 0) - first) for z, t in zip(zeros, times, strict=True)]
    base = next(k for k, zero in enumerate(zeros) if zero is not None)
    notes = list[str]()
    for k in (k for k, zero in enumerate(zeros) if zero is None):
        pair = (str(tables[k].path), times[k]), (str(tables[base].path), shifted[base])
        shifted[k], words = _aligned_starts(log, *pair)
        notes.append(words)
    return shifted, first, tuple(notes)


def _aligned_starts(
    log: Path, part: tuple[str, Array], base: tuple[str, Array]
) -> tuple[Array, str]:
    """Shift a part to begin with one that has dates and the same duration, and note it."""
    (name, time), (other, reference) = part, base
    spans = [float(np.nanmax(t) - np.nanmin(t)) for t in (time, reference)]
    period = max(float(np.nanmedian(np.diff(t))) if len(t) > 1 else 0.0 for t in (time, reference))
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
    return time + float(np.nanmin(reference) - np.nanmin(time)), words


def at_instants(instants: Array, time: Array, values: Array, *, holds: bool = False) -> Array:
    """Interpolate values (K,) at instants (N,); NaN outside, in gaps and next to NaN."""
    valid = np.isfinite(time)
    time, values = time[valid], values[valid]
    if len(time) < 2:
        return np.full(len(instants), np.nan)
    inside = np.clip(instants, time.min(), time.max())
    instants = np.where(np.abs(inside - instants) < _ROUNDING, inside, instants)
    after = np.clip(np.searchsorted(time, instants), 1, len(time) - 1)
    steps, elapsed, remaining = np.diff(time), instants - time[after - 1], time[after] - instants
    gap = steps[after - 1] > longest_step(float(np.median(steps)))
    gap &= (elapsed > _ROUNDING) & (remaining > _ROUNDING)
    result = np.interp(instants, time, values, left=np.nan, right=np.nan)
    return np.where(gap, values[after - 1] if holds else np.nan, result)


def by_clocks(table: LogTable, reading: Reading) -> LogTable:
    """Join groups of columns that begin or end with their own clock.

    Clocks increase, and each group must have columns of joints.
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
    loaded, parts = table.loaded(skip=reading.skip_bad_rows), list[LogTable]()
    spans = dict[str, Array]()
    for clock, *group in groups if is_before else [[g[0], *g[:0:-1]] for g in groups[::-1]]:
        rows = np.isfinite(loaded.columns[clock])
        if not rows.any() or not (np.diff(loaded.columns[clock][rows]) > 0.0).all():
            return table
        columns = {name: loaded.columns[name][rows] for name in (clock, *group)}
        unit = find_unit(table.units.get(clock, ""), "time") or without_unit(clock, "time")[1]
        spans[clock] = (unit.factor if unit else 1.0) * columns[clock][[0, -1]]
        units = {**table.units} | ({"t": unit.name} if unit else {})
        origins = {"t": table.origins[clock]} if clock in table.origins else {}
        part = LogTable(Path(clock), columns, units, (), origins)
        parts.append(part.renamed({clock: "t"}))
    if not _share_time(spans, table):
        return table
    joined = joined_tables(table.path, parts, reading)
    return joined.noting(f"columns have clocks of their own: {listed(clocks)}", *loaded.notes)


def _share_time(spans: Mapping[str, Array], table: LogTable) -> bool:
    """Return whether clocks share a name, or begin and end at about the same time (s).

    This excludes processor times and row counts.
    """
    if len({_AGAIN.sub("", clock) for clock in spans}) == 1:
        return True
    ends = np.array([x - x[0] * (clock in table.origins) for clock, x in spans.items()])
    return bool(np.all(np.ptp(ends, axis=0) <= _APART * np.diff(ends, axis=1).min()))


_NAMES = frozenset(["name", "names"])
_AGAIN = re.compile(r"\.\d+$")  # number of a duplicate name
_APART = 0.25  # tolerance of the ends of clocks, as a fraction of the shortest span
_ITEM = re.compile(r"[^\s,;'\"\[\]()]+")  # item in a list of names
_MOST_CHANGES = 0.05  # fraction of rows before a different joint, if joints take turns
_TOGETHER = 0.9  # least common fraction of time and rows of joints logged together
_MOST_JOINTS, _MOST_SIGNALS = 200, 2000  # most distinct names


def reshaped(table: LogTable, reading: Reading) -> LogTable:
    """Give each joint its own columns, if cells name the joints."""
    words = {n: w for column, cells in table.words.items() for n, w in _items(column, cells)}
    for name, values in table.columns.items():  # joints numbered by integers
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
    by_name = {n: w for n, w in numbered.items() if _NAMES & plain_words(n) or n.endswith("]")}
    if by_name:
        return _named(table, by_name)
    return _pivoted(table, *next(iter(naming.items())), reading) if naming else table


def _spread_values(
    table: LogTable, words: Mapping[str, Texts], reading: Reading
) -> LogTable | None:
    """Give each signal its own column, if each row contains one signal, of one or all joints."""
    signals = sorted((n for n in words if tells(n, "signals")), key=lambda n: len({*words[n]}) < 2)
    signal = next(iter(signals), None)
    others = [n for n in table.columns if meaning_of(n) is None]
    ends = {n: "" for n in others if "value" in plain_words(n)}
    if signal is not None and not ends and all(map(quantity_of, {*words[signal]})):
        ends = {n: f".{n}" for n in others}  # columns of joints
    has_time = any(map(table.is_time, table.columns))
    if signal is None or not ends or not has_time or joint_columns(table.columns):
        return None
    of_joints = next((w for n, w in words.items() if n != signal and names_joints(n)), None)
    names = words[signal] if of_joints is None else of_joints + "." + words[signal]
    if len({*names}) > _MOST_SIGNALS:
        return None
    ends = ends if any(ends.values()) else dict([*ends.items()][:1])
    return _merged_rows(table, signal, names, ends, reading)


def _items(column: str, cells: Texts) -> Iterator[tuple[str, Texts]]:
    """Yield a column of texts; lists such as `['a', 'b']` become a column for each item."""
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
    """Rename the columns of joints by the names in each row."""
    in_lists = all(name.endswith("]") for name in naming)
    columns = [name for name in table.columns if name not in table.origins]  # without dates
    measured = joint_columns(columns)
    measured = [m for m in measured if m.role <= PLAIN]
    if in_lists:  # values are then in lists too, or in columns numbered from 0
        sizes = Counter(m.column.rpartition("[")[0] for m in measured)
        measured = [m for m in measured if sizes[m.column.rpartition("[")[0]] == len(naming)] or [
            m for m in measured if m.number is not None and m.number < len(naming)
        ]
    tests = {name: _named_by(name, naming) for name in naming}
    assigned = {m.column: (m, n) for n, matches in tests.items() for m in measured if matches(m)}
    meanings = {column: m for column, (m, _) in assigned.items()}
    chosen = _likeliest(meanings, lambda m: (m.quantity, assigned[m.column][1]))
    if not chosen:
        return table
    for name, words in naming.items():
        _check_names(table, name, words)
    kept = {n: values for n, values in table.columns.items() if n not in assigned}
    units = {n: unit for n, unit in table.units.items() if n not in assigned}
    for column, meaning in chosen.items():
        words, unit = naming[assigned[column][1]], _unit_of(table, meaning)
        for joint in dict.fromkeys(words.tolist()):
            name, is_joint = f"{joint}.{meaning.quantity}", words == joint
            previous = kept.get(name, np.full(len(table), np.nan))
            kept[name] = np.where(is_joint, table.columns[column], previous)
            units |= {name: unit} if unit else {}
    names = list(dict.fromkeys(joint for words in naming.values() for joint in words.tolist()))
    note = f"joints are named by cells of the log: {listed(names)}"
    return replace(table, columns=kept, units=units, notes=(*table.notes, note))


def _named_by(name: str, naming: Mapping[str, Texts]) -> Callable[[Meaning], bool]:
    """Return a test of whether a column belongs to the joint in a column of names.

    It does if both are in one group, such as `joints[2].angle` and `joints[2].name`, or if both
    end with the same number, within one group if groups name their joints differently.
    """
    head, number = _head(name), number_of(name)
    if number is None:
        return lambda m: f"{_head(m.column)}.".startswith(f"{head}.")
    peers = (n for n in naming if number_of(n) == number)
    is_shared = len({tuple(dict.fromkeys(naming[n].tolist())) for n in peers}) == 1
    return lambda m: (
        m.words[-1:] == (number,)
        and (is_shared or f"{m.column.replace('/', '.')}.".startswith(f"{head}."))
    )


def _head(name: str) -> str:
    """Return the group of a column."""
    return name.replace("/", ".").rpartition(".")[0]


def _likeliest(
    meanings: Mapping[str, Meaning], place: Callable[[Meaning], object]
) -> dict[str, Meaning]:
    """Return the column with the best role for each place."""
    best = {place(m): n for n, m in sorted(meanings.items(), key=lambda each: -each[1].role)}
    return {name: meanings[name] for name in best.values()}


def _unit_of(table: LogTable, meaning: Meaning) -> str | None:
    """Return the unit of a column, from its name or the file's units."""
    return meaning.unit.name if meaning.unit else table.units.get(meaning.column)


def _pivoted(table: LogTable, naming: str, words: Texts, reading: Reading) -> LogTable:
    """Merge rows for each joint and instant to one row for each instant."""
    meanings = joint_columns(table.columns)
    columns = _likeliest({m.column: m for m in meanings if not m.words}, lambda m: m.quantity)
    has_others = any(m.words and m.quantity == "position" for m in meanings)
    if not columns or has_others or len({*words}) == len(words):
        return table
    _check_names(table, naming, words)
    _check_simultaneous(table, naming, words)
    ends = {n: f".{m.quantity}" for n, m in columns.items()}
    return _merged_rows(table, naming, words, ends, reading)


def _merged_rows(
    table: LogTable, naming: str, words: Texts, ends: Mapping[str, str], reading: Reading
) -> LogTable:
    """Merge rows for each word and instant to one row for each instant."""
    parts = []
    meanings = [m for m in meanings_of(table.columns) if m.column in ends]
    unit_of = {m.column: unit for m in meanings if (unit := _unit_of(table, m))}
    for word in dict.fromkeys(words.tolist()):
        columns = {n: x[words == word] for n, x in table.columns.items() if table.is_time(n)}
        columns |= {word + end: table.columns[n][words == word] for n, end in ends.items()}
        units = {**table.units} | {word + ends[n]: unit for n, unit in unit_of.items()}
        parts.append(LogTable(Path(word), columns, units, origins=table.origins))
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


def _check_simultaneous(table: LogTable, naming: str, words: Texts) -> None:
    """Raise if joints were logged one after the other.

    Sorting by joint is fine if all joints have about the same time span and number of rows.
    """
    changes = np.count_nonzero(words[1:] != words[:-1])
    time = next((values for name, values in table.columns.items() if table.is_time(name)), None)
    if time is None or changes > _MOST_CHANGES * len(words):
        return
    spans = [time[(words == joint) & np.isfinite(time)] for joint in dict.fromkeys(words.tolist())]
    if not all(map(len, spans)):
        return
    first, last = ([float(end(span)) for span in spans] for end in (np.min, np.max))
    longest = max(np.subtract(last, first))
    counts = [len(span) for span in spans]
    if min(last) - max(first) < _TOGETHER * longest or min(counts) < _TOGETHER * max(counts):
        raise LogError(
            f"In log {str(table.path)!r} the joints in {naming!r} follow each other in time "
            "instead of being logged together.",
            advice="Write a log for each joint, with the positions of the others.",
        )
