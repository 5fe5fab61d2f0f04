"""Messages of ROS about a free base, its IMU, and forces at its feet, as columns of a log."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geodrake.logs.files.joint_messages import Clock, MessageNumbers, on_clock, stamp_of
from geodrake.logs.files.table import LogTable
from geodrake.logs.floating import AXES, IS_BASE, QUATERNION

_POSES = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")
_SOURCES = (
    ("nav_msgs/msg/Odometry", *_POSES, "tf2_msgs/msg/TFMessage"),
    ("sensor_msgs/msg/Imu",),
    ("geometry_msgs/msg/WrenchStamped",),
)
"""Types of messages about the pose of a base, its IMU and its feet, the best first."""

_WORLDS = ("world", "map", "odom")
_PATHS = {
    "base.position": ("pose.pose.position", "pose.position", "translation"),
    "base.orientation": ("pose.pose.orientation", "pose.orientation", "rotation"),
    "base.linear_velocity": ("twist.twist.linear",),
    "base.angular_velocity": ("twist.twist.angular",),
    "imu.angular_velocity": ("angular_velocity",),
    "imu.linear_acceleration": ("linear_acceleration",),
    ".force": ("wrench.force",),
    ".torque": ("wrench.torque",),
}
"""Column, after the frame of a wrench -> where messages may have it."""


def base_sources(
    kinds: Mapping[str, str], named: Sequence[str]
) -> tuple[list[str], list[str], list[str]]:
    """Return the topics of poses, of IMUs and of wrenches, the best first.

    `kinds` are the types of topics; those that are `named` are the only ones of their source.
    """
    asked = {name.strip("/") for name in named}

    def of(source: tuple[str, ...]) -> list[str]:
        able = [name for name, kind in kinds.items() if kind in source]
        able = [name for name in able if name.strip("/") in asked] or [
            name
            for name in able
            if not name.endswith("tf_static")
            and (kinds[name] not in _POSES or IS_BASE.search(name))
        ]
        return sorted(able, key=lambda n: (source.index(kinds[n]), IS_BASE.search(n) is None))

    poses, imus, wrenches = map(of, _SOURCES)
    return poses, imus, wrenches


def base_tables(
    topic: str, messages: Iterable[tuple[Any, int]], clock: Clock | None = None
) -> list[LogTable]:
    """Return the tables of a topic, from its messages and when they were received, ns.

    What is said of several frames in one topic makes several tables. Where a message has no stamp,
    those of all are times of receipt, on a clock if one is given.
    """
    rows = MessageNumbers(topic)
    for message, received in messages:
        rows.count += 1
        for part, frame in _parts(message):
            told = dict(_numbers(part, frame or topic.strip("/").rpartition("/")[0]))
            if told:
                rows.take((frame, *told), np.array([*told.values()]), stamp_of(part), received)
    tables = list[LogTable]()
    for key in rows.groups:
        (_, *names), (stamps, values) = key, rows.rows(key)
        stamps, first = np.unique(stamps, return_index=True)
        values = values[first]
        turned = [k for k, name in enumerate(names) if name.startswith("base.orientation")]
        q = values[:, turned]  # and its negative are the same orientation: the nearer one is taken
        back = np.einsum("ni,ni->n", q[1:], q[:-1]) < 0.0
        values[1:, turned] *= np.where(np.cumsum(back) % 2, -1.0, 1.0)[:, None]
        columns = {"time": 1e-9 * (stamps - stamps[0])}
        columns |= {name: values[:, k].copy() for k, name in enumerate(names)}
        table = LogTable(Path(topic), columns, origins={"time": int(stamps[0])})
        tables.append(table if rows.clock else on_clock(table, clock).noting(*rows.clock_notes))
    return tables


def _parts(message: Any) -> Iterator[tuple[Any, str]]:
    """Return what of a message tells of a frame, and the name of that frame."""
    if not hasattr(message, "transforms"):
        yield message, message.header.frame_id.strip("/").rpartition("/")[2]
    for each in getattr(message, "transforms", ()):
        parent = each.header.frame_id.strip("/").rpartition("/")[2]
        child = each.child_frame_id.strip("/").rpartition("/")[2]
        if parent in _WORLDS and child not in _WORLDS and IS_BASE.search(child):
            yield each, f"{each.header.frame_id} {each.child_frame_id}"


def _numbers(message: Any, frame: str) -> Iterator[tuple[str, float]]:
    """Return the columns of a message, and their numbers."""
    told = getattr(message, "transform", message)
    for name, paths in _PATHS.items():
        for path in paths:
            values = told
            for word in path.split("."):
                values = getattr(values, word, None)
            if values is not None:
                axes = QUATERNION if name.endswith("orientation") else AXES
                column = f"{frame}{name}" if name.startswith(".") else name
                yield from ((f"{column}.{axis}", float(getattr(values, axis))) for axis in axes)
                break
