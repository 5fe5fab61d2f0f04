"""Where logs of a fleet are, on this machine or elsewhere by fsspec; and when each began."""

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
"""Beginning of addresses that other processes do not see."""


class UnreachableLogError(LogError):
    """A log that is elsewhere cannot be copied from there, now."""


@dataclass(frozen=True)
class LogPlace:
    """A log that is not read yet."""

    address: str
    stamp: str  # its size and when it, or who may read it, was changed: another one is another log
    changed: float | None  # when it was changed, s since 1970; None where nobody knows

    @property
    def name(self) -> str:
        """Name of the file."""
        links = self.address.split("::") if protocol_of(self.address) else [self.address]
        own = next(link for link in links if "/" in link)
        return own.rstrip("/").rpartition("/")[2]


def protocol_of(pattern: str) -> str:
    """Return `s3` of `s3://bucket/log.csv`; empty for a path."""
    found = re.match(r"([\w+.-]+)://|([\w+.-]+)::", pattern)
    return (found[1] or found[2]) if found else ""


def home_path(text: str) -> Path:
    """Return a path, with `~` for the home of a user."""
    try:
        return Path(text).expanduser()
    except RuntimeError as error:
        raise ArgumentError(
            f"{text} is in the home folder of an unknown user.", advice="Write the full path."
        ) from error


def absolute_pattern(pattern: str, base: Path) -> str:
    """Return a pattern that means the same in every folder."""
    if protocol_of(pattern):
        return pattern
    return str(Path(glob.escape(str(base))) / home_path(pattern))


def find_logs(pattern: str) -> tuple[LogPlace, ...]:
    """Return by name the matches of a path or address with `*`, `?`, `[…]` and `**`."""
    try:
        if not protocol_of(pattern):
            # Unlike pathlib's, this finds no hidden files, such as those that are being copied.
            local = sorted(glob.glob(pattern, recursive=True))  # noqa: PTH207
            return tuple(place for path in local if (place := _place(path)) is not None)
        fs, path = _file_system(pattern)
        fs.invalidate_cache()  # of listings, which would hide logs that came later
        found = sorted(fs.glob(path)) if glob.has_magic(path) else [path]
        found = [each for each in found if glob.has_magic(path) or fs.exists(each)]
        return tuple(_remote_place(fs, each, _address(fs, each, pattern)) for each in found)
    except FleetError:
        raise
    except Exception as error:  # each kind of place has errors of its own
        raise FleetError(
            f"Logs {pattern!r} cannot be listed: {kind_and_line(error)}.",
            advice="Check the address and the credentials for it.",
        ) from error


def fits(address: str, pattern: str) -> bool:
    """Return whether a pattern would find an address, if the log were there."""
    plain = (re.sub(r"^[\w+.-]+://", "", each) for each in (address, pattern))
    return _fit(*([part for part in each.split("/") if part] for each in plain))


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
    """Yield the log as a file of this machine, under its own name: itself, or a copy.

    A copy is as old as the log; where nobody knows when that was changed, as in 1970.
    """
    if not protocol_of(place.address):
        yield Path(place.address)
        return
    with TemporaryDirectory(prefix="geodrake") as folder:
        copy = Path(folder) / place.name
        try:
            fs, path = _file_system(place.address)
            fs.get(path, str(copy), recursive=fs.isdir(path))
            for each in (copy, *copy.rglob("*")):
                os.utime(each, (place.changed or 0.0,) * 2)
        except Exception as error:  # each kind of place has errors of its own
            raise UnreachableLogError(
                f"Log {place.address} cannot be read: {kind_and_line(error)}.",
                advice="Check the address and the credentials for it.",
            ) from error
        yield copy


def _place(path: str) -> LogPlace | None:
    try:
        status = Path(path).stat()
    except FileNotFoundError:  # a link to nothing, or deleted meanwhile
        return None
    return LogPlace(path, f"{status.st_size} {status.st_ctime_ns}", status.st_mtime)


def _file_system(address: str) -> tuple[Any, str]:
    """Return the fsspec file system of an address, and the path there."""
    core = optional_package("fsspec.core", "fleet", f"logs at {address}", FleetError)
    return core.url_to_fs(address)


def _address(fs: Any, path: str, pattern: str) -> str:
    """Return the address of a pattern's match, in the pattern's archive or cache."""
    links = pattern.split("::")
    if len(links) == 1:
        return str(fs.unstrip_protocol(path))
    at = next(at for at, link in enumerate(links) if "://" in link)
    links[at] = f"{links[at].partition('://')[0]}://{path}"
    return "::".join(links)


def _remote_place(fs: Any, path: str, address: str) -> LogPlace:
    said = fs.info(path)
    try:
        changed = float(fs.modified(path).timestamp())
    except (NotImplementedError, AttributeError, KeyError, TypeError, OSError):
        changed = None
    mark = said.get("ETag") or said.get("etag") or said.get("md5Hash") or changed
    stamp = " ".join(str(each) for each in (said.get("size"), mark) if each is not None)
    return LogPlace(address, stamp, changed)


DATED_BY = ("file", "stamps")
"""Words that may be given instead of a pattern of dates in paths."""

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
    """Return the s since 1970 of a date in ISO 8601, in UTC unless it has another zone."""
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
    """Return a date in ISO 8601, of s since 1970."""
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")


def _day(seconds: float) -> str:
    return date_text(seconds).partition("T")[0]


def date_of_log(
    log: JointLog, files: Sequence[Path], given: float | None = None
) -> tuple[float, str]:
    """Return when a log began, s since 1970, and where that is from: `stamps`, `option` or `file`.

    Args:
        files: Its files, which count where nothing else is known: the one changed last.
        given: What the user says, s since 1970, where stamps do not say it.
    """
    first = float(log.time[np.isfinite(log.time)][0])
    began = first + 1e-9 * (log.origin or 0)
    if _EARLIEST < began < _LATEST:
        return began, "stamps"
    if given is not None:
        date, source, says = given, "option", "the given date is"
    else:
        date, source = max(path.stat().st_mtime for path in files), "file"
        says = "its modification time is"
    if not _EARLIEST < date < _LATEST:
        raise LogError(
            f"The date of log {log.name!r} is unknown: its time stamps are not dates, and "
            f"{says} {date:.10g} s since 1970.",
            advice="Use --date or, in a fleet file, `dates` and dates in the names of logs.",
        )
    return date, source


def check_date_pattern(pattern: str) -> None:
    """Raise for a pattern that no date in a path can match."""
    parts = [part for part in re.findall(r"%.?", pattern) if part != "%%"]
    if set(parts) - _TIMES not in _DATES or len(set(parts)) < len(parts):
        raise ArgumentError(
            f"dates has the invalid pattern {pattern!r}.",
            advice=f"Write %Y-%m-%d, or with others of {', '.join(_DIRECTIVES)}, each once; "
            f"or one of {', '.join(DATED_BY)}.",
        )


def date_in_path(path: str, pattern: str) -> float:
    """Return the s since 1970 of the last date like `%Y-%m-%d_%H%M` in a path, in UTC."""
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
