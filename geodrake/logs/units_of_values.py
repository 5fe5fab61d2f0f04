"""Detection of other units than rad, m, N·m and N: conversion if certain, otherwise hints."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import Array
from geodrake.errors import LogError
from geodrake.logs.files.column_mapping import Columns
from geodrake.logs.files.name_rules import MOTOR, Meaning
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.units import Unit, unit_of
from geodrake.logs.motion import NOT_MEASURED, JointLog
from geodrake.logs.resting import LARGEST

TICKS = 4096  # per turn, of servos with twelve bits
ROUNDING = 1e-3  # error of an integer after a unit's factor
_HELD, _MARGIN = 0.99, 0.05  # least share of positions within limits, and tolerance of these, rad
_FIRST = 1000  # rows, usually enough to show that numbers are not integers
_FAR, _MOST_FAR = 45.0, 10.0  # largest position in rad of one joint, and of most joints
_NORMALIZED = 101.0  # largest position of LeRobot in percent of a range
_OF_LEROBOT = re.compile(r"\.pos$|^observation\.state")
_ROWS, _WINDOW = 50_000, 25  # rows examined, and over which positions and velocities are compared
_SHORTER = 12  # the latter if a motion repeats after those
_OFF, _ALIKE = 0.02, 0.99  # tolerance of a ratio, and least correlation to determine it
_UNLIKE, _MOVES = 0.5, 0.1  # correlation of unrelated signals; least motion relative to the largest
_JUMP = 0.5  # of its range, least step of an angle that wraps
Bare = Mapping[str, Mapping[tuple[str, str], Meaning]]
"""Quantity -> its columns without a stated unit."""

_ANGLES = ("deg", "rev", "mrad", "cdeg", "rad")
_SMALL = ("mrad", "cdeg")  # units in which any motion has large values
_SPEEDS = ("rad/s", "deg/s", "rev/s", "rpm")
_OF_SERVOS = (*_SPEEDS, "ticks/s", "0.229 rpm", "0.111 rpm")  # with ticks, as of Dynamixel
_AS_OTHERS = (("rev", "rad/s"), ("rev", "rpm"))  # like m and m/min, or gears of 6.3 and 60
_LARGE = 0.9  # quantile of moves


def take_units(time: Array, data: dict[str, Array], columns: Columns) -> None:
    """Convert positions, velocities and commands (N, n) to SI units if values show others."""
    bare = {quantity: _bare(columns, quantity) for quantity in data}
    _take_lengths(time, data, columns, bare)
    if _take_ticks(data, columns, bare):
        _take_angles(time, data, columns, {**bare, "position": {}, "command": {}}, _OF_SERVOS)
    else:
        _take_angles(time, data, columns, bare, _SPEEDS)


def _bare(columns: Columns, quantity: str) -> dict[tuple[str, str], Meaning]:
    """Return the columns of a quantity, or none if one has a unit, as by geodrake's own names."""
    places = [(joint, quantity) for joint in columns.joints]
    sources = {p: source for p in places if (source := columns.places.get(p)) is not None}
    have_units = (s.unit or s.factor != 1.0 or s.column == ".".join(p) for p, s in sources.items())
    return {} if any(have_units) else sources


def _convert(
    data: dict[str, Array], columns: Columns, sources: Mapping[tuple[str, str], Meaning], unit: Unit
) -> None:
    for joint, quantity in sources:
        at = columns.joints.index(joint)
        data[quantity][:, at] = unit.factor * data[quantity][:, at] + unit.offset
    columns.places |= {place: replace(source, unit=unit) for place, source in sources.items()}


def _take_angles(
    time: Array,
    data: dict[str, Array],
    columns: Columns,
    bare: Bare,
    speeds: Sequence[str],
) -> None:
    """Convert angles and speeds to rad and rad/s if values prove other units.

    The ratio of velocities to changes of positions determines both units, if positions in that
    unit are within the model's limits. Small units need large values, too, as differences from row
    to row have such a ratio. Otherwise positions are in degrees if most are far beyond the limits
    in rad, but within them in degrees. Velocities unrelated to positions are left out.
    """
    turning = [joint for joint in columns.joints if joint not in columns.reading.sliding]
    places = bare.get("position", {})
    if not turning or any(source.role == MOTOR for source in places.values()):
        return
    bare = {q: {p: sources[p] for p in sources if p[0] in turning} for q, sources in bare.items()}
    at = np.isin(columns.joints, turning)
    position, velocity = data["position"][:, at], data.get("velocity")
    moves = [] if velocity is None else _moves(time, position, velocity[:, at])
    angles = _ANGLES if places else ("rad",)
    speeds = speeds if bare.get("velocity") else ("rad/s",)
    angle, speed, ratio = _by_motion(moves, angles, speeds)
    if velocity is not None and not ratio:
        moves = _moves(time, position, velocity[:, at], _SHORTER)
        angle, speed, ratio = _by_motion(moves, angles, speeds)
    why = f"velocities are {ratio:.4g} times as fast as positions change"
    if angle != "rad":
        unit = unit_of(angle, "position")
        held = _share_within(columns.reading, turning, _some(position), unit)
        is_far = angle not in _SMALL or peaks_of(position).max() > _MOST_FAR
        angle, speed = (angle, speed) if held > _HELD and is_far else ("rad", "rad/s")
    is_open = bool(places) and (angle, speed) == ("rad", "rad/s")
    beyond = _beyond_limits(position, columns, turning) if is_open else ""
    if beyond:
        angle, speed, why = "deg", _nearer_speed(moves), beyond
    elif bare.get("velocity") and not ratio:
        data.pop("velocity")
        columns.leave_out("velocity", "it is unrelated to positions")
    for quantity, name in {"position": angle, "command": angle, "velocity": speed}.items():
        unit = unit_of(name, quantity)
        if unit.factor != 1.0 and bare.get(quantity):
            _convert(data, columns, bare[quantity], unit)
            words = f"{quantity} is in {name}, as {why}: converted"
            columns.notes.append(f"{words} (--units {quantity}=UNIT if it is in another)")


def _take_lengths(time: Array, data: dict[str, Array], columns: Columns, bare: Bare) -> None:
    """Convert positions of sliding joints from mm if only in mm they are within the limits."""
    places = [place for place in bare.get("position", {}) if place[0] in columns.reading.sliding]
    joints = [joint for joint, _ in places]
    if not joints:
        return
    at = [columns.joints.index(joint) for joint in joints]
    position, velocity = data["position"][:, at], data.get("velocity")
    peaks, shares = peaks_of(position), dict[str, float]()
    for name in ("mm", "cm", "m"):
        unit = unit_of(name, "position")
        shares[name] = _share_within(columns.reading, joints, _some(position), unit)
    is_mm = shares["mm"] > _HELD and max(shares["cm"], shares["m"]) <= 0.5
    if peaks.min() < _MOST_FAR or not is_mm:
        return
    moves = [] if velocity is None else _moves(time, position, velocity[:, at])
    speed = _nearer_speed(moves, "mm/s", "m/s")
    for quantity, name in {"position": "mm", "command": "mm", "velocity": speed}.items():
        unit = unit_of(name, quantity)
        own = {p: source for p, source in bare.get(quantity, {}).items() if p[0] in joints}
        if unit.factor != 1.0 and own:
            _convert(data, columns, own, unit)
            columns.notes.append(
                f"{quantity} is in {name} at {', '.join(joints)}, which reaches {peaks.max():.4g}, "
                "and the model's limits hold no positions in m: converted (set another unit in a "
                "mapping)"
            )


def _nearer_speed(
    moves: Sequence[tuple[Array, Array]], small: str = "deg/s", si: str = "rad/s"
) -> str:
    """Return the unit of speeds if positions are in a small unit, from a high quantile of moves."""
    sizes = [[np.quantile(np.abs(x), _LARGE) for x in each] for each in moves if len(each[0])]
    moved, driven = np.sum(sizes, axis=0) if sizes else (0.0, 0.0)
    ratio = unit_of(small, "velocity").factor / unit_of(si, "velocity").factor
    return small if driven > ratio**0.5 * moved else si


@np.errstate(over="ignore", invalid="ignore")  # of outliers
def _moves(
    time: Array, position: Array, velocity: Array, rows: int = _WINDOW
) -> list[tuple[Array, Array]]:
    """Return the motion of each joint over some rows, from its positions and its velocities."""
    if len(time) <= rows:
        return []
    position, velocity, time = position[:_ROWS], velocity[:_ROWS], time[:_ROWS]
    steps = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time)[:, None]
    integral = np.cumsum(np.vstack([np.zeros(velocity.shape[1]), np.nan_to_num(steps)]), axis=0)
    moves = list[tuple[Array, Array]]()
    for q, s in zip(position.T, integral.T, strict=True):
        moved, driven = (x[rows:] - x[:-rows] for x in (q, s))
        jumps = np.abs(np.diff(q, prepend=q[0])) > _JUMP * (np.fmax.reduce(q) - np.fmin.reduce(q))
        count = np.cumsum(jumps)
        valid = np.isfinite(moved) & np.isfinite(driven) & (count[rows:] == count[:-rows])
        moves.append((moved[valid], driven[valid]))
    return moves


@np.errstate(over="ignore", invalid="ignore")  # of outliers
def _by_motion(
    moves: Sequence[tuple[Array, Array]], angles: Sequence[str], speeds: Sequence[str]
) -> tuple[str, str, float]:
    """Return the units of angles and speeds with the ratio of moves, and this; SI units if none.

    The ratio is zero if velocities are unrelated to positions.
    """
    si_units, ratios, correlations = ("rad", "rad/s", 1.0), list[float](), list[float]()
    largest = max((np.linalg.norm(moved) for moved, _ in moves), default=0.0)
    for moved, driven in moves:
        size = np.linalg.norm(moved) * np.linalg.norm(driven)
        if size > 0.0 and moved @ driven > _ALIKE * size:
            ratios.append(float(driven @ driven / (moved @ driven)))
        if np.linalg.norm(moved) > _MOVES * largest:
            correlations.append(float(abs(moved @ driven) / max(size, np.finfo(float).tiny)))
    if correlations and max(correlations) < _UNLIKE:
        return "rad", "rad/s", 0.0
    ratio = float(np.median(ratios)) if ratios else 1.0
    if not ratios or np.ptp(ratios) > 2.0 * _OFF * ratio:
        return si_units
    for angle, speed in ((a, s) for s in speeds for a in angles):
        expected = unit_of(angle, "position").factor / unit_of(speed, "velocity").factor
        are_bare = len(angles) > 1 and len(speeds) > 1
        if abs(expected - 1.0) < _OFF or (are_bare and (angle, speed) in _AS_OTHERS):
            continue
        if abs(ratio / expected - 1.0) < _OFF:
            return angle, speed, ratio
    return si_units


def _beyond_limits(position: Array, columns: Columns, joints: Sequence[str]) -> str:
    """Return why the model's limits prove that positions (N, n) are in degrees, or ""."""
    position = _some(position)
    peaks = peaks_of(position)
    names = (columns.places[joint, "position"].column for joint in joints)
    may_be_shares = peaks.max() <= _NORMALIZED and any(map(_OF_LEROBOT.search, names))
    if may_be_shares or not _are_far(peaks):
        return ""
    inside, outside = (
        _share_within(columns.reading, joints, position, unit_of(unit, "position"))
        for unit in ("deg", "rad")
    )
    if not inside > _HELD or outside > 0.5:
        return ""
    joint = joints[int(peaks.argmax())]
    return f"{joint} reaches {peaks.max():.4g}, and the model's limits hold no positions in rad"


def _are_far(peaks: Array) -> bool:
    """Return whether the largest positions (n,) of most joints are impossible in rad."""
    return bool(peaks.max() > _FAR and np.mean(peaks > _MOST_FAR) > 0.5)


def _take_ticks(
    data: dict[str, Array],
    columns: Columns,
    bare: Bare,
) -> bool:
    """Convert positions and commands (N, n) of servos from ticks to rad.

    Integers without a unit from 0 to less than 4,096, and beyond 1,024, are ticks: no joint moves
    so far in rad, and hardly any in whole degrees. Zero is at 2,048, as in drivers, unless only a
    zero at tick 0 brings positions within the model's limits.
    """
    quantities = [n for n in data if n in ("position", "command") and np.isfinite(data[n]).any()]
    if "position" not in quantities or not all(bare[quantity] for quantity in quantities):
        return False
    for quantity in quantities:
        numbers, least = data[quantity], TICKS / 4 if quantity == "position" else 0.0
        if not are_whole(numbers):
            return False
        if not np.nanmin(numbers) >= 0.0 or not least < np.nanmax(numbers) < TICKS:
            return False
    ticks = data["position"]
    middle, bottom = (unit_of(name, "position") for name in ("ticks@2048", "ticks"))
    some = _some(ticks)
    joints = columns.joints
    shares = {u: _share_within(columns.reading, joints, some, u) for u in (middle, bottom)}
    unit, other = (bottom, middle) if shares[bottom] > _HELD > shares[middle] else (middle, bottom)
    zero = "2048, as in drivers" if unit is middle else "0, as the model's limits suggest"
    words = (
        f"positions are integers from {np.nanmin(ticks):.0f} to {np.nanmax(ticks):.0f}: "
        f"taken as servo ticks, {TICKS} a turn, with zero at tick {zero} (--units "
        f"{','.join(f'{each}={other.name}' for each in quantities)} for zero at "
        f"{'0' if unit is middle else '2048'}; other units with --units or a mapping)"
    )
    for quantity in quantities:
        _convert(data, columns, bare[quantity], unit)
    columns.notes.append(words)
    return True


def _share_within(reading: Reading, joints: Sequence[str], position: Array, unit: Unit) -> float:
    """Return the share of positions (N, n) in a unit that are within the joints' limits."""
    limits = np.array([reading.limits.get(j, (-np.inf, np.inf)) for j in joints])
    bounded = np.isfinite(limits).all(axis=1)
    low, high = limits[bounded].T
    q = unit.factor * position[:, bounded] + unit.offset
    within = (low - _MARGIN <= q) & (q <= high + _MARGIN)
    return float(np.mean(within[np.isfinite(q)])) if np.isfinite(q).any() else 1.0


def _some(values: Array) -> Array:
    """Return at most `_ROWS` rows of (N, n), evenly spread over a log."""
    return values[:: len(values) // _ROWS + 1]


def are_whole(numbers: Array) -> bool:
    """Return whether numbers are integers, except for rounding, empty cells and infinity."""
    with np.errstate(invalid="ignore"):
        parts = (numbers[:_FIRST], numbers)  # the first usually suffice
        return not any(np.any(np.abs(part - np.rint(part)) > ROUNDING) for part in parts)


def peaks_of(values: Array) -> Array:
    """Return the largest magnitudes (n,) of columns, 0 without measurements."""
    peaks = np.zeros(values.shape[1])
    for first in range(0, len(values), _ROWS):
        part = np.abs(values[first : first + _ROWS])
        peaks = np.maximum(peaks, np.max(part, axis=0, initial=0.0, where=np.isfinite(part)))
    return peaks


_NO_NOISE = 0.3  # rad or m, more than the noise of any position
_ENOUGH_ROWS = 30  # to judge their order, or efforts
_JUMP = 0.2  # of a range, between two rows: 0.3 in random order, 0.1 at 20 rows per oscillation
_LARGEST = 1e100  # of compared efforts and positions
_LEAST_LIMIT = 1e-9  # N·m or N, less than the limit of any motor
_NEAR_ZERO, _TOUCHES = 0.03, 4  # of the largest effort, and least number of returns to it
_MOST_AMPERES = 300.0
_LOOKS = 200  # samples of a position, so that noise causes few reversals
_LEAST_MRAD, _MOST_DEGREES = 400.0, 3600.0  # ten turns
_FILLS = 0.9  # least share of the counts of a turn that an angle which wraps takes
_LEAST_TICKS = 100.0  # more than the reach of any joint in rad
_FEW = 0.01  # share of samples that may be spikes
_BEYOND = 0.01  # of a range, by which a joint may exceed its limits


def effort_unit_hint(log: JointLog, effort_limits: ArrayLike) -> str | None:
    """Return a hint if efforts look like another unit than N·m or N; else None.

    They are compared with the model's limits (n,); zeros and infinities count as unknown.
    """
    limits = np.broadcast_to(np.asarray(effort_limits, float), (len(log.joints),))
    silent = (*log.passive, *log.unmeasured)
    known = np.isfinite(limits) & (limits > _LEAST_LIMIT) & ~np.isin(log.joints, silent)
    if not known.any():
        return None
    peaks = np.minimum(peaks_of(log.motor_effort), _LARGEST)
    ratio = np.where(known, peaks / np.where(known, limits, 1.0), np.nan)
    worst = int(np.nanargmax(ratio))
    if ratio[worst] > 3.0:
        return (
            f"Efforts seem to be in other units: {log.joints[worst]} peaks at "
            f"{peaks[worst]:.4g}, {ratio[worst]:.0f} times the model's limit of "
            f"{limits[worst]:.4g} N·m or N. Are they N·mm, motor torques or ticks?"
        )
    if ratio[worst] < 0.01:
        return (
            "Efforts seem to be in other units: no joint exceeds 1 % of the model's limit; "
            f"the largest is {peaks[worst]:.3g} of {limits[worst]:.4g} N·m or N at "
            f"{log.joints[worst]}. Are they motor currents, fractions of the limit, or kN·m?"
        )
    return None


_CONVERTED = re.compile(r"position is in .*converted|positions are .*taken as servo ticks")
_OF_MOTORS = (
    " Are they of motors, before the gears? Give the ratios, as in --units position=rev/100 for "
    "turns of motors with a gear of 100, or as gains in a mapping."
)
_UNIT_ADVICE = (
    "Set their unit: --units position=deg, =cdeg, =mrad, =mm or, for an encoder with 4096 counts "
    "a turn of the joint and zero at 2048, =rev/4096@2048."
)


def position_unit_hint(log: JointLog) -> str | None:
    """Return a hint if positions without a unit look like degrees or ticks; else None."""
    peaks = peaks_of(log.position)
    if any(map(_CONVERTED.match, log.notes)):
        return None
    worst = int(np.argmax(peaks))
    if are_whole(log.position[:_ROWS]) and peaks[worst] >= _LEAST_TICKS:
        return None  # see `check_ticks`
    farthest = f"{log.joints[worst]} reaches {peaks[worst]:.4g}, and most joints exceed 10"
    if not _are_far(peaks):
        return None
    if peaks[worst] > _MOST_DEGREES:
        return f"Positions are neither rad nor degrees: {farthest}. {_UNIT_ADVICE}"
    other = " (or, for LeRobot's −100 to 100 of a joint's range, position=normalized)"
    other = other if peaks.max() <= _NORMALIZED else ""
    other = other if peaks[worst] < _LEAST_MRAD else " (or position=mrad)"
    return (
        f"Positions seem to be in degrees: {farthest}. --units position=deg converts them{other}. "
        "Those of sliding joints may be in mm."
    )


def check_ticks(log: JointLog) -> None:
    """Raise for positions that are integers beyond the range of joints in rad."""
    if not are_whole(log.position[:_ROWS]):
        return
    peaks = peaks_of(log.position)
    worst = int(np.argmax(peaks))
    if not _LEAST_TICKS <= peaks[worst] <= LARGEST:
        return
    known = log.position[np.isfinite(log.position)]
    turn = 2 ** math.ceil(math.log2(peaks[worst] + 1.0))
    fills = known.min() >= 0.0 and np.ptp(known) > _FILLS * turn
    advice = f"They fill {turn}: --units position=rev/{turn} if that is a turn. " if fills else ""
    raise LogError(
        f"Positions of log {log.name!r} are integers of up to {peaks[worst]:.7g} at "
        f"{log.joints[worst]}, which no joint reaches in rad or m.",
        advice=advice + _UNIT_ADVICE,
    )


def effort_hint(log: JointLog) -> str | None:
    """Return a hint if efforts look like magnitudes or counts of currents; else None.

    Magnitudes return to zero while the joint turns both ways, and those of no joint are negative.
    """
    peaks = dict(zip(log.joints, peaks_of(log.motor_effort).tolist(), strict=True))
    large = [j for j, kind in log.effort_kinds.items() if kind == "current"]
    large = [joint for joint in large if peaks[joint] > _MOST_AMPERES]
    if large and are_whole(log.motor_effort[:, np.isin(log.joints, large)]):
        return (
            f"The currents of {', '.join(large)} are integers of up to {peaks[large[0]]:.0f} A, "
            "which motors of robots do not draw: they seem to be counts or mA. Give their unit, as "
            "in --units current=mA."
        )
    position, effort = log.position[:_ROWS], log.motor_effort[:_ROWS]
    rows = np.isfinite(position).all(axis=1) & np.isfinite(effort).all(axis=1)
    position, effort = position[rows], effort[rows]
    if len(effort) < _ENOUGH_ROWS:
        return None
    names = []
    for name, q, tau in zip(log.joints, position.T, effort.T, strict=True):
        largest, kind = float(tau.max()), log.effort_kinds.get(name)
        if kind in NOT_MEASURED or not largest:
            continue
        if tau.min() < 0.0:
            return None
        low = tau < _NEAR_ZERO * largest
        turns = np.diff(np.sign(np.diff(q[:: len(q) // _LOOKS + 1])))
        touches = np.count_nonzero(low[1:] & ~low[:-1])
        if touches >= _TOUCHES and np.count_nonzero(turns) > 1:
            names.append(name)
    if not names:
        return None
    return (
        f"The efforts of {', '.join(names)} are never negative, and often return to zero "
        "while the joint turns both ways: they seem to be magnitudes. Log them with their "
        "sign; or, if servo commands are logged too, use these: --kind command."
    )


def position_limit_hint(log: JointLog, lower: ArrayLike, upper: ArrayLike) -> str | None:
    """Return a hint if positions are beyond a model's limits (n,); else None."""
    ends = np.stack([np.asarray(lower, float), np.asarray(upper, float)])
    violations = []
    for name, q, (low, high) in zip(log.joints, log.position.T, ends.T, strict=True):
        known = q[np.isfinite(q)]
        share = _share_outside(known, low, high)
        if share > _FEW:
            beyond = max(low - known.min(), known.max() - high)
            violations.append((share, name, beyond, known, low, high))
    if not violations:
        return None
    share, name, beyond, known, low, high = max(violations, key=lambda each: each[0])
    others = f"; joints beyond: {len(violations)}" if len(violations) > 1 else ""
    doubted = any(note.startswith("position: by their names") for note in log.notes)
    return (
        f"Positions exceed the model's limits: {name} in {100 * share:.0f} % of the samples "
        f"of log {log.name!r}, by up to {beyond:.3g} rad (m) beyond {low:.4g} … "
        f"{high:.4g}{others}.{_OF_MOTORS if doubted else _cause_beyond(known, low, high)}"
    )


def _share_outside(q: Array, low: float, high: float) -> float:
    """Return the share of positions (N,) outside limits by more than 1 % of their range."""
    margin = _BEYOND * min(high - low, 2.0 * np.pi)
    return float(np.mean((q < low - margin) | (q > high + margin))) if len(q) else 0.0


def _cause_beyond(q: Array, low: float, high: float) -> str:
    """Return a hint on the change that would bring positions (N,) within limits."""
    if _share_outside(-q, low, high) <= _FEW:
        return (
            " With the opposite sign they are within: is the joint's axis, or the column, reversed?"
        )
    for quarter in (1, -1, 2, -2, 3, -3, 4, -4):
        if _share_outside(q - quarter * np.pi / 2, low, high) <= _FEW:
            return (
                f" Shifted by {-90 * quarter:+}° they are within: does the log have another zero?"
            )
    if _share_outside(np.deg2rad(q), low, high) <= _FEW:
        if np.quantile(np.abs(q), 1.0 - _FEW) > 2.0 * np.pi:
            return " Divided by 57.3 they are within: is the log in degrees?"
        return " Within limits 57.3 times as wide: are the file's limits in radians or in degrees?"
    return " Do model and log have the same joints, zeros and units?"


def row_order_hint(log: JointLog) -> str | None:
    """Return a hint if rows are not sorted by time; else None."""
    rows = log.position[np.isfinite(log.position).all(axis=1)][:_ROWS]
    if len(rows) < _ENOUGH_ROWS:
        return None
    # Quantiles, as spikes of sensors also make large steps.
    rows = np.clip(rows, -_LARGEST, _LARGEST)
    low, high = np.quantile(rows, [0.05, 0.95], axis=0)
    ranges, steps = high - low, np.abs(np.diff(rows, axis=0))
    large = ranges > _NO_NOISE
    if not large.any() or (np.median(steps, axis=0) < _JUMP * ranges)[large].any():
        return None
    widest = int(np.argmax(ranges))
    return (
        f"The rows of log {log.name!r} are not sorted by time: {log.joints[widest]} jumps by "
        f"{np.median(steps[:, widest]):.3g} rad (m) from row to row, within a range of "
        f"{ranges[widest]:.3g}."
    )
