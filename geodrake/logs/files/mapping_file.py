"""Mapping files of log columns: reading, and drafts for unknown names."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import yaml  # type: ignore[import-untyped]

from geodrake.boundary.arguments import positive, typed
from geodrake.boundary.yaml_schema import Schema, as_schema
from geodrake.boundary.yaml_text import yaml_content
from geodrake.errors import ArgumentError, LogError
from geodrake.logs.files.name_rules import DESIRED, NUMBERED, OF_JOINTS, Meaning
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
    """Read a mapping file, in which no column may come twice."""
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
    joints = dict[str, dict[str, MappedColumn]]()
    for joint, columns in said.joints.items():
        named = {q: each for q in _QUANTITIES if (each := getattr(columns, q)) is not None}
        joints[str(joint)] = {q: _column(each, q, f"{joint}.{q}") for q, each in named.items()}
    if said.rate is not None:
        positive(said.rate, "`rate`")
    if not joints:
        raise ArgumentError("`joints` is empty.", advice=_FORM)
    time = None if said.time is None else _column(said.time, "time", "time")
    if said.time is None and said.rate is None:
        raise ArgumentError("it has neither `time` nor `rate`.", advice=_FORM)
    mapping = ColumnMapping(joints, time, said.rate, "it")  # errors here begin with the file
    return replace(mapping, source=f"mapping {path}")


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


def propose(
    error: LogError,
    path: Path,
    names: Sequence[str],
    *,
    places: Mapping[tuple[str, str], Meaning],
    joints: Sequence[str] | None,
    reading: Reading,
    headed: bool = True,
) -> LogError:
    """Return the error of a failed reading, with a mapping as evidence.

    The mapping is text to edit, filled in with the columns that are understood: those in `places`,
    time among them. It is left out if the user gave one, or the file has too many columns. Columns
    of files that are not `headed` by these names are given by their numbers.
    """
    if reading.mapping is not None or len(names) > MOST_COLUMNS:
        return error
    named = list(dict.fromkeys(joint for joint, _ in places if joint))
    called = [joint for joint in named if (joint, "position") in places] or named
    own = joints or named or ["JOINT"]
    if are_numbered := all(map(NUMBERED.fullmatch, called)):
        called.sort(key=lambda joint: int(joint.rpartition("_")[2]))
    is_by_order = not set(called).intersection(own) and (are_numbered or len(called) == len(own))
    model = dict(zip(called, own, strict=False)) if is_by_order else {}
    known = {(model.get(joint, joint), m.quantity): m for (joint, _), m in places.items()}
    units = {place: m.unit.name if m.unit else None for place, m in known.items()}
    found = {place: MappedColumn(m.column, units[place]) for place, m in known.items()}
    guessed = {} if called else _guess(names, own, headed=headed)
    if any(guessed.get(place) != column for place, column in found.items()):
        guessed = {}
    found |= guessed
    columns = dict[str, dict[str, MappedColumn | None]]()
    for joint in own:
        kind = next((k for k in (*EFFORT_KINDS, "command") if (joint, k) in found), "effort")
        columns[joint] = {q: found.get((joint, q)) for q in ("position", "velocity", kind)}
        if joint in reading.motorless and (kind == "effort" or known[joint, kind].role >= DESIRED):
            columns[joint] |= {kind: MappedColumn(PASSIVE)}
    scalars = (yaml.safe_dump([name], allow_unicode=True, width=math.inf) for name in names)
    listed = "\n".join(f"#   {k}: {str(each).strip()[2:]}" for k, each in enumerate(scalars, 1))
    text = _HEAD.format(name=path.name, columns=listed, units=unit_names())
    if model:
        pairs = ", ".join(f"{joint} is {name!r}" for name, joint in model.items())
        text += f"# Guessed from the order of the joints, please check: {pairs}.\n"
    if guessed:
        text += "# Guessed from the number of columns, please check:\n"
    text += mapping_yaml(columns, found.get(("", "time")), reading.rate)
    error.evidence |= {"path": path, "proposal": text}
    return error


_HEAD = """\
# How geodrake is to read {name!r}: edit this, and give it by --mapping.
# Columns are given by name, or by number from 1 on. Its columns are:
{columns}
# Units: {units}.
# Without efforts, write current:, voltage:, pwm: or command: in their place;
# of a joint without a motor, effort: passive. Without time, write rate: 500 (Hz).
# gain: such as torque constant times gear ratio, for motor currents.
"""


def mapping_yaml(
    joints: Mapping[str, Mapping[str, MappedColumn | None]],
    time: MappedColumn | None,
    rate: float | None,
) -> str:
    """Return a mapping as the text of a file; what is None is for the user to fill in."""
    clock = {"time": _said(time)} if rate is None else {"rate": rate}
    told = {j: {q: _said(column) for q, column in own.items()} for j, own in joints.items()}
    text = yaml.safe_dump(
        {**clock, "joints": told}, sort_keys=False, allow_unicode=True, width=math.inf
    )
    return str(text).replace(": null\n", ":  # which column?\n")


def _said(mapped: MappedColumn | None) -> object:
    """Return a column as it stands in a file."""
    if mapped is None:
        return None
    gain = mapped.gain if mapped.deviation is None else f"{mapped.gain}±{mapped.deviation}"
    more: dict[str, object] = {"unit": mapped.unit} if mapped.unit else {}
    more |= {"gain": gain} if gain != 1.0 else {}
    return {"column": mapped.column, **more} if more else mapped.column


def _guess(
    names: Sequence[str], joints: Sequence[str], *, headed: bool
) -> dict[tuple[str, str], MappedColumn]:
    """Map (joint, quantity) to columns, if their number is that of time and all quantities."""
    columns = [MappedColumn(name if headed else k) for k, name in enumerate(names, 1)]
    for timed, quantities in product((True, False), (_ASKED, ("position", "effort"))):
        order = [("", "time")] * timed + [(j, q) for q in quantities for j in joints]
        if len(names) == len(order):
            return dict(zip(order, columns, strict=True))
    return {}
