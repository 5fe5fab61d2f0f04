"""Which column of a file is which quantity of which joint: by names, or by a mapping."""

from __future__ import annotations

import difflib
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from geodrake.boundary.arguments import Array
from geodrake.errors import ArgumentError, LogError, nearest
from geodrake.logs.files.base_names import floating_meaning, numbered_axes
from geodrake.logs.files.name_rules import (
    DESIRED,
    MAPPED,
    MOTOR,
    NUMBERED,
    ONLY,
    OTHER,
    PAIRS,
    PART,
    PLAIN,
    PREVIOUS,
    ROLES,
    SHORT,
    Meaning,
    as_positions,
    bracketed,
    is_gripper,
    is_unknown_word,
    joint_columns,
    matched,
    meaning_of,
    meanings_of,
    plain_words,
    words_of,
)
from geodrake.logs.files.packed_files import log_name
from geodrake.logs.files.reading import ColumnMapping, MappedColumn, Reading, propose
from geodrake.logs.files.state_space import follows, state_columns
from geodrake.logs.files.table import LogTable, date_words, rate_in
from geodrake.logs.files.units import UNITS, find_unit, unit_advice, unit_of
from geodrake.logs.motion import (
    EFFORT_KINDS,
    PARTIAL,
    PASSIVE,
    QUANTITIES,
    SIGNAL_KINDS,
    JointLog,
    check_joints,
)
from geodrake.logs.time_stamps import are_parts, of_clock, time_unit

HEADER = "time,<joint>.position,<joint>.velocity,<joint>.effort"
MOST_COLUMNS = 10_000  # ten times more than a robot of a hundred joints has
HEADER_ADVICE = f"The first line names the columns: {HEADER}; velocity is optional."
SIGNAL_ADVICE = "<joint>.current, .voltage, .pwm or .command may replace effort."
"""Signals that may replace the measured effort of a joint."""


def read_column(meaning: Meaning, numbers: dict[str, Array], *, since_first: bool = True) -> Array:
    """Take the numbers (N,) of a column out of those of a file, in SI units.

    Seconds with a column of parts beside them may be from the first second on, to lose no digits.
    """
    values = numbers.pop(meaning.column)
    if meaning.beside is not None:
        start = float(values[np.isfinite(values)][:1].sum()) if since_first else 0.0
        values = (values - start) + meaning.beside.factor * numbers.pop(meaning.beside.column)
    values = values if meaning.factor == 1.0 else meaning.factor * values
    return values + meaning.offset if meaning.offset else values


def with_own_parts(time: Meaning, numbers: Mapping[str, Array]) -> Meaning:
    """Return a column of time without the one beside it, unless that has parts of its seconds."""
    if (beside := time.beside) is None:
        return time
    belongs = are_parts(numbers[time.column], beside.factor * numbers[beside.column])
    return time if belongs else replace(time, beside=None)


def in_seconds(
    meaning: Meaning, time: Array, motion: Sequence[Array | None] = ()
) -> tuple[Array, tuple[str, ...]]:
    """Return time stamps (N,) of unknown unit in s, and a note; `motion` as for `time_unit`."""
    if meaning.unit is not None or meaning.beside is not None:
        return time, ()
    if (seconds := of_clock(time)) is not None:
        return seconds, ("time has the digits of a clock, hhmmss, as its minutes show: converted",)
    found = time_unit(meaning.column, time, *motion)
    return (time, ()) if found is None else (found[0] * time, (found[1],))


def check_text(path: Path, names: Sequence[str]) -> None:
    """Raise for column names that are not text, and for duplicates of geodrake's own names."""
    if len(names) > MOST_COLUMNS:
        raise LogError(
            f"Log {str(path)!r} has {len(names)} columns; at most {MOST_COLUMNS} are read.",
            advice="Is it transposed? Write a row for each sample, or remove columns.",
        )
    if any("\0" in name for name in names):
        raise LogError(
            f"The first line of log {str(path)!r} has null characters: it is not UTF-8 text.",
            advice="Is it UTF-16 or binary? Save it as CSV in UTF-8, or as .npz.",
        )
    check_once(path, names, [name for name in names if is_used(name) and name != "time"])


def no_header(path: Path, first: Sequence[str]) -> LogError:
    """Return the error for a table without a header, from the cells of its first row."""
    return LogError(
        f"Log {str(path)!r} has no header: its first line is {','.join(first)[:60]!r}.",
        advice=f"{HEADER_ADVICE} Or name its columns with --columns or --mapping.",
    )


def check_once(path: Path, names: Sequence[str], used: Collection[str] | None = None) -> None:
    """Raise for duplicate columns, by default in all."""
    counts = Counter(names)
    twice = sorted(name for name in set(names if used is None else used) if counts[name] > 1)
    if twice:
        raise LogError(
            f"Log {str(path)!r} has duplicate columns: {', '.join(twice)}.",
            advice="Remove or rename them.",
        )


def is_used(name: str) -> bool:
    """Return whether a column is one of the format's."""
    words = (*QUANTITIES, *EFFORT_KINDS)
    return name == "time" or ("." in name and name.rsplit(".", 1)[1] in words)


def listed(names: Sequence[str]) -> str:
    """Return the first few names."""
    return f"{', '.join(names[:8]) or 'none'}{' …' if len(names) > 8 else ''}"


Best = dict[tuple[str, str], list[Meaning]]

_MOST_CLOCKS, _EVEN = 50, 0.9  # columns that are looked at, and share of steps that are even
_FORWARD = 0.99  # share of steps of a counter that begins anew
_CLOCKS = frozenset(("time", "timestamp", "stamp", "ts", "clock", "duration", "uptime", "elapsed"))
_KEPT = {"m": 1, "motor": 1, "filtered": 1, "filt": 1, "smoothed": 1, "qd": 1, "raw": 2, "th": 2}
_STEADY = 0.2  # of its mean, by which the voltage of a supply may vary


def candidates(
    meanings: Sequence[Meaning], found: Mapping[str, str], reading: Reading
) -> tuple[Best, dict[str, tuple[str, ...]]]:
    """Return candidate columns by (joint, quantity), best first, and other efforts by joint.

    A joint with efforts of any kind has no command, unless one is called as geodrake itself does.
    Numbered columns of what joints should do, or of motors, do not complete what was measured at
    other joints.
    """
    best: Best = defaultdict(list)
    for meaning in _of_these_joints(meanings, found, reading.joints):
        if meaning.column not in reading.ignored:
            best[found[meaning.column], meaning.log_quantity].append(meaning)
    others = {}
    for joint in dict.fromkeys(joint for joint, _ in best):
        said = reading.kind_of(joint)
        positions = best.get((joint, "position"), [])
        wanted = [m for m in positions if m.is_wanted]
        wanted = wanted if len(wanted) < len(positions) else []  # beside measured ones
        commands = [*best.pop((joint, "command"), ()), *wanted]
        efforts = best.get((joint, "effort"), [])
        efforts.sort(key=lambda meaning: _preference(meaning, joint, said))
        others[joint] = (*(m.column for m in efforts[1:]), *(m.column for m in commands))
        if commands and said == "command":
            best.pop((joint, "effort"), None)
        is_own = any(meaning.style[0] == "own" for meaning in commands)
        if not commands or (best.get((joint, "effort")) and not is_own):
            continue
        best[joint, "command"] = commands
        kept = [m for m in positions if m not in commands]
        if kept:
            best[joint, "position"] = kept
    best = {key: same for key, same in best.items() if same}
    for (joint, _), same in best.items():
        same.sort(key=lambda m: _preference(m, joint, reading.kind_of(joint)))
    limits = dict.fromkeys(("position", "velocity", "acceleration"), MOTOR)
    doubtful = {key for key, (m, *_) in best.items() if m.role >= limits.get(key[1], DESIRED)}
    few, several = (Counter(what for _, what in each) for each in (doubtful, best))
    numbered = {key for key in doubtful if best[key][0].number is not None}
    asked = {key for key in numbered if 2 * few[key[1]] < several[key[1]]}
    return {key: same for key, same in best.items() if key not in asked}, others


def _of_these_joints(
    meanings: Sequence[Meaning], found: Mapping[str, str], known: Sequence[str]
) -> Iterator[Meaning]:
    """Yield columns of joints without those that count something else, such as fingers of a hand.

    These have a word that names of the joints lack, are fewer than the joints, and number some of
    these again; `known` are those of the model.
    """
    own = [meaning for meaning in meanings if meaning.column in found]
    words = {meaning.column: _other_words(meaning, found[meaning.column]) for meaning in own}
    joints: dict[tuple[str, frozenset[str]], set[str]] = defaultdict(set)
    for meaning in own:
        if found[meaning.column] in known or not known:
            joints[meaning.log_quantity, words[meaning.column]].add(found[meaning.column])
    moved = [those for (quantity, _), those in joints.items() if quantity == "position"]
    most = max(moved, key=len, default=set[str]())
    for meaning in own:
        more, joint = words[meaning.column], found[meaning.column]
        those, placed = (joints.get((q, more), set()) for q in (meaning.log_quantity, "position"))
        is_again = len(those) < len(most) != len(placed) and not those.isdisjoint(most)
        if not (more and is_again) or {*map(str, meaning.words)} & plain_words(joint):
            yield meaning


def _other_words(meaning: Meaning, joint: str) -> frozenset[str]:
    """Return the words of a column that say something else than its joint's name."""
    words = {word for word in (*meaning.group, *meaning.words) if isinstance(word, str)}
    return frozenset(words) - plain_words(joint)


def _preference(meaning: Meaning, joint: str, said: str | None) -> tuple[bool | int, ...]:
    """Return the sort key of several columns of one quantity of a joint, best first.

    What is raw is often in counts, m may be of the motor, V a voltage, and beside `qdot` `qd` is
    desired; what else names have more than others is of something else.
    """
    kept = max((_KEPT[word] for word in plain_words(meaning.column) if word in _KEPT), default=0)
    more = len(_other_words(meaning, joint)), len(plain_words(meaning.column))
    is_short = not SHORT.isdisjoint(meaning.style)
    own, rest = meaning.style[0] != "own", (meaning.role, is_short, kept, *more)
    if meaning.log_quantity != "effort":
        return own, *rest
    other = said is not None and said != meaning.quantity
    kind = (meaning.unit and meaning.unit.signal) or meaning.quantity
    return other, own, meaning.role >= DESIRED, EFFORT_KINDS.index(kind), *rest


def settled(
    path: Path, meaning: Meaning, joint: str, reading: Reading, units: Mapping[str, str]
) -> Meaning:
    """Return the meaning of a joint's column with its unit and the kind of efforts."""
    quantity, told = meaning.quantity, {} if meaning.style == MAPPED else reading.units
    stated = "" if meaning.style == MAPPED else units.get(meaning.column, "")
    column = f"Column {meaning.column!r} of log {str(path)!r}"
    unit = meaning.unit or find_unit(stated, quantity)
    if meaning.log_quantity != "effort":
        unit = unit_of(told[quantity], quantity) if quantity in told else unit
        if unit and np.isnan(unit.factor) and quantity in ("position", "command"):
            raise LogError(
                f"{column} is in {unit.name} of unknown resolution.",
                advice=f"Give it, with gears, as in --units {quantity}=rev/4096 (or "
                "rev/4096@2048 if 2048 is counted where the joint is at 0), or for each "
                "column in a mapping, with gain −1 for reversed ones.",
            )
        if unit and unit.name == "normalized" and quantity in ("position", "command"):
            low, high = reading.limits.get(joint, (-np.inf, np.inf))
            if not np.isfinite(high - low):
                raise LogError(
                    f"{column} is a share of the range of {joint}, but the model has no limits of "
                    "it.",
                    advice="Add them to the model, or use --model.",
                )
            zero = low if is_gripper(joint) else 0.5 * (high + low)  # which is closed at 0
            factor = high - low if is_gripper(joint) else 0.5 * (high - low)
            unit = replace(unit, factor=unit.factor * factor, offset=zero)
        return replace(meaning, unit=unit)
    said = reading.kind_of(joint)
    said = None if said == "command" else said
    unit = unit or find_unit(stated, "effort")
    asked = unit_of(told["effort"], "effort") if "effort" in told else None
    kind, known = quantity, asked or unit
    if kind == "effort" and known is not None and meaning.gain == 1.0:
        kind = known.signal or kind
    if said in ("effort", kind) or (said is not None and quantity == "effort"):
        kind = str(said)
    elif joint in reading.kinds and said is not None:
        by = "the mapping" if meaning.style == MAPPED else "its name"
        raise LogError(
            f"{column} is {quantity} by {by}, but {said} by --kind.",
            advice="Use another column in --mapping, or omit --kind.",
        )
    if kind in told:
        unit = unit_of(told[kind], kind)
    elif asked is not None:
        is_meant = (asked.signal or "effort") == kind or (asked.signal and quantity == "effort")
        unit = asked if is_meant else unit
    is_scaled = joint in reading.gains or meaning.gain != 1.0
    is_other = unit is not None and (unit.signal or "effort") != kind
    if unit is not None and is_other and not (kind == "effort" and is_scaled):
        raise LogError(
            f"{column} is used as {kind} of {joint}, but is in {unit.name}, a unit of "
            f"{unit.signal or 'effort'}.",
            advice="Set its kind with --kind JOINT=KIND, or its unit with --units.",
        )
    return replace(meaning, quantity=kind, unit=unit)


def without_use(log: JointLog, columns: Columns) -> frozenset[str]:
    """Return columns of efforts without information, where others may replace them.

    They are empty, the voltage of a supply, which hardly changes, or all the same, as flags.
    """
    chosen = {
        columns.sources[name].column: (log.effort[:, at], columns.kinds.get(joint))
        for at, joint in enumerate(log.joints)
        if columns.others.get(joint) and (name := f"{joint}.effort") in columns.sources
    }
    known = {column: values[np.isfinite(values)] for column, (values, _) in chosen.items()}
    spans = {column: float(np.ptp(values)) for column, values in known.items() if len(values)}
    if spans and not any(spans.values()):
        return frozenset(chosen)
    supplies = (c for c, (_, kind) in chosen.items() if kind == "voltage" and c in spans)
    steady = (c for c in supplies if spans[c] < _STEADY * abs(known[c].mean()))
    return frozenset({*chosen} - {*spans}).union(steady)


_UNITS_WITH = {**dict.fromkeys(SIGNAL_KINDS, "effort"), "command": "position"}
_CONSTANT = " (torque constant × gear ratio)"
_KIND_WORDS = {
    "current": "motor currents in A",
    "voltage": "voltages in V",
    "pwm": "duty cycles or percentages in fractions of the largest value",
}


def choice_words(best: Mapping[tuple[str, str], Sequence[Meaning]]) -> Iterator[str]:
    """Yield notes on the choice among several columns of one quantity."""
    for quantity in QUANTITIES:
        several = [same for (_, q), same in best.items() if q == quantity]
        chosen, others = [s[0] for s in several], [m for s in several for m in s[1:]]
        if others:
            why = {ROLES[m.role] for m in others if m.role > PLAIN} - {""}
            why |= {m.quantity for m in others} - {m.quantity for m in chosen}
            words = f" ({', '.join(sorted(why))})" if why else ""
            yield f"{quantity}: {_span(chosen)} used instead of {_span(others)}{words}"
        measured = dict.fromkeys(SIGNAL_KINDS, MOTOR)  # currents are of motors anyway
        doubtful = [m for m in chosen if m.role > measured.get(m.quantity, PLAIN)]
        if late := [m for m in doubtful if m.role == PREVIOUS]:
            yield f"{quantity}: by name, of the row before: {_span(late)}"
        elsewhere = [m for m in doubtful if m.role != PREVIOUS]
        if quantity not in PARTIAL and elsewhere:
            words = "may not be measured at the joints"
            yield f"{quantity}: by their names, {_span(elsewhere)} {words}"


def unit_words(sources: Mapping[str, Meaning], reading: Reading) -> Iterator[str]:
    """Yield which units were converted, in words."""
    same: dict[str, dict[str, Meaning]] = defaultdict(dict)
    for name, source in sources.items():
        quantity = name.rpartition(".")[2]
        same[source.quantity if quantity == "effort" else quantity][name] = source
    for quantity in ("time", *QUANTITIES, *SIGNAL_KINDS):
        found = [source.unit for source in same[quantity].values() if source.unit]
        units = dict.fromkeys(unit.name for unit in found if unit.factor != 1.0 or unit.offset)
        if units:
            asked = {quantity, _UNITS_WITH.get(quantity, quantity)}.intersection(reading.units)
            told = "as requested" if asked else "by the column names"
            yield f"{quantity} is in {', '.join(units)}, {told}: converted"
    for kind in SIGNAL_KINDS:
        joints = [name.rpartition(".")[0] for name in same[kind]]
        if joints:
            yield (
                f"efforts of {listed(joints)} are {_KIND_WORDS[kind]}: their gains "
                "are estimated with the model's inertias, unless given by --gain "
                f"JOINT=VALUE{_CONSTANT if kind == 'current' else ''}"
            )
    commanded = [name.rpartition(".")[0] for name in same["command"]]
    if bare := [joint for joint in commanded if f"{joint}.effort" not in sources]:
        yield (
            f"no efforts of {listed(bare)}: their servo commands are used, with gains that "
            "are estimated with the model's inertias"
        )


def _span(meanings: Sequence[Meaning]) -> str:
    """Return the first column of each style, with the last."""
    styles: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for meaning in meanings:
        styles[meaning.style].append(meaning.column)
    return ", ".join(
        names[0] if len(names) == 1 else f"{names[0]} … {names[-1]}" for names in styles.values()
    )


_FEW_WORDS, _LONGEST_WORD = 3, 40  # columns of words that are told, and letters of each
_WORDS_ADVICE = (
    "If the table has one row for each value, pivot it to a column for each quantity of "
    "each joint (DataFrame.pivot), or write JSON records to a .jsonl file. "
)
_MAPPING_ADVICE = "Or map the columns with --mapping."


def columns_of(
    table: LogTable, joints: Sequence[str] | None, reading: Reading, *, partial: bool = False
) -> Columns:
    """Return the meaning of a table's columns; see `read_log` for arguments."""
    path, names = table.path, table.names
    if joints is not None and len(set(joints)) < len(joints):
        raise ArgumentError(f"Log {str(path)!r} would have a joint twice: {listed(joints)}.")
    check_text(path, names)
    is_mapped, first = reading.mapping is not None, table.unnamed
    if first and not is_mapped:
        error = no_header(path, first)
        raise propose(error, path, first, places={}, joints=joints, reading=reading, headed=False)
    columns = _by_mapping(table, reading) if is_mapped else _by_names(table, joints, reading)
    places = columns.places
    try:
        if columns.rate is None and ("", "time") not in places:
            clock, words, is_sure = likely_clock(table)
            if clock is not None:
                if not is_mapped:  # `temps` may be temperatures by its name, as others may be
                    columns = _by_names(table, joints, reading, clock=clock.column)
                places = {("", "time"): clock, **columns.places}
            if is_sure:
                columns.places = places
                columns.notes.append(f"{words}, so it is taken as time")
        if columns.rate is None and ("", "time") not in columns.places:
            asked = ": is it time? In which unit, a mapping can say. "
            told = [] if names else [f"; {n!r} {why}" for n, why in table.silent.items()]
            silent = "".join(told[:_FEW_WORDS])
            raise LogError(
                f"Log {str(path)!r} has no column 'time'; it has {listed(names)}{silent}.",
                advice=f"{words}{asked if clock else ''}{HEADER_ADVICE} "
                "Without time, give the sampling rate with --rate.",
            )
        columns.date(table)
        columns.choose(table, joints, partial=partial)
    except LogError as error:
        if not is_mapped and not {joint for joint, _ in places}.intersection(joints or ()):
            places = _by_names(table, None, reading).places | places
        propose(error, path, table.counted, places=places, joints=joints, reading=reading)
        raise
    check_once(path, names, {c for source in columns.places.values() for c in source.columns})
    columns.check_said()
    columns.keep_used(names)
    return columns


def likely_clock(table: LogTable) -> tuple[Meaning | None, str, bool]:
    """Return the column that may be time by its values or its name, in words, and if it must be.

    It must if it increases evenly and is called so, increases and is called as a unit such as ms,
    or is the first, even and not of whole steps.
    """
    told = {name: meaning_of(name) for name in table.names[:_MOST_CLOCKS]}
    bare = {n for n, m in told.items() if m and m.is_bare and m.quantity == "temperature"}
    others = [n for n, m in told.items() if m is None or m.quantity == PART or n in bare]
    with suppress(LogError):  # of cells that are no numbers
        for name, values in table.read(others, skip=True)[0].items():
            steps = np.diff(values)
            step = float(np.median(steps)) if len(steps) else 0.0
            even = np.abs(steps - step) <= 0.5 * step
            is_called, part = bool(_CLOCKS & plain_words(name)), told[name]
            units = [find_unit(word, "time") for word in plain_words(name)]
            unit = next((u for u in units if u is not None and u.factor < 1.0), None)  # as ms
            unit = part.unit if part is not None and part.quantity == PART else unit
            is_unit = unit is not None and float((steps > 0.0).mean()) > _FORWARD
            counts = step == 1.0 and not (is_called or is_unit)  # rows
            if step > 0.0 and not counts and (is_unit or float(even.mean()) > _EVEN):
                words = f"{name!r} increases by {step:.4g} from row to row"
                is_first = name == table.names[0] or name.startswith("__index_level")
                is_sure = is_called or is_unit or (is_first and step % 1.0 != 0.0)
                unit = unit or find_unit(name, "time")
                return Meaning(name, "time", unit=unit), words, is_sure
    close = difflib.get_close_matches("time", [name.lower() for name in table.names[:100]], 1)
    return None, f"Is it {close[0]!r}? " if close else "", False


def _steady_rate(table: LogTable) -> tuple[float, str] | None:
    """Return the rate that each row of a column says, as its period does, and the column."""
    names = [name for name in table.names if rate_in(name, 0.01) or rate_in(name, 100.0)]
    for name, values in table.read(names, skip=True)[0].items() if names else ():
        known = values[np.isfinite(values)]
        rate = rate_in(name, float(known[0])) if len(known) else None
        if rate is not None and (known == known[0]).all():
            return rate, name
    return None


def _by_names(
    table: LogTable, joints: Sequence[str] | None, reading: Reading, *, clock: str = ""
) -> Columns:
    """Return the meaning of columns by their names; a `clock` is left out."""
    path, units = table.path, table.units
    beside = [name for name in table.names if name != clock and floating_meaning(name) is None]
    told, said = joint_columns(beside, joints or ()), []
    if joints and not any(m.quantity == "position" and m.role < OTHER for m in told):
        bare = as_positions(beside, joints)
        said = [f"position: {_span(bare)} taken, as they are named like joints"] if bare else []
        told += bare
    states = [*state_columns(table, beside, told, reading)] if joints else []
    told = [*states, *(m for m in told if m.column not in {each.column for each in states})]
    said += [f"taken as states and inputs, in the model's order: {_span(states)}"] * bool(states)
    asked = [words for words in map(plain_words, reading.topics) if words]
    told = [m for m in told if any(words <= plain_words(m.column) for words in asked)] or told
    told, spare = _without_spare(table, told, joints)
    said += spare
    of_joints = _with_targets(table, told)
    if joints and len(joints) > 1 and all(meaning.is_bare for meaning in of_joints):
        called = log_name(path)  # the joint may be said by the name of the file
        named = [replace(m, joint=called, words=words_of(called)) for m in of_joints]
        of_joints = named if {*matched(named, joints)[0].values()} <= {*joints} else of_joints
    found, notes = matched(of_joints, joints)
    best, others = candidates(of_joints, found, reading)
    _check_one_robot(path, best)
    places = {
        (joint, what): settled(
            path, replace(m, quantity=what) if what == "command" else m, joint, reading, units
        )
        for (joint, what), (m, *_) in best.items()
    }
    _check_units(table, places)
    if (time := time_source(table, reading)) is not None:
        places = {("", "time"): time, **places}
    own = frozenset(m.joint for m in of_joints if m.style[0] == "own")
    said, rate = [*said, *notes, *choice_words(best)], reading.rate
    unknown = {k: s.unit.name for k, s in places.items() if s.unit and np.isnan(s.unit.factor)}
    if unknown:
        lost, of = listed([places[k].column for k in unknown]), dict.fromkeys(unknown.values())
        said.append(f"not used, as the scale of {', '.join(of)} is unknown: {lost}")
    places = {key: source for key, source in places.items() if key not in unknown}
    if rate is None and time is None and (told_rate := table.rate or _steady_rate(table)):
        rate, name = told_rate
        said.append(f"{rate:.6g} Hz, from {name!r} in the file")
    return Columns(path, reading, places, said, rate, own, others)


def _check_one_robot(path: Path, best: Best) -> None:
    """Raise for two columns of each joint that differ in a word which tells robots apart."""
    apart = dict[str, set[frozenset[str]]]()
    for (_, quantity), same in best.items():
        first, second = same[0], same[min(1, len(same) - 1)]
        words = ({*map(str, words_of(m.column))} for m in (first, second))
        differ = set.symmetric_difference(*words) if first.role == second.role else set()
        apart.setdefault(quantity, set()).add(frozenset(differ))
    told = apart.get("position", set()) | apart.get("effort", set())
    if any(words and PAIRS.issuperset(words) for words in told):
        told.discard(frozenset())  # of a quantity that only one of them has
    robots = sorted(next(iter(told), ()))
    if len(told) == 1 and len(robots) == 2:
        raise LogError(
            f"Log {str(path)!r} has each joint twice: of {robots[0]} and of {robots[1]}.",
            advice=f"Choose one: --topic {robots[0]}.",
        )


def _check_units(table: LogTable, places: Mapping[tuple[str, str], Meaning]) -> None:
    """Raise for columns of several joints whose unit is unknown, where a table has known ones."""
    stated = {n: unit for n in table.names if (unit := bracketed(n))} | {**table.units}
    known = {unit for unit in {*stated.values()} if any(find_unit(unit, each) for each in UNITS)}
    odd = {n for n, unit in stated.items() if known and (unit in known or is_unknown_word(unit))}
    bare = [
        s for s in places.values() if s.unit is None and s.column in odd and s.quantity in UNITS
    ]
    counts = Counter((source.quantity, stated[source.column]) for source in bare)
    for source in bare:
        unit = stated[source.column]
        if counts[source.quantity, unit] > 1:
            raise LogError(
                f"Column {source.column!r} of log {str(table.path)!r} is in {unit!r}, which is no "
                f"known unit of {source.quantity}.",
                advice=f"Give it, as in --units {source.quantity}=UNIT. "
                f"{unit_advice(source.quantity)}",
            )


def _without_spare(
    table: LogTable, told: list[Meaning], joints: Sequence[str] | None
) -> tuple[list[Meaning], list[str]]:
    """Return columns but those of numbered motors behind the robot's last, and a note.

    They are zero throughout, and more than the model has joints.
    """
    counted = {m.column: m.number for m in told if m.number is not None}
    if not joints or len({*counted.values()}) <= len(joints):
        return told, []
    known = [name for name in counted if table.has_numbers(name)]
    moved = [counted[n] for n, values in table.read(known, skip=True)[0].items() if values.any()]
    spare = [name for name, number in counted.items() if moved and number > max(moved)]
    note = f"zero throughout, so without a motor: {', '.join(spare[:1])} …"
    return [m for m in told if m.column not in spare], [note] * bool(spare)


_TARGET = "tq"  # torques, or targets of positions q


def _with_targets(table: LogTable, meanings: Sequence[Meaning]) -> list[Meaning]:
    """Return columns with those called `tq` as targets, where their numbers follow positions."""
    places = {m.words: m.column for m in meanings if m.quantity == "position" and m.role < DESIRED}
    doubted = [m for m in meanings if m.words in places and _TARGET in plain_words(m.column)]
    names = [name for m in doubted for name in (m.column, places[m.words])]
    numbers, _ = table.read(list(dict.fromkeys(names)), skip=True) if names else ({}, None)
    targets = set[str]()
    for meaning in doubted:
        place, target = numbers[places[meaning.words]], numbers[meaning.column]
        targets |= {meaning.column} if follows(place, target) else set()
    return [
        replace(m, quantity="position", role=DESIRED, style=(_TARGET,), is_wanted=True)
        if m.column in targets
        else m
        for m in meanings
    ]


def _by_mapping(table: LogTable, reading: Reading) -> Columns:
    """Return the meaning of columns by a mapping."""
    places, path, names = dict[tuple[str, str], Meaning](), table.path, table.names
    mapping = reading.mapping or ColumnMapping({})
    for name, mapped in mapping:
        if name.endswith(".effort") and mapped.column == PASSIVE and PASSIVE not in names:
            places[name.removesuffix(".effort"), PASSIVE] = Meaning(PASSIVE, PASSIVE)
            continue
        meaning = _mapped(name, mapped, table, reading)
        if meaning.column not in names:
            raise LogError(
                f"Log {str(path)!r} has no column {meaning.column!r}, which {mapping.source} maps "
                f"to {name!r}; it has {listed(names)}.",
                advice="Correct the mapping.",
            )
        joint = meaning.joint
        places[joint, meaning.log_quantity] = settled(path, meaning, joint, reading, {})
    mapping = mapping.named(table.counted)  # which refuses a column that is used twice
    if mapping.time is not None and (time := time_source(table, reading)) is not None:
        places["", "time"] = time
    for joint in [joint for joint, quantity in places if quantity == "command"]:
        if reading.kind_of(joint) == "command":  # in the place of its efforts
            places.pop((joint, "effort"), None)
    rate = reading.rate or mapping.rate
    return Columns(path, reading, places, [], rate, frozenset(mapping.joints))


@dataclass
class Columns:
    """The quantity and joint of each column of a file, and how they are read."""

    path: Path
    reading: Reading  # how the user said that the file is to be read
    # (joint, quantity) -> column, in the order of the file; `("", "time")` is time.
    places: dict[tuple[str, str], Meaning]
    notes: list[str]  # what is to be noted of them
    rate: float | None  # rows a second, Hz, where there is no column of time
    own: frozenset[str]  # joints by geodrake's own names, of which none is left out unasked
    # Joint -> further columns that could be taken for its efforts, or in their place.
    others: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    origin: int | None = None  # since when time is, ns since 1970, if that is known
    joints: tuple[str, ...] = ()  # names of the n joints, in the order of the log to be
    standing: tuple[str, ...] = ()  # joints of which there is the position alone
    # Quantities that every joint has; and efforts and commands, which some may lack.
    quantities: tuple[str, ...] = ()
    passive: tuple[str, ...] = ()  # joints without a motor, which need no column of efforts
    # Name -> column of a free base or of contacts.
    floating: dict[str, Meaning] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()  # joints of the file that the model lacks

    @property
    def sources(self) -> dict[str, Meaning]:
        """`time`, `<joint>.<quantity>` and names of a free base -> column."""
        own = {q if q == "time" else f"{joint}.{q}": s for (joint, q), s in self.places.items()}
        return own | self.floating

    @property
    def kinds(self) -> dict[str, str]:
        """Joint -> kind of the signal that replaces its efforts, if any."""
        named = {joint: self.places.get((joint, "effort")) for joint in self.joints}
        found = {joint: source.quantity for joint, source in named.items() if source is not None}
        found |= dict.fromkeys(self.passive, PASSIVE)
        return {joint: kind for joint, kind in found.items() if kind != "effort"}

    @property
    def files(self) -> tuple[str, ...]:
        """Columns of the file that are read."""
        return tuple(dict.fromkeys(c for source in self.sources.values() for c in source.columns))

    def date(self, table: LogTable) -> None:
        """Find since when time is.

        Time is left out where a rate says it. Commands without a unit have that of positions.
        """
        if self.rate is not None:
            self.places.pop(("", "time"), None)
        for (joint, quantity), source in self.places.items():
            position = self.places.get((joint, "position")) if quantity == "command" else None
            if position is not None and source.unit is None and source.factor == 1.0:
                own = replace(source, unit=position.unit, gain=position.gain)
                self.places[joint, quantity] = own
            if quantity != "time" and source.column in table.origins:
                raise LogError(
                    f"Column {source.column!r} of log {str(table.path)!r} is used as the "
                    f"{quantity} of {joint}, but has dates.",
                    advice=_MAPPING_ADVICE,
                )
        if (time := self.places.get(("", "time"))) is not None:
            self.origin = table.origins.get(time.column)
        if self.origin is not None:
            self.notes.append(f"time is in s since {date_words(self.origin)}")

    def leave_out(self, quantity: str, why: str) -> None:
        """Leave out the columns of a quantity that joints may lack, and note it."""
        self.quantities = tuple(each for each in self.quantities if each != quantity)
        self.places = {place: s for place, s in self.places.items() if place[1] != quantity}
        self.notes.append(f"{quantity} is not used, as {why}")

    def choose(self, table: LogTable, wanted: Sequence[str] | None, *, partial: bool) -> None:
        """Find the joints of the log, and those with positions only."""
        path, moved = table.path, self._of_model(self.having("position"), wanted)
        efforts = self.having("effort", "command")
        heard = {*efforts, *self._without_motor(moved)}
        known = [each.quantity for n in table.names if (each := floating_meaning(n))]
        if self.reading.of_base and any(n.startswith(("base.", "imu.")) for n in known):
            heard |= {*moved}  # forces at feet say more than efforts
        silent = [joint for joint in moved if joint not in heard]
        if len(silent) == len(moved):
            told = {} if moved or efforts else table.first_words
            words = [f"; {n!r} holds {cell[:_LONGEST_WORD]!r}" for n, cell in told.items()]
            words = words or [f"; its columns are {listed(table.names)}"]
            advice = _WORDS_ADVICE if told else ""
            advice += f"{HEADER_ADVICE} {SIGNAL_ADVICE} {_MAPPING_ADVICE}"
            if self.reading.mapping is not None:
                advice = f"Fill in {self.reading.mapping.source}."
            raise LogError(
                f"Log {str(path)!r} has no joint with both position and effort; positions: "
                f"{listed(moved)}; efforts: {listed(efforts)}{''.join(words[:_FEW_WORDS])}.",
                advice=f"Without efforts, nothing can be said about dynamics. {advice}",
            )
        standing = tuple(j for j in silent if j in self.own or j in (wanted or ()))
        if standing and not partial:
            raise LogError(
                f"Log {str(path)!r} has positions but no efforts of {', '.join(standing)}.",
                advice=f"Log their efforts too, or remove their columns. {SIGNAL_ADVICE}",
            )
        own = tuple(joint for joint in moved if joint in heard)
        if own == (ONLY,) and wanted and len(wanted) > 1 and ONLY not in wanted:
            raise LogError(
                f"Log {str(path)!r} has columns of one joint without its name.",
                advice=f"Name the columns or the file after one of {listed(wanted)}, as in "
                f"{wanted[0]}.position. Write tables of several joints to a file each, and "
                f"join them as {wanted[0]}.csv+{wanted[1]}.csv. {_MAPPING_ADVICE}",
            )
        are_numbered = wanted is not None and all(map(NUMBERED.fullmatch, own))
        if wanted is not None and are_numbered and not {*own}.intersection(wanted):
            raise LogError(
                f"Log {str(path)!r} has {len(own)} joints by numbers, but the model has "
                f"{len(wanted)}: {listed(wanted)}.",
                advice="Say in a mapping which is which.",
            )
        if wanted is not None:
            check_joints(log_name(path), [*own, *standing], wanted, partial=partial)
            own = tuple(joint for joint in wanted if joint in own)
        self.joints, self.standing, self.passive = own, standing, self._without_motor(own)
        beside = [j for j in self.having("position") if j not in (*own, *standing)]
        self.left_out = tuple(beside) if wanted is not None else ()

    def keep_used(self, names: Sequence[str]) -> None:
        """Keep the columns that are read, with notes on others."""
        own, reading, used = self.joints, self.reading, {*self.files}
        for quantity in QUANTITIES:
            missing = [f"{j}.{quantity}" for j in own if (j, quantity) not in self.places]
            some = len(missing) < len(own) and quantity in PARTIAL
            if not missing or some or quantity == "effort":
                self.quantities += (quantity,)
            elif len(missing) < len(own):
                self.notes.append(f"{quantity} is not used: there is none of {listed(missing)}")
        if said := [joint for joint in self.passive if joint not in reading.motorless]:
            self.notes.append(f"no motor at {listed(said)}: its effort is zero")
        every, kept = self.places.items(), (*own, *self.standing)
        of_joints = {p: source for p, source in every if p[1] == "time" or p[0] in kept}
        self.places = {
            (joint, what): source
            for (joint, what), source in of_joints.items()
            if what in (("position",) if joint in self.standing else ("time", *self.quantities))
        }
        for joint, gain in reading.gains.items():  # with which signals are efforts
            if (of_motor := self.places.get((joint, "effort"))) is not None:
                effort = replace(of_motor, gain=gain * of_motor.gain, quantity="effort")
                self.places[joint, "effort"] = effort
        for name in names:
            if name not in used and (known := floating_meaning(name)) is not None:
                self.floating.setdefault(known.quantity, known)
        axes = numbered_axes(self.floating)
        self.floating = {axes.get(name, name): source for name, source in self.floating.items()}
        self.notes += unit_words(self.sources, reading)
        known_too = {c for source in of_joints.values() for c in source.columns}
        if ignored := [n for n in names if n and n not in {*self.files, *known_too}]:
            self.notes.append(f"columns ignored: {listed(ignored)}")

    def _of_model(self, joints: Sequence[str], wanted: Sequence[str] | None) -> tuple[str, ...]:
        """Return the joints without those that the model lacks, if it has any of the log's.

        A joint that is called like one that the log lacks stays: it is that one, misspelled.
        """
        if wanted is None or not set(wanted).intersection(self.having("position")):
            return tuple(joints)
        lacking = set(wanted).difference(self.having("position"))
        missing = ["".join(map(str, words_of(joint))) for joint in lacking]
        names = {joint: "".join(map(str, words_of(joint))) for joint in joints}
        close = (j for j in joints if difflib.get_close_matches(names[j], missing, 1))
        known = {*wanted, *close}
        return tuple(joint for joint in joints if joint in known)

    def _without_motor(self, joints: Sequence[str]) -> tuple[str, ...]:
        """Return the joints without a motor, according to the log, the user or the model."""
        heard, said = self.having("effort", "command"), self.having(PASSIVE)
        says = bool(heard) or not self.reading.of_base  # else nobody measured what motors do
        return tuple(
            joint
            for joint in joints
            if joint in said
            or self.reading.kinds.get(joint) == PASSIVE
            or (joint in self.reading.motorless and joint not in heard and says)
        )

    def having(self, *quantities: str) -> list[str]:
        """Return joints with one of some quantities, in the order of the file."""
        return list(dict.fromkeys(joint for joint, other in self.places if other in quantities))

    def check_said(self) -> None:
        """Raise for gains, kinds and motors of joints without such a column."""
        motors = [joint for joint in self.reading.motors if joint]
        said = [(joint, "") for joint in self.reading.gains]
        said += [(joint, kind) for joint, kind in self.reading.kinds.items() if joint]
        if self.reading.kinds.get("") == "command" and not self.having("command"):
            self.notes.append("no servo commands were logged, so --kind command has no effect")
        for joint, kind in [*((joint, "motor") for joint in motors), *said]:
            option = {"": "--gain", PASSIVE: "--passive", "motor": "--motor"}.get(kind, "--kind")
            if joint not in self.joints:
                raise LogError(
                    f"{option} names {joint!r}, which is not a joint of the log.",
                    advice=f"{nearest(joint, self.joints)}Its joints are {listed(self.joints)}.",
                )
            quantity = "command" if kind == "command" else "effort"
            if kind in (PASSIVE, "motor") or joint in self.having(quantity):
                continue
            raise LogError(
                f"Log {str(self.path)!r} has no column of {joint!r} with "
                f"{f'kind {kind!r}' if kind else 'efforts or signals'}, which {option} names.",
                advice="Map it with --mapping."
                if kind
                else "Gains of servo commands are estimated with the model's inertias.",
            )


def _mapped(name: str, column: MappedColumn, table: LogTable, reading: Reading) -> Meaning:
    """Return the meaning of a column that a mapping gives to `time` or `<joint>.<quantity>`."""
    joint, _, quantity = name.rpartition(".")
    text = column.unit or reading.units.get(quantity)
    unit = unit_of(text, quantity) if text else None
    called = column.among(table.counted)
    return Meaning(called, quantity, joint, unit=unit, style=MAPPED, gain=column.gain)


def time_source(table: LogTable, reading: Reading) -> Meaning | None:
    """Return the column of time, with one of parts of a second if there is one."""
    mapped = reading.mapping.time if reading.mapping else None
    if mapped is not None and mapped.among(table.counted) in table.names:
        source = _mapped("time", mapped, table, reading)
    else:
        times = [m for m in meanings_of(table.names) if m.quantity == "time"]
        times = [m for m in times if table.has_numbers(m.column)] or times
        times = times or [Meaning(n, "time") for n in table.origins if table.is_time(n)]
        if not times:
            return None
        best = min(times, key=lambda meaning: meaning.role)
        source = settled(table.path, best, "", reading, table.units)
    if source.column in table.origins:  # whatever its name says
        source = Meaning(source.column, "time", unit=unit_of("s", "time"))
    own, known = meaning_of(source.column), filter(None, map(meaning_of, table.names))
    beside = (m for m in known if m.quantity == PART and own is not None and m.style == own.style)
    return replace(source, beside=next(beside, None)) if source.factor == 1.0 else source
