"""Logs that are there twice, as copies or as parts of each other: they must not be held out."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import ArgumentError
from geodrake.logs.motion import JointLog

Array = NDArray[np.float64]

_PROBES, _ROWS = 32, 8  # places of a log that are looked for in another, and rows at each of them
_FIRST = 4  # of them, one of which must be there for the others to be looked for
_MOST = 0.5  # of the probes that another log may have


def check_repeated(logs: Sequence[JointLog]) -> None:
    """Refuse logs of which one has the measurements of another.

    Positions and efforts are compared number by number, at some stretches of moving joints of each
    log; names, formats and time stamps do not matter.

    Args:
        logs: The logs, all of the same joints in the same order.

    Raises:
        ArgumentError: Most of a log is in another one.
    """
    for pair in combinations(logs, 2):
        short, long = sorted(pair, key=len)
        probes = _probes(short)
        if not any(_holds(long, probe) for probe in probes[:: _PROBES // _FIRST]):
            continue
        if np.mean([_holds(long, probe) for probe in probes]) > _MOST:
            raise ArgumentError(
                f"Log {short.name!r} is given twice, so it would be validated against itself: its "
                f"measurements are those of {long.name!r}.",
                advice="Name each log once.",
            )


def _probes(log: JointLog) -> list[tuple[Array, Array]]:
    """Positions and efforts (rows, n) at some places of a log, where a joint moves all the time."""
    starts = np.unique(np.linspace(0, max(0, len(log) - _ROWS), _PROBES).astype(int)).tolist()
    rows = (slice(start, start + _ROWS) for start in starts)
    places = ((log.position[each], log.effort[each]) for each in rows)
    return [place for place in places if np.diff(place[0], axis=0).any(axis=1).all()]


def _holds(log: JointLog, probe: tuple[Array, Array]) -> bool:
    """Whether a log has such positions and efforts, number by number, in rows that follow."""
    starts = np.arange(len(log) - len(probe[0]) + 1)
    for row in range(len(probe[0])):
        for measured, wanted in zip((log.effort, log.position), probe[::-1], strict=True):
            for joint, value in enumerate(wanted[row].tolist()):
                starts = starts[measured[starts + row, joint] == value]
    return len(starts) > 0
