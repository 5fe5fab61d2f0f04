"""Columns of efforts and of what stands for them: currents, voltages, duty cycles and commands."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from geodrake.errors import LogError
from geodrake.logs.files.column_names import Columns, Source
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.recognition import DESIRED, Meaning
from geodrake.logs.files.units import Unit, find_unit, unit_of
from geodrake.logs.motion import EFFORT_KINDS, JointLog

Best = dict[tuple[str, str], list[Meaning]]

_STEADY = 0.2  # of its mean, by which the voltage of a supply may vary


def candidates(
    meanings: Sequence[Meaning], found: Mapping[str, str], reading: Reading
) -> tuple[Best, dict[str, tuple[str, ...]]]:
    """What may be each quantity of each joint, what is taken first.

    A joint with efforts of any kind has no command, unless one is called as geodrake itself does.

    Returns:
        (joint, quantity) -> columns; and joint -> further columns that could stand for efforts.
    """
    best: Best = defaultdict(list)
    for meaning in meanings:
        if meaning.column in found and meaning.column not in reading.ignored:
            best[found[meaning.column], meaning.log_quantity].append(meaning)
    others = {}
    for joint in dict.fromkeys(joint for joint, _ in best):
        said = reading.kind_of(joint)
        commands = [*best.pop((joint, "command"), ()), *_wanted(best.get((joint, "position"), ()))]
        efforts = best.get((joint, "effort"), [])
        efforts.sort(key=lambda meaning: _preference(meaning, said))
        others[joint] = (*(m.column for m in efforts[1:]), *(m.column for m in commands))
        if commands and said == "command":
            best.pop((joint, "effort"), None)
        if not commands or (best.get((joint, "effort")) and not any(map(_is_own, commands))):
            continue
        best[joint, "command"] = commands
        kept = [m for m in best.get((joint, "position"), ()) if m not in commands]
        if kept:
            best[joint, "position"] = kept
    for same in best.values():
        same.sort(key=lambda meaning: _preference(meaning, reading.kind_of(found[meaning.column])))
    return {key: same for key, same in best.items() if same}, others


def _wanted(positions: Sequence[Meaning]) -> list[Meaning]:
    """Desired positions beside measured ones."""
    wanted = [meaning for meaning in positions if meaning.is_wanted]
    return wanted if len(wanted) < len(positions) else []


def _is_own(meaning: Meaning) -> bool:
    return meaning.style[0] == "own"


def _preference(meaning: Meaning, said: str | None) -> tuple[bool, bool, bool, int, int]:
    """The least is taken, of several columns of one quantity of one joint."""
    if meaning.log_quantity != "effort":
        return False, not _is_own(meaning), False, 0, meaning.role
    kind = EFFORT_KINDS.index(meaning.quantity)
    other = said is not None and said != meaning.quantity
    return other, not _is_own(meaning), meaning.role >= DESIRED, kind, meaning.role


def effort_source(
    path: Path, meaning: Meaning, joint: str, reading: Reading, stated: str
) -> Source:
    """Where the efforts of a joint come from, and what they are.

    Raises:
        LogError: What the column is by its name, by the user and by its unit cannot all be.
    """
    said = reading.kind_of(joint)
    said = None if said == "command" else said
    named = meaning.unit or find_unit(stated, meaning.quantity) or find_unit(stated, "effort")
    units = reading.units
    asked = unit_of(units["effort"], "effort") if "effort" in units else None
    kind = meaning.quantity
    if kind == "effort" and (unit := asked or named) is not None:
        kind = unit.signal or kind
    if said in ("effort", kind) or (said is not None and meaning.quantity == "effort"):
        kind = str(said)
    elif joint in reading.kinds and said is not None:
        raise LogError(
            f"Column {meaning.column!r} of log {str(path)!r} is {meaning.quantity} by its name, "
            f"and {said} by --kind.",
            advice="Name another column by --mapping, or leave --kind out.",
            joint=joint,
        )
    unit = named
    if kind in units:
        unit = unit_of(units[kind], kind)
    elif asked is not None:
        is_meant = (asked.signal or "effort") == kind
        unit = asked if is_meant or (asked.signal and meaning.quantity == "effort") else named
    if kind != "effort" or joint not in reading.gains:
        check_kind(path, meaning.column, joint, kind, unit)
    return Source(meaning.column, unit.factor if unit else 1.0, unit, kind=kind)


def check_kind(path: Path, column: str, joint: str, kind: str, unit: Unit | None) -> None:
    """Refuse a unit that is not of the kind of efforts in a column.

    Args:
        unit: Its unit; None where nobody said one.

    Raises:
        LogError: They contradict each other.
    """
    if unit is not None and (unit.signal or "effort") != kind:
        raise LogError(
            f"Column {column!r} of log {str(path)!r} is to be the {kind} of {joint}, and is in "
            f"{unit.name}, a unit of {unit.signal or 'effort'}.",
            advice="Say what it is by --kind JOINT=KIND, or its unit by --units.",
            joint=joint,
        )


def without_use(log: JointLog, columns: Columns) -> frozenset[str]:
    """Columns that were taken for efforts and say nothing, where others may stand for them.

    They are empty, or they are the voltage of a supply, which hardly changes.
    """
    found = set()
    for at, joint in enumerate(log.joints):
        if not columns.others.get(joint) or not columns.has(joint, "effort"):
            continue
        values = log.effort[:, at]
        values = values[np.isfinite(values)]
        supplied = columns.kinds.get(joint) == "voltage" and len(values) > 0
        if not len(values) or (supplied and np.ptp(values) < _STEADY * abs(values.mean())):
            found.add(columns.sources[f"{joint}.effort"].column)
    return frozenset(found)
