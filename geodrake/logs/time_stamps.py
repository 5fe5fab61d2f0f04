"""Time stamps of a log, which are to increase."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import LogError

Array = NDArray[np.float64]


def check_time(name: str, time: Array) -> None:
    """Raise a LogError unless time stamps increase, those left out that are not finite.

    Args:
        name: Name of the log.
        time: (N,) time stamps, s.
    """
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
