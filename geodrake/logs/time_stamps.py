"""Time stamps of a log, which are to increase."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from geodrake.boundary.arguments import Array
from geodrake.errors import LogError

_LATEST = 1e20  # s; nanoseconds since 1970 are 2e18


_EPOCH = 9e8, 4.2e9  # s since 1970 at which a robot may have been logged: from 1998 to 2103
_UNITS = {"ns": 1e-9, "µs": 1e-6, "ms": 1e-3}
_SINCE = {f"{unit} since 1970": (factor, 0.0) for unit, factor in _UNITS.items()} | {
    "100 ns since 1601": (1e-7, 11_644_473_600.0),
    "100 ns since the year 1": (1e-7, 62_135_596_800.0),
}
"""Stamps by their size -> s of a step, and s from their zero to 1970."""

_DAYS = {"Excel": (36526.0, 73051.0), "MATLAB": (730486.0, 767011.0)}  # of 2000 to 2099
_DAY = 86400.0  # s
_RATES = 5.0, 5000.0  # rows a second of a log
_ROWS = 100_000  # that tell the unit
_SLOWEST = 0.5  # s between rows: what has more says nothing about accelerations
_SLOW = 5.0  # s between rows of a log that is of use for other questions
_SMOOTH = 0.01  # of its range, by which a position that is logged often bends from row to row
_ALIKE = 0.1  # of a unit, by which joints may differ in what their speeds say of it
_MOST_SETS = 40  # of a clock, in a log
_SMOOTHER = 0.5  # times as much as before positions bend in the order of time
_EVEN = 0.02  # share of the rows before and after, at least, and ten of them
_REPEATED = 0.05  # share of rows that may have the stamp of the row before
_FEWEST, _BEGIN = 50, 20_000  # rows that tell bursts, and among which these are looked for
_SHORT, _BURSTS = 0.25, 0.05  # of the mean step, and the share of steps that are shorter
_GAP_STEPS, _GAP_SECONDS = 5.0, 0.02  # a longer step is a gap, a shorter one is jitter
_BURSTS_TOGETHER = 10.0  # longest usual steps of what is averaged
_INSTANT = 1e-9  # s
_DIGITS = 30.0  # of the 40 that the digits of a clock leave out at the end of a minute
_WHOLE = 1e-6  # by which stamps that count are off
_WRAPS = [2.0**bits * unit for bits in (16, 24, 32) for unit in (1.0, 1e-3, 1e-6, 1e-9)]
"""Times at which a counter in some unit begins anew, s."""

_CLOCKS = 3600.0, 43_200.0, 86_400.0  # s after which clocks begin anew
_GAP = 1.0  # s that are taken to lie between rows before and after a clock was set back


def longest_step(period: float) -> float:
    """Return the time between rows, s, beyond which there is a gap, from the usual one."""
    return max(_GAP_STEPS * period, _GAP_SECONDS)


def time_unit(
    name: str, time: Array, position: Array | None = None, velocity: Array | None = None
) -> tuple[float, str] | None:
    """Return the factor from time stamps (N,) of unknown unit to seconds, and why; None for s.

    They are of an epoch in ms, µs, ns or days, or of no plausible rate in any unit but one. Those
    in a column of the `name` time are in s, as geodrake writes them, unless they are of an epoch,
    velocities (N, n) say another unit, or they are whole and positions (N, n) smooth.
    """
    known = time[np.isfinite(time)][:_ROWS]
    if len(known) < 2:
        return None
    typical, period = float(np.median(known)), float(np.median(np.abs(np.diff(known))))
    for unit, (factor, before) in _SINCE.items():
        is_of_epoch = _EPOCH[0] < factor * typical - before < _EPOCH[1]
        if is_of_epoch and factor * period < _SLOW:  # not of an uptime in a smaller unit
            return factor, f"time is in {unit}, judging by its size: converted"
    for program, (first, last) in _DAYS.items():
        if first <= typical < last and _RATES[0] <= 1.0 / max(_DAY * period, _INSTANT) <= _RATES[1]:
            return _DAY, f"time is in days as in {program}, judging by its size: converted"
    rates = {unit: 1.0 / (factor * max(period, _INSTANT)) for unit, factor in _UNITS.items()}
    likely = [unit for unit, rate in rates.items() if _RATES[0] <= rate <= _RATES[1]]
    if period < _SLOWEST or len(likely) != 1:
        return None
    (unit,) = likely
    if name == "time" and not _is_certain(_UNITS[unit], time, position, velocity):
        return None
    words = f"time is in {unit}, judging by {rates[unit]:.4g} Hz: converted"
    return _UNITS[unit], f"{words} (--units time=s if it is not)"


def of_clock(time: Array) -> Array | None:
    """Return seconds of time stamps (N,) that are digits of a clock; None if they are not.

    These are hhmmss.fff or hhmmssmmm, which jump where a minute ends, as 59.99 is followed by 100.
    """
    for unit in (1.0, 1e-3):
        steps = np.diff(unit * time[:_ROWS])
        if not (jumps := steps > _DIGITS).any():
            continue
        stamps = unit * time
        since = stamps - 40.0 * (stamps // 1e2) - 2400.0 * (stamps // 1e4)
        own, seen = np.diff(since[:_ROWS]), stamps[:_ROWS]
        digits = np.nanmax([seen // 1e4, seen // 1e2 % 1e2, seen % 1e2], axis=1)
        are_of_clock = (digits < [24.0, 60.0, 60.0]).all()
        if are_of_clock and own[jumps].max() <= longest_step(float(np.nanmedian(own))):
            return since
    return None


def are_parts(seconds: Array, parts: Array) -> bool:
    """Return whether `parts` (N,), s, are those of whole `seconds` (N,) in another column.

    In a log of several rows a second these rarely change, or they count from 1970 on.
    """
    known = seconds[np.isfinite(seconds)]
    if (known % 1.0).any() or (parts >= 1.0).any() or len(known) < 2:
        return False
    slow = np.median(np.abs(np.diff(known))) < 1.0
    return bool(slow or _EPOCH[0] < np.median(known) < _EPOCH[1])


def _is_certain(factor: float, time: Array, position: Array | None, velocity: Array | None) -> bool:
    """Return whether a motion (N, n) shows that a factor makes seconds of its time stamps (N,)."""
    if position is None:
        return False
    place, steps = position[:_ROWS], np.diff(time[:_ROWS])
    if velocity is not None:
        way = np.nansum(np.abs(np.diff(place, axis=0)), axis=0)
        seconds = way / np.maximum(np.nansum(np.abs(velocity[1:_ROWS]), axis=0), _INSTANT)
        moves = seconds > 0.0
        ratio = seconds[moves] / (factor * np.nanmedian(steps))
        return bool(moves.any() and abs(np.median(ratio) - 1.0) < _ALIKE)
    place = place[np.isfinite(place).all(axis=1)]
    if len(place) < _FEWEST or np.any(np.abs(steps - np.rint(steps)) > _WHOLE):
        return False
    reach, bends = np.ptp(place, axis=0), np.abs(np.diff(place, 2, axis=0))
    return bool(reach.any() and (np.median(bends, axis=0) <= _SMOOTH * reach).all())


def going_on(time: Array, *, of_day: bool = False) -> tuple[Array, tuple[str, ...]]:
    """Return time stamps (N,) that go on where a counter began anew or a clock was set back.

    With them comes a note. A counter ends at a power of two of its units, between one row and the
    next; a time `of_day` after an hour, half a day or a day. Before and after a clock was set back
    there must be many rows, as a few of another time are damaged ones; a gap is taken to be there.
    """
    rows = np.flatnonzero(np.isfinite(time))
    steps = np.diff(time[rows])
    back = np.flatnonzero(steps < 0.0)
    if not len(back):
        return time, ()
    period, falls = float(np.median(steps)), -steps[back]
    most = _GAP_STEPS * period
    last, first = time[rows[back]], time[rows[back + 1]]
    ends = [w for w in _WRAPS if np.all((last < w) & (w - last <= most) & (np.abs(first) <= most))]
    if of_day:
        ends = [w for w in _CLOCKS if np.all((last < first + w) & (first + w <= last + most))]
    again = f"{len(back)} times, first " if len(back) > 1 else ""
    row = rows[back[0] + 1] + 1
    if len(ends) == 1 and len(back) <= _EVEN * len(rows):
        added = np.full(len(back), ends[0])
        words = (
            f"the counter of time begins anew at {ends[0]:.6g} s, {again}at row {row}: it goes on"
        )
    else:
        parts = np.diff(np.concatenate([[0], back + 1, [len(rows)]]))
        are_few = len(back) <= _MOST_SETS and parts.min() >= max(10.0, _EVEN * len(rows))
        # After damaged rows, and before them, time is what it was: steps of one size lead there.
        if not are_few or falls.min() < 10.0 * period or steps.max() > 0.5 * falls.max():
            return time, ()
        added = max(_GAP, 20.0 * period) + falls
        words = (
            f"the clock was set back {again}by {period + falls[0]:.3g} s at row {row}, which is "
        )
        words += "treated as a gap"
    found = time.copy()
    for k, more in zip(back.tolist(), added.tolist(), strict=True):
        found[rows[k + 1] :] += more
    return found, (words,)


def order_of_time(time: Array, position: Array) -> NDArray[np.intp] | None:
    """Return the order of rows by time if many are out of order; None otherwise.

    Positions must be smooth in that order, and not as they are, unless all rows are reversed.
    """
    rows = np.flatnonzero(np.isfinite(time))
    backwards = np.count_nonzero(np.diff(time[rows]) < 0.0)
    if len(rows) < _FEWEST or backwards <= _EVEN * len(rows):
        return None
    order = rows[np.argsort(time[rows], kind="stable")]
    if backwards == len(rows) - 1:  # the latest first
        return order
    repeated = np.count_nonzero(np.diff(time[order]) == 0.0)
    smooth, given = (np.abs(np.diff(position[each], 2, axis=0)) for each in (order, rows))
    if repeated or not (np.isfinite(smooth).any() and np.isfinite(given).any()):
        return None
    return order if np.nanmean(smooth) < _SMOOTHER * np.nanmean(given) else None


def evened(time: Array, position: Array) -> tuple[Array, tuple[str, ...]]:
    """Return even time stamps where rows came in bursts and were stamped on arrival, and a note.

    The mean of the stamps of some bursts counts, if positions run more smoothly with it.
    """
    begin = np.diff(time[:_BEGIN][np.isfinite(time[:_BEGIN])])
    if len(begin) < _FEWEST or np.mean(begin < _SHORT * np.mean(begin)) < _BURSTS:
        return time, ()
    rows = np.flatnonzero(np.isfinite(time))
    stamps = time[rows]
    steps = np.diff(stamps)
    if (steps < 0.0).any():
        return time, ()
    pause = float(np.quantile(steps, 0.98))
    inside = steps <= _GAP_STEPS * pause
    period = float(steps[inside].mean())
    short = np.count_nonzero(steps[inside] < _SHORT * period)
    if short < _BURSTS * len(steps):
        return time, ()
    found, width = stamps.copy(), round(_BURSTS_TOGETHER * pause / period)
    for part in np.split(np.arange(len(stamps)), np.flatnonzero(~inside) + 1):
        if len(part) > width:
            line = period * np.arange(len(part))
            late = uniform_filter1d(stamps[part] - line, width, mode="nearest")
            found[part] = line + late
    apart = np.abs(found - stamps).max() > 2.0 * pause or not (np.diff(found) > 0.0).all()
    if apart or not _roughness(found, position[rows]) < 0.5 * _roughness(stamps, position[rows]):
        return time, ()
    even = time.copy()
    even[rows] = found
    words = (
        f"rows were stamped on arrival, {short} of {len(rows)} together with the one before: "
        f"they are assumed to be uniform at {1.0 / period:.4g} Hz"
    )
    return even, (words,)


def _roughness(time: Array, position: Array) -> float:
    """Return by how much speeds typically change from row to row, summed over joints."""
    speeds = np.diff(position, axis=0) / np.maximum(np.diff(time), _INSTANT)[:, None]
    changes = np.abs(np.diff(speeds, axis=0)).T
    return sum(float(np.nanmedian(each)) for each in changes if np.isfinite(each).any())


def repeats(time: Array, numbers: Sequence[Array]) -> NDArray[np.bool_]:
    """Return which rows repeat the time of the row before; none if many do, except copies."""
    same = np.concatenate([[False], np.diff(time) == 0.0])
    if np.count_nonzero(same) <= _REPEATED * len(time):
        return same
    before = np.roll(same, -1)
    return same & all(np.array_equal(x[same], x[before], equal_nan=True) for x in numbers)


def check_time(name: str, time: Array) -> None:
    """Raise a LogError unless time stamps (N,), s, increase, but for those that are not finite."""
    latest = float(np.max(np.abs(time), initial=0.0, where=np.isfinite(time)))
    if latest > _LATEST:
        raise LogError(
            f"Time in log {name!r} reaches {latest:.4g} s, which is impossible.",
            advice="Is this column the time, or is a row corrupt?",
        )
    steps = np.diff(time)
    if np.all(steps > 0):
        return
    rows = np.flatnonzero(np.isfinite(time))
    steps = np.diff(time[rows])
    if np.all(steps > 0):
        return
    first = int(np.argmax(steps <= 0))
    before, after = rows[first] + 1, rows[first + 1] + 1
    again = steps[first] == 0
    what = "runs backwards" if not again else "repeats" if steps.any() else "is constant"
    raise LogError(
        f"Time {what} in log {name!r}: row {before} has {time[before - 1]:.9g} s and row {after} "
        f"has {time[after - 1]:.9g} s.",
        advice="Log the time at which each sample was measured, with enough digits, and sort "
        "or remove rows so that it increases."
        + (" If rows are uniform, give their rate with --rate." if again else ""),
    )
