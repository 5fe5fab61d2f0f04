"""Names of the columns of a free base and its contacts, and contact flags.

    base.position.x … z             m, of the root body's origin in the world
    base.orientation.w, x, y, z     its quaternion, body to world
    base.linear_velocity.x … z      m/s, in the body's axes, as the twist of ROS Odometry
    base.angular_velocity.x … z     rad/s, likewise
    imu.angular_velocity.x … z      rad/s, in the root body's axes
    imu.linear_acceleration.x … z   specific force at its origin, m/s², as that of ROS Imu
    <frame>.contact                 1 where a frame touches something, 0 where it does not
    <frame>.force.x … z             N, of what it touches on the robot, in the frame's axes
    <frame>.torque.x … z            N·m, about the frame's origin

Other names and units are understood as well: see `geodrake.logs.files.base_names`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import Array

AXES, QUATERNION = ("x", "y", "z"), ("w", "x", "y", "z")
_BESIDE = 0.02  # s, around a touch or a lift within which a frame may be in contact


def vectors(columns: Mapping[str, Array], name: str) -> Array | None:
    """Return (N, 3) of `name.x`, `.y` and `.z`, or (N, 4) of an orientation; None without."""
    axes = QUATERNION if name.endswith("orientation") else AXES
    if not all(f"{name}.{axis}" in columns for axis in axes):
        return None
    return np.stack([columns[f"{name}.{axis}"] for axis in axes], -1)


FORCE, FLAG = ".force.x", ".contact"
"""How columns end that have the force at a frame, and whether that touches something."""


def frames_of(columns: Mapping[str, Array], end: str) -> tuple[str, ...]:
    """Return the frames of which columns have an end, in their order."""
    return tuple(name.removesuffix(end) for name in columns if name.endswith(end))


@dataclass(frozen=True, eq=False)
class ContactFlags:
    """Frames that may touch the ground, and when."""

    frames: tuple[str, ...]  # names of the c frames
    time: Array  # (K,) instants, s
    flags: NDArray[np.bool_]  # (K, c) whether each may touch

    def at(self, time: Array) -> NDArray[np.bool_]:
        """Return (N, c) whether frames may touch in the rows beside instants (N,)."""
        after = np.clip(np.searchsorted(self.time, time), 0, len(self.time) - 1)
        return np.asarray(self.flags[np.maximum(after - 1, 0)] | self.flags[after])


def odd_flags(time: Array, flags: NDArray[np.bool_]) -> Array:
    """Return the shares (c,) of flags (N, c) that most of those just before and after contradict.

    No foot touches or lifts for so short a while.
    """
    counts, sums = _around(time, flags)
    return np.asarray((flags != (2 * sums > counts[:, None])).mean(axis=0))


def widened(time: Array, flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return flags (N, c) that start a little earlier and end a little later."""
    return np.asarray(_around(time, flags)[1] > 0)


def _around(time: Array, flags: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return how many flags (N,) there are around each instant, and how many of them hold."""
    first = np.searchsorted(time, time - _BESIDE)
    last = np.searchsorted(time, time + _BESIDE, side="right")
    sums = np.vstack([np.zeros((1, flags.shape[1])), np.cumsum(flags, axis=0)])
    return (last - first).astype(float), sums[last] - sums[first]
