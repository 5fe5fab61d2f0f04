"""Messages about joints, in ROS as in LCM: their fields, and rows as one table."""

from __future__ import annotations

from array import array
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import LogError
from geodrake.logs.files.joined_tables import joined_tables
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import LogTable
from geodrake.logs.motion import EFFORT_KINDS

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
Clock = tuple[Stamps, Stamps]
"""(N,) when messages were measured, and (N,) when they were received, ns."""

JointKey = str | int
"""The name of a joint, or its number from 0 on in messages without names."""


def is_complete(quantities: Iterable[str]) -> bool:
    """Return whether positions and something of efforts are among quantities."""
    known = set(quantities)
    return "position" in known and not known.isdisjoint((*EFFORT_KINDS, "command"))


def on_clock(table: LogTable, clock: Clock | None) -> LogTable:
    """Return a table of times of receipt, at stamps that others had when they were received."""
    if clock is None or len(clock[0]) < 2:
        return table
    stamps, received = clock
    since = 1e-9 * (received - received[0])
    line = np.polyfit(since, 1e-9 * (stamps - stamps[0]), 1)
    time = table.columns["time"] + 1e-9 * ((table.origins["time"] or 0) - int(received[0]))
    columns = {**table.columns, "time": np.asarray(np.polyval(line, time), float)}
    return replace(table, columns=columns, origins={"time": int(stamps[0])})


_LATEST = 1 << 62
"""What no stamp reaches, ns since 1970: the year 2116, and steps between two fit 64 bits."""

NUMBERS = "data"
"""What the numbers of a message are called that says nothing of them."""

_NAMES = ("name", "names", "joint_name", "joint_names")
_PLACES = ((), ("feedback",), ("actual",))  # of the arrays in a message
_OUTPUT = ("output", "effort")  # of a controller, where nobody measures
_COMMANDS = (
    ("reference", "positions"),
    ("desired", "positions"),
    ("joint_position_commanded",),
    ("joint_position_desired",),
    ("points", "positions"),
)
"""Where messages have what joints were told, which stands for efforts that nobody measures."""
_ARRAYS = {
    "position": "position positions joint_position joint_positions joint_position_measured "
    "measured_joint_position q",
    "velocity": "velocity velocities joint_velocity joint_velocities joint_velocity_estimated dq",
    "acceleration": "acceleration accelerations",
    "effort": "effort efforts torque torques joint_effort joint_torque joint_torques "
    "joint_torque_measured measured_torque tau tau_J tau_j",
}
"""Quantity -> what its array is called."""

_INTERFACES = {
    **{name: name for name in ("position", "velocity", "acceleration", *EFFORT_KINDS)},
    "torque": "effort",
    "temperature": "temperature",
}
"""What hardware interfaces of ros2_control are called -> quantity."""


@dataclass(frozen=True)
class JointFields:
    """Where messages of a type have the names of joints and what is measured at them.

    Attributes:
        arrays: Quantity -> where its array may be; the first with numbers counts. `NUMBERS` of
            which the message says no more.
        by_joint: Whether every joint has a list of its own, of values and what they are.
    """

    names: str | None
    arrays: Mapping[str, tuple[tuple[str, ...], ...]]
    by_joint: bool = False

    @classmethod
    def of(cls, message: Any) -> JointFields | None:
        """Return the fields of messages such as this one; None if no log needs them."""
        names = next(
            (n for n in _NAMES if isinstance(getattr(message, n, None), list | tuple)), None
        )
        arrays = {
            quantity: tuple(
                (*place, word)
                for place in _PLACES
                for word in words.split()
                if np.ndim(_at(message, (*place, word))) == 1
            )
            for quantity, words in _ARRAYS.items()
        }
        if _at(message, _OUTPUT) is not None:
            arrays["effort"] += (_OUTPUT,)
        arrays["command"] = tuple(path for path in _COMMANDS if np.ndim(_at(message, path)) == 1)
        if hasattr(message, "layout") and np.ndim(_at(message, (NUMBERS,))) == 1:
            arrays[NUMBERS] = ((NUMBERS,),)
        by_joint = hasattr(message, "interface_values")
        says = by_joint or any(arrays.get(q) for q in ("position", "effort", "command", NUMBERS))
        return cls(names, arrays, by_joint) if says else None

    def sample(self, message: Any) -> tuple[tuple[JointKey, ...], dict[str, Any], bool]:
        """Return joints and arrays of a message, and whether efforts are those of a controller.

        Joints without names are numbers from 0 on.
        """
        found: dict[str, Any] = _by_interface(message) if self.by_joint else {}
        output = False
        for quantity, paths in self.arrays.items():
            for path in paths:
                values = _at(message, path)
                if values is not None and len(values) and not np.isnan(values).all():
                    found[quantity] = values
                    output |= path == _OUTPUT
                    break
        if "effort" in found:
            found.pop("command", None)
        names = () if self.names is None else tuple(getattr(message, self.names))
        return names or tuple(range(len(next(iter(found.values()), ())))), found, output


@dataclass
class MessageNumbers:
    """Numbers of messages of one topic, in groups of those with the same columns.

    They grow; no message is kept.
    """

    topic: str
    count: int = field(default=0, init=False)
    groups: dict[Any, _Group] = field(default_factory=dict, init=False)

    def take(self, key: Hashable, numbers: Array, stamp: int, received: int) -> None:
        """Take the numbers of a message: a row of the group of a key."""
        if not max(abs(stamp), abs(received)) < _LATEST:
            raise LogError(
                f"Message {self.count} of {self.topic} is stamped {1e-9 * stamp:.4g} s and "
                f"received {1e-9 * received:.4g} s since 1970, which cannot be.",
                advice="Check the clock of the recorder, or leave that message out.",
            )
        group = self.groups.setdefault(key, _Group())
        group.stamps.append(stamp)
        group.received.append(received)
        group.numbers.frombytes(numbers.tobytes())

    def rows(self, key: Hashable) -> tuple[Stamps, Array]:
        """Return the times (N,) of the messages of a group, ns, and their numbers (N, n).

        Times are those of receipt unless every message says when it was measured.
        """
        group = self.groups[key]
        times = group.stamps if self.clock else group.received
        stamps = np.frombuffer(times, np.int64)
        return stamps, np.frombuffer(group.numbers).reshape(len(stamps), -1)

    @property
    def clock(self) -> Clock | None:
        """When messages were measured and received; None unless all of them say it."""
        return self._stamps if (self._stamps[0] > 0).all() else None

    @property
    def clock_notes(self) -> tuple[str, ...]:
        """Return that messages have no stamps, in words, if they have not."""
        if self.clock:
            return ()
        some = "some messages" if (self._stamps[0] > 0).any() else "messages"
        return (f"{some} of {self.topic} have no stamps: their time is that of receipt",)

    @property
    def _stamps(self) -> Clock:
        times = [(g.stamps, g.received) for g in self.groups.values()]
        stamps, received = (
            np.concatenate([np.frombuffer(each, np.int64) for each in (array("q"), *both)])
            for both in zip(*times, strict=True)
        )
        return stamps, received


@dataclass
class _Group:
    """Messages with the same columns in the same order."""

    stamps: array[int] = field(default_factory=lambda: array("q"))
    received: array[int] = field(default_factory=lambda: array("q"))
    numbers: array[float] = field(default_factory=lambda: array("d"))


@dataclass
class MessageRows(MessageNumbers):
    """What messages of one topic say of joints."""

    fields: JointFields
    from_controller: bool = field(default=False, init=False)

    def add(self, message: Any, stamp: int, received: int) -> None:
        """Take the numbers of a message."""
        joints, found, output = self.fields.sample(message)
        self.count += 1
        self.from_controller |= output
        for quantity, values in found.items():
            if len(values) != len(joints):
                raise LogError(
                    f"Message {self.count} of {self.topic} has {len(joints)} joints and "
                    f"{len(values)} numbers of {quantity}.",
                    advice="Is another message type recorded under that name?",
                )
        numbers = np.concatenate([np.zeros(0), *found.values()], dtype=float)
        self.take((joints, tuple(found)), numbers, stamp, received)

    @property
    def quantities(self) -> frozenset[str]:
        """Return what some joint has in one message."""
        best = max((q for _, q in self.groups), key=lambda q: (is_complete(q), len(q)), default=())
        return frozenset(best)

    @property
    def joints(self) -> tuple[JointKey, ...]:
        """All joints, in the order in which they appear."""
        return tuple(dict.fromkeys(joint for joints, _ in self.groups for joint in joints))

    def table(self, *, part: bool = False) -> LogTable:
        """Return what the messages say as columns: `time` and `<joint>.<quantity>`.

        Joints without names are `position[0]`, …. Of joints that come in messages of their own each
        has its instants, at which tables are joined.

        Args:
            part: Whether it is a part of a log; nothing of a part is left out.
        """
        groups = [key for key in self.groups if (key[1] if part else is_complete(key[1]))]
        notes, found = list[str](), dict[JointKey, list[tuple[Stamps, dict[str, Array]]]]()
        if len({joints for joints, _ in groups}) > len({frozenset(joints) for joints, _ in groups}):
            notes.append(
                f"the order of joints changes in {self.topic}: they are told apart by their names"
            )
        silent = set(self.joints).difference(*(joints for joints, _ in groups))
        if silent:
            named = ", ".join(str(joint) for joint in self.joints if joint in silent)
            notes.append(f"joints without effort left out: {named}")
        for joints, quantities in groups:
            stamps, rows = self.rows((joints, quantities))
            kept = self._once(stamps, joints, notes)
            for k, joint in enumerate(joints):
                own = dict(zip(quantities, rows[kept, k :: len(joints)].T, strict=True))
                found.setdefault(joint, []).append((stamps[kept], own))
        tables: dict[bytes, LogTable] = {}
        for joint, parts in found.items():
            stamped, first = np.unique(np.concatenate([s for s, _ in parts]), return_index=True)
            time = {"time": (stamped - stamped[0]) / 1e9}
            new = LogTable(Path(str(joint)), time, origins={"time": int(stamped[0])})
            into = tables.setdefault(stamped.tobytes(), new).columns
            for quantity in dict.fromkeys(q for _, own in parts for q in own):
                all_of_it = [own.get(quantity, np.full(len(s), np.nan)) for s, own in parts]
                name = f"{quantity}[{joint}]" if isinstance(joint, int) else f"{joint}.{quantity}"
                into[name] = np.concatenate(all_of_it)[first]  # type: ignore[index]
        table = next(iter(tables.values()))
        if len(tables) > 1:
            table = joined_tables(Path(self.topic), list(tables.values()), Reading())
        return replace(table, notes=(*notes, *table.notes))

    def _once(
        self, stamps: Stamps, joints: Sequence[JointKey], notes: list[str]
    ) -> NDArray[np.bool_]:
        """Return which messages (N,) come after the one before; refuse those that come earlier."""
        steps = np.diff(stamps)
        if np.any(steps < 0):
            at = int(np.argmax(steps < 0))
            raise LogError(
                f"Time runs backwards in {self.topic}: message {at + 2} is "
                f"{-steps[at] / 1e9:.3g} s before message {at + 1} of "
                f"{', '.join(map(str, joints[:3]))}, ….",
                advice="Was a clock set, a simulation started again, or does somebody else publish "
                "on it? Cut the recording there.",
                message=at + 2,
            )
        kept = np.concatenate([[True], steps > 0])
        if not kept.all():
            count = np.count_nonzero(~kept)
            notes.append(f"{count} messages with the stamp of the one before left out")
        return kept


def stamp_of(message: Any) -> int:
    """Return when a message of ROS was measured, ns; 0 if it does not say."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else int(stamp.sec * 1_000_000_000 + stamp.nanosec)


def _at(message: Any, path: Sequence[str]) -> Any:
    """Return what a message has at a place, None for nothing; a list of one is what is in it."""
    for name in path:
        if isinstance(message, list):
            message = message[0] if len(message) == 1 else None
        message = getattr(message, name, None)
    return message


def _by_interface(message: Any) -> dict[str, Array]:
    """Quantity -> (n,) numbers of a message with a list of values for each joint, NaN for none."""
    rows = [
        {
            _INTERFACES.get(name): value
            for name, value in zip(i.interface_names, i.values, strict=True)
        }
        for i in message.interface_values
    ]
    quantities = dict.fromkeys(q for row in rows for q in row if q is not None)
    found = {q: np.array([row.get(q, np.nan) for row in rows]) for q in quantities}
    return {q: numbers for q, numbers in found.items() if not np.isnan(numbers).all()}
