"""Do a log's numbers look like other units than rad, m, N·m and N, or like no series in time?"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import Array
from geodrake.errors import LogError
from geodrake.logs.files.units_of_values import are_whole, peaks_of
from geodrake.logs.motion import JointLog
from geodrake.logs.resting import LARGEST

_NO_NOISE = 0.3  # rad or m: no position's noise reaches so far
_ENOUGH_ROWS = 30  # that tell an order
_JUMP = 0.2  # of its range, between two rows: 0.3 in random order, 0.1 in 20 rows a swing
_LARGEST = 1e100  # of efforts that are compared with limits, and of positions with each other
_LEAST_LIMIT = 1e-9  # N·m or N: no motor is that weak
_NEAR_ZERO, _TOUCHES = 0.03, 4  # of the largest effort, and how often one comes down to it
_LOOKS = 200  # at a position, between which its noise turns it round
_LEAST_DEGREES = 45.0  # seven turns of a joint in radians
_MOST_NORMALIZED = 101.0
_LEAST_MRAD, _MOST_DEGREES = 400.0, 3600.0  # ten turns
_LEAST_TICKS = 100.0  # no joint goes there in radians
_FEW = 0.01  # share of samples that may be spikes
_MARGIN = 0.01  # of a range, by which a joint may pass its stops
_ROWS = 100_000  # of a log that are looked at together


def effort_unit_hint(log: JointLog, effort_limits: ArrayLike) -> str | None:
    """Return a hint if efforts look like another unit than N·m or N; else None.

    They are compared with the model's (n,) limits; zeros and infinities count as unknown.
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
    """Return a hint if positions of which nobody said the unit look like degrees or ticks."""
    peaks = peaks_of(log.position)
    if any(map(_CONVERTED.match, log.notes)):
        return None
    worst = int(np.argmax(peaks))
    farthest = f"{log.joints[worst]} reaches {peaks[worst]:.4g}, and most joints exceed 10"
    if not peaks[worst] > _LEAST_DEGREES or np.mean(peaks > 10.0) <= 0.5:
        return None
    if peaks[worst] > _MOST_DEGREES:
        return f"Positions are neither rad nor degrees: {farthest}. {_UNIT_ADVICE}"
    other = " (or, for LeRobot's −100 to 100 of a joint's range, position=normalized)"
    other = other if peaks.max() <= _MOST_NORMALIZED else ""
    other = other if peaks[worst] < _LEAST_MRAD else " (or position=mrad)"
    return (
        f"Positions seem to be in degrees: {farthest}. --units position=deg converts them{other}."
    )


def check_ticks(log: JointLog) -> None:
    """Raise for positions that are integers beyond the range of joints in rad."""
    if not are_whole(log.position[:_ROWS]):
        return
    peaks = peaks_of(log.position)
    worst = int(np.argmax(peaks))
    if not _LEAST_TICKS <= peaks[worst] <= LARGEST:
        return
    raise LogError(
        f"Positions of log {log.name!r} are integers of up to {peaks[worst]:.7g} at "
        f"{log.joints[worst]}, which no joint reaches in rad or m.",
        advice=_UNIT_ADVICE,
    )


def effort_sign_hint(log: JointLog) -> str | None:
    """Return a hint if efforts look like magnitudes; else None.

    Efforts that only gravity keeps from changing their sign do not come back from zero again and
    again.
    """
    position, effort = log.position[:_ROWS], log.motor_effort[:_ROWS]
    rows = np.isfinite(position).all(axis=1) & np.isfinite(effort).all(axis=1)
    position, effort = position[rows], effort[rows]
    if len(effort) < _ENOUGH_ROWS:
        return None
    found = []
    for name, q, tau in zip(log.joints, position.T, effort.T, strict=True):
        largest, kind = float(tau.max()), log.effort_kinds.get(name)
        if kind in ("passive", "ground", "unmeasured") or tau.min() < 0.0 or not largest:
            continue
        low = tau < _NEAR_ZERO * largest
        turns = np.diff(np.sign(np.diff(q[:: len(q) // _LOOKS + 1])))
        touches = np.count_nonzero(low[1:] & ~low[:-1])
        if touches >= _TOUCHES and np.count_nonzero(turns) > 1:
            found.append(name)
    if not found:
        return None
    return (
        f"The efforts of {', '.join(found)} are never negative, and often return to zero "
        "while the joint turns both ways: they seem to be magnitudes. Log them with their "
        "sign; or, if servo commands are logged too, use these: --kind command."
    )


def position_limit_hint(log: JointLog, lower: ArrayLike, upper: ArrayLike) -> str | None:
    """Return a hint if positions are beyond a model's limits (n,); else None."""
    ends = np.stack([np.asarray(lower, float), np.asarray(upper, float)])
    found = []
    for name, q, (low, high) in zip(log.joints, log.position.T, ends.T, strict=True):
        known = q[np.isfinite(q)]
        share = _share_outside(known, low, high)
        if share > _FEW:
            beyond = max(low - known.min(), known.max() - high)
            found.append((share, name, beyond, known, low, high))
    if not found:
        return None
    share, name, beyond, known, low, high = max(found, key=lambda each: each[0])
    others = f"; joints beyond: {len(found)}" if len(found) > 1 else ""
    doubted = any(note.startswith("position: by their names") for note in log.notes)
    return (
        f"Positions exceed the model's limits: {name} in {100 * share:.0f} % of the samples "
        f"of log {log.name!r}, by up to {beyond:.3g} rad (m) beyond {low:.4g} … "
        f"{high:.4g}{others}.{_OF_MOTORS if doubted else _cause_beyond(known, low, high)}"
    )


def _share_outside(q: Array, low: float, high: float) -> float:
    """Return the share of positions (N,) outside of limits by more than a percent of them."""
    margin = _MARGIN * min(high - low, 2.0 * np.pi)
    return float(np.mean((q < low - margin) | (q > high + margin))) if len(q) else 0.0


def _cause_beyond(q: Array, low: float, high: float) -> str:
    """Return a hint on what would bring positions (N,) within limits."""
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
    # Quantiles, as spikes of sensors make large steps, too.
    rows = np.clip(rows, -_LARGEST, _LARGEST)
    low, high = np.quantile(rows, [0.05, 0.95], axis=0)
    reach, steps = high - low, np.abs(np.diff(rows, axis=0))
    far = reach > _NO_NOISE
    if not far.any() or (np.median(steps, axis=0) < _JUMP * reach)[far].any():
        return None
    most = int(np.argmax(reach))
    return (
        f"The rows of log {log.name!r} are not sorted by time: {log.joints[most]} jumps by "
        f"{np.median(steps[:, most]):.3g} rad (m) from row to row, within a range of "
        f"{reach[most]:.3g}."
    )
