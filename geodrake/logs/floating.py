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
from geodrake.logs.held_readings import held_readings

AXES, QUATERNION, ANGLES = ("x", "y", "z"), ("w", "x", "y", "z"), ("roll", "pitch", "yaw")
_STUCK_ROWS, _STUCK_SECONDS, _JUMPS = 20, 0.25, 3.0  # of stuck values, and jump in usual changes
_POSE = "base.position", "base.orientation"
_BESIDE = 0.02  # s, uncertainty of the instants of contact


def vectors(columns: Mapping[str, Array], name: str) -> Array | None:
    """Return `name.x`, `.y`, `.z` as (N, 3), or a quaternion as (N, 4); None if missing."""
    axes = QUATERNION if name.endswith("orientation") else AXES
    if not all(f"{name}.{axis}" in columns for axis in axes):
        return None
    return np.stack([columns[f"{name}.{axis}"] for axis in axes], -1)


def orientation(columns: Mapping[str, Array]) -> tuple[tuple[str, ...], Array] | None:
    """Return the axes and values (N, k) of a quaternion, angles or a matrix, or None."""
    for axes in (QUATERNION, ANGLES, tuple("012345678"), tuple("0123")):
        names = [f"base.orientation.{axis}" for axis in axes]
        if all(name in columns for name in names):
            return axes, np.stack([columns[name] for name in names], -1)
    return None


def without_held(
    time: Array, columns: Mapping[str, Array]
) -> tuple[dict[str, Array], NDArray[np.bool_], list[str]]:
    """Return columns without held or stuck readings, the usable rows (N,), and notes.

    If a source is slower than the log, its readings are held until the next one. The rows with new
    readings of the slowest source are usable. Readings of faster ones are interpolated, and so is
    a pose if there is an IMU. Poses that are stuck until they jump are left out.
    """
    repaired, slow, notes = dict(columns), dict[str, tuple[int, NDArray[np.bool_]]](), list[str]()
    for head in dict.fromkeys(n.rpartition(".")[0] for n in columns if not n.endswith(FLAG)):
        names = [name for name in columns if name.rpartition(".")[0] == head]
        values = unwound(np.stack([columns[name] for name in names], -1), names)
        if head in _POSE and (stuck := _stuck(time, values)).any():
            values[stuck] = np.nan
            notes.append(f"{head} is stuck and then jumps: {stuck.sum()} rows of it are not used")
        elif held := held_readings(values):
            slow[head] = held
            new = slow[head][1] & np.isfinite(values).all(axis=1)
            spline = make_interp_spline(time[new], values[new], k=1 if "force" in head else 3)
            values[~new] = np.where(np.isfinite(values[~new]), spline(time[~new]), np.nan)
        else:
            continue
        repaired |= dict(zip(names, values.T, strict=True))
    if not slow:
        return repaired, np.ones(len(time), bool), notes
    has_imu = vectors(columns, "imu.linear_acceleration") is not None
    rows = {head: new for head, (_, new) in slow.items() if not (has_imu and head in _POSE)}
    slowest = max(rows, key=lambda head: slow[head][0], default="")
    heads = {every: [h for h in slow if slow[h][0] == every] for every, _ in slow.values()}
    rates = "; ".join(f"{', '.join(own)} every {every} rows" for every, own in heads.items())
    words = f"rows without those of {slowest} are not used" if rows else "interpolated"
    notes.append(f"new values are less frequent than rows, {rates}: {words}")
    return repaired, rows.get(slowest, np.ones(len(time), bool)), notes


def _stuck(time: Array, values: Array) -> NDArray[np.bool_]:
    """Return the repeated rows (N,) of values (N, k) that are equal for too long and then jump."""
    changes = np.linalg.norm(np.diff(values, axis=0), axis=1)
    starts = np.flatnonzero(np.append(True, changes != 0.0))
    lengths = np.diff(np.append(starts, len(time)))
    ends = starts + lengths - 1
    is_long = (lengths > _STUCK_ROWS + 1) & (time[ends] - time[starts] > _STUCK_SECONDS)
    after = np.append(changes, 0.0)[ends]
    usual = np.nanmax(np.where(is_long, 0.0, after), initial=0.0)
    stuck = np.repeat(is_long & (after > _JUMPS * usual), lengths)
    stuck[starts] = False
    return np.asarray(stuck)


def unwound(values: Array, names: Sequence[str]) -> Array:
    """Return values (N, k) with angles unwrapped, and with continuous signs of quaternions."""
    if names[0].endswith(ANGLES):
        return np.unwrap(values, axis=0, period=2.0 * np.pi if np.ptp(values) < 7.0 else 360.0)
    if len(names) != len(QUATERNION):
        return values.copy()
    flips = np.append(False, (values[1:] * values[:-1]).sum(axis=1) < 0.0)
    return values * np.where(np.cumsum(flips) % 2, -1.0, 1.0)[:, None]


FORCE, FLAG = ".force.x", ".contact"
"""Endings of the names of columns of forces and contact flags."""


def frames_of(columns: Mapping[str, Array], end: str) -> tuple[str, ...]:
    """Return the frames of columns with an ending, in order."""
    return tuple(name.removesuffix(end) for name in columns if name.endswith(end))


@dataclass(frozen=True, eq=False)
class ContactFlags:
    """Times at which frames may touch the ground."""

    frames: tuple[str, ...]  # names of the c frames
    time: Array  # (K,) instants, s
    flags: NDArray[np.bool_]  # (K, c) whether each may touch

    def at(self, time: Array) -> NDArray[np.bool_]:
        """Return whether frames may touch (N, c) just before or after instants (N,)."""
        after = np.clip(np.searchsorted(self.time, time), 0, len(self.time) - 1)
        return np.asarray(self.flags[np.maximum(after - 1, 0)] | self.flags[after])


def odd_flags(time: Array, flags: NDArray[np.bool_]) -> Array:
    """Return the shares (c,) of flags (N, c) that differ from most of those just before and after.

    No foot touches or lifts for such a short time.
    """
    counts, sums = _around(time, flags)
    return np.asarray((flags != (2 * sums > counts[:, None])).mean(axis=0))


def widened(time: Array, flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return flags (N, c) with contacts that begin slightly earlier and end slightly later."""
    return np.asarray(_around(time, flags)[1] > 0)


def _around(time: Array, flags: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the numbers of rows (N,) around each instant, and of contacts (N, c) in them."""
    first = np.searchsorted(time, time - _BESIDE)
    last = np.searchsorted(time, time + _BESIDE, side="right")
    sums = np.vstack([np.zeros((1, flags.shape[1])), np.cumsum(flags, axis=0)])
    return (last - first).astype(float), sums[last] - sums[first]
