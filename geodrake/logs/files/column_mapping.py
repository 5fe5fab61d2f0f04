"""Assign the columns of a file to quantities of joints, by their names or by a mapping."""

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
from geodrake.logs.files.base_names import floating_meaning, mapped_meaning, numbered_axes
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
    number_of,
    plain_words,
    words_of,
)
from geodrake.logs.files.packed_files import log_name
from geodrake.logs.files.reading import ColumnMapping, MappedColumn, Reading, propose
from geodrake.logs.files.state_space import follows, state_columns
from geodrake.logs.files.table import LogTable, date_words, rate_in
from geodrake.logs.files.units import UNITS, find_unit, scaled_unit, unit_advice, unit_of
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
    """Remove the values (N,) of a column from `numbers` and return them in SI units.

    Time with a separate column of fractions may start at its first second, to keep precision.
    """
    values = numbers.pop(meaning.column)
    if meaning.beside is not None:
        start = float(values[np.isfinite(values)][:1].sum()) if since_first else 0.0
        values = (values - start) + meaning.beside.factor * numbers.pop(meaning.beside.column)
    values = values if meaning.factor == 1.0 else meaning.factor * values
    return values + meaning.offset if meaning.offset else values


def with_own_parts(time: Meaning, numbers: Mapping[str, Array]) -> Meaning:
    """Drop the fraction column of a time column unless its values complete the seconds."""
    if (beside := time.beside) is None:
        return time
    belongs = are_parts(numbers[time.column], beside.factor * numbers[beside.column])
    return time if belongs else replace(time, beside=None)


def in_seconds(
    meaning: Meaning, time: Array, motion: Sequence[Array | None] = ()
) -> tuple[Array, tuple[str, ...]]:
    """Convert time stamps (N,) of unknown unit to s, and note it; see `time_unit` for `motion`."""
    if meaning.unit is not None or meaning.beside is not None:
        return time, ()
    if (seconds := of_clock(time)) is not None:
        return seconds, ("time has the digits of a clock, hhmmss, as its minutes show: converted",)
    unit = time_unit(meaning.column, time, *motion)
    return (time, ()) if unit is None else (unit[0] * time, (unit[1],))


def check_text(path: Path, names: Sequence[str]) -> None:
    """Raise for too many or binary column names, and for duplicates of geodrake's own names."""
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
    """Raise for duplicates among the used columns, by default among all."""
    counts = Counter(names)
    duplicates = sorted(name for name in set(names if used is None else used) if counts[name] > 1)
    if duplicates:
        raise LogError(
            f"Log {str(path)!r} has duplicate columns: {', '.join(duplicates)}.",
            advice="Remove or rename them.",
        )


def is_used(name: str) -> bool:
    """Return whether a column name belongs to geodrake's own format."""
    words = (*QUANTITIES, *EFFORT_KINDS)
    return name == "time" or ("." in name and name.rsplit(".", 1)[1] in words)


def listed(names: Sequence[str]) -> str:
    """Return the first few names as text."""
    return f"{', '.join(names[:8]) or 'none'}{' …' if len(names) > 8 else ''}"


Best = dict[tuple[str, str], list[Meaning]]

_MOST_CLOCKS, _EVEN = 50, 0.9  # columns examined, and least share of even steps
_FORWARD = 0.99  # least share of positive steps of a counter that may wrap around
_CLOCKS = frozenset(("time", "timestamp", "stamp", "ts", "clock", "duration", "uptime", "elapsed"))
_KEPT = {"m": 1, "motor": 1, "filtered": 1, "filt": 1, "smoothed": 1, "qd": 1, "raw": 2, "th": 2}
_STEADY = 0.2  # largest variation of a supply voltage, as a fraction of its mean


def candidates(
    meanings: Sequence[Meaning], joint_of: Mapping[str, str], reading: Reading
) -> tuple[Best, dict[str, tuple[str, ...]]]:
    """Return candidate columns by (joint, quantity), best first, and other efforts by joint.

    Efforts of any kind take precedence over commands, unless a command has geodrake's own name.
    Numbered columns of targets or motors are excluded if most joints have measured ones.
    """
    choices: Best = defaultdict(list)
    for meaning in _of_these_joints(meanings, joint_of, reading.joints):
        if meaning.column not in reading.ignored:
            choices[joint_of[meaning.column], meaning.log_quantity].append(meaning)
    other_efforts = {}
    for joint in dict.fromkeys(joint for joint, _ in choices):
        kind = reading.kind_of(joint)
        positions = choices.get((joint, "position"), [])
        targets = [m for m in positions if m.is_wanted]
        targets = targets if len(targets) < len(positions) else []  # only beside measured ones
        commands = [*choices.pop((joint, "command"), ()), *targets]
        efforts = choices.get((joint, "effort"), [])
        efforts.sort(key=lambda meaning: _preference(meaning, joint, kind))
        other_efforts[joint] = (*(m.column for m in efforts[1:]), *(m.column for m in commands))
        if commands and kind == "command":
            choices.pop((joint, "effort"), None)
        is_native = any(meaning.style[0] == "own" for meaning in commands)
        if not commands or (choices.get((joint, "effort")) and not is_native):
            continue
        choices[joint, "command"] = commands
        measured = [m for m in positions if m not in commands]
        if measured:
            choices[joint, "position"] = measured
    choices = {key: options for key, options in choices.items() if options}
    for (joint, _), options in choices.items():
        options.sort(key=lambda m: _preference(m, joint, reading.kind_of(joint)))
    limits = dict.fromkeys(("position", "velocity", "acceleration"), MOTOR)
    doubtful = {key for key, (m, *_) in choices.items() if m.role >= limits.get(key[1], DESIRED)}
    doubtful_counts, counts = (Counter(what for _, what in each) for each in (doubtful, choices))
    numbered = {key for key in doubtful if choices[key][0].number is not None}
    excluded = {key for key in numbered if 2 * doubtful_counts[key[1]] < counts[key[1]]}
    return {key: options for key, options in choices.items() if key not in excluded}, other_efforts


def _of_these_joints(
    meanings: Sequence[Meaning], joint_of: Mapping[str, str], known: Sequence[str]
) -> Iterator[Meaning]:
    """Yield the columns of joints, without those that number other things, such as fingers.

    Such columns share a word that the joint names lack, are fewer than the joints, and reuse
    some of their numbers. `known` lists the joints of the model.
    """
    columns = [meaning for meaning in meanings if meaning.column in joint_of]
    words = {meaning.column: _other_words(meaning, joint_of[meaning.column]) for meaning in columns}
    joints: dict[tuple[str, frozenset[str]], set[str]] = defaultdict(set)
    for meaning in columns:
        if joint_of[meaning.column] in known or not known:
            joints[meaning.log_quantity, words[meaning.column]].add(joint_of[meaning.column])
    positioned = [group for (quantity, _), group in joints.items() if quantity == "position"]
    largest = max(positioned, key=len, default=set[str]())
    for meaning in columns:
        extra, joint = words[meaning.column], joint_of[meaning.column]
        group, places = (joints.get((q, extra), set()) for q in (meaning.log_quantity, "position"))
        is_again = len(group) < len(largest) != len(places) and not group.isdisjoint(largest)
        if not (extra and is_again) or {*map(str, meaning.words)} & plain_words(joint):
            yield meaning


def _other_words(meaning: Meaning, joint: str) -> frozenset[str]:
    """Return the words of a column that its joint's name lacks."""
    words = {word for word in (*meaning.group, *meaning.words) if isinstance(word, str)}
    return frozenset(words) - plain_words(joint)


def _preference(meaning: Meaning, joint: str, chosen_kind: str | None) -> tuple[bool | int, ...]:
    """Return a sort key for columns of one quantity of a joint, best first.

    Raw values are often in counts, `m` may mean motor, V a voltage, and `qd` desired if there is
    a `qdot`. Extra words in a name suggest a different signal.
    """
    penalty = max((_KEPT[word] for word in plain_words(meaning.column) if word in _KEPT), default=0)
    word_counts = len(_other_words(meaning, joint)), len(plain_words(meaning.column))
    is_short = not SHORT.isdisjoint(meaning.style)
    is_foreign, rest = meaning.style[0] != "own", (meaning.role, is_short, penalty, *word_counts)
    if meaning.log_quantity != "effort":
        return is_foreign, *rest
    is_other_kind = chosen_kind is not None and chosen_kind != meaning.quantity
    kind = (meaning.unit and meaning.unit.signal) or meaning.quantity
    return is_other_kind, is_foreign, meaning.role >= DESIRED, EFFORT_KINDS.index(kind), *rest


def settled(
    path: Path, meaning: Meaning, joint: str, reading: Reading, units: Mapping[str, str]
) -> Meaning:
    """Complete the meaning of a joint's column by its unit and the kind of its efforts."""
    quantity, user_units = meaning.quantity, {} if meaning.style == MAPPED else reading.units
    stated = "" if meaning.style == MAPPED else units.get(meaning.column, "")
    column = f"Column {meaning.column!r} of log {str(path)!r}"
    unit = meaning.unit or scaled_unit(stated, quantity)
    if meaning.log_quantity != "effort":
        unit = unit_of(user_units[quantity], quantity) if quantity in user_units else unit
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
                    f"{column} is a share of the range of {joint}, but the model has no limits for "
                    "it.",
                    advice="Add them to the model, or use --model.",
                )
            zero = low if is_gripper(joint) else 0.5 * (high + low)  # grippers are closed at 0
            factor = high - low if is_gripper(joint) else 0.5 * (high - low)
            unit = replace(unit, factor=unit.factor * factor, offset=zero)
        return replace(meaning, unit=unit)
    choice = reading.kind_of(joint)
    choice = None if choice == "command" else choice
    unit = unit or scaled_unit(stated, "effort")
    option = unit_of(user_units["effort"], "effort") if "effort" in user_units else None
    kind, likely = quantity, option or unit
    if kind == "effort" and likely is not None and meaning.gain == 1.0:
        kind = likely.signal or kind
    if choice in ("effort", kind) or (choice is not None and quantity == "effort"):
        kind = str(choice)
    elif joint in reading.kinds and choice is not None:
        origin = "the mapping" if meaning.style == MAPPED else "its name"
        raise LogError(
            f"{column} is {quantity} by {origin}, but {choice} by --kind.",
            advice="Use another column in --mapping, or omit --kind.",
        )
    if kind in user_units:
        unit = unit_of(user_units[kind], kind)
    elif option is not None:
        applies = (option.signal or "effort") == kind or (option.signal and quantity == "effort")
        unit = option if applies else unit
    is_scaled = joint in reading.gains or meaning.gain != 1.0
    is_mismatch = unit is not None and (unit.signal or "effort") != kind
    if unit is not None and is_mismatch and not (kind == "effort" and is_scaled):
        raise LogError(
            f"{column} is used as {kind} of {joint}, but is in {unit.name}, a unit of "
            f"{unit.signal or 'effort'}.",
            advice="Set its kind with --kind JOINT=KIND, or its unit with --units.",
        )
    return replace(meaning, quantity=kind, unit=unit)


def without_use(log: JointLog, columns: Columns) -> frozenset[str]:
    """Return the uninformative columns of efforts that other columns may replace.

    They are empty, constant like flags, or nearly constant like a supply voltage.
    """
    chosen = {
        columns.sources[name].column: (log.effort[:, index], columns.kinds.get(joint))
        for index, joint in enumerate(log.joints)
        if columns.others.get(joint) and (name := f"{joint}.effort") in columns.sources
    }
    finite = {column: values[np.isfinite(values)] for column, (values, _) in chosen.items()}
    spans = {column: float(np.ptp(values)) for column, values in finite.items() if len(values)}
    if spans and not any(spans.values()):
        return frozenset(chosen)
    supplies = (c for c, (_, kind) in chosen.items() if kind == "voltage" and c in spans)
    steady = (c for c in supplies if spans[c] < _STEADY * abs(finite[c].mean()))
    return frozenset({*chosen} - {*spans}).union(steady)


_UNITS_WITH = {**dict.fromkeys(SIGNAL_KINDS, "effort"), "command": "position"}
_CONSTANT = " (torque constant × gear ratio)"
_KIND_WORDS = {
    "current": "motor currents in A",
    "voltage": "voltages in V",
    "pwm": "duty cycles or percentages in fractions of the largest value",
}


def choice_words(best: Mapping[tuple[str, str], Sequence[Meaning]]) -> Iterator[str]:
    """Yield notes on how columns were chosen where a joint has several of one quantity."""
    for quantity in QUANTITIES:
        groups = [options for (_, q), options in best.items() if q == quantity]
        chosen, others = [s[0] for s in groups], [m for s in groups for m in s[1:]]
        if others:
            reasons = {ROLES[m.role] for m in others if m.role > PLAIN} - {""}
            reasons |= {m.quantity for m in others} - {m.quantity for m in chosen}
            words = f" ({', '.join(sorted(reasons))})" if reasons else ""
            yield f"{quantity}: {_span(chosen)} used instead of {_span(others)}{words}"
        measured = dict.fromkeys(SIGNAL_KINDS, MOTOR)  # currents always belong to motors
        doubtful = [m for m in chosen if m.role > measured.get(m.quantity, PLAIN)]
        if lagged := [m for m in doubtful if m.role == PREVIOUS]:
            yield f"{quantity}: by name, of the row before: {_span(lagged)}"
        elsewhere = [m for m in doubtful if m.role != PREVIOUS]
        if quantity not in PARTIAL and elsewhere:
            words = "may not be measured at the joints"
            yield f"{quantity}: by their names, {_span(elsewhere)} {words}"


def unit_words(sources: Mapping[str, Meaning], reading: Reading) -> Iterator[str]:
    """Yield notes on converted units and on signals that replace efforts."""
    groups: dict[str, dict[str, Meaning]] = defaultdict(dict)
    for name, source in sources.items():
        quantity = name.rpartition(".")[2]
        groups[source.quantity if quantity == "effort" else quantity][name] = source
    for quantity in ("time", *QUANTITIES, *SIGNAL_KINDS):
        stated = [source.unit for source in groups[quantity].values() if source.unit]
        units = dict.fromkeys(unit.name for unit in stated if unit.factor != 1.0 or unit.offset)
        if units:
            requested = {quantity, _UNITS_WITH.get(quantity, quantity)}.intersection(reading.units)
            origin = "as requested" if requested else "by the column names"
            yield f"{quantity} is in {', '.join(units)}, {origin}: converted"
    for kind in SIGNAL_KINDS:
        joints = [name.rpartition(".")[0] for name in groups[kind]]
        if joints:
            yield (
                f"efforts of {listed(joints)} are {_KIND_WORDS[kind]}: their gains "
                "are estimated with the model's inertias, unless given by --gain "
                f"JOINT=VALUE{_CONSTANT if kind == 'current' else ''}"
            )
    commanded = [name.rpartition(".")[0] for name in groups["command"]]
    if bare := [joint for joint in commanded if f"{joint}.effort" not in sources]:
        yield (
            f"no efforts of {listed(bare)}: their servo commands are used, with gains that "
            "are estimated with the model's inertias"
        )


def _span(meanings: Sequence[Meaning]) -> str:
    """Return the first and last column of each style as text."""
    styles: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for meaning in meanings:
        styles[meaning.style].append(meaning.column)
    return ", ".join(
        names[0] if len(names) == 1 else f"{names[0]} … {names[-1]}" for names in styles.values()
    )


_FEW_WORDS, _LONGEST_WORD = 3, 40  # text columns in a message, and characters of each
_WORDS_ADVICE = (
    "If the table has one row for each value, pivot it to a column for each quantity of "
    "each joint (DataFrame.pivot), or write JSON records to a .jsonl file. "
)
_MAPPING_ADVICE = "Or map the columns with --mapping."


def columns_of(
    table: LogTable, joints: Sequence[str] | None, reading: Reading, *, partial: bool = False
) -> Columns:
    """Assign the columns of a table; see `read_log` for the arguments."""
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
                if not is_mapped:  # `temps` may be read as temperatures
                    columns = _by_names(table, joints, reading, clock=clock.column)
                places = {("", "time"): clock, **columns.places}
            if is_sure:
                columns.places = places
                columns.notes.append(f"{words}, so it is taken as time")
        if columns.rate is None and ("", "time") not in columns.places:
            question = ": is it time? A mapping can state its unit. "
            reasons = [] if names else [f"; {n!r} {why}" for n, why in table.silent.items()]
            silent = "".join(reasons[:_FEW_WORDS])
            raise LogError(
                f"Log {str(path)!r} has no column 'time'; it has {listed(names)}{silent}.",
                advice=f"{words}{question if clock else ''}{HEADER_ADVICE} "
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
    """Return the column that is probably time, a description, and whether it is certain.

    It is certain if the column increases evenly and is named like a clock, increases and is named
    like a unit such as ms, or is the first one and increases evenly by fractional steps.
    """
    parsed = {name: meaning_of(name) for name in table.names[:_MOST_CLOCKS]}
    temps = {n for n, m in parsed.items() if m and m.is_bare and m.quantity == "temperature"}
    others = [n for n, m in parsed.items() if m is None or m.quantity == PART or n in temps]
    with suppress(LogError):  # cells that are not numbers
        for name, values in table.read(others, skip=True)[0].items():
            steps = np.diff(values)
            step = float(np.median(steps)) if len(steps) else 0.0
            even = np.abs(steps - step) <= 0.5 * step
            is_called, part = bool(_CLOCKS & plain_words(name)), parsed[name]
            units = [find_unit(word, "time") for word in plain_words(name)]
            unit = next((u for u in units if u is not None and u.factor < 1.0), None)  # as ms
            unit = part.unit if part is not None and part.quantity == PART else unit
            is_unit = unit is not None and float((steps > 0.0).mean()) > _FORWARD
            counts = step == 1.0 and not (is_called or is_unit)  # row numbers
            if step > 0.0 and not counts and (is_unit or float(even.mean()) > _EVEN):
                words = f"{name!r} increases by {step:.4g} from row to row"
                is_first = name == table.names[0] or name.startswith("__index_level")
                is_sure = is_called or is_unit or (is_first and step % 1.0 != 0.0)
                unit = unit or find_unit(name, "time")
                return Meaning(name, "time", unit=unit), words, is_sure
    close = difflib.get_close_matches("time", [name.lower() for name in table.names[:100]], 1)
    return None, f"Is it {close[0]!r}? " if close else "", False


def _steady_rate(table: LogTable) -> tuple[float, str] | None:
    """Return the sampling rate from a constant column of rates or periods, and its name."""
    names = [name for name in table.names if rate_in(name, 0.01) or rate_in(name, 100.0)]
    for name, values in table.read(names, skip=True)[0].items() if names else ():
        finite = values[np.isfinite(values)]
        rate = rate_in(name, float(finite[0])) if len(finite) else None
        if rate is not None and (finite == finite[0]).all():
            return rate, name
    return None


def _by_names(
    table: LogTable, joints: Sequence[str] | None, reading: Reading, *, clock: str = ""
) -> Columns:
    """Assign columns by their names, except `clock`."""
    path, units = table.path, table.units
    columns = [name for name in table.names if name != clock and floating_meaning(name) is None]
    parsed, texts = joint_columns(columns, joints or ()), []
    if joints and not any(m.quantity == "position" and m.role < OTHER for m in parsed):
        bare = as_positions(columns, joints)
        texts = [f"position: {_span(bare)} taken, as they are named like joints"] if bare else []
        parsed += bare
    states = [*state_columns(table, columns, parsed, reading)] if joints else []
    parsed = [*states, *(m for m in parsed if m.column not in {each.column for each in states})]
    assumed = [f"taken as states and inputs, in the model's order: {_span(states)}"] * bool(states)
    terms = [words for words in map(plain_words, reading.topics) if words]
    parsed = [m for m in parsed if any(words <= plain_words(m.column) for words in terms)] or parsed
    parsed, spare_texts = _without_spare(table, parsed, joints)
    texts += spare_texts
    of_joints = _with_targets(table, parsed)
    if joints and len(joints) > 1 and all(meaning.is_bare for meaning in of_joints):
        title = log_name(path)  # the file name may name the joint
        of_title = words_of(title)
        named = [replace(m, joint=title, words=of_title) for m in of_joints]
        # A number may be that of the first joint, or that of `wrist_1`.
        is_name = any(isinstance(w, str) for w in of_title) or of_title in map(words_of, joints)
        is_known = is_name and {*matched(named, joints)[0].values()} <= {*joints}
        of_joints = named if is_known else of_joints
    links, words = reading.links, "columns are named like links: those of the joints that move them"
    if joints and set() < {m.joint for m in of_joints if m.joint} <= links.keys() - {*joints}:
        moved = {link: (joint, words_of(joint)) for link, joint in links.items()} | {"": ("", ())}
        pairs = [(m, moved[m.joint]) for m in of_joints]
        of_joints = [replace(m, joint=j, words=w) if j else m for m, (j, w) in pairs]
        assumed.append(words)
    joint_of, notes = matched(of_joints, joints)
    best, others = candidates(of_joints, joint_of, reading)
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
    native = frozenset(m.joint for m in of_joints if m.style[0] == "own")
    assumed += notes
    texts, rate = [*texts, *assumed, *choice_words(best)], reading.rate
    unknown = {k: s.unit.name for k, s in places.items() if s.unit and np.isnan(s.unit.factor)}
    if unknown:
        lost, names = listed([places[k].column for k in unknown]), dict.fromkeys(unknown.values())
        texts.append(f"not used, as the scale of {', '.join(names)} is unknown: {lost}")
    places = {key: source for key, source in places.items() if key not in unknown}
    if rate is None and time is None and (stated := table.rate or _steady_rate(table)):
        rate, name = stated
        texts.append(f"{rate:.6g} Hz, from {name!r} in the file")
    given = (path, reading, places, texts, rate, native, others)
    return Columns(*given, assumed=tuple(assumed))


_MEASURED, _COMMANDED = "m", "c"  # as in q_m and q_c


def _check_one_robot(path: Path, best: Best) -> None:
    """Raise if every joint has two columns whose names differ by a word that separates robots."""
    differences = dict[str, set[frozenset[str]]]()
    for (_, quantity), options in best.items():
        first, second = options[0], options[min(1, len(options) - 1)]
        words = ({*map(str, words_of(m.column))} for m in (first, second))
        difference = set.symmetric_difference(*words) if first.role == second.role else set()
        differences.setdefault(quantity, set()).add(frozenset(difference))
    word_sets = differences.get("position", set()) | differences.get("effort", set())
    if any(words and PAIRS.issuperset(words) for words in word_sets):
        word_sets.discard(frozenset())  # quantities that only one robot has
    robots = sorted(next(iter(word_sets), ()), key=lambda word: (word != _MEASURED, word))
    if len(word_sets) == 1 and len(robots) == 2:
        hint = f" (probably measured, as {_COMMANDED} are commanded)"
        raise LogError(
            f"Log {str(path)!r} has each joint twice: of {robots[0]} and of {robots[1]}.",
            advice=f"Choose one: --topic {robots[0]}{hint * (robots == [_MEASURED, _COMMANDED])}.",
        )


def _check_units(table: LogTable, places: Mapping[tuple[str, str], Meaning]) -> None:
    """Raise for unknown units, if the table also has known ones.

    Brackets in the names of columns may mean something else, unless several joints have them.
    """
    stated = {n: unit for n in table.names if (unit := bracketed(n))} | {**table.units}
    known = {unit for unit in {*stated.values()} if any(find_unit(unit, each) for each in UNITS)}
    odd = {n for n, unit in stated.items() if known and (unit in known or is_unknown_word(unit))}
    unresolved = [
        s for s in places.values() if s.unit is None and s.column in odd and s.quantity in UNITS
    ]
    counts = Counter((source.quantity, stated[source.column]) for source in unresolved)
    for source in unresolved:
        unit = stated[source.column]
        if counts[source.quantity, unit] > 1 or source.column in table.units:
            raise LogError(
                f"Column {source.column!r} of log {str(table.path)!r} is in {unit!r}, which is no "
                f"known unit of {source.quantity}.",
                advice=f"Give it, as in --units {source.quantity}=UNIT. "
                f"{unit_advice(source.quantity)}",
            )


def _without_spare(
    table: LogTable, parsed: list[Meaning], joints: Sequence[str] | None
) -> tuple[list[Meaning], list[str]]:
    """Drop numbered columns beyond the last nonzero one if they outnumber the model's joints.

    Controllers also log motor channels that are not connected. Returns a note on them too.
    """
    numbers = {m.column: m.number for m in parsed if m.number is not None}
    if not joints or len({*numbers.values()}) <= len(joints):
        return parsed, []
    names = [name for name in numbers if table.has_numbers(name)]
    nonzero = [numbers[n] for n, values in table.read(names, skip=True)[0].items() if values.any()]
    spare = [name for name, number in numbers.items() if nonzero and number > max(nonzero)]
    note = f"zero throughout, so without a motor: {', '.join(spare[:1])} …"
    return [m for m in parsed if m.column not in spare], [note] * bool(spare)


_TARGET = "tq"  # torques, or position targets


def _with_targets(table: LogTable, meanings: Sequence[Meaning]) -> list[Meaning]:
    """Treat columns named `tq` as position targets if the positions follow them."""
    places = {m.words: m.column for m in meanings if m.quantity == "position" and m.role < DESIRED}
    doubtful = [m for m in meanings if m.words in places and _TARGET in plain_words(m.column)]
    names = [name for m in doubtful for name in (m.column, places[m.words])]
    numbers, _ = table.read(list(dict.fromkeys(names)), skip=True) if names else ({}, None)
    targets = set[str]()
    for meaning in doubtful:
        place, target = numbers[places[meaning.words]], numbers[meaning.column]
        targets |= {meaning.column} if follows(place, target) else set()
    return [
        replace(m, quantity="position", role=DESIRED, style=(_TARGET,), is_wanted=True)
        if m.column in targets
        else m
        for m in meanings
    ]


def _by_mapping(table: LogTable, reading: Reading) -> Columns:
    """Assign columns by a mapping."""
    places, path, names = dict[tuple[str, str], Meaning](), table.path, table.names
    mapping, floating = reading.mapping or ColumnMapping({}), dict[str, Meaning]()
    for name, mapped in mapping:
        if name.endswith(".effort") and mapped.column == PASSIVE and PASSIVE not in names:
            places[name.removesuffix(".effort"), PASSIVE] = Meaning(PASSIVE, PASSIVE)
            continue
        if is_of_base := name in mapping.base:
            column = mapped.among(table.counted)
            meaning = floating[name] = mapped_meaning(name, column, mapped.unit, mapped.gain)
        else:
            meaning = _mapped(name, mapped, table, reading)
        if meaning.column not in names:
            raise LogError(
                f"Log {str(path)!r} has no column {meaning.column!r}, which {mapping.source} maps "
                f"to {name!r}; it has {listed(names)}.",
                advice="Correct the mapping.",
            )
        if not is_of_base:
            joint = meaning.joint
            places[joint, meaning.log_quantity] = settled(path, meaning, joint, reading, {})
    mapping = mapping.named(table.counted)  # raises for a column that is used twice
    if mapping.time is not None and (time := time_source(table, reading)) is not None:
        places["", "time"] = time
    for joint in [joint for joint, quantity in places if quantity == "command"]:
        if reading.kind_of(joint) == "command":  # instead of efforts
            places.pop((joint, "effort"), None)
    rate = reading.rate or mapping.rate
    own = frozenset(mapping.joints)
    return Columns(path, reading, places, [], rate, own, floating=floating)


@dataclass
class Columns:
    """The quantities and joints of the columns of a file, and how they are read."""

    path: Path
    reading: Reading  # options of the user
    # (joint, quantity) -> column, in file order; time is `("", "time")`.
    places: dict[tuple[str, str], Meaning]
    notes: list[str]
    rate: float | None  # sampling rate (Hz) if there is no column of time
    own: frozenset[str]  # joints in geodrake's own format, which are not dropped unless `partial`
    # Joint -> alternative columns for its efforts.
    others: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    origin: int | None = None  # time zero in ns since 1970, if known
    joints: tuple[str, ...] = ()  # n names, in the order of the resulting log
    standing: tuple[str, ...] = ()  # joints with positions only
    # Quantities of every joint, and those that some joints may lack, such as efforts.
    quantities: tuple[str, ...] = ()
    passive: tuple[str, ...] = ()  # joints without a motor, which need no efforts
    # Name -> column of a floating base or of contacts.
    floating: dict[str, Meaning] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()  # joints of the file that the log does not use
    assumed: tuple[str, ...] = ()  # notes on joints that columns do not name

    @property
    def sources(self) -> dict[str, Meaning]:
        """`time`, `<joint>.<quantity>` and names of a floating base -> column."""
        named = {q if q == "time" else f"{joint}.{q}": s for (joint, q), s in self.places.items()}
        return named | self.floating

    @property
    def kinds(self) -> dict[str, str]:
        """Joint -> kind of signal that replaces its efforts, if any."""
        efforts = {joint: self.places.get((joint, "effort")) for joint in self.joints}
        kinds = {joint: source.quantity for joint, source in efforts.items() if source is not None}
        kinds |= dict.fromkeys(self.passive, PASSIVE)
        return {joint: kind for joint, kind in kinds.items() if kind != "effort"}

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the columns that are read."""
        return tuple(dict.fromkeys(c for source in self.sources.values() for c in source.columns))

    def date(self, table: LogTable) -> None:
        """Determine the date at which time is zero.

        Given a rate, time is dropped. Commands without a unit take that of positions.
        """
        if self.rate is not None:
            self.places.pop(("", "time"), None)
        for (joint, quantity), source in self.places.items():
            position = self.places.get((joint, "position")) if quantity == "command" else None
            if position is not None and source.unit is None and source.factor == 1.0:
                converted = replace(source, unit=position.unit, gain=position.gain)
                self.places[joint, quantity] = converted
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
        """Drop the columns of an optional quantity, with a note."""
        self.quantities = tuple(other for other in self.quantities if other != quantity)
        self.places = {place: s for place, s in self.places.items() if place[1] != quantity}
        self.notes.append(f"{quantity} is not used, as {why}")

    def choose(self, table: LogTable, wanted: Sequence[str] | None, *, partial: bool) -> None:
        """Choose the joints of the log, and those with positions only."""
        path, positioned = table.path, self._of_model(self.having("position"), wanted)
        efforts = self.having("effort", "command")
        driven = {*efforts, *self._without_motor(positioned)}
        floating = [*self.floating]
        floating += [each.quantity for n in table.names if (each := floating_meaning(n))]
        if self.reading.of_base and any(n.startswith(("base.", "imu.")) for n in floating):
            driven |= {*positioned}  # contact forces replace efforts
        undriven = [joint for joint in positioned if joint not in driven]
        if len(undriven) == len(positioned):
            texts = {} if positioned or efforts else table.first_words
            words = [f"; {n!r} holds {cell[:_LONGEST_WORD]!r}" for n, cell in texts.items()]
            known = {source.column for source in self.places.values()}
            others = [name for name in table.names if name not in known]
            words = words or [f"; other columns: {listed(others)}"]
            advice = _WORDS_ADVICE if texts else ""
            advice += f"{HEADER_ADVICE} {SIGNAL_ADVICE} {_MAPPING_ADVICE}"
            if self.reading.mapping is not None:
                advice = f"Fill in {self.reading.mapping.source}."
            raise LogError(
                f"Log {str(path)!r} has no joint with both position and effort; positions: "
                f"{listed(positioned)}; efforts: {listed(efforts)}{''.join(words[:_FEW_WORDS])}.",
                advice=advice,
            )
        position_only = tuple(j for j in undriven if j in self.own or j in (wanted or ()))
        if position_only and not partial:
            raise LogError(
                f"Log {str(path)!r} has positions but no efforts of {', '.join(position_only)}.",
                advice=f"Log their efforts too, or remove their columns. {SIGNAL_ADVICE}",
            )
        names = tuple(joint for joint in positioned if joint in driven)
        if names == (ONLY,) and wanted and len(wanted) > 1 and ONLY not in wanted:
            raise LogError(
                f"Log {str(path)!r} has columns of one joint without its name.",
                advice=f"Name the columns or the file after one of {listed(wanted)}, as in "
                f"{wanted[0]}.position. Write tables of several joints to a file each, and "
                f"join them as {wanted[0]}.csv+{wanted[1]}.csv. {_MAPPING_ADVICE}",
            )
        are_numbered = wanted is not None and all(map(NUMBERED.fullmatch, names))
        are_others = are_numbered and not {*names}.intersection(wanted or ())
        in_order = {} if wanted is None else self._counted_otherwise(wanted)
        if wanted is not None and (are_others or in_order):
            names = tuple(self.having("position"))
            if in_order:  # for the proposed mapping
                kept = {(in_order[j], q): s for (j, q), s in self.places.items() if j in in_order}
                self.places.clear()
                self.places |= kept
            raise LogError(
                f"Log {str(path)!r} has {len(names)} joints by numbers, but the model has "
                f"{len(wanted)}: {listed(wanted)}.",
                advice="Say in a mapping which is which.",
            )
        if wanted is not None:
            check_joints(log_name(path), [*names, *position_only], wanted, partial=partial)
            names = tuple(joint for joint in wanted if joint in names)
        self.joints, self.standing, self.passive = names, position_only, self._without_motor(names)
        unused = [j for j in self.having("position") if j not in (*names, *position_only)]
        self.left_out = tuple(unused) if wanted is not None else ()

    def _counted_otherwise(self, wanted: Sequence[str]) -> dict[str, str]:
        """Return the joints in the order of columns if these count from 0 and joints from 1.

        Or if these count from 1 and joints from 0; it is empty otherwise. Both are only noticed if
        there are more columns than joints, as equal numbers are then of different joints.
        """
        sources = {joint: self.places[joint, "position"] for joint in self.having("position")}
        numbers = {j: s.number for j, s in sources.items() if s.style[:1] not in (MAPPED, ("own",))}
        counts = {j: number for j, number in numbers.items() if number is not None}
        shared = [number for joint, number in counts.items() if joint in wanted]
        extra = [number for joint, number in counts.items() if joint not in wanted]
        lacking = (number_of(joint) for joint in wanted if joint not in sources)
        first = min(shared, default=0)
        before = [number for number in (*extra, *lacking) if number is not None and number < first]
        if not (shared and extra and before):
            return {}
        by_number = sorted(counts, key=lambda joint: counts[joint])
        return {"": "", **dict(zip(by_number, wanted, strict=False))}

    def keep_used(self, names: Sequence[str]) -> None:
        """Keep only the columns that are read, with notes on the others."""
        joints, reading, used = self.joints, self.reading, {*self.files}
        for quantity in QUANTITIES:
            missing = [f"{j}.{quantity}" for j in joints if (j, quantity) not in self.places]
            is_partial = len(missing) < len(joints) and quantity in PARTIAL
            if not missing or is_partial or quantity == "effort":
                self.quantities += (quantity,)
            elif len(missing) < len(joints):
                self.notes.append(f"{quantity} is not used: there is none of {listed(missing)}")
        if undriven := [joint for joint in self.passive if joint not in reading.motorless]:
            self.notes.append(f"no motor at {listed(undriven)}: its effort is zero")
        items, kept = self.places.items(), (*joints, *self.standing)
        of_joints = {p: source for p, source in items if p[1] == "time" or p[0] in kept}
        self.places = {
            (joint, what): source
            for (joint, what), source in of_joints.items()
            if what in (("position",) if joint in self.standing else ("time", *self.quantities))
        }
        for joint, gain in reading.gains.items():  # which convert signals to efforts
            if (signal := self.places.get((joint, "effort"))) is not None:
                effort = replace(signal, gain=gain * signal.gain, quantity="effort")
                self.places[joint, "effort"] = effort
        for name in names:
            if name not in used and (meaning := floating_meaning(name)) is not None:
                self.floating.setdefault(meaning.quantity, meaning)
        axes = numbered_axes(self.floating)
        self.floating = {axes.get(name, name): source for name, source in self.floating.items()}
        self.notes += unit_words(self.sources, reading)
        recognized = {c for source in of_joints.values() for c in source.columns}
        if ignored := [n for n in names if n and n not in {*self.files, *recognized}]:
            self.notes.append(f"columns ignored: {listed(ignored)}")

    def _of_model(self, joints: Sequence[str], wanted: Sequence[str] | None) -> tuple[str, ...]:
        """Drop the joints that the model lacks, unless it has none of the log's joints.

        A name close to that of a missing joint is kept, as a probable misspelling.
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
        driven, declared = self.having("effort", "command"), self.having(PASSIVE)
        says = bool(driven) or not self.reading.of_base  # otherwise no efforts were measured
        return tuple(
            joint
            for joint in joints
            if joint in declared
            or self.reading.kinds.get(joint) == PASSIVE
            or (joint in self.reading.motorless and joint not in driven and says)
        )

    def having(self, *quantities: str) -> list[str]:
        """Return the joints with any of some quantities, in file order."""
        return list(dict.fromkeys(joint for joint, other in self.places if other in quantities))

    def check_said(self) -> None:
        """Raise if gains, kinds or motors are given for joints without a matching column."""
        motors = [joint for joint in self.reading.motors if joint]
        settings = [(joint, "") for joint in self.reading.gains]
        settings += [(joint, kind) for joint, kind in self.reading.kinds.items() if joint]
        if self.reading.kinds.get("") == "command" and not self.having("command"):
            self.notes.append("no servo commands were logged, so --kind command has no effect")
        for joint, kind in [*((joint, "motor") for joint in motors), *settings]:
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
    """Return the meaning of a column mapped to `time` or `<joint>.<quantity>`."""
    joint, _, quantity = name.rpartition(".")
    text = column.unit or reading.units.get(quantity)
    unit = unit_of(text, quantity) if text else None
    column_name = column.among(table.counted)
    return Meaning(column_name, quantity, joint, unit=unit, style=MAPPED, gain=column.gain)


def time_source(table: LogTable, reading: Reading) -> Meaning | None:
    """Return the column of time, with the column of fractions of a second if there is one."""
    mapped = reading.mapping.time if reading.mapping else None
    if mapped is not None and mapped.among(table.counted) in table.names:
        source = _mapped("time", mapped, table, reading)
    else:
        times = [m for m in meanings_of(table.names) if m.quantity == "time"]
        times = [m for m in times if table.has_numbers(m.column)] or times
        times = times or [Meaning(n, "time") for n in table.origins if table.is_time(n)]
        if not times:
            return None
        first = min(times, key=lambda meaning: meaning.role)
        source = settled(table.path, first, "", reading, table.units)
    if source.column in table.origins:  # dates are in seconds, regardless of the name
        source = Meaning(source.column, "time", unit=unit_of("s", "time"))
    main, others = meaning_of(source.column), filter(None, map(meaning_of, table.names))
    parts = (m for m in others if m.quantity == PART and main is not None and m.style == main.style)
    return replace(source, beside=next(parts, None)) if source.factor == 1.0 else source
