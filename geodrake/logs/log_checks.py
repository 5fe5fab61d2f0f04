"""Checks of logs: uninformative commands, saturated or constant efforts, and duplicate logs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import Array
from geodrake.errors import ArgumentError, LogError
from geodrake.logs.motion import NOT_MEASURED, JointLog

_STILL = 2e-3  # rad or m, largest range of a joint at rest
_SAME = 1e-6  # of a joint's range: rounding error of a copy of its positions
_RATIOS = 57.3, 652.0, 11.4  # between rad, degrees and ticks of 1/4096 turn
_LAG, _FOLLOWS = 0.4, 0.8  # tolerance of a ratio's logarithm, and least correlation with it
_UNLIKE, _APART = 0.5, 5.0  # correlation and ratio of ranges of unrelated commands
_LATEST = 3  # rows, largest delay of a copy
_WINDOW, _MOVING = 0.05, 0.1  # s, and share of the largest distance in them, of a moving joint
_FULL, _MOST = 1.0 - 1e-6, 0.9  # share of the largest effort, and of rows that may reach it
_EVEN = 0.01  # tolerance of multiples of the resolution
_STEPS = 50  # resolutions: rounding may explain saturation at smaller values


def check_commands(log: JointLog) -> None:
    """Raise for commands that equal positions, are in another unit, or belong to other signals."""
    unlike, moved = list[str](), 0
    for j, joint in enumerate(log.joints):
        if log.command is None or np.isfinite(log.effort[:, j]).any():
            continue
        command, position = log.command[:, j], log.position[:, j]
        known = np.isfinite(position)
        if not known.any() or position[known].max() - _STILL <= position[known].min():
            continue
        correlation, scale = _correlation(command, position)
        is_unlike = scale > 0.0 and (correlation < _UNLIKE or not 1.0 / _APART < scale < _APART)
        words = f"those of {joint} vary {scale:.3g} times as much as its positions, and the "
        unlike += [f"{words}correlation is {correlation:.2f}"] * is_unlike
        moved += scale > 0.0
        if correlation >= _FOLLOWS and any(
            abs(abs(np.log(scale)) - np.log(ratio)) < _LAG for ratio in _RATIOS
        ):
            raise LogError(
                f"Commands of {joint} in log {log.name!r} move like its positions, but {scale:.3g} "
                "times as far.",
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
    is_alone = moved == 1 < len(log.joints)  # a heavy joint may sag in spite of its command
    if unlike and len(unlike) == moved and not is_alone:
        raise LogError(
            f"No joint follows its commands in log {log.name!r}: {unlike[0]}.",
            advice="Are they increments, normalized, torques, or of an end effector? Log the "
            "commanded positions of servos, or efforts.",
        )


def _correlation(command: Array, position: Array) -> tuple[float, float]:
    """Return the correlation of commands and positions (N,), and the ratio of their deviations."""
    known = np.isfinite(command) & np.isfinite(position)
    commands, positions = command[known], position[known]
    deviations = (float(commands.std()), float(positions.std())) if known.any() else (0.0, 0.0)
    if not min(deviations) > 0.0:
        return 0.0, 0.0
    return float(np.corrcoef(commands, positions)[0, 1]), deviations[0] / deviations[1]


def _is_copy(command: Array, position: Array, late: int) -> bool:
    """Return whether commands equal the positions `late` rows later, up to rounding."""
    command, position = command[: len(command) - late], position[late:]
    known = np.isfinite(command) & np.isfinite(position)
    if not known.any():
        return False
    command, position = command[known], position[known]
    digits = 4.0 * float(np.finfo(np.float32).eps) * float(np.abs(position).max())
    return bool(np.abs(command - position).max() <= max(np.ptp(_SAME * position), digits))


def check_saturation(log: JointLog, measured: JointLog | None = None) -> None:
    """Raise for efforts that are at their largest value most of the time.

    If the log has efforts derived from commands of servos, `measured` is the original log, without
    efforts of these joints.
    """
    for j, joint in enumerate(log.joints):
        if log.effort_kinds.get(joint, "effort") not in ("effort", "current"):
            continue  # a switched voltage is often at its maximum
        effort = log.effort[_moving(log, j), j]
        effort = effort[np.isfinite(effort)]
        largest = float(np.abs(effort).max(initial=0.0))
        is_servo = measured is not None and not np.isfinite(measured.effort[:, j]).any()
        is_constant = not len(effort) or effort.max() == effort.min()
        if is_constant and not (is_servo and largest > 0.0):
            continue
        share = float(np.mean(np.abs(effort) >= _FULL * largest))
        if share > _MOST and (is_constant or not _is_coarse(effort)):
            if is_servo:
                raise _saturated_servo(log, j, largest, share)
            raise LogError(
                f"The {log.effort_kinds.get(joint, 'effort')} of {joint} in log {log.name!r} "
                f"is saturated: it is at its largest value, {largest:.4g}, in "
                f"{100 * share:.0f} % of the rows in which the joint moves.",
                advice="Move with less acceleration or load to stay within the drive's limit, "
                "or raise the limit.",
            )


def _saturated_servo(log: JointLog, j: int, largest: float, share: float) -> LogError:
    """Return the error for a servo at its limit in a `share` of the rows in which it moves."""
    joint, command = log.joints[j], log.command
    is_still = command is not None and not np.nanmax(command[:, j]) > np.nanmin(command[:, j])
    why = "its command never changes" if is_still else "its command is far from its position"
    return LogError(
        f"The servo of {joint} in log {log.name!r} is saturated: {why}, and its effort is at the "
        f"limit, {largest:.4g}, in {100 * share:.0f} % of the rows in which the joint moves.",
        advice=f"Does that servo follow another command? If it is off, use --passive {joint}."
        if is_still
        else "Check the command's unit and zero, or move with less acceleration or load.",
    )


def _moving(log: JointLog, j: int) -> NDArray[np.bool_]:
    """Return whether a joint moves in each row (N,)."""
    time, position = log.time, log.position[:, j]
    steps = np.diff(time[np.isfinite(time)])
    rows = max(1, round(_WINDOW / float(np.median(steps)))) if len(steps) else 1
    distance = np.zeros(len(position))
    if rows < len(position):
        distance[:-rows] = np.abs(position[rows:] - position[:-rows])
    distance = np.nan_to_num(distance)
    return np.asarray(distance > max(_MOVING * float(distance.max(initial=0.0)), 0.0))


def _is_coarse(effort: Array) -> bool:
    """Return whether rounding alone may explain constant largest values."""
    levels = np.unique(effort)
    if len(levels) == 2 and levels[0] == -levels[1]:
        return False  # a bang-bang signal
    steps = np.diff(levels)
    ratios = steps / steps.min()
    is_rounded = np.all(np.abs(ratios - np.rint(ratios)) < _EVEN)
    return bool(is_rounded and np.abs(levels).max() < _STEPS * steps.min())


_MOST_ALIKE = 0.95  # share of equal efforts, beyond which they are constant
_LEAST_EFFORT = 1e-12  # least variation of a measured effort, N·m or N


def constant_efforts(log: JointLog) -> dict[str, str]:
    """Return joints with motors whose measured efforts are constant, with value and share."""
    known = np.isfinite(log.effort)
    measured = np.where(known, log.effort, np.nan)
    usual = np.nanmedian(np.where(known.any(axis=0), measured, 0.0), axis=0)
    alike = np.abs(log.effort - usual) <= np.maximum(1e-9 * np.abs(usual), _LEAST_EFFORT)
    shares = np.sum(alike, axis=0, where=known) / np.maximum(known.sum(axis=0), 1)
    return {
        joint: f"{value:.3g} in {100 * share:.3g} %"
        for joint, value, share in zip(log.joints, usual.tolist(), shares.tolist(), strict=True)
        if share >= _MOST_ALIKE and log.effort_kinds.get(joint) not in NOT_MEASURED
    }


def constant_notes(constant: Mapping[str, str]) -> list[str]:
    """Return what the constant efforts of joints mean, in words."""
    joints = defaultdict[str, list[str]](list)
    for joint, values in constant.items():
        joints[values].append(joint)
    return [
        f"the effort of {', '.join(own)} is {values} of the rows, so it is not used; without a "
        f"motor, use --passive {own[0]}"
        for values, own in joints.items()
    ]


_TOGETHER = 8  # successive rows, which two logs do not share by chance
_MOST_SHARED = 0.5  # largest share of such sequences that another log may contain


def check_repeated(logs: Sequence[JointLog]) -> None:
    """Raise if two logs have the same measurements.

    Positions and efforts of rows in which a joint moves are compared, not names or time stamps.
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
    """Return hashes of all sequences of rows of a log in which a joint moves."""
    if len(log) < _TOGETHER:
        return np.zeros(0, np.int64)
    rows, draw = np.hstack([log.position, log.effort]), np.random.default_rng(0).integers
    with np.errstate(over="ignore"):
        row_hashes = rows.view(np.int64) @ draw(1 << 62, size=rows.shape[1])
        digests = np.convolve(row_hashes, draw(1 << 62, size=_TOGETHER), "valid")
    still = np.concatenate([[0], np.cumsum((log.position[1:] == log.position[:-1]).all(axis=1))])
    return digests[still[_TOGETHER - 1 :] == still[: len(digests)]]
