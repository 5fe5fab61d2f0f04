"""Names of the columns of a free base and its contacts, and contact flags.

    base.position.x … z             m, of the root body's origin in the world
    base.orientation.w, x, y, z     its quaternion, body to world; or .roll, .pitch, .yaw, about
                                    fixed axes, rad; or numbers .0 … .8 of its matrix, row by row,
                                    or .0 … .3 of a quaternion of unknown order
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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from geodrake.boundary.arguments import Array

AXES, QUATERNION, ANGLES = ("x", "y", "z"), ("w", "x", "y", "z"), ("roll", "pitch", "yaw")
_LONGER = 2.0  # times the usual run of equal values
_MOSTLY, _FEWEST = 0.8, 20  # share of runs that are as long, and number of runs
_STUCK_ROWS, _STUCK_SECONDS, _JUMPS = 20, 0.25, 3.0  # of what is stuck, and times usual changes
_POSE = "base.position", "base.orientation"
_BESIDE = 0.02  # s, around a touch or a lift within which a frame may be in contact


def vectors(columns: Mapping[str, Array], name: str) -> Array | None:
    """Return (N, 3) of `name.x`, `.y` and `.z`, or (N, 4) of an orientation; None without."""
    axes = QUATERNION if name.endswith("orientation") else AXES
    if not all(f"{name}.{axis}" in columns for axis in axes):
        return None
    return np.stack([columns[f"{name}.{axis}"] for axis in axes], -1)


def orientation(columns: Mapping[str, Array]) -> tuple[tuple[str, ...], Array] | None:
    """Return the names and values (N, k) of a quaternion, angles or a matrix; None without."""
    for axes in (QUATERNION, ANGLES, tuple("012345678"), tuple("0123")):
        names = [f"base.orientation.{axis}" for axis in axes]
        if all(name in columns for name in names):
            return axes, np.stack([columns[name] for name in names], -1)
    return None


def without_held(
    time: Array, columns: Mapping[str, Array]
) -> tuple[dict[str, Array], NDArray[np.bool_], list[str]]:
    """Return columns without readings that are held or stuck, which rows are of use, and notes.

    Where a source is slower than the log, its readings are held until the next ones come. The rows
    that have those of the slowest source are of use, and the others' are interpolated, as is a pose
    beside an IMU. A pose that is stuck, and then jumps to where the base is, is left out.
    """
    found, slow, notes = dict(columns), dict[str, tuple[int, NDArray[np.bool_]]](), list[str]()
    for head in dict.fromkeys(n.rpartition(".")[0] for n in columns if not n.endswith(FLAG)):
        names = [name for name in columns if name.rpartition(".")[0] == head]
        values = unwound(np.stack([columns[name] for name in names], -1), names)
        changes = np.linalg.norm(np.diff(values, axis=0), axis=1)
        starts = np.flatnonzero(np.append(True, changes != 0.0))
        lengths = np.diff(np.append(starts, len(values)))
        run = np.repeat(np.arange(len(starts)), lengths)  # of equal values, of each row
        is_held, every = np.arange(len(values)) != starts[run], int(np.median(lengths))
        is_short = lengths <= _LONGER * every  # otherwise it stays the same
        if head in _POSE and (lost := is_held & _stuck(time, starts, changes)[run]).any():
            values[lost] = np.nan
            notes.append(f"{head} is stuck and then jumps: {lost.sum()} rows of it are not used")
        elif len(lengths) >= _FEWEST and np.mean(is_short & (lengths > 1)) >= _MOSTLY:
            slow[head] = every, ~(is_held & is_short[run])
            new = slow[head][1] & np.isfinite(values).all(axis=1)
            spline = make_interp_spline(time[new], values[new], k=1 if "force" in head else 3)
            values[~new] = np.where(np.isfinite(values[~new]), spline(time[~new]), np.nan)
        else:
            continue
        found |= dict(zip(names, values.T, strict=True))
    if not slow:
        return found, np.ones(len(time), bool), notes
    has_imu = vectors(columns, "imu.linear_acceleration") is not None
    rows = {head: new for head, (_, new) in slow.items() if not (has_imu and head in _POSE)}
    slowest = max(rows, key=lambda head: slow[head][0], default="")
    heads = {every: [h for h in slow if slow[h][0] == every] for every, _ in slow.values()}
    said = "; ".join(f"{', '.join(own)} every {every} rows" for every, own in heads.items())
    words = f"rows without those of {slowest} are not used" if rows else "interpolated"
    notes.append(f"new values come more seldom than rows, {said}: {words}")
    return found, rows.get(slowest, np.ones(len(time), bool)), notes


def _stuck(time: Array, starts: NDArray[np.intp], changes: Array) -> NDArray[np.bool_]:
    """Return which runs (K,) of equal values from rows on last too long and end with a jump."""
    ends = np.append(starts[1:], len(time)) - 1
    is_long = (ends - starts > _STUCK_ROWS) & (time[ends] - time[starts] > _STUCK_SECONDS)
    after = np.append(changes, 0.0)[ends]
    usual = np.nanmax(np.where(is_long, 0.0, after), initial=0.0)
    return np.asarray(is_long & (after > _JUMPS * usual))


def unwound(values: Array, names: Sequence[str]) -> Array:
    """Return values (N, k) without jumps by a turn of angles, and of signs of quaternions."""
    if names[0].endswith(ANGLES):
        return np.unwrap(values, axis=0, period=2.0 * np.pi if np.ptp(values) < 7.0 else 360.0)
    if len(names) != len(QUATERNION):
        return values.copy()
    flips = np.append(False, (values[1:] * values[:-1]).sum(axis=1) < 0.0)
    return values * np.where(np.cumsum(flips) % 2, -1.0, 1.0)[:, None]


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
