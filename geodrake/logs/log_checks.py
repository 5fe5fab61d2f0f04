"""Checks of logs: uninformative commands, saturated efforts, and duplicates."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import Array
from geodrake.errors import ArgumentError, LogError
from geodrake.logs.motion import JointLog

_STILL = 2e-3  # rad or m, by which a joint may move and still stand
_SAME = 1e-6  # of what a joint moves, by which a copy of its positions may differ: it is rounded
_RATIOS = 57.3, 652.0, 11.4  # of rad, degrees and ticks of 4,096 a turn
_LAG, _FOLLOWS = 0.4, 0.8  # of such a ratio's logarithm, and correlation of what follows
_UNLIKE, _APART = 0.5, 5.0  # correlation of what does not, and times as far that it moves
_LATEST = 3  # rows by which a copy may be late
_WINDOW, _MOVING = 0.05, 0.1  # s, and the share of the largest way in them of a joint that moves
_FULL, _MOST = 1.0 - 1e-6, 0.9  # of the largest effort, and the share of rows that may be at it
_EVEN = 0.01  # by which steps between rounded values are off whole multiples of the least
_STEPS = 50  # resolutions that a largest value must have, or rounding may explain it


def check_commands(log: JointLog) -> None:
    """Raise for commands that always equal positions, are in another unit, or are of others."""
    unlike, moved = list[str](), 0
    for at, joint in enumerate(log.joints):
        if log.command is None or np.isfinite(log.effort[:, at]).any():
            continue
        command, position = log.command[:, at], log.position[:, at]
        known = np.isfinite(position)
        if not known.any() or position[known].max() - _STILL <= position[known].min():
            continue
        alike, size = _alike(command, position)
        is_unlike = size > 0.0 and (alike < _UNLIKE or not 1.0 / _APART < size < _APART)
        words = f"{joint} they correlate by {alike:.2f} and vary {size:.3g} times as much"
        unlike += [words] * is_unlike
        moved += size > 0.0
        if alike >= _FOLLOWS and any(
            abs(abs(np.log(size)) - np.log(ratio)) < _LAG for ratio in _RATIOS
        ):
            raise LogError(
                f"Commands of {joint} in log {log.name!r} move as positions, but {size:.3g} times "
                "as far.",
                advice="One of them is in another unit; give that of both, for example --units "
                "position=rad,command=deg, or ticks@2048.",
            )
        if any(_is_copy(command, position, late) for late in range(_LATEST + 1)):
            raise LogError(
                f"The command of {joint} in log {log.name!r} always equals its position, so "
                "its effort is unknown.",
                advice="Is it a copy of the measured position? Log the servo's command. If "
                "that is the command, move the joint faster, in steps or oscillations of "
                "some hertz, or with a load, so that the servo lags.",
            )
    is_alone = moved == 1 < len(log.joints)  # a heavy joint may sag, whatever it is told
    if unlike and len(unlike) == moved and not is_alone:
        raise LogError(
            f"No joint follows its commands in log {log.name!r}: of {unlike[0]} as positions.",
            advice="Are they increments, normalized, torques, or of an end effector? Log the "
            "positions that servos are told, or efforts.",
        )


def _alike(command: Array, position: Array) -> tuple[float, float]:
    """Return the correlation of commands and positions (N,), and the ratio of their deviations."""
    known = np.isfinite(command) & np.isfinite(position)
    first, second = command[known], position[known]
    sizes = (float(first.std()), float(second.std())) if known.any() else (0.0, 0.0)
    if not min(sizes) > 0.0:
        return 0.0, 0.0
    return float(np.corrcoef(first, second)[0, 1]), sizes[0] / sizes[1]


def _is_copy(command: Array, position: Array, late: int) -> bool:
    """Return whether commands are positions of some rows before, up to rounding."""
    command, position = command[: len(command) - late], position[late:]
    known = np.isfinite(command) & np.isfinite(position)
    if not known.any():
        return False
    command, position = command[known], position[known]
    digits = 4.0 * float(np.finfo(np.float32).eps) * float(np.abs(position).max())
    return bool(np.abs(command - position).max() <= max(np.ptp(_SAME * position), digits))


def check_saturation(log: JointLog, measured: JointLog | None = None) -> None:
    """Raise for efforts that are at their largest value most of the time.

    Where efforts are those of servos, by their commands, the log is told apart from what was
    `measured`, which has none there.
    """
    for at, joint in enumerate(log.joints):
        if log.effort_kinds.get(joint, "effort") not in ("effort", "current"):
            continue  # voltages may be switched
        effort = log.effort[_moving(log, at), at]
        effort = effort[np.isfinite(effort)]
        largest = float(np.abs(effort).max(initial=0.0))
        is_servo = measured is not None and not np.isfinite(measured.effort[:, at]).any()
        is_constant = not len(effort) or effort.max() == effort.min()
        if is_constant and not (is_servo and largest > 0.0):
            continue
        share = float(np.mean(np.abs(effort) >= _FULL * largest))
        if share > _MOST and (is_constant or not _is_coarse(effort)):
            if is_servo:
                raise _saturated_servo(log, at, largest, share)
            raise LogError(
                f"The {log.effort_kinds.get(joint, 'effort')} of {joint} in log {log.name!r} "
                f"is saturated: it is at its largest value, {largest:.4g}, in "
                f"{100 * share:.0f} % of the rows in which the joint moves.",
                advice="Move with less acceleration or load to stay within the drive's limit, "
                "or raise the limit.",
            )


def _saturated_servo(log: JointLog, at: int, largest: float, share: float) -> LogError:
    """Return the error that a servo is at its limit in a share of the rows in which it moves."""
    joint, command = log.joints[at], log.command
    stays = command is not None and not np.nanmax(command[:, at]) > np.nanmin(command[:, at])
    why = "its command never changes" if stays else "its command is far from its position"
    return LogError(
        f"The servo of {joint} in log {log.name!r} is saturated: {why}, and its effort is at the "
        f"limit, {largest:.4g}, in {100 * share:.0f} % of the rows in which the joint moves.",
        advice=f"Does that servo follow another command? If it is off, use --passive {joint}."
        if stays
        else "Check the command's unit and zero, or move with less acceleration or load.",
    )


def _moving(log: JointLog, at: int) -> NDArray[np.bool_]:
    """Return (N,) rows in which a joint moves."""
    time, position = log.time, log.position[:, at]
    steps = np.diff(time[np.isfinite(time)])
    rows = max(1, round(_WINDOW / float(np.median(steps)))) if len(steps) else 1
    way = np.zeros(len(position))
    if rows < len(position):
        way[:-rows] = np.abs(position[rows:] - position[:-rows])
    way = np.nan_to_num(way)
    return np.asarray(way > max(_MOVING * float(way.max(initial=0.0)), 0.0))


def _is_coarse(effort: Array) -> bool:
    """Return whether rounding alone may explain a largest value."""
    levels = np.unique(effort)
    if len(levels) == 2 and levels[0] == -levels[1]:
        return False  # a switch
    steps = np.diff(levels)
    ratios = steps / steps.min()
    is_rounded = np.all(np.abs(ratios - np.rint(ratios)) < _EVEN)
    return bool(is_rounded and np.abs(levels).max() < _STEPS * steps.min())


_TOGETHER = 8  # rows that follow each other, which two logs do not share by chance
_MOST_SHARED = 0.5  # of such rows of a log, that another may have


def check_repeated(logs: Sequence[JointLog]) -> None:
    """Raise if two logs have the same measurements.

    Positions and efforts of rows in which a joint moves count, and neither names nor time stamps.
    """
    digests = [_digests(log) for log in logs]
    for pair in combinations(range(len(logs)), 2):
        short, long = sorted(pair, key=lambda k: len(logs[k]))
        if np.isin(digests[short], digests[long]).sum() > _MOST_SHARED * len(digests[short]):
            raise ArgumentError(
                f"Log {logs[short].name!r} has the same measurements as {logs[long].name!r}, "
                "so it would be validated against itself.",
                advice="Give each log once.",
            )


def _digests(log: JointLog) -> NDArray[np.int64]:
    """Return a hash of some rows of each log."""
    if len(log) < _TOGETHER:
        return np.zeros(0, np.int64)
    rows, draw = np.hstack([log.position, log.effort]), np.random.default_rng(0).integers
    with np.errstate(over="ignore"):
        each = rows.view(np.int64) @ draw(1 << 62, size=rows.shape[1])
        found = np.convolve(each, draw(1 << 62, size=_TOGETHER), "valid")
    still = np.concatenate([[0], np.cumsum((log.position[1:] == log.position[:-1]).all(axis=1))])
    return found[still[_TOGETHER - 1 :] == still[: len(found)]]
