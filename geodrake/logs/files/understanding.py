"""Which column of a file is which quantity of which joint: by names, or by a mapping."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from geodrake.errors import LogError
from geodrake.logs.files.column_names import (
    HEADER_ADVICE,
    SIGNAL_ADVICE,
    Columns,
    Source,
    check_text,
    check_twice,
    listed,
)
from geodrake.logs.files.column_words import choice_words, unit_words
from geodrake.logs.files.dates import date_words
from geodrake.logs.files.joint_matching import matched
from geodrake.logs.files.mapping_file import proposed_mapping, with_proposal
from geodrake.logs.files.reading import ColumnMapping, Reading
from geodrake.logs.files.recognition import OF_JOINTS, Meaning, meaning_of, words_of
from geodrake.logs.files.signal_columns import candidates, check_kind, effort_source
from geodrake.logs.files.units import Unit, find_unit, unit_of
from geodrake.logs.motion import EFFORT_KINDS, PARTIAL, PASSIVE, QUANTITIES, check_joints

_MAPPING_ADVICE = "Or say which column is what by --mapping."


def columns_of(
    path: Path,
    names: Sequence[str],
    joints: Sequence[str] | None,
    reading: Reading | None = None,
    units: Mapping[str, str] | None = None,
    *,
    origins: Mapping[str, int] | None = None,
    partial: bool = False,
) -> Columns:
    """The columns of a file with these names, joints in the order given if any is.

    Args:
        names: All columns of the file, in its order.
        joints: Names of the model's joints, which the log must have, in the order that it shall
            have them in; None for the order of the file.
        origins: Columns of seconds since an instant -> this, ns since 1970; see `LogTable`.
        partial: Whether the log may lack some of the model's joints, or their efforts.

    Raises:
        LogError: Time, or a joint's position or effort, is missing, or the joints are others.
    """
    reading = reading or Reading()
    check_text(path, names)
    if reading.mapping is not None:
        understood = _Understood.by_mapping(path, names, reading, reading.mapping)
        understood = understood.dated(origins or {})
        return understood.columns(*understood.joints(joints, partial=partial), joints)
    understood = _Understood.by_names(path, names, joints, reading, units or {})
    understood = understood.dated(origins or {})
    try:
        own, standing = understood.joints(joints, partial=partial)
    except LogError as error:
        proposal = proposed_mapping(path, names, joints, motorless=reading.motorless)
        raise with_proposal(error, path, proposal) from error
    return understood.columns(own, standing, joints)


@dataclass(frozen=True)
class _Understood:
    """Which column of a file is which quantity of which joint, before that is checked.

    Attributes:
        reading: What the user said of it.
        places: (joint, quantity) -> source, in the order of the file; `("", "time")` is time.
        rate: Rows a second, Hz.
        own: Whether joints are those of geodrake's own names, of which none is left out unasked.
        others: Joint -> further columns that could be taken for its efforts, or in their place.
        origin: Since when time is, ns since 1970, if that is known.
    """

    path: Path
    names: Sequence[str]
    reading: Reading
    places: Mapping[tuple[str, str], Source]
    notes: tuple[str, ...]
    rate: float | None
    own: frozenset[str]
    others: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    origin: int | None = None

    @classmethod
    def by_names(
        cls,
        path: Path,
        names: Sequence[str],
        joints: Sequence[str] | None,
        reading: Reading,
        units: Mapping[str, str],
    ) -> _Understood:
        """What the names of the columns say."""
        meanings = [meaning for name in names if (meaning := meaning_of(name)) is not None]
        of_joints = [meaning for meaning in meanings if meaning.quantity in OF_JOINTS]
        found, notes = matched(of_joints, joints)
        best, others = candidates(of_joints, found, reading)
        places = {}
        for (joint, quantity), same in best.items():
            if quantity == "effort":
                stated = units.get(same[0].column, "")
                places[joint, quantity] = effort_source(path, same[0], joint, reading, stated)
                continue
            unit = _unit(same[0], quantity, reading, units)
            places[joint, quantity] = Source(same[0].column, unit.factor if unit else 1.0, unit)
        places = _with_commands_as_positions(places)
        if reading.rate is None:
            places |= _time(path, names, meanings, reading, units)
        own = frozenset(m.joint for m in of_joints if m.style[0] == "own")
        notes = (*notes, *choice_words(best))
        return cls(path, names, reading, places, notes, reading.rate, own, others)

    @classmethod
    def by_mapping(
        cls, path: Path, names: Sequence[str], reading: Reading, mapping: ColumnMapping
    ) -> _Understood:
        """What a mapping says."""
        places = {}
        for name, mapped in mapping:
            if name.endswith(".effort") and mapped.column == PASSIVE and PASSIVE not in names:
                places[name.removesuffix(".effort"), PASSIVE] = Source(PASSIVE)
                continue
            column, (joint, _, quantity) = mapped.column, name.rpartition(".")
            if isinstance(column, int):  # by number, unless that is a name
                by_number = names[column - 1] if 0 < column <= len(names) else str(column)
                column = str(column) if str(column) in names else by_number
            if column not in names:
                raise LogError(
                    f"Log {str(path)!r} has no column {column!r}, which {mapping.source} names for "
                    f"{name!r}; it has {listed(names)}.",
                    advice="Correct the mapping.",
                )
            text = mapped.unit or reading.units.get(quantity)
            unit = unit_of(text, quantity) if text else None
            source = Source(column, mapped.gain * (unit.factor if unit else 1.0), unit)
            if quantity in EFFORT_KINDS:
                kind = _mapped_kind(quantity, mapped.gain, unit, reading.kind_of(joint))
                if kind != "effort" or mapped.gain == 1.0:
                    check_kind(path, column, joint, kind, unit)
                source, quantity = replace(source, kind=kind), "effort"
            places[joint, quantity] = source
        _drop_unwanted(places, reading)
        places = _with_commands_as_positions(places)
        rate = reading.rate or mapping.rate
        if rate is not None:
            places.pop(("", "time"), None)
        return cls(path, names, reading, places, (), rate, frozenset(mapping.joints))

    def dated(self, origins: Mapping[str, int]) -> _Understood:
        """With the time in seconds, whatever its name says, where it is since a known instant.

        Raises:
            LogError: A column of dates is taken for another quantity.
        """
        for (joint, quantity), source in self.places.items():
            if quantity != "time" and source.column in origins:
                raise LogError(
                    f"Column {source.column!r} of log {str(self.path)!r} holds dates, and is taken "
                    f"for the {quantity} of {joint}.",
                    advice=_MAPPING_ADVICE,
                )
        time = self.places.get(("", "time"))
        if time is None or time.column not in origins:
            return self
        places = {**self.places, ("", "time"): Source(time.column, 1.0, unit_of("s", "time"))}
        origin = origins[time.column]
        note = f"time is in s since {date_words(origin)}"
        return replace(self, places=places, notes=(*self.notes, note), origin=origin)

    def joints(
        self, wanted: Sequence[str] | None, *, partial: bool
    ) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Joints of the log to be, in their order, and those of which there is the position alone.

        Args:
            wanted: The model's joints, if the log must have them.
            partial: Whether it may lack some of them, or their efforts.

        Raises:
            LogError: Time, a position, an effort and what may stand for it, or a joint is missing.
        """
        if self.rate is None and ("", "time") not in self.places:
            close = difflib.get_close_matches("time", [n.lower() for n in self.names[:100]], 1)
            raise LogError(
                f"Log {str(self.path)!r} has no column 'time'; it has {listed(self.names)}.",
                advice=(f"Is it {close[0]!r}? " if close else "")
                + f"{HEADER_ADVICE} Without time, give the rows a second by --rate.",
            )
        moved = self._of_model(self._having("position"), wanted)
        heard = {*self._having("effort", "command"), *self._passive(moved)}
        silent = [joint for joint in moved if joint not in heard]
        if len(silent) == len(moved):
            raise LogError(
                f"Log {str(self.path)!r} has no joint with both position and effort; positions: "
                f"{listed(moved)}; efforts: {listed(self._having('effort', 'command'))}.",
                advice="A log without effort says nothing about dynamics. "
                f"{HEADER_ADVICE} {SIGNAL_ADVICE} {_MAPPING_ADVICE}",
            )
        standing = tuple(j for j in silent if j in self.own or j in (wanted or ()))
        if standing and not partial:
            raise LogError(
                f"Log {str(self.path)!r} is a log without effort of {', '.join(standing)}: the "
                "position is there, the effort is not.",
                advice=f"Log that joint's effort too, or leave its columns out. {SIGNAL_ADVICE}",
                joints=standing,
            )
        own = tuple(joint for joint in moved if joint in heard)
        if wanted is None:
            return own, standing
        check_joints(self.path.stem, [*own, *standing], wanted, partial=partial)
        return tuple(joint for joint in wanted if joint in own), standing

    def _of_model(self, joints: Sequence[str], wanted: Sequence[str] | None) -> tuple[str, ...]:
        """Joints without those that the model lacks, if it has some of the log's.

        A joint that is called like one that the log lacks stays: it is that one, misspelled.
        """
        if wanted is None or not set(wanted).intersection(self._having("position")):
            return tuple(joints)
        lacking = set(wanted).difference(self._having("position"))
        missing = ["".join(map(str, words_of(joint))) for joint in lacking]
        names = {joint: "".join(map(str, words_of(joint))) for joint in joints}
        return tuple(
            joint
            for joint in joints
            if joint in wanted or difflib.get_close_matches(names[joint], missing, 1)
        )

    def columns(
        self, joints: Sequence[str], standing: Sequence[str], model: Sequence[str] | None
    ) -> Columns:
        """What is read for these joints.

        Args:
            joints: Joints with position and effort, or what stands for it.
            standing: Joints with positions alone.

        Raises:
            LogError: A column that is needed is there twice, or a gain is of no joint.
        """
        used = {c for source in self.places.values() for c in source.columns}
        check_twice(self.path, self.names, used)
        self._check_said(joints)
        quantities, notes = [], list(self.notes)
        for quantity in QUANTITIES:
            missing = [f"{j}.{quantity}" for j in joints if (j, quantity) not in self.places]
            some = len(missing) < len(joints) and quantity in PARTIAL
            if not missing or some or quantity == "effort":
                quantities.append(quantity)
            elif len(missing) < len(joints):
                notes.append(f"{quantity} is not used: there is no {listed(missing)}")
        passive = self._passive(joints)
        if said := [joint for joint in passive if joint not in self.reading.motorless]:
            notes.append(f"no motor at {listed(said)}: bodies and friction need no effort there")
        sources = {
            quantity if quantity == "time" else f"{joint}.{quantity}": self._scaled(joint, quantity)
            for joint, quantity in self.places
            if quantity == "time"
            or (joint in joints and quantity in quantities)
            or (joint in standing and quantity == "position")
        }
        beside = [j for j in self._having("position") if j not in (*joints, *standing)]
        if beside and model is not None:
            notes.append(f"left out, as the model has no such joint: {listed(beside)}")
        notes += unit_words(sources, self.reading)
        kept = {
            c
            for (j, quantity), source in self.places.items()
            if quantity == "time" or j in joints or j in standing
            for c in source.columns
        }
        others = [name for name in self.names if name not in kept]
        notes += [f"columns ignored: {listed(others)}"] if others else []
        return Columns(
            self.path,
            tuple(joints),
            tuple(quantities),
            tuple(notes),
            sources,
            self.rate,
            self.reading,
            tuple(standing),
            self._passive(joints),
            self.others,
            self.origin,
        )

    def _passive(self, joints: Sequence[str]) -> tuple[str, ...]:
        """Those of some joints without a motor, as the log, the user or the model says."""
        heard, said = self._having("effort", "command"), self._having(PASSIVE)
        return tuple(
            joint
            for joint in joints
            if joint in said
            or self.reading.kinds.get(joint) == PASSIVE
            or (joint in self.reading.motorless and joint not in heard)
        )

    def _having(self, *quantities: str) -> list[str]:
        """Joints with one of some quantities, in the order of the file."""
        return list(dict.fromkeys(joint for joint, other in self.places if other in quantities))

    def _scaled(self, joint: str, quantity: str) -> Source:
        """The source of a column; with a known gain, signals are efforts."""
        source = self.places[joint, quantity]
        gain = self.reading.gains.get(joint)
        if gain is None or quantity != "effort":
            return source
        return replace(source, factor=gain * source.factor, kind="effort")

    def _check_said(self, joints: Sequence[str]) -> None:
        """Refuse gains and kinds of joints that have no such column.

        Raises:
            LogError: There is one.
        """
        heard, told = self._having("effort"), self._having("command")
        _check_joints_of("There is a gain of", self.reading.gains, joints)
        for joint, said in self.reading.kinds.items():
            what = "--passive names" if said == PASSIVE else "There is a kind of"
            _check_joints_of(what, [joint] if joint else [], joints)
        for joint in self.reading.gains:
            if joint not in heard:
                raise LogError(
                    f"There is a gain of {joint!r}, of which log {str(self.path)!r} has neither "
                    "effort nor current, voltage or duty cycle.",
                    advice="What a servo makes of its command is found from the model's inertias.",
                    joint=joint,
                )
        for joint in joints:
            kind = self.reading.kind_of(joint)
            if kind not in (None, PASSIVE) and joint not in (told if kind == "command" else heard):
                if joint not in self.reading.kinds:
                    continue  # said of all joints that have it
                raise LogError(
                    f"Log {str(self.path)!r} has no column of {joint!r} that could be {kind!r}.",
                    advice="Say which column it is by --mapping.",
                    joint=joint,
                )


def _mapped_kind(quantity: str, gain: float, unit: Unit | None, said: str | None) -> str:
    """What a mapped column is: as its key says; of an effort, as the user or its unit says."""
    if said not in (None, "command", quantity) and quantity != "effort":
        raise LogError(
            f"A mapping has a column as {quantity}, and --kind says that it is {said}.",
            advice="Leave one of both out.",
        )
    if quantity != "effort" or said not in (None, "command"):
        return quantity if said in (None, "command") else str(said)
    in_signal = unit is not None and unit.signal is not None and gain == 1.0
    return str(unit.signal) if unit is not None and in_signal else "effort"


def _drop_unwanted(places: dict[tuple[str, str], Source], reading: Reading) -> None:
    """Take out the efforts of joints whose commands are to be used in their place."""
    for joint in [joint for joint, quantity in places if quantity == "command"]:
        if reading.kind_of(joint) == "command":
            places.pop((joint, "effort"), None)


def _with_commands_as_positions(
    places: Mapping[tuple[str, str], Source],
) -> dict[tuple[str, str], Source]:
    """The columns, with commands in the unit of their joint's position, where nobody says theirs.

    Args:
        places: (joint, quantity) -> source.
    """
    found = dict(places)
    for (joint, quantity), source in places.items():
        position = places.get((joint, "position"))
        bare = source.unit is None and source.factor == 1.0
        if quantity == "command" and bare and position is not None:
            found[joint, quantity] = replace(source, unit=position.unit, factor=position.factor)
    return found


def _unit(
    meaning: Meaning, quantity: str, reading: Reading, units: Mapping[str, str]
) -> Unit | None:
    """The unit of a column: as the user says, as its name says, as the file states."""
    if quantity in reading.units:
        return unit_of(reading.units[quantity], quantity)
    return meaning.unit or find_unit(units.get(meaning.column, ""), quantity)


def _time(
    path: Path,
    names: Sequence[str],
    meanings: Sequence[Meaning],
    reading: Reading,
    units: Mapping[str, str],
) -> dict[tuple[str, str], Source]:
    """The column of time, the likeliest of several; with one of nanoseconds beside it."""
    times = sorted((m for m in meanings if m.quantity == "time"), key=lambda m: m.role)
    if not times:
        return {}
    time = times[0]
    beside = [m for m in meanings if m.quantity == "nanoseconds" and m.style == time.style]
    unit = _unit(time, "time", reading, units)
    nanoseconds = beside[0].column if beside else None
    return {("", "time"): Source(time.column, unit.factor if unit else 1.0, unit, nanoseconds)}


def _check_joints_of(what: str, named: Iterable[str], joints: Sequence[str]) -> None:
    for joint in named:
        if joint not in joints:
            raise LogError(
                f"{what} {joint!r}, which is no joint of the log.",
                advice=f"Its joints are: {listed(joints)}.",
            )
