"""Options for reading a log, and mapping files that assign its columns."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import yaml  # type: ignore[import-untyped]

from geodrake.boundary.arguments import (
    Array,
    file_path,
    instance,
    instances,
    integer,
    number,
    positive,
    typed,
)
from geodrake.boundary.yaml_schema import Schema, as_schema
from geodrake.boundary.yaml_text import made_of_yaml
from geodrake.errors import ArgumentError, LogError, nearest
from geodrake.logs.files.base_names import mapped_meaning
from geodrake.logs.files.name_rules import DESIRED, NUMBERED, OF_JOINTS, Meaning
from geodrake.logs.files.units import unit_names, unit_of
from geodrake.logs.motion import EFFORT_KINDS, PASSIVE, USUAL_GAIN_DEVIATION
from geodrake.logs.motors import Motor

KINDS = (*EFFORT_KINDS, "command")
"""Kinds of efforts; commands may replace measured ones."""

_GAIN_FORM = "Write 13.2, or 13.2±0.5 with its standard deviation."


@dataclass(frozen=True)
class MappedColumn:
    """A column of a mapping."""

    column: str | int  # name or number, from 1, of the column in the file
    unit: str | None = None  # None: from the column name, or SI
    # Factor in addition to the unit: to N·m for an effort, to A for a current.
    gain: float = 1.0
    deviation: float | None = None  # standard deviation of the gain, if known

    def among(self, names: Sequence[str]) -> str:
        """Return the name of the column, which may be given by number.

        A list of one number may be named like its item.
        """
        name, number = str(self.column), self.column if isinstance(self.column, int) else 0
        if name not in names and (list_name := name.removesuffix("[0]")) in names:
            return list_name
        return names[number - 1] if 0 < number <= len(names) and name not in names else name


@dataclass(frozen=True)
class ColumnMapping:
    """Assignment of the columns of a file to quantities of joints."""

    # Joint -> quantity -> column; quantities are those of a log, and the kinds of effort.
    joints: Mapping[str, Mapping[str, MappedColumn]]
    time: MappedColumn | None = None  # None if a rate is given
    rate: float | None = None  # sampling rate (Hz), if there is no time
    source: str = "the mapping"  # name of the mapping in messages
    # Name of a quantity of a free base or its feet, as in `geodrake.logs.floating` -> column.
    base: Mapping[str, MappedColumn] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for joint, quantities in self.joints.items():
            kinds = [kind for kind in EFFORT_KINDS if kind in quantities]
            if len(kinds) > 1:
                raise ArgumentError(
                    f"{self.source} has {' and '.join(kinds)} of {joint!r}, but only one can "
                    "replace its efforts.",
                    advice=f"Remove {' and '.join(kinds[1:])}, or whichever is less accurate.",
                )
        seen: dict[str | int, str] = {}
        for name, mapped in self:
            if mapped.column != PASSIVE and (first := seen.setdefault(mapped.column, name)) != name:
                raise ArgumentError(
                    f"{self.source} uses column {mapped.column!r} twice, for {first!r} and for "
                    f"{name!r}.",
                    advice="Each column can have only one meaning.",
                )

    def named(self, names: Sequence[str]) -> ColumnMapping:
        """Return the mapping with column numbers replaced by names."""

        def by_name(mapped: MappedColumn) -> MappedColumn:
            return replace(mapped, column=mapped.among(names))

        joints = {
            joint: {quantity: by_name(mapped) for quantity, mapped in quantities.items()}
            for joint, quantities in self.joints.items()
        }
        base = {name: by_name(mapped) for name, mapped in self.base.items()}
        return replace(self, joints=joints, time=self.time and by_name(self.time), base=base)

    def __iter__(self) -> Iterator[tuple[str, MappedColumn]]:
        """Yield every column with its name: `time`, `<joint>.<quantity>` or one of a base."""
        if self.time is not None:
            yield "time", self.time
        for joint, quantities in self.joints.items():
            for quantity, column in quantities.items():
                yield f"{joint}.{quantity}", column
        yield from self.base.items()


@dataclass(frozen=True)
class Reading:
    """Options for reading a log; anything not given is inferred from the column names.

    Attributes:
        mapping: Assignment of columns.
        columns: Names of the columns of files without a header, in order.
        rate: Sampling rate of logs without a column of time, Hz.
        units: Quantity (time, position, velocity, acceleration, effort, current, voltage, pwm or
            command) -> its unit.
        gains: Joint -> gain of its efforts, such as torque constant × gear ratio for currents.
        gain_deviations: Joint -> standard deviation of its gain, for some of these joints.
        usual_deviation: Relative standard deviation of the gains of all other joints.
        kinds: Joint -> kind of its efforts, one of `KINDS`; the key "" applies to all joints whose
            columns do not determine it.
        skip_bad_rows: Skip corrupt rows, if they are at most 1 %.
        topic: Topic of a bag or channel of an LCM log, or several of a bag, which are joined by
            time; a word in the columns of one of several robots; None for the best match.
        dbc: DBC file that decodes traces of a CAN bus.
        episode: Episode of a dataset, or of demonstrations; None to concatenate all.
        ignored: Columns that are not used.
        motorless: Joints that are passive if a log has no efforts of them, or only zeros.
        motors: Joint -> its motor; the key "" applies to all others.
        joints: Joints of the model; parts of a log without any of them are not used.
        limits: Joint -> its lower and upper position limits in the model, rad or m.
        sliding: Prismatic joints of the model.
        links: Link of the model -> the joint that moves it.
        of_base: Whether to read the floating base and its feet from a recording.
    """

    mapping: ColumnMapping | None = None
    columns: tuple[str, ...] = ()
    rate: float | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    gains: Mapping[str, float] = field(default_factory=dict)
    skip_bad_rows: bool = False
    topic: str | Sequence[str] | None = None
    episode: int | None = None
    dbc: Path | None = None
    gain_deviations: Mapping[str, float] = field(default_factory=dict)
    usual_deviation: float = USUAL_GAIN_DEVIATION
    kinds: Mapping[str, str] = field(default_factory=dict)
    ignored: frozenset[str] = frozenset()
    motorless: frozenset[str] = frozenset()
    motors: Mapping[str, Motor] = field(default_factory=dict)
    of_base: bool = False
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    joints: tuple[str, ...] = ()
    sliding: frozenset[str] = frozenset()
    links: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("columns", "joints"):
            object.__setattr__(self, name, instances(getattr(self, name), name, str))
        instance(self.units, "units", Mapping)
        for name in ("gains", "gain_deviations", "kinds", "motors", "limits", "links"):
            instance(getattr(self, name), name, Mapping)
        if self.rate is not None:
            positive(self.rate, "The sampling rate of a log, Hz,")
        number(self.usual_deviation, "effort_uncertainty", lower=0.0, upper=1.0)
        instances(self.topics, "topic", str)
        if self.dbc is not None:
            object.__setattr__(self, "dbc", file_path(self.dbc))
        if self.episode is not None:
            integer(self.episode, "episode", lower=0)
        for quantity, unit in self.units.items():
            unit_of(unit, quantity)
        for joint, gain in self.gains.items():
            check_gain(gain, f"the gain of {joint}", self.gain_deviations.get(joint))
        for joint in self.gain_deviations:
            if joint not in self.gains:
                raise ArgumentError(f"The gain of {joint!r} has a deviation, but no value.")
        for joint, kind in self.kinds.items():
            if kind not in KINDS:
                whose = f" of {joint!r}" if joint else ""
                raise ArgumentError(
                    f"{kind!r} is not a known kind of efforts{whose}.",
                    advice=f"{nearest(kind, KINDS)}Kinds are {', '.join(KINDS)}.",
                )

    @property
    def topics(self) -> tuple[str, ...]:
        """Names of the requested topics."""
        return (self.topic,) if isinstance(self.topic, str) else tuple(self.topic or ())

    def kind_of(self, joint: str) -> str | None:
        """Return the given kind of a joint's efforts, or None."""
        return self.kinds.get(joint, self.kinds.get(""))

    def motors_of(self, joints: Sequence[str]) -> dict[str, Motor]:
        """Return the motors of joints, where known."""
        found = {joint: self.motors.get(joint, self.motors.get("")) for joint in joints}
        return {joint: motor for joint, motor in found.items() if motor is not None}

    def effort_uncertainty(self, joints: Sequence[str]) -> float | Array:
        """Return relative standard deviations (n,) of the gains of efforts, or one for all."""
        stated = {joint: list[float]() for joint in joints}
        for joint, shares in stated.items():
            if joint in self.gain_deviations:
                shares.append(self.gain_deviations[joint] / abs(self.gains[joint]))
            mapped = {} if self.mapping is None else self.mapping.joints.get(joint, {})
            column = mapped.get("effort")
            if column is not None and column.deviation is not None:
                shares.append(column.deviation / abs(column.gain))
        if not any(stated.values()):
            return self.usual_deviation
        usual = [self.usual_deviation]
        return np.array([np.linalg.norm(shares or usual) for shares in stated.values()])


def parsed_gain(text: str, what: str) -> tuple[float, float | None]:
    """Return a gain and its standard deviation, if given, as in `13.2±0.5` or `13.2+-0.5`."""
    parts = re.split(r"±|\+/?-", text)
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 2):
        raise ArgumentError(f"{what} is {text!r}, which is not a number.", advice=_GAIN_FORM)
    return numbers[0], numbers[1] if len(numbers) == 2 else None


def check_gain(gain: object, what: str, deviation: object = None) -> None:
    """Raise unless a gain is nonzero, and its sign certain given its deviation."""
    if number(gain, what) == 0.0:
        raise ArgumentError(f"{what} must be a nonzero number; got {gain!r}.")
    if deviation is not None and not 0.0 <= number(deviation, f"the deviation of {what}") < abs(
        number(gain, what)
    ):
        raise ArgumentError(
            f"{what} is {gain!r} with deviation {deviation!r}, which must be at least 0 and "
            "less than the gain.",
            advice="If the gain is that uncertain, omit it; it is then estimated.",
        )


MOST_COLUMNS = 500  # most columns for which a mapping is proposed
_ASKED = ("position", "velocity", "effort")
_FORM = (
    "Write `time: COLUMN` or `rate: HZ`, and `joints:`, each with `position:` and `effort:` "
    "(or `current:`, `voltage:`, `pwm:`, `command:`; `effort: passive` without a motor) and "
    "the name or number of a column, or {column: NAME, unit: deg, gain: 1.0}."
)


@typed
def read_mapping(path: Path) -> ColumnMapping:
    """Read a mapping file, in which each column may occur only once."""
    return made_of_yaml(path, "mapping", LogError, partial(mapping_of, path), advice=_FORM)


class _ColumnSchema(Schema):
    """A column in the file; see `MappedColumn`."""

    column: str | int
    unit: str | None = None
    gain: float | str = 1.0


_Column = str | int | _ColumnSchema | None


_QUANTITIES = [quantity for quantity in OF_JOINTS if quantity != PASSIVE]
_JointSchema: Any = msgspec.defstruct(
    "_JointSchema", [(quantity, _Column, None) for quantity in _QUANTITIES], bases=(Schema,)
)
"""Columns of a joint in the file."""


class _MappingSchema(Schema):
    """The content of a mapping file."""

    joints: dict[str | int, _JointSchema]
    time: _Column = None
    rate: float | None = None
    base: dict[str, _Column] = msgspec.field(default_factory=dict)


def mapping_of(path: Path, content: object) -> ColumnMapping:
    """Convert the content of a file to a mapping; see `read_mapping`."""
    schema = as_schema(content, _MappingSchema)
    joints = dict[str, dict[str, MappedColumn]]()
    for joint, columns in schema.joints.items():
        named = {q: each for q in _QUANTITIES if (each := getattr(columns, q)) is not None}
        joints[str(joint)] = {q: _column(each, q, f"{joint}.{q}") for q, each in named.items()}
    if schema.rate is not None:
        positive(schema.rate, "`rate`")
    if not joints:
        raise ArgumentError("`joints` is empty.", advice=_FORM)
    time = None if schema.time is None else _column(schema.time, "time", "time")
    if schema.time is None and schema.rate is None:
        raise ArgumentError("it has neither `time` nor `rate`.", advice=_FORM)
    base = {name: _base_column(name, each) for name, each in schema.base.items() if each}
    mapping = ColumnMapping(
        joints, time, schema.rate, "it", base
    )  # errors here begin with the file
    return replace(mapping, source=f"mapping {path}")


def _base_column(name: str, entry: str | int | _ColumnSchema) -> MappedColumn:
    entry = entry if isinstance(entry, _ColumnSchema) else _ColumnSchema(entry)
    gain = number(entry.gain, f"the gain of {name!r}")
    mapped_meaning(name, "", entry.unit, gain)  # raises for an unknown name or unit
    return MappedColumn(entry.column, entry.unit, gain)


def _column(entry: str | int | _ColumnSchema, quantity: str, what: str) -> MappedColumn:
    entry = entry if isinstance(entry, _ColumnSchema) else _ColumnSchema(entry)
    if entry.unit is not None:
        unit_of(entry.unit, quantity)
    gain, deviation = entry.gain, None
    if isinstance(gain, str):
        gain, deviation = parsed_gain(gain, f"the gain of {what!r}")
    check_gain(gain, f"the gain of {what!r}", deviation)
    if deviation is not None and quantity != "effort":
        raise ArgumentError(
            f"the gain of {what!r} has a deviation, which only gains of efforts may have.",
            advice="Write it under `effort:`.",
        )
    return MappedColumn(entry.column, entry.unit, float(gain), deviation)


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
    """Add a proposed mapping to the evidence of an error, and return it.

    The mapping is text to edit, filled in with the columns in `places`; without a header, columns
    are given by number. It is omitted if the user gave one or there are too many columns.
    """
    if reading.mapping is not None or len(names) > MOST_COLUMNS:
        return error
    named = list(dict.fromkeys(joint for joint, _ in places if joint))
    logged = [joint for joint in named if (joint, "position") in places] or named
    own = joints or named or ["JOINT"]
    if are_numbered := all(map(NUMBERED.fullmatch, logged)):
        logged.sort(key=lambda joint: int(joint.rpartition("_")[2]))
    is_by_order = not set(logged).intersection(own) and (are_numbered or len(logged) == len(own))
    model = dict(zip(logged, own, strict=False)) if is_by_order else {}
    known = {(model.get(joint, joint), m.quantity): m for (joint, _), m in places.items()}
    units = {place: m.unit.name if m.unit else None for place, m in known.items()}
    columns_at = {place: MappedColumn(m.column, units[place]) for place, m in known.items()}
    guessed = {} if logged else _guess(names, own, headed=headed)
    if any(guessed.get(place) != column for place, column in columns_at.items()):
        guessed = {}
    columns_at |= guessed
    columns = dict[str, dict[str, MappedColumn | None]]()
    for joint in own:
        kind = next((k for k in (*EFFORT_KINDS, "command") if (joint, k) in columns_at), "effort")
        columns[joint] = {q: columns_at.get((joint, q)) for q in ("position", "velocity", kind)}
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
    text += mapping_yaml(columns, columns_at.get(("", "time")), reading.rate)
    error.evidence |= {"path": path, "proposal": text}
    return error


_HEAD = """\
# How geodrake is to read {name!r}: edit this, and pass it with --mapping.
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
    base: Mapping[str, MappedColumn] | None = None,
) -> str:
    """Return a mapping as the text of a file; the user fills in columns that are None."""
    clock = {"time": _entry(time)} if rate is None else {"rate": rate}
    content = {j: {q: _entry(column) for q, column in row.items()} for j, row in joints.items()}
    floating = {"base": {n: _entry(column) for n, column in base.items()}} if base else {}
    text = yaml.safe_dump(
        {**clock, "joints": content, **floating},
        sort_keys=False,
        allow_unicode=True,
        width=math.inf,
    )
    return str(text).replace(": null\n", ":  # which column?\n")


def _entry(mapped: MappedColumn | None) -> object:
    """Return a column in the form of the file."""
    if mapped is None:
        return None
    gain = mapped.gain if mapped.deviation is None else f"{mapped.gain}±{mapped.deviation}"
    details: dict[str, object] = {"unit": mapped.unit} if mapped.unit else {}
    details |= {"gain": gain} if gain != 1.0 else {}
    return {"column": mapped.column, **details} if details else mapped.column


def _guess(
    names: Sequence[str], joints: Sequence[str], *, headed: bool
) -> dict[tuple[str, str], MappedColumn]:
    """Map (joint, quantity) to columns in order, if their number fits time and quantities."""
    columns = [MappedColumn(name if headed else k) for k, name in enumerate(names, 1)]
    for timed, quantities in product((True, False), (_ASKED, ("position", "effort"))):
        order = [("", "time")] * timed + [(j, q) for q in quantities for j in joints]
        if len(names) == len(order):
            return dict(zip(order, columns, strict=True))
    return {}
