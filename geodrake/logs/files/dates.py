"""Time stamps that are dates, in ISO 8601: `2026-05-01T12:00:00.25+02:00`."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_DATE = re.compile(
    r"(\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d(?::\d\d)?)"
    r"(?:[.,](\d{1,9})\d*)?\s*([Zz]|UTC|[+-]\d\d(?::?\d\d)?)?"
)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_SECOND, _DAY = 1_000_000_000, 86_400  # ns, s
NO_DATE = np.iinfo(np.int64).min
"""What NumPy has for no date."""


def date_of(text: str) -> int | None:
    """The nanoseconds since 1970 of a date with its time of day; None if the text is none.

    Args:
        text: In ISO 8601, with a blank for the T if need be. Without a time zone it is in UTC.
    """
    found = _DATE.fullmatch(text.strip())
    if found is None:
        return None
    head, fraction, zone = found.groups()
    try:
        instant = datetime.fromisoformat(f"{head.upper()}{_offset(zone)}")
    except ValueError:  # the 30th of February
        return None
    since = instant - _EPOCH
    return (since.days * _DAY + since.seconds) * _SECOND + int((fraction or "").ljust(9, "0"))


def _offset(zone: str | None) -> str:
    if zone is None or zone.upper() in ("Z", "UTC"):
        return "+00:00"
    return zone if len(zone) > len("+00") else f"{zone}:00"


def date_words(nanoseconds: int) -> str:
    """A date as messages write it.

    Args:
        nanoseconds: Since 1970.
    """
    instant = _EPOCH + timedelta(microseconds=nanoseconds // 1000)
    return f"{instant:%Y-%m-%d %H:%M:%S} UTC"


def since_first(stamps: NDArray[np.int64]) -> tuple[Array, int]:
    """(N,) seconds from the first date on, NaN for none, and the first, ns since 1970.

    Args:
        stamps: (N,) ns since 1970, `NO_DATE` for none.
    """
    known = stamps != NO_DATE
    origin = int(stamps[known][0]) if known.any() else 0
    seconds = np.full(len(stamps), np.nan)
    seconds[known] = (stamps[known] - origin) / _SECOND
    return seconds, origin


def dates(array: NDArray[Any]) -> tuple[Array, int]:
    """Seconds of dates of NumPy; see `since_first`.

    Args:
        array: (N,) of a type `datetime64`.
    """
    return since_first(array.astype("datetime64[ns]").astype(np.int64))
