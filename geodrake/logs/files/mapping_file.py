"""Mapping files of log columns: reading, and drafts for unknown names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import yaml  # type: ignore[import-untyped]

from geodrake.boundary.arguments import positive, typed
from geodrake.boundary.yaml_schema import Schema, as_schema
from geodrake.boundary.yaml_text import yaml_content
from geodrake.errors import ArgumentError, LogError
from geodrake.logs.files.name_rules import DESIRED, OF_JOINTS, Meaning, matched, meanings_of
from geodrake.logs.files.reading import (
    ColumnMapping,
    MappedColumn,
    Reading,
    check_gain,
    parsed_gain,
)
from geodrake.logs.files.units import unit_names, unit_of
from geodrake.logs.motion import EFFORT_KINDS, PASSIVE

MOST_COLUMNS = 500  # of a file for which a mapping is proposed
_ASKED = ("position", "velocity", "effort")
_FORM = (
    "Write `time: COLUMN` or `rate: HZ`, and `joints:`, each with `position:` and `effort:` "
    "(or `current:`, `voltage:`, `pwm:`, `command:`; `effort: passive` without a motor) and "
    "the name or number of a column, or {column: NAME, unit: deg, gain: 1.0}."
)


@typed
def read_mapping(path: Path) -> ColumnMapping:
    """Read a mapping file.

    Raises:
        LogError: It cannot be read, has other keys or kinds of values, names a column twice, or
            a unit that is not known.
    """
    content = yaml_content(path, "mapping", LogError, advice=_FORM)
    try:
        return mapping_of(path, content)
    except ArgumentError as error:
        advice = error.advice or _FORM
        raise LogError(f"Mapping {path}: {error.problem}", advice=advice) from error


class _ColumnSchema(Schema):
    """A column as the file has it; see `MappedColumn`."""

    column: str | int
    unit: str | None = None
    gain: float | str = 1.0


_Column = str | int | _ColumnSchema | None


_QUANTITIES = [quantity for quantity in OF_JOINTS if quantity != PASSIVE]
_JointSchema: Any = msgspec.defstruct(
    "_JointSchema", [(quantity, _Column, None) for quantity in _QUANTITIES], bases=(Schema,)
)
"""Columns of a joint as the file has them."""


class _MappingSchema(Schema):
    """The content of a mapping file."""

    joints: dict[str | int, _JointSchema]
    time: _Column = None
    rate: float | None = None


def mapping_of(path: Path, content: object) -> ColumnMapping:
    """Return the mapping in the content of a file; see `read_mapping`."""
    said = as_schema(content, _MappingSchema)
    joints = {
        str(joint): {
            quantity: _column(column, quantity, f"{joint}.{quantity}")
            for quantity in _QUANTITIES
            if (column := getattr(columns, quantity)) is not None
        }
        for joint, columns in said.joints.items()
    }
    if said.rate is not None:
        positive(said.rate, "`rate`")
    if not joints:
        raise ArgumentError("`joints` is empty.", advice=_FORM)
    time = None if said.time is None else _column(said.time, "time", "time")
    mapping = ColumnMapping(joints, time, said.rate, f"mapping {path}")
    _check_once(mapping)
    if said.time is None and said.rate is None:
        raise ArgumentError("it has neither `time` nor `rate`.", advice=_FORM)
    return mapping


def _column(said: str | int | _ColumnSchema, quantity: str, what: str) -> MappedColumn:
    said = said if isinstance(said, _ColumnSchema) else _ColumnSchema(said)
    if said.unit is not None:
        unit_of(said.unit, quantity)
    gain, deviation = said.gain, None
    if isinstance(gain, str):
        gain, deviation = parsed_gain(gain, f"the gain of {what!r}")
    check_gain(gain, f"the gain of {what!r}", deviation)
    if deviation is not None and quantity != "effort":
        raise ArgumentError(
            f"the gain of {what!r} has a deviation, which only gains of efforts may have.",
            advice="Write it under `effort:`.",
        )
    return MappedColumn(said.column, said.unit, float(gain), deviation)


def _check_once(mapping: ColumnMapping) -> None:
    seen: dict[str | int, str] = {}
    for name, mapped in mapping:
        if mapped.column == PASSIVE:
            continue
        if mapped.column in seen:
            raise ArgumentError(
                f"it uses column {mapped.column!r} twice, for {seen[mapped.column]!r} and "
                f"for {name!r}.",
                advice="Each column can have only one meaning.",
            )
        seen[mapped.column] = name


def propose(
    error: LogError,
    path: Path,
    names: Sequence[str],
    joints: Sequence[str] | None,
    reading: Reading,
    *,
    headed: bool = True,
    clock: str = "",
) -> LogError:
    """Return the error of a failed reading, with a mapping as evidence.

    It is text to edit, filled in as far as column names are understood. There is none where the
    user gave one, and for files with too many columns.

    Args:
        headed: Whether the file has these names; columns of others are given by their numbers.
        clock: The column that may be time by its values, where no name says it.
    """
    if reading.mapping is not None or len(names) > MOST_COLUMNS:
        return error
    meanings = meanings_of(names if headed else ())
    times = sorted((m for m in meanings if m.quantity == "time"), key=lambda m: m.role)
    of_joints = sorted((m for m in meanings if m.quantity in OF_JOINTS), key=lambda m: m.role)
    found, _ = matched(of_joints, joints)
    named, _ = matched(of_joints, None)
    positions = (m.column for m in meanings if m.quantity == "position" and m.column in named)
    called = list(dict.fromkeys(named[column] for column in positions))
    known = set(found.values()).intersection(joints or ())
    by_order = joints is not None and not known and len(called) == len(joints)
    if by_order:
        model = dict(zip(called, joints or (), strict=True))
        found = {column: model[joint] for column, joint in named.items() if joint in model}
    places = {(found[m.column], m.quantity): m for m in reversed(of_joints) if m.column in found}
    own = joints or list(dict.fromkeys(found.values())) or ["JOINT"]
    guessed = {} if meanings else _guess(names, own, headed=headed)
    listed = "\n".join(f"#   {k}: {_word(name)}" for k, name in enumerate(names, 1))
    lines = [_HEAD.format(name=path.name, columns=listed, units=unit_names())]
    if by_order:
        pairs = (f"{joint} is {name!r}" for name, joint in model.items())
        lines += [f"# Guessed from the order of the joints, please check: {', '.join(pairs)}."]
    if guessed:
        lines += ["# Guessed from the number of columns, please check:"]
    columns: dict[str, dict[str, MappedColumn]] = {}
    for joint in own:
        effort = places.get((joint, "effort"))
        if joint in reading.motorless and (effort is None or effort.role >= DESIRED):
            guessed[joint, "effort"] = MappedColumn(PASSIVE)
        kinds = [kind for kind in (*EFFORT_KINDS, "command") if (joint, kind) in places]
        columns[joint] = {
            quantity: guessed.get((joint, quantity), _column_of(places.get((joint, quantity))))
            for quantity in ("position", "velocity", kinds[0] if kinds else "effort")
        }
    time = guessed.get(("", "time"), MappedColumn(times[0].column if times else clock))
    first, *others = mapping_lines(ColumnMapping(columns, time))
    lines += [first, "# rate: 500  # Hz, instead of time", *others, ""]
    error.evidence |= {"path": path, "proposal": "\n".join(lines)}
    return error


_HEAD = """\
# How geodrake is to read {name!r}: edit this, and give it by --mapping.
# Columns are given by name, or by number from 1 on. Its columns are:
{columns}
# Units: {units}.
# Without efforts, write current:, voltage:, pwm: or command: in their place;
# of a joint without a motor, effort: passive.
# gain: such as torque constant times gear ratio, for motor currents.
"""
_UNKNOWN = MappedColumn("")
"""Placeholder for a column that the user has to fill in."""


def mapping_lines(mapping: ColumnMapping) -> list[str]:
    """Return a mapping as lines of YAML."""
    time = mapping.time
    lines = [f"rate: {mapping.rate}" if time is None else f"time: {_written(time)}", "joints:"]
    for joint, columns in mapping.joints.items():
        lines.append(f"  {_word(joint)}:")
        lines += [f"    {quantity}: {_written(column)}" for quantity, column in columns.items()]
    return lines


def _written(mapped: MappedColumn) -> str:
    if mapped == _UNKNOWN:
        return "  # which column?"
    column = mapped.column if isinstance(mapped.column, int) else _word(mapped.column)
    fields = [f"unit: {_word(mapped.unit)}"] if mapped.unit else []
    gain = f"{mapped.gain}" if mapped.deviation is None else f"{mapped.gain}±{mapped.deviation}"
    fields += [f"gain: {gain}"] if gain != "1.0" else []
    return f"{{column: {column}, {', '.join(fields)}}}" if fields else str(column)


def _guess(
    names: Sequence[str], joints: Sequence[str], *, headed: bool
) -> dict[tuple[str, str], MappedColumn]:
    """Map (joint, quantity) to columns, if their number is that of time and all quantities."""
    for timed in (True, False):
        for quantities in (_ASKED, ("position", "effort")):
            if len(names) == timed + len(joints) * len(quantities):
                order = [("", "time")] * timed + [(j, q) for q in quantities for j in joints]
                columns = [MappedColumn(n if headed else k) for k, n in enumerate(names, 1)]
                return dict(zip(order, columns, strict=True))
    return {}


def _column_of(meaning: Meaning | None) -> MappedColumn:
    unit = meaning.unit.name if meaning and meaning.unit else None
    return MappedColumn(meaning.column, unit) if meaning else _UNKNOWN


def _word(text: str) -> str:
    """Return a text as one scalar of YAML, also within braces."""
    words = yaml.safe_dump([text], default_flow_style=True, allow_unicode=True, width=1e9)
    return str(words.strip()[1:-1])
