"""Locations of a fleet's logs, local or remote by fsspec, and the dates of logs."""

from __future__ import annotations

import fnmatch
import glob
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from geodrake.boundary.escaping import kind_and_line
from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import ArgumentError, FleetError, LogError
from geodrake.logs.motion import JointLog

IN_THIS_PROCESS = "memory://"
"""Prefix of addresses that other processes cannot access."""


class UnreachableLogError(LogError):
    """A remote log cannot be copied at present."""


@dataclass(frozen=True)
class LogPlace:
    """A log that has not been read yet."""

    address: str
    stamp: str  # identifies the content: size, and time of the last change of content or metadata
    changed: float | None  # time of the last change, s since 1970; None if unknown

    @property
    def name(self) -> str:
        """Name of the file."""
        links = self.address.split("::") if protocol_of(self.address) else [self.address]
        path = next(link for link in links if "/" in link)
        return path.rstrip("/").rpartition("/")[2]


def protocol_of(pattern: str) -> str:
    """Return the protocol of an address, such as `s3` of `s3://bucket/log.csv`; "" for a path."""
    match = re.match(r"([\w+.-]+)://|([\w+.-]+)::", pattern)
    return (match[1] or match[2]) if match else ""


def home_path(text: str) -> Path:
    """Return a path, with `~` expanded."""
    try:
        return Path(text).expanduser()
    except RuntimeError as error:
        raise ArgumentError(
            f"{text} is in the home folder of an unknown user.", advice="Write the full path."
        ) from error


def absolute_pattern(pattern: str, base: Path) -> str:
    """Return a pattern with an absolute path."""
    if protocol_of(pattern):
        return pattern
    return str(Path(glob.escape(str(base))) / home_path(pattern))


def find_logs(pattern: str) -> tuple[LogPlace, ...]:
    """Return the logs that match a path or address with `*`, `?`, `[…]` and `**`, sorted."""
    try:
        if not protocol_of(pattern):
            # Unlike pathlib, this skips hidden files, such as incomplete copies.
            local = sorted(glob.glob(pattern, recursive=True))  # noqa: PTH207
            return tuple(place for path in local if (place := _place(path)) is not None)
        fs, path = _file_system(pattern)
        fs.invalidate_cache()  # cached listings lack new logs
        matches = sorted(fs.glob(path)) if glob.has_magic(path) else [path]
        matches = [match for match in matches if glob.has_magic(path) or fs.exists(match)]
        return tuple(_remote_place(fs, match, _address(fs, match, pattern)) for match in matches)
    except FleetError:
        raise
    except Exception as error:  # each file system has its own errors
        raise FleetError(
            f"Logs {pattern!r} cannot be listed: {kind_and_line(error)}.",
            advice="Check the address and the credentials for it.",
        ) from error


def fits(address: str, pattern: str) -> bool:
    """Return whether an address matches a pattern, even if the log no longer exists."""
    paths = (re.sub(r"^[\w+.-]+://", "", text) for text in (address, pattern))
    return _fit(*([part for part in path.split("/") if part] for path in paths))


def _fit(parts: Sequence[str], patterns: Sequence[str]) -> bool:
    """Return whether the parts of a path match patterns; `**` matches any number of parts."""
    if not patterns:
        return not parts
    if patterns[0] == "**":
        return any(_fit(parts[first:], patterns[1:]) for first in range(len(parts) + 1))
    return (
        bool(parts) and fnmatch.fnmatchcase(parts[0], patterns[0]) and _fit(parts[1:], patterns[1:])
    )


@contextmanager
def local_log(place: LogPlace) -> Iterator[Path]:
    """Yield a local file of the log, which is a temporary copy for remote logs.

    A copy has the log's name and modification time, or 1970 if that is unknown.
    """
    if not protocol_of(place.address):
        yield Path(place.address)
        return
    with TemporaryDirectory(prefix="geodrake") as folder:
        copy = Path(folder) / place.name
        try:
            fs, path = _file_system(place.address)
            fs.get(path, str(copy), recursive=fs.isdir(path))
            for file in (copy, *copy.rglob("*")):
                os.utime(file, (place.changed or 0.0,) * 2)
        except Exception as error:  # each file system has its own errors
            raise UnreachableLogError(
                f"Log {place.address} cannot be read: {kind_and_line(error)}.",
                advice="Check the address and the credentials for it.",
            ) from error
        yield copy


def _place(path: str) -> LogPlace | None:
    try:
        status = Path(path).stat()
    except FileNotFoundError:  # a dangling link, or just deleted
        return None
    return LogPlace(path, f"{status.st_size} {status.st_ctime_ns}", status.st_mtime)


def _file_system(address: str) -> tuple[Any, str]:
    """Return the fsspec file system of an address, and the path there."""
    core = optional_package("fsspec.core", "fleet", f"logs at {address}", FleetError)
    return core.url_to_fs(address)


def _address(fs: Any, path: str, pattern: str) -> str:
    """Return the address of a match of a pattern, within the same archive or cache."""
    links = pattern.split("::")
    if len(links) == 1:
        return str(fs.unstrip_protocol(path))
    k = next(k for k, link in enumerate(links) if "://" in link)
    links[k] = f"{links[k].partition('://')[0]}://{path}"
    return "::".join(links)


def _remote_place(fs: Any, path: str, address: str) -> LogPlace:
    info = fs.info(path)
    try:
        changed = float(fs.modified(path).timestamp())
    except (NotImplementedError, AttributeError, KeyError, TypeError, OSError):
        changed = None
    tag = info.get("ETag") or info.get("etag") or info.get("md5Hash") or changed
    stamp = " ".join(str(value) for value in (info.get("size"), tag) if value is not None)
    return LogPlace(address, stamp, changed)


DATED_BY = ("file", "stamps")
"""Alternatives to a pattern of dates in paths."""

_DIRECTIVES = {
    **{f"%{letter}": r"\d{2}" for letter in "mdHMSy"},
    "%Y": r"\d{4}",
    "%j": r"\d{3}",
    "%%": "%",
}

_TIMES = {"%H", "%M", "%S"}
_DATES = [{*day, year} for day in (("%m", "%d"), ("%j",)) for year in ("%Y", "%y")]
_EARLIEST, _LATEST = 9e8, 4.2e9  # s since 1970, range of plausible dates of logs


def date_seconds(text: str) -> float:
    """Return the time, s since 1970, of a date in ISO 8601, in UTC unless it has a time zone."""
    try:
        instant = datetime.fromisoformat(text.strip())
    except ValueError:
        instant = None
    if instant is not None:
        zoned = instant if instant.tzinfo else instant.replace(tzinfo=UTC)
        if _EARLIEST < (seconds := zoned.timestamp()) < _LATEST:
            return seconds
    raise ArgumentError(
        f"{text!r} is not a date such as 2026-05-01 or 2026-05-01T12:00:00+02:00.",
        advice=f"Write it in ISO 8601, after {_day(_EARLIEST)} and before {_day(_LATEST)}.",
    )


def date_text(seconds: float) -> str:
    """Return the date in ISO 8601 of a time, s since 1970."""
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")


def _day(seconds: float) -> str:
    return date_text(seconds).partition("T")[0]


def date_of_log(
    log: JointLog, files: Sequence[Path], given: float | None = None
) -> tuple[float, str]:
    """Return the start of a log, s since 1970, and its source: `stamps`, `option` or `file`.

    Args:
        files: Its files, whose last modification is the default.
        given: Date given by the user, s since 1970, if the time stamps are not dates.
    """
    first = float(log.time[np.isfinite(log.time)][0])
    start = first + 1e-9 * (log.origin or 0)
    if _EARLIEST < start < _LATEST:
        return start, "stamps"
    if given is not None:
        date, source, words = given, "option", "the given date is"
    else:
        date, source = max(path.stat().st_mtime for path in files), "file"
        words = "its modification time is"
    if not _EARLIEST < date < _LATEST:
        raise LogError(
            f"The date of log {log.name!r} is unknown: its time stamps are not dates, and "
            f"{words} {date:.10g} s since 1970.",
            advice="Use --date or, in a fleet file, `dates` and dates in the names of logs.",
        )
    return date, source


def check_date_pattern(pattern: str) -> None:
    """Raise if a pattern does not define a date."""
    parts = [part for part in re.findall(r"%.?", pattern) if part != "%%"]
    if set(parts) - _TIMES not in _DATES or len(set(parts)) < len(parts):
        raise ArgumentError(
            f"dates has the invalid pattern {pattern!r}.",
            advice=f"Write %Y-%m-%d, or with others of {', '.join(_DIRECTIVES)}, each once; "
            f"or one of {', '.join(DATED_BY)}.",
        )


def date_in_path(path: str, pattern: str) -> float:
    """Return the time, s since 1970, of the last date in a path that matches a pattern, in UTC."""
    parts = re.split(r"(%.)", pattern)
    expression = "".join(_DIRECTIVES.get(part, re.escape(part)) for part in parts)
    expression = rf"(?<!\d){expression}"  # not in the middle of a number
    for text in reversed(re.findall(expression, path)):
        try:
            instant = datetime.strptime(text, pattern).replace(tzinfo=UTC)
        except ValueError:  # such as 30 February
            continue
        if _EARLIEST < (seconds := instant.timestamp()) < _LATEST:
            return seconds
    raise ArgumentError(
        f"The path {path} has no date like {pattern}.",
        advice="Correct `dates` of the robot, or the name of the log.",
    )
