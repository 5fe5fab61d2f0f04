"""Read recordings of messages: bags of ROS 1 and 2, MCAP files, and logs of LCM."""

from __future__ import annotations

import importlib
import json
import re
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby, islice
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any, TypeVar

from geodrake.boundary.input_files import open_regular, regular_files
from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import LogError
from geodrake.logs.files.messages import (
    JOINT_STATE,
    LCM_TYPES,
    WANTED,
    BaseMessages,
    JointMessages,
    Messages,
    base_sources,
)
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import LogTable, readable
from geodrake.logs.files.topics import Received, chosen_topics, topics_of, topics_table
from geodrake.logs.files.units import WORDS

_FIRST = 20  # messages used to probe a topic, as publishers may take turns
_DYNAMIC_STATE = "control_msgs/msg/DynamicJointState"
_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
_NUMBERS = re.compile(r"std_msgs/msg/(Float|Int)\d+MultiArray")
_WORDS = re.compile(r"effort|torque|trq|\btau")  # in definitions of types with efforts
_IDL_RULE = "=" * 80 + "\n"  # between definitions in IDL
_LONGEST_DEFINITION = 50_000  # characters of a type definition, as parsing takes seconds
_LONG_ARRAY = re.compile(r"\[\d{5,}\]")  # fixed size, allocated even without data
_REPAIR = (
    "If the recording is truncated, repair it: `ros2 bag reindex` for a folder, `mcap "
    "recover` for .mcap, `rosbag reindex` for .bag."
)

Decoder = Callable[[bytes, str], Any]
"""Function from the bytes and the type of a message to the message."""

M = TypeVar("M", bound=Messages)


def read_bag(path: Path, reading: Reading) -> LogTable:
    """Read a ROS bag."""
    if path.suffix.lower() == ".mcap" and (profile := _profile(path)) is not None:
        return _read_channels(path, reading, profile)
    is_first = path.suffix.lower() == ".bag"
    method = "deserialize_ros1" if is_first else "deserialize_cdr"
    module = f"rosbags.rosbag{1 if is_first else 2}"
    package = optional_package(module, "logs", "ROS bags", LogError)
    with readable(path, "ROS bag", _REPAIR), package.Reader(_storage(path)) as reader:
        connections = sorted((c for c in reader.connections if c.msgcount), key=lambda c: c.topic)
        groups = groupby(connections, key=lambda c: c.topic)
        topics = [_probed(reader, [*each], method) for _, each in groups]
        base, notes, of_base = _base(reader, connections, method, reading)
        requested = [name for name in reading.topics if name.strip("/") not in of_base]
        chosen = chosen_topics(path, topics, replace(reading, topic=requested or None))
        messages = [each.read() for each in chosen if each.read is not None]
    return topics_table(path, messages, topics, reading, base).noting(*notes)


_MCAP = re.compile(rb"\x89MCAP0\r\n\x01.{8}(.)\0\0\0", re.DOTALL)


def _profile(path: Path) -> str | None:
    """Return the profile of an MCAP file; None for ROS 2, or if the file is not MCAP."""
    with open_regular(path, "log", LogError) as file:
        found = _MCAP.match(file.read(21))
        profile = file.read(found[1][0]).decode(errors="replace") if found else "ros2"
    return None if profile == "ros2" else profile


def _read_channels(path: Path, reading: Reading, profile: str) -> LogTable:
    """Read an MCAP file of messages in JSON or protobuf, such as Foxglove's."""
    package = optional_package("mcap_protobuf.decoder", "logs", "MCAP files", LogError)
    factory, make = package.DecoderFactory(), importlib.import_module("mcap.reader").make_reader
    plain = importlib.import_module("google.protobuf.json_format").MessageToDict
    options = {"preserving_proto_field_name": True, "always_print_fields_with_no_presence": True}

    def messages(file: Any) -> Iterator[Received]:
        for schema, channel, message in make(file).iter_messages():
            decode = factory.decoder_for(channel.message_encoding, schema)
            if decode is None and channel.message_encoding != "json":
                raise LogError(
                    f"Log {str(path)!r} has messages of {channel.topic} in "
                    f"{channel.message_encoding!r}; its profile is {profile!r}.",
                    advice="Of MCAP files other than ROS's, JSON and protobuf are read.",
                )
            data = message.data
            read = json.loads(data) if decode is None else plain(decode(data), **options)
            yield channel.topic, schema.name if schema else "json", read, message.log_time

    with readable(path, "MCAP file", _REPAIR), open_regular(path, "log", LogError) as file:
        topics = topics_of(messages(file))
    return topics_table(path, chosen_topics(path, topics, reading), topics, reading)


def _base(
    reader: Any, connections: Sequence[Any], method: str, reading: Reading
) -> tuple[list[BaseMessages], list[str], set[str]]:
    """Return the data of a floating base and its feet, notes, and the names of their topics."""
    if not reading.of_base:
        return [], [], set()
    requested = [name.strip("/") for name in reading.topics]
    topics = {c.topic.strip("/"): c for c in connections}
    kinds = {n: c.msgtype for n, c in topics.items() if n in requested or not WANTED.search(n)}
    base, others, sources = list[BaseMessages](), list[str](), base_sources(kinds, requested)
    for names in sources:
        for k, name in enumerate(names):
            matching = [each for each in connections if each.topic == topics[name].topic]
            kind, definition = matching[0].msgtype, matching[0].msgdef
            decode = getattr(_store(kind, definition.data, definition.format.name), method)
            rows = _messages(reader, matching, decode, BaseMessages(matching[0].topic))
            if rows.groups:
                base.append(rows)
                others += [topics[other].topic for other in names[k + 1 :]]
                break
    read = ", ".join(rows.topic for rows in base)
    notes = [f"base and feet are read from {read}"] if base else []
    notes += [f"{', '.join(others)} have the same (--topic)"] if others else []
    return base, notes, {name for names in sources for name in names}


def _storage(path: Path) -> Path:
    """Return the path for the reader: the folder, or its only file if metadata are missing."""
    if not path.is_dir():
        return path
    inside = regular_files((each for each in path.iterdir() if not each.is_dir()), "log", LogError)
    if path / "metadata.yaml" in inside:
        return path
    files = [each for each in inside if each.suffix in (".mcap", ".db3")]
    if len(files) == 1:
        return files[0]
    raise LogError(
        f"Log {str(path)!r} has {len(files)} bag files, but no metadata.yaml, which defines "
        "their order.",
        advice=f"Create it with ros2 bag reindex {path}, or give one of the files.",
    )


def _probed(reader: Any, connections: Sequence[Any], method: str) -> JointMessages:
    """Return a topic with its first messages."""
    name, kind, definition = (getattr(connections[0], x) for x in ("topic", "msgtype", "msgdef"))
    for text in _definitions(kind, definition):
        try:
            decode = getattr(_store(kind, text, definition.format.name), method)
            read = partial(_messages, reader, connections, decode)
            read_all = partial(read, JointMessages(name, kind))
            return read(JointMessages(name, kind, read_all), _FIRST)
        except _decoding_errors():
            if kind == JOINT_STATE:  # other types may be unknown
                raise
    return JointMessages(name, kind)


def _messages(
    reader: Any, connections: Sequence[Any], decode: Decoder, found: M, most: int | None = None
) -> M:
    """Add the messages of a topic, at most the first few, to `found`."""
    for connection, received, data in islice(reader.messages(connections=connections), most):
        found.add(decode(data, connection.msgtype), received)
    return found


def _definitions(kind: str, definition: Any) -> Sequence[str]:
    """Return the possible definitions of a message type, if it may be about joints."""
    if len(definition.data) > _LONGEST_DEFINITION or _LONG_ARRAY.search(definition.data):
        return ()  # not a message about joints
    numbers = kind == _DYNAMIC_STATE or _NUMBERS.fullmatch(kind)
    if definition.data:
        return (definition.data,) if numbers or _WORDS.search(definition.data) else ()
    if kind in (JOINT_STATE, _TRAJECTORY) or _NUMBERS.fullmatch(kind):
        return ("",)
    return WORDS["definitions"].get(kind, ())


def _store(kind: str, definition: str, form: str) -> Any:
    """Return the type store for a message, with the bag's definition or those of ROS 2."""
    typesys = importlib.import_module("rosbags.typesys")
    stores = typesys.Stores
    store = typesys.get_typestore(stores.LATEST if form == "NONE" else stores.EMPTY)
    if form == "IDL":
        for part in definition.split(_IDL_RULE):
            text = part.partition("\n")[2] if part.startswith("IDL: ") else part
            store.register(typesys.get_types_from_idl(text) if text.strip() else {})
    elif definition:
        types = typesys.get_types_from_msg(definition, kind)
        store.register(
            {name: fields for name, fields in types.items() if form == "MSG" or name == kind}
        )
    return store


def _decoding_errors() -> tuple[type[Exception], ...]:
    """Return the exceptions for unreadable types, and for messages that do not fit their type."""
    serde, typesys = map(importlib.import_module, ("rosbags.serde", "rosbags.typesys"))
    return serde.SerdeError, typesys.TypesysError, LogError, TypeError, ValueError, RecursionError


MAGIC = b"\xed\xa1\xda\x01"
"""Magic number at the start of each event."""

_NEGATIVE = ("lcmt_iiwa_status",)
"""Types whose torques are defined with the opposite sign to Drake's."""

_EVENT = struct.Struct(">4sQQII")  # magic, number, time, lengths of channel name and message
_FINGERPRINT = 8  # bytes that identify the type of a message


def read_lcm(path: Path, reading: Reading) -> LogTable:
    """Read the channels of an LCM log whose message types are known."""
    with readable(path, "LCM log"), open_regular(path, "log", LogError) as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise LogError(
                f"Log {str(path)!r} is not an LCM log: its first bytes differ.",
                advice="Record it with lcm-logger.",
            )
        with mmap(file.fileno(), 0, access=ACCESS_READ) as log:
            topics = _channels(log)
    chosen = chosen_topics(path, topics, reading)
    table = topics_table(path, chosen, topics, reading)
    negated = dict.fromkeys(topic.kind for topic in chosen if topic.kind in _NEGATIVE)
    notes = [f"efforts have the opposite sign, as {kind} defines torques" for kind in negated]
    return replace(table, notes=(*table.notes, *notes))


def _channels(log: mmap) -> list[JointMessages]:
    """Return all channels with their messages, ignoring a truncated one at the end."""
    kinds = [getattr(importlib.import_module("drake"), name) for name in LCM_TYPES]
    types = {kind._get_packed_fingerprint(): kind for kind in kinds}
    topics: dict[str, JointMessages] = {}
    offset = 0
    while 0 <= offset <= len(log) - _EVENT.size:
        _, number, received, name_length, message_length = _EVENT.unpack_from(log, offset)
        begin = offset + _EVENT.size + name_length
        name = log[offset + _EVENT.size : begin].decode(errors="replace")
        kind: Any = types.get(log[begin : begin + _FINGERPRINT])
        if (end := begin + message_length) > len(log):
            break
        offset = log.find(MAGIC, end)
        if kind is None:
            topics.setdefault(name, JointMessages(name, "another type"))
            continue
        if name not in topics or not topics[name].made_for_joints:
            topics[name] = JointMessages(name, kind.__name__)
        try:
            message = kind.decode(log[begin:end])
        except (struct.error, ValueError) as error:
            raise LogError(
                f"Message {number} of the log on channel {name} is truncated or damaged: {error}.",
                advice="Record again, or remove that message.",
            ) from error
        for field in kind.__slots__ if kind.__name__ in _NEGATIVE else ():
            if "torque" in field:
                setattr(message, field, [-torque for torque in getattr(message, field)])
        topics[name].add(message, 1000 * received)
    return list(topics.values())
