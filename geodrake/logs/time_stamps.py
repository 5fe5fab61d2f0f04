"""Time stamps of a log, which are to increase."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import LogError

Array = NDArray[np.float64]

_LATEST = 1e20  # s; nanoseconds since 1970 are 2e18


def check_time(name: str, time: Array) -> None:
    """Raise a LogError unless time stamps increase, those left out that are not finite.

    Args:
        name: Name of the log.
        time: (N,) time stamps, s.
    """
    latest = float(np.max(np.abs(time), initial=0.0, where=np.isfinite(time)))
    if latest > _LATEST:
        raise LogError(
            f"Time in log {name!r} reaches {latest:.4g} s, which no log does.",
            advice="Is this column the time, or is a row damaged?",
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
    what = "runs backwards" if steps[first] < 0 else "repeats" if steps.any() else "is constant"
    raise LogError(
        f"Time {what} in log {name!r}: row {before} has {time[before - 1]:.9g} s and row {after} "
        f"has {time[after - 1]:.9g} s.",
        advice="Log the instant each sample was measured at, with enough digits, and sort or "
        "remove rows so that time increases.",
        row=int(after),
    )
