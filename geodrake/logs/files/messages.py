"""Convert messages of ROS and LCM about joints and a floating base to columns."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import isnan
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import Array
from geodrake.errors import LogError
from geodrake.logs.files.base_names import IS_BASE, floating_meaning
from geodrake.logs.files.grouped_arrays import fields_of
from geodrake.logs.files.name_rules import MEASURED, OTHER, PLAIN, PREVIOUS, Meaning, meaning_of
from geodrake.logs.files.table import LogTable, array_of
from geodrake.logs.files.units import WORDS
from geodrake.logs.floating import unwound
from geodrake.logs.motion import EFFORT_KINDS, QUANTITIES

Stamps = NDArray[np.int64]
Clock = tuple[Stamps, Stamps]
"""Times (N,) of measurement and (N,) of receipt of messages, ns."""


def is_complete(quantities: Iterable[str]) -> bool:
    """Return whether quantities include positions, and efforts or commands."""
    present = set(quantities)
    return "position" in present and not present.isdisjoint((*EFFORT_KINDS, "command"))


def on_clock(table: LogTable, clock: Clock | None) -> LogTable:
    """Convert times of receipt to the measurement clock of other messages, by a linear fit."""
    if clock is None or len(clock[0]) < 2:
        return table
    stamps, received = clock
    since = 1e-9 * (received - received[0])
    line = np.polyfit(since, 1e-9 * (stamps - stamps[0]), 1)
    time = table.columns["time"] + 1e-9 * ((table.origins["time"] or 0) - int(received[0]))
    columns = {**table.columns, "time": np.asarray(np.polyval(line, time), float)}
    return replace(table, columns=columns, origins={"time": int(stamps[0])})


_LATEST = 1 << 62
"""Upper bound of stamps, ns since 1970: the year 2116; differences fit 64 bits."""

NUMBERS = "data"
"""Field of numbers whose quantity is not named."""

_NAMES = ("name", "names", "joint_name", "joint_names")
_OUTPUT = "output.effort"  # output of a controller
_POINTS = "points."  # commanded trajectory
_LAYOUT = "layout.data_offset"  # field of arrays of any meaning


Owners = tuple[Any, ...]
"""Joints or frame of a message."""

Said = tuple[Owners, Mapping[str, Any], Any]
"""Owners, their numbers by quantity, and the part of the message with its stamp."""

Key = tuple[Owners, tuple[str, ...]]
"""Owners and quantities common to a group of messages."""


@dataclass
class Messages:
    """Numbers in the messages of one topic, grouped by equal columns."""

    topic: str
    kind: str = ""  # type of the messages
    count: int = field(default=0, init=False)
    groups: dict[Key, bytearray] = field(default_factory=dict, init=False)

    def said(self, message: Any) -> Iterable[Said]:
        """Return the data of joints or frames in a message."""
        raise NotImplementedError

    def column(self, owner: Hashable, name: str) -> str:
        """Return the column name of a quantity of a joint or a frame."""
        return name

    def add(self, message: Any, received: int) -> None:
        """Add a message, received at a time in ns."""
        self.count += 1
        for owners, numbers, part in self.said(message):
            times = stamp_of(part), received
            if not max(map(abs, times)) < _LATEST:
                raise LogError(
                    f"Message {self.count} of {self.topic} has the stamp {1e-9 * times[0]:.4g} s "
                    f"and was received at {1e-9 * received:.4g} s since 1970, which is "
                    "impossible.",
                    advice="Check the clock of the recorder, or remove that message.",
                )
            group = self.groups.setdefault((owners, tuple(numbers)), bytearray())
            group += np.array(times, np.int64).tobytes()
            group += np.array([*numbers.values()], float).tobytes()

    def rows(self, key: Key) -> NDArray[np.void]:
        """Return the messages of a group, with the fields `stamp`, `received` and `numbers`."""
        owners, names = key
        numbers = ("numbers", float, (len(owners) * len(names),))
        kind = np.dtype([("stamp", np.int64), ("received", np.int64), numbers])
        return np.frombuffer(self.groups[key], kind)

    def tables_of(self, keys: Iterable[Key], *, shared: bool = True) -> list[LogTable]:
        """Return some groups as one table for each set of time stamps.

        Unless tables are `shared`, each joint or frame has its own.
        """
        parts_of = defaultdict[Hashable, list[tuple[Stamps, dict[str, Array]]]](list)
        for owners, names in keys:
            rows = self.rows((owners, names))
            for k, owner in enumerate(owners):
                numbers = zip(names, rows["numbers"].T[k :: len(owners)], strict=True)
                own = {self.column(owner, name): values for name, values in numbers}
                parts_of[owner].append((rows[self.when], own))
        tables: dict[Hashable, LogTable] = {}
        for owner, parts in parts_of.items():
            stamped, first = np.unique(np.concatenate([s for s, _ in parts]), return_index=True)
            time = {"time": (stamped - stamped[0]) / 1e9}
            new = LogTable(Path(str(owner)), time, origins={"time": int(stamped[0])})
            columns: Any = tables.setdefault(stamped.tobytes() if shared else owner, new).columns
            for name in dict.fromkeys(name for _, own in parts for name in own):
                values = [own.get(name, np.full(len(s), np.nan)) for s, own in parts]
                columns[name] = np.concatenate(values)[first]
        return list(tables.values())

    @property
    def clock(self) -> Clock | None:
        """Times of measurement and receipt; None unless all messages have both."""
        stamps = self._times("stamp")
        return (stamps, self._times("received")) if (stamps > 0).all() else None

    @property
    def when(self) -> str:
        """Time in use: `stamp` if all messages have one, else `received`."""
        return "received" if self.clock is None else "stamp"

    @property
    def clock_notes(self) -> tuple[str, ...]:
        """Notes on messages without stamps."""
        if self.clock is not None:
            return ()
        some = "some messages" if (self._times("stamp") > 0).any() else "messages"
        return (f"{some} of {self.topic} have no stamps, so the time of receipt is used",)

    def _times(self, which: str) -> Stamps:
        return np.concatenate([np.zeros(0, np.int64), *(self.rows(k)[which] for k in self.groups)])


WANTED = re.compile(r"command|cmd|goal|target|desired|reference|setpoint", re.IGNORECASE)
"""Words in names of topics of commands."""

JOINT_STATE = "sensor_msgs/msg/JointState"
"""Type of messages for joint states in ROS."""

LCM_TYPES = ("lcmt_iiwa_status", "lcmt_jaco_status", "lcmt_panda_status")
"""Types of messages for joint states in LCM."""


@dataclass
class JointMessages(Messages):
    """Joint data in the messages of a topic, or of a channel of LCM."""

    # Function that reads all messages, if only the first ones were read.
    read: Callable[[], JointMessages] | None = None
    # Whether efforts are the output of a controller.
    from_controller: bool = field(default=False, init=False)

    def said(self, message: Any) -> Iterator[Said]:
        """Yield the data of joints in a message; unnamed joints are numbered from 0."""
        fields, numbers = dict(fields_of(_plain(message))), dict[str, Array]()
        joints: Owners = ()
        for quantity, paths in _fields_of_quantities(tuple(fields)).items():
            for path in paths:
                values = _joint_values(fields[path], quantity)
                if len(values) and not (isnan(values[0]) and np.isnan(values).all()):
                    numbers[quantity] = values
                    self.from_controller |= path == _OUTPUT
                    break
        if not is_complete(numbers) and (parts := _numbers_of_joints(fields)):
            joints, numbers = parts
        if "effort" in numbers:
            numbers.pop("command", None)
        if not numbers:
            return
        named = (x for n, x in fields.items() if n.rpartition(".")[2] in _NAMES)
        names = next((x for x in named if isinstance(x, list | tuple)), ())
        joints = joints or tuple(names) or tuple(range(len(next(iter(numbers.values())))))
        for quantity, values in numbers.items():
            if len(values) != len(joints):
                raise LogError(
                    f"Message {self.count} of {self.topic} has {len(joints)} joints, but "
                    f"{len(values)} values of {quantity}.",
                    advice="Was another message type recorded under that name?",
                )
        yield joints, numbers, message

    def column(self, owner: Hashable, name: str) -> str:
        """Return `<joint>.<quantity>`, or `<quantity>[<number>]` of an unnamed joint."""
        return f"{name}[{owner}]" if isinstance(owner, int) else f"{owner}.{name}"

    @property
    def quantities(self) -> frozenset[str]:
        """Quantities in the most complete messages."""
        most = max((q for _, q in self.groups), key=lambda q: (is_complete(q), len(q)), default=())
        return frozenset(most)

    @property
    def fits(self) -> bool:
        """Whether the topic has positions, and efforts or commands."""
        return is_complete(self.quantities)

    @property
    def is_wanted(self) -> bool:
        """Whether positions are commands, according to the name of the topic."""
        return bool(WANTED.search(self.topic))

    @property
    def made_for_joints(self) -> bool:
        """Whether the type of messages is only for joint states."""
        return self.kind in LCM_TYPES or (self.kind == JOINT_STATE and not self.is_wanted)

    @property
    def part(self) -> frozenset[str]:
        """Quantities that the topic contributes to a joined log."""
        present = self.quantities
        if NUMBERS in present:
            meaning = meaning_of(f"{self.topic}/{NUMBERS}[0]")
            return frozenset(() if meaning is None else (meaning.quantity,))
        return frozenset(("command",)) if self.is_wanted and "position" in present else present

    @property
    def has_efforts(self) -> bool:
        """Whether these include efforts or signals that replace them."""
        return not self.part.isdisjoint(EFFORT_KINDS)

    def __str__(self) -> str:
        listed = [q for q in (*QUANTITIES, *EFFORT_KINDS[1:]) if q in self.part]
        words = f", {len(self.joints)} joints with {', '.join(listed)}" if listed else ""
        return f"{self.topic} ({self.kind}{words})"

    @property
    def joints(self) -> Owners:
        """All joints, in order of appearance."""
        return tuple(dict.fromkeys(joint for joints, _ in self.groups for joint in joints))

    def tables(self, *, part: bool = False) -> list[LogTable]:
        """Return the data as tables; joints without effort are kept only in a part of a log."""
        groups = [key for key in self.groups if (key[1] if part else is_complete(key[1]))]
        notes = list[str]()
        if len({joints for joints, _ in groups}) > len({frozenset(joints) for joints, _ in groups}):
            notes.append(f"the order of joints in {self.topic} changes; joints are matched by name")
        silent = set(self.joints).difference(*(joints for joints, _ in groups))
        if silent:
            named = ", ".join(str(joint) for joint in self.joints if joint in silent)
            notes.append(f"joints without effort are not used: {named}")
        for key in groups:
            steps = np.diff(self.rows(key)[self.when])
            if np.any(steps < 0):
                index = int(np.argmax(steps < 0))
                raise LogError(
                    f"Time runs backwards in {self.topic}: message {index + 2} is "
                    f"{-steps[index] / 1e9:.3g} s before message {index + 1} of "
                    f"{', '.join(map(str, key[0][:3]))}, ….",
                    advice="Was a clock set, a simulation restarted, or are there two "
                    "publishers? Cut the recording there.",
                )
            if repeated := np.count_nonzero(steps == 0):
                notes.append(f"{repeated} messages with a repeated stamp are skipped")
        first, *others = self.tables_of(groups)
        return [first.noting(*notes), *others]


def stamp_of(message: Any) -> int:
    """Return the time stamp (ns) of a message of ROS, LCM or JSON, or 0."""
    stamp = _field(_field(message, "header") or message, "stamp")
    seconds = _field(stamp, "sec", "secs")
    if seconds is None:
        return 1000 * int(_field(message, "utime") or 0)
    return int(seconds) * 1_000_000_000 + int(_field(stamp, "nanosec", "nsec", "nsecs") or 0)


def _field(message: Any, *names: str) -> Any:
    """Return the first existing field among some names, of an object or a dict; else None."""
    for name in names:
        value = message.get(name) if isinstance(message, dict) else getattr(message, name, None)
        if value is not None:
            return value
    return None


_LEAVES = (str, int, float, np.ndarray)


def _plain(message: Any) -> Any:
    """Convert a message and nested ones to dicts without headers.

    A list of messages becomes a dict of lists; a message of names and values, a dict of these.
    """
    if isinstance(message, _LEAVES):
        return message
    if isinstance(message, list):
        if message and all(isinstance(value, float | int) for value in message):  # in JSON
            return np.array(message, float)
        first = _plain(message[0]) if message else None
        if not isinstance(first, dict):
            return message
        rows = [first, *map(_plain, message[1:])]
        names = dict.fromkeys(name for row in rows for name in row)
        return {name: [row.get(name, np.nan) for row in rows] for name in names}
    if (names := _field(message, "interface_names")) is not None:
        return dict(zip(names, _field(message, "values"), strict=True))
    fields = message if isinstance(message, dict) else getattr(message, "__dict__", None)
    fields = fields or {name: getattr(message, name) for name in getattr(message, "__slots__", ())}
    return {str(n): _plain(x) for n, x in fields.items() if n != "header"} if fields else message


def _numbers_of_joints(fields: Mapping[str, Any]) -> tuple[Owners, dict[str, Array]] | None:
    """Return the joints and quantities of a message with a named part for each joint."""
    values_of = defaultdict[str, dict[str, float]](dict)
    for path, meaning in _parts_of_joints(tuple(fields)).items():
        if isinstance(fields[path], float | int):
            values_of[meaning.quantity][meaning.joint] = fields[path]
    joints = tuple(values_of.get("position", ()))
    complete = {q: np.array([*x.values()]) for q, x in values_of.items() if tuple(x) == joints}
    return (joints, complete) if is_complete(complete) else None


@lru_cache(1024)
def _parts_of_joints(paths: tuple[str, ...]) -> dict[str, Meaning]:
    """Return the fields of a message that name joints, with their meanings."""
    told = {path: meaning_of(path.replace(".", "/")) for path in paths}
    return {p: m for p, m in told.items() if m and m.role <= PLAIN and m.joint not in (*"xyzw", "")}


def _joint_values(values: Any, quantity: str) -> Array:
    """Return the numbers (n,) of joints, with one temperature each; (0,) for other values."""
    array = array_of(values)
    if array.ndim == 2 and quantity == "temperature":
        array = array[:, 0]
    elif array.ndim == 2 and len(array) == 1:  # trajectory of one point
        array = array[0]
    return array if array.ndim == 1 and array.dtype.kind in "fiu" else np.zeros(0)


@lru_cache(1024)
def _fields_of_quantities(paths: tuple[str, ...]) -> dict[str, list[str]]:
    """Return quantity -> fields of a message that may contain it, best first.

    Target positions are commands, which may replace efforts. Numbers without a quantity are stored
    as `NUMBERS`.
    """
    ranked = defaultdict[str, list[tuple[int, str]]](list)
    for path in paths:
        meaning = meaning_of(f"{path.replace('.', '/')}[0]")
        if path == NUMBERS and _LAYOUT in paths:
            ranked[NUMBERS].append((MEASURED, path))
        if path == NUMBERS or meaning is None or meaning.role >= PREVIOUS:
            continue
        quantity, role = meaning.quantity, meaning.role
        if path.partition(".")[0] == "output":
            quantity, role = quantity if path == _OUTPUT else "", OTHER
        elif meaning.is_wanted or path.startswith(_POINTS):
            quantity = "command" if quantity in ("position", "command") else ""
        if quantity:
            ranked[quantity].append((role, path))
    return {q: [path for _, path in sorted(own, key=itemgetter(0))] for q, own in ranked.items()}


_SOURCES = [kinds.split() for kinds in WORDS["base_messages"]]
_WORLDS = ("world", "map", "odom")


def base_sources(kinds: Mapping[str, str], named: Sequence[str]) -> list[list[str]]:
    """Return the topics of the pose of a base, its IMU and each foot, best first in each source.

    `kinds` maps topics to types. A `named` topic excludes the others of its source.
    """
    sources = []
    for source in _SOURCES:
        topics = [name for name, kind in kinds.items() if kind in source]
        dynamic = [name for name in topics if not name.endswith("tf_static")]
        of_base = [n for n in dynamic if "/Pose" not in kinds[n] or IS_BASE.search(n)]
        topics = [name for name in topics if name in named] or of_base
        topics.sort(key=lambda n: (source.index(kinds[n]), IS_BASE.search(n) is None))
        sources += [topics] if source != _SOURCES[-1] else [[name] for name in topics]
    return sources


@dataclass
class BaseMessages(Messages):
    """Data of a floating base, its IMU, or forces at feet in the messages of one topic."""

    def said(self, message: Any) -> Iterator[Said]:
        """Yield the data of each frame in a message."""
        for part, frame in _frames(message):
            fields = dict(fields_of(_plain(part)))
            called = frame or self.topic.strip("/").rpartition("/")[0]
            if told := _floating(tuple(fields), called):
                yield (frame,), {name: fields[path] for name, path in told.items()}, part

    def tables(self) -> list[LogTable]:
        """Return a table for each frame, with continuous quaternions."""
        found = self.tables_of(self.groups, shared=False)
        for table in found:
            turned = [n for n in table.columns if n.startswith("base.orientation")]
            if turned:
                q = unwound(np.stack([table.columns[name] for name in turned], -1), turned)
                table.columns |= dict(zip(turned, q.T, strict=True))  # type: ignore[operator]
        return [replace(table, path=Path(self.topic)) for table in found]


def _frames(message: Any) -> Iterator[tuple[Any, str]]:
    """Yield the parts of a message about base frames, and the frames' names."""
    if not hasattr(message, "transforms"):
        yield message, message.header.frame_id.strip("/").rpartition("/")[2]
    for each in getattr(message, "transforms", ()):
        parent = each.header.frame_id.strip("/").rpartition("/")[2]
        child = each.child_frame_id.strip("/").rpartition("/")[2]
        if parent in _WORLDS and child not in _WORLDS and IS_BASE.search(child):
            yield each, f"{each.header.frame_id} {each.child_frame_id}"


@lru_cache(1024)
def _floating(paths: tuple[str, ...], frame: str) -> dict[str, str]:
    """Return column -> field of a message, for a floating base, an IMU or a foot."""
    heads = {path.partition(".")[0] for path in paths}
    kind = "imu" if "linear_acceleration" in heads else "foot" if "wrench" in heads else "base"
    names = {path: m.quantity for path in paths if (m := floating_meaning(f"{kind}.{path}"))}
    if kind != "foot":
        return {name: path for path, name in names.items()}
    return {f"{frame}{name.removeprefix(kind)}": path for path, name in names.items()}
