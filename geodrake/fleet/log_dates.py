"""When a log began: by its time stamps, by what the user says, or by when its file was changed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from geodrake.errors import ArgumentError, LogError
from geodrake.logs.motion import JointLog

DATED_BY = ("file", "stamps")
"""Words in the place of what a date in a path is like."""

_DIRECTIVES = {
    **{f"%{letter}": r"\d{2}" for letter in "mdHMSy"},
    "%Y": r"\d{4}",
    "%j": r"\d{3}",
    "%%": "%",
}

_TIMES = {"%H", "%M", "%S"}
_DATES = [{*day, year} for day in (("%m", "%d"), ("%j",)) for year in ("%Y", "%y")]
_EARLIEST, _LATEST = 9e8, 4.2e9  # s since 1970 at which a robot may have been logged


def date_seconds(text: str) -> float:
    """The s since 1970 of a date in ISO 8601, in UTC unless it says another zone.

    Raises:
        ArgumentError: The text is no date, or one at which no robot was logged.
    """
    try:
        instant = datetime.fromisoformat(text.strip())
    except ValueError:
        instant = None
    if instant is not None:
        zoned = instant if instant.tzinfo else instant.replace(tzinfo=UTC)
        if _EARLIEST < (seconds := zoned.timestamp()) < _LATEST:
            return seconds
    raise ArgumentError(
        f"A date is such as 2026-05-01 or 2026-05-01T12:00:00+02:00; got {text!r}.",
        advice=f"Write it in ISO 8601, after {_day(_EARLIEST)} and before {_day(_LATEST)}.",
    )


def date_text(seconds: float) -> str:
    """A date in ISO 8601, of s since 1970."""
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")


def _day(seconds: float) -> str:
    return date_text(seconds).partition("T")[0]


def date_of_log(
    log: JointLog, files: Sequence[Path], given: float | None = None
) -> tuple[float, str]:
    """When a log began, s since 1970, and where that is from: `stamps`, `option` or `file`.

    Args:
        files: Its files, which count where nothing else is known: the one changed last.
        given: What the user says, s since 1970, where stamps do not say it.

    Raises:
        LogError: That is no date at which a robot was logged.
    """
    first = float(log.time[np.isfinite(log.time)][0])
    began = first + 1e-9 * (log.origin or 0)
    if _EARLIEST < began < _LATEST:
        return began, "stamps"
    if given is not None:
        date, source, says = given, "option", "what is said is"
    else:
        date, source = max(path.stat().st_mtime for path in files), "file"
        says = "its file was changed at"
    if not _EARLIEST < date < _LATEST:
        raise LogError(
            f"Nobody knows when log {log.name!r} was recorded: its time stamps are no dates, and "
            f"{says} {date:.10g} s since 1970.",
            advice="Say when: by --date, or, in a fleet file, by a date in the names of logs and "
            "`dates`.",
            date=date,
        )
    return date, source


def check_date_pattern(pattern: str) -> None:
    """Refuse what no date in a path can be like.

    Raises:
        ArgumentError: It lacks the year or the day, or has directives that are not known, or twice.
    """
    parts = [part for part in re.findall(r"%.?", pattern) if part != "%%"]
    if set(parts) - _TIMES not in _DATES or len(set(parts)) < len(parts):
        raise ArgumentError(
            f"dates are {pattern!r}, which is like no date.",
            advice=f"Write %Y-%m-%d, or with others of {', '.join(_DIRECTIVES)}, each once; "
            f"or one of {', '.join(DATED_BY)}.",
        )


def date_in_path(path: str, pattern: str) -> float:
    """The s since 1970 of the last date in a path, in UTC.

    Args:
        pattern: What the date is like, such as `%Y-%m-%d_%H%M`.

    Raises:
        ArgumentError: There is none.
    """
    parts = re.split(r"(%.)", pattern)
    like = "".join(_DIRECTIVES.get(part, re.escape(part)) for part in parts)
    like = rf"(?<!\d){like}"  # a date begins where its digits do
    for found in reversed(re.findall(like, path)):
        try:
            instant = datetime.strptime(found, pattern).replace(tzinfo=UTC)
        except ValueError:  # such as the 30th of February
            continue
        if _EARLIEST < (seconds := instant.timestamp()) < _LATEST:
            return seconds
    raise ArgumentError(
        f"The path {path} has no date like {pattern}.",
        advice="Correct `dates` of the robot, or the name of the log.",
    )
