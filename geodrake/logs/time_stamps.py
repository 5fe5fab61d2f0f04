"""Units, repair and checks of the time stamps of a log."""

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
"""Unit of stamps since an epoch -> its length, s, and time from the epoch to 1970, s."""

_DAYS = {"Excel": (36526.0, 73051.0), "MATLAB": (730486.0, 767011.0)}  # of 2000 to 2099
_DAY = 86400.0  # s
_RATES = 5.0, 5000.0  # Hz, plausible sampling rates
_ROWS = 100_000  # from which the unit is determined
_SLOWEST = 0.5  # s, longest period that is useful for accelerations
_SLOW = 5.0  # s, longest period of logs with stamps since an epoch
_SMOOTH = 0.01  # of its range: second difference of a position that is sampled often
_ALIKE = 0.1  # relative tolerance of a unit determined from velocities
_MOST_SETS = 40  # most changes of a clock in a log
_SMOOTHER = 0.5  # roughness of positions in the order of time, relative to the order of rows
_EVEN = 0.02  # least share of rows before and after a change of a clock, besides ten rows
_REPEATED = 0.05  # largest share of rows with the stamp of the row before
_FEWEST, _BEGIN = 50, 20_000  # fewest rows to detect bursts, and rows examined for them
_SHORT, _BURSTS = 0.25, 0.05  # short steps relative to the mean, and their share in bursts
_GAP_STEPS, _GAP_SECONDS = 5.0, 0.02  # a longer step is a gap, a shorter one is jitter
_BURSTS_TOGETHER = 10.0  # length of the moving average, in longest usual steps
_INSTANT = 1e-9  # s
_DIGITS = 30.0  # of the 40 that the digits of a clock skip at the end of a minute
_WHOLE = 1e-6  # rounding error of integer stamps
_WRAPS = [2.0**bits * unit for bits in (16, 24, 32) for unit in (1.0, 1e-3, 1e-6, 1e-9)]
"""Times after which counters wrap, s."""

_CLOCKS = 3600.0, 43_200.0, 86_400.0  # s after which clocks restart
_USUAL = 1.2  # longest step beside a clock that was set back by a few periods, in periods
_GAP = 1.0  # s, assumed between rows before and after a clock was set back


def longest_step(period: float) -> float:
    """Return the longest time between rows, s, that is no gap, for a sampling period, s."""
    return max(_GAP_STEPS * period, _GAP_SECONDS)


def time_unit(
    name: str, time: Array, position: Array | None = None, velocity: Array | None = None
) -> tuple[float, str] | None:
    """Return the factor from time stamps (N,) of unknown unit to seconds, and why; None for s.

    Stamps are recognized by an epoch, or if only one unit gives a plausible sampling rate. Those in
    a column of the `name` time are in s, as geodrake writes them, unless there is an epoch,
    velocities (N, n) show another unit, or stamps are integers and positions (N, n) smooth.
    """
    known = time[np.isfinite(time)][:_ROWS]
    if len(known) < 2:
        return None
    typical, period = float(np.median(known)), float(np.median(np.abs(np.diff(known))))
    for unit, (factor, before) in _SINCE.items():
        is_of_epoch = _EPOCH[0] < factor * typical - before < _EPOCH[1]
        if is_of_epoch and factor * period < _SLOW:  # excludes an uptime in a smaller unit
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
    """Return the seconds of time stamps (N,) that are digits of a clock; None for others.

    The formats are hhmmss.fff and hhmmssmmm, which jump at full minutes, from 59.99 to 100.
    """
    for unit in (1.0, 1e-3):
        steps = np.diff(unit * time[:_ROWS])
        if not (jumps := steps > _DIGITS).any():
            continue
        stamps = unit * time
        seconds = stamps - 40.0 * (stamps // 1e2) - 2400.0 * (stamps // 1e4)
        intervals, first = np.diff(seconds[:_ROWS]), stamps[:_ROWS]
        digits = np.nanmax([first // 1e4, first // 1e2 % 1e2, first % 1e2], axis=1)
        are_of_clock = (digits < [24.0, 60.0, 60.0]).all()
        if are_of_clock and intervals[jumps].max() <= longest_step(float(np.nanmedian(intervals))):
            return seconds
    return None


def are_parts(seconds: Array, parts: Array) -> bool:
    """Return whether `parts` (N,), s, are the fractions of whole `seconds` (N,) in another column.

    Such seconds are constant over several rows, or count from 1970.
    """
    known = seconds[np.isfinite(seconds)]
    if (known % 1.0).any() or (parts >= 1.0).any() or len(known) < 2:
        return False
    slow = np.median(np.abs(np.diff(known))) < 1.0
    return bool(slow or _EPOCH[0] < np.median(known) < _EPOCH[1])


def _is_certain(factor: float, time: Array, position: Array | None, velocity: Array | None) -> bool:
    """Return whether a motion (N, n) proves that a factor turns time stamps (N,) into seconds."""
    if position is None:
        return False
    place, steps = position[:_ROWS], np.diff(time[:_ROWS])
    if velocity is not None:
        distance = np.nansum(np.abs(np.diff(place, axis=0)), axis=0)
        seconds = distance / np.maximum(np.nansum(np.abs(velocity[1:_ROWS]), axis=0), _INSTANT)
        moves = seconds > 0.0
        ratio = seconds[moves] / (factor * np.nanmedian(steps))
        return bool(moves.any() and abs(np.median(ratio) - 1.0) < _ALIKE)
    place = place[np.isfinite(place).all(axis=1)]
    if len(place) < _FEWEST or np.any(np.abs(steps - np.rint(steps)) > _WHOLE):
        return False
    ranges, bends = np.ptp(place, axis=0), np.abs(np.diff(place, 2, axis=0))
    return bool(ranges.any() and (np.median(bends, axis=0) <= _SMOOTH * ranges).all())


def going_on(time: Array, *, of_day: bool = False) -> tuple[Array, tuple[str, ...]]:
    """Return time stamps (N,) that continue after a counter wrapped or a clock was set back.

    A note is returned, too. A counter wraps at a power of two of its units, a time `of_day` after
    an hour, half a day or a day. A clock that was set back leaves a gap. Many rows must precede and
    follow it, as a few rows of another time are corrupt.
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
    times = f"{len(back)} times, first " if len(back) > 1 else ""
    row = rows[back[0] + 1] + 1
    if len(ends) == 1 and len(back) <= _EVEN * len(rows):
        added = np.full(len(back), ends[0])
        words = f"the time counter restarts after {ends[0]:.6g} s, {times}at row {row}: continued"
    else:
        parts = np.diff(np.concatenate([[0], back + 1, [len(rows)]]))
        are_few = len(back) <= _MOST_SETS and parts.min() >= max(10.0, _EVEN * len(rows))
        # Corrupt rows have steps of equal size before and after them.
        around = steps[np.clip([back - 1, back + 1], 0, len(steps) - 1)].max(axis=0)
        is_short = falls < 10.0 * period
        is_corrupt = is_short & (around > _USUAL * period) | (falls < 0.5 * period)
        if not are_few or is_corrupt.any() or steps.max() > 0.5 * falls.max():
            return time, ()
        added = max(_GAP, 20.0 * period) + falls
        words = (
            f"the clock was set back {times}by {period + falls[0]:.4g} s at row {row}, which is "
        )
        words += "treated as a gap"
    continued = time.copy()
    for k, more in zip(back.tolist(), added.tolist(), strict=True):
        continued[rows[k + 1] :] += more
    return continued, (words,)


def order_of_time(time: Array, position: Array) -> NDArray[np.intp] | None:
    """Return the order of rows by time if many are out of order; None otherwise.

    Positions must be smooth in that order but not in the order of rows, unless this is reversed. If
    no two stamps are close together, few rows may be out of order, as between shuffled blocks, and
    positions need only be smoother.
    """
    rows = np.flatnonzero(np.isfinite(time))
    backwards = np.count_nonzero(np.diff(time[rows]) < 0.0)
    if len(rows) < _FEWEST or not backwards:
        return None
    order = rows[np.argsort(time[rows], kind="stable")]
    if backwards == len(rows) - 1:  # reversed
        return order
    steps = np.diff(time[order])
    are_apart = steps.min() > 0.5 * np.median(steps)
    if backwards <= _EVEN * len(rows) and not are_apart:
        return None
    repeated = np.count_nonzero(steps == 0.0)
    smooth, given = (np.abs(np.diff(position[each], 2, axis=0)) for each in (order, rows))
    if repeated or not (np.isfinite(smooth).any() and np.isfinite(given).any()):
        return None
    least = 1.0 if are_apart else _SMOOTHER
    return order if np.nanmean(smooth) < least * np.nanmean(given) else None


def evened(time: Array, position: Array) -> tuple[Array, tuple[str, ...]]:
    """Return uniform time stamps for rows that were stamped on arrival in bursts, and a note.

    They are moving averages over several bursts, used only if they make positions smoother.
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
    means, width = stamps.copy(), round(_BURSTS_TOGETHER * pause / period)
    for part in np.split(np.arange(len(stamps)), np.flatnonzero(~inside) + 1):
        if len(part) > width:
            uniform = period * np.arange(len(part))
            delay = uniform_filter1d(stamps[part] - uniform, width, mode="nearest")
            means[part] = uniform + delay
    is_off = np.abs(means - stamps).max() > 2.0 * pause or not (np.diff(means) > 0.0).all()
    if is_off or not _roughness(means, position[rows]) < 0.5 * _roughness(stamps, position[rows]):
        return time, ()
    even = time.copy()
    even[rows] = means
    words = (
        f"rows were stamped on arrival, {short} of {len(rows)} together with the one before: "
        f"they are assumed to be uniform at {1.0 / period:.4g} Hz"
    )
    return even, (words,)


def _roughness(time: Array, position: Array) -> float:
    """Return the median change of speeds from row to row, summed over joints."""
    speeds = np.diff(position, axis=0) / np.maximum(np.diff(time), _INSTANT)[:, None]
    changes = np.abs(np.diff(speeds, axis=0)).T
    return sum(float(np.nanmedian(each)) for each in changes if np.isfinite(each).any())


def repeats(time: Array, numbers: Sequence[Array]) -> NDArray[np.bool_]:
    """Return whether rows repeat the time of the row before; if many do, only copies count."""
    same = np.concatenate([[False], np.diff(time) == 0.0])
    if np.count_nonzero(same) <= _REPEATED * len(time):
        return same
    before = np.roll(same, -1)
    return same & all(np.array_equal(x[same], x[before], equal_nan=True) for x in numbers)


def check_time(name: str, time: Array) -> None:
    """Raise a LogError unless the finite time stamps (N,), s, increase."""
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
    is_repeated = steps[first] == 0
    fault = "runs backwards" if not is_repeated else "repeats" if steps.any() else "is constant"
    raise LogError(
        f"Time {fault} in log {name!r}: row {before} has {time[before - 1]:.12g} s and row {after} "
        f"has {time[after - 1]:.12g} s.",
        advice="Log the time at which each sample was measured, with enough digits, and sort "
        "or remove rows so that it increases."
        + (" If rows are uniform, give their rate with --rate." if is_repeated else ""),
    )
